//! The observatory node dies, and people are informed once: by an archive node, or by one of two web nodes. It comes
//! back, and nobody gets anything twice.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::Router;
use axum::routing::post;
use contract::observatory::Alerts;
use contract::{Address, Key, NodeTopic, Part, Role};
use serde_json::Value;
use test_support::{Harness, HarnessOptions, SITE, TELESCOPE, long_row, serve};

const SILENT: &str = "node-silent/observatory/main";
/// Alerts that are sent before the observatory node dies and stay active all the time: a full disk, which each node
/// reports, and a receiver that cannot be reached, which only the senders can know.
const BEFORE: [&str; 2] = ["disk/data", "alert-not-sent/dead"];

/// The receiver of the alerts.
#[derive(Clone, Default)]
struct Chat(Arc<Mutex<Vec<Value>>>);

impl Chat {
    async fn open(&self) -> u16 {
        let letters = self.0.clone();
        let take = move |body: String| {
            letters
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(serde_json::from_str(&body).unwrap_or_default());
            std::future::ready("thanks")
        };
        serve(Router::new().route("/", post(take))).await.port()
    }

    /// Every event so far, in order, such as `raised no-lease`.
    fn events(&self) -> Vec<String> {
        let letters = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let news = letters.iter().flat_map(|letter| letter["news"].as_array().cloned().unwrap_or_default());
        let words = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        news.map(|news| format!("{} {}", words(&news["event"]), words(&news["alert"]["id"]))).collect()
    }

    fn count(&self, event: &str) -> usize {
        self.events().iter().filter(|one| *one == event).count()
    }
}

/// Waits for a message and longer: it came once, and no message came twice.
async fn once(harness: &Harness, chat: &Chat, event: &str, limit_s: f64) -> anyhow::Result<()> {
    harness.until(event, limit_s, |_| chat.count(event) > 0).await?;
    tokio::time::sleep(Duration::from_secs(4)).await;
    for event in chat.events() {
        assert_eq!(chat.count(&event), 1, "{event} came more than once: {:?}", chat.events());
    }
    Ok(())
}

async fn play(role: Role, ids: &[&str]) -> anyhow::Result<()> {
    let chat = Chat::default();
    let port = chat.open().await;
    let more = format!(
        "[safety]\ndisk_free_min_gb = 1000000\n[alerts]\nsend_when_observatory_silent_s = 20\nstand_in = \"{}\"\n\
         [[alerts.webhook]]\nname = \"chat\"\nurl = \"http://127.0.0.1:{port}/\"\n\
         [[alerts.webhook]]\nname = \"dead\"\nurl = \"http://127.0.0.1:1/\"\n",
        role.word()
    );
    let mut harness = Harness::new(HarnessOptions { more, ..HarnessOptions::default() }, long_row).await?;
    for role in [Role::Device, role, Role::Observatory] {
        harness.start(role)?;
    }
    if ids.len() > 1 {
        harness.start_second(role)?;
    }
    let address = Address::new(SITE, TELESCOPE)?;
    let merged = harness.bus.latest::<Alerts>(&Key::Observatory(address.clone(), Part::Alerts)).await?;
    let mut own = Vec::new();
    for id in ids {
        own.push(
            harness.bus.latest::<Alerts>(&Key::Node(address.clone(), role, id.parse()?, NodeTopic::Alerts)).await?,
        );
    }
    let raised = format!("raised {SILENT}");
    let stands = |latest: &bus::Latest<Alerts>, id: &str| {
        latest.get().is_some_and(|received| received.sample.body.alerts.iter().any(|alert| alert.id == id))
    };
    for id in BEFORE {
        harness.until("what stands before is alerted", 60.0, |_| stands(&merged, id)).await?;
        once(&harness, &chat, &format!("raised {id}"), 20.0).await?;
    }
    assert_eq!(chat.count(&raised), 0, "nobody stands in for a node that lives");

    harness.kill(Role::Observatory)?;
    once(&harness, &chat, &raised, 60.0).await?;
    harness.until("all that stand in say so", 10.0, |_| own.iter().all(|latest| stands(latest, SILENT))).await?;

    harness.start(Role::Observatory)?;
    let over = format!("returned {SILENT}");
    once(&harness, &chat, &over, 90.0).await?;
    harness.until("who stood in is content", 20.0, |_| own.iter().all(|latest| !stands(latest, SILENT))).await?;
    for id in BEFORE {
        assert!(stands(&merged, id), "{id} still stands");
        assert_eq!(chat.count(&format!("raised {id}")), 1, "and was reported once: {:?}", chat.events());
    }
    harness.until("the dome ends shut", 60.0, Harness::is_shut).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn an_archive_node_alerts_once_that_the_observatory_is_dead_and_falls_silent_when_it_is_back()
-> anyhow::Result<()> {
    play(Role::Archive, &["main"]).await
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_web_nodes_one_sends_it() -> anyhow::Result<()> {
    play(Role::Web, &["main", "second"]).await
}
