//! A critical alert reaches people by webhook and e-mail, is escalated until somebody acknowledges it, and the ping
//! falls silent with the observatory node.
#![cfg(unix)]

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::Router;
use axum::http::HeaderMap;
use axum::routing::{get, post};
use contract::node::NodeState;
use contract::observatory::Alerts;
use contract::{Address, Key, NodeTopic, Part, Role};
use serde_json::Value;
use test_support::{Harness, HarnessOptions, SITE, TELESCOPE, long_row, serve};
use tokio::io::{AsyncBufReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::net::{TcpListener, TcpStream};

/// The world outside: an HTTP server and a mail server that remember what they received.
#[derive(Clone, Default)]
struct Outside {
    hooks: Arc<Mutex<Vec<(String, Value)>>>,
    mails: Arc<Mutex<Vec<String>>>,
    pings: Arc<Mutex<Vec<Instant>>>,
}

impl Outside {
    /// Starts both; returns their ports.
    async fn open(&self) -> anyhow::Result<(u16, u16)> {
        let (hooks, pings, escalated) = (self.hooks.clone(), self.pings.clone(), self.hooks.clone());
        let remember = |list: Arc<Mutex<Vec<(String, Value)>>>, who: &'static str| {
            move |headers: HeaderMap, body: String| {
                let token = headers.get("authorization").and_then(|value| value.to_str().ok()).unwrap_or("").to_owned();
                list.lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .push((format!("{who} {token}"), serde_json::from_str(&body).unwrap_or_default()));
                std::future::ready("thanks")
            }
        };
        let app = Router::new()
            .route("/chat", post(remember(hooks, "chat")))
            .route("/chief", post(remember(escalated, "chief")))
            .route(
                "/ping",
                get(move || {
                    pings.lock().unwrap_or_else(PoisonError::into_inner).push(Instant::now());
                    std::future::ready("ok")
                }),
            );
        let smtp = TcpListener::bind("127.0.0.1:0").await?;
        let ports = (serve(app).await.port(), smtp.local_addr()?.port());
        let mails = self.mails.clone();
        tokio::spawn(async move {
            while let Ok((stream, _)) = smtp.accept().await {
                tokio::spawn(take_mail(stream, mails.clone()));
            }
        });
        Ok(ports)
    }

    /// How many mails have this in their subject.
    fn mails(&self, subject: &str) -> usize {
        let mails = self.mails.lock().unwrap_or_else(PoisonError::into_inner);
        let has = |mail: &&String| mail.lines().any(|line| line.starts_with("Subject:") && line.contains(subject));
        mails.iter().filter(has).count()
    }

    /// The number of webhook letters that `who` got with this event about this alert.
    fn letters(&self, who: &str, event: &str, id: &str) -> usize {
        let hooks = self.hooks.lock().unwrap_or_else(PoisonError::into_inner);
        let mine = hooks.iter().filter(|(to, _)| to.starts_with(who));
        let news = mine.flat_map(|(_, body)| body["news"].as_array().cloned().unwrap_or_default());
        news.filter(|news| news["event"] == event && news["alert"]["id"] == id).count()
    }
}

/// RFC 5321 as far as one mail goes.
async fn take_mail(stream: TcpStream, mails: Arc<Mutex<Vec<String>>>) -> anyhow::Result<()> {
    let (read, mut write) = stream.into_split();
    let mut lines = BufReader::new(read).lines();
    let mut mail: Option<String> = None;
    write.write_all(b"220 mail.test ESMTP\r\n").await?;
    while let Some(line) = lines.next_line().await? {
        let answer = match (&mut mail, line.as_str()) {
            (Some(text), ".") => {
                mails.lock().unwrap_or_else(PoisonError::into_inner).push(std::mem::take(text));
                mail = None;
                "250 taken"
            }
            (Some(text), line) => {
                text.push_str(line);
                text.push('\n');
                continue;
            }
            (None, "DATA") => {
                mail = Some(String::new());
                "354 go on"
            }
            (None, "QUIT") => "221 bye",
            (None, _) => "250 ok",
        };
        write.write_all(format!("{answer}\r\n").as_bytes()).await?;
    }
    Ok(())
}

/// The node processes with all receivers; the chief gets alerts that nobody acknowledged for 6 s.
async fn harness(outside: &Outside) -> anyhow::Result<Harness> {
    let (http, smtp) = outside.open().await?;
    let more = format!(
        "[[alerts.webhook]]\nname = \"chat\"\nurl = \"http://127.0.0.1:{http}/chat\"\ntoken_file = \"token\"\n\
         [[alerts.webhook]]\nname = \"chief\"\nurl = \"http://127.0.0.1:{http}/chief\"\nafter_min = 0.1\n\
         min_priority = \"critical\"\n\
         [[alerts.webhook]]\nname = \"dead\"\nurl = \"http://127.0.0.1:1/\"\n\
         [alerts.smtp]\nserver = \"127.0.0.1\"\nport = {smtp}\nsecurity = \"none\"\nfrom = \"t@example.org\"\n\
         [[alerts.email]]\nname = \"night\"\nto = [\"ana@example.org\"]\n\
         [alerts.ping]\nurl = \"http://127.0.0.1:{http}/ping\"\nperiod_s = 1\n"
    );
    let mut harness = Harness::new(HarnessOptions { more, ..HarnessOptions::default() }, long_row).await?;
    std::fs::write(harness.path("token"), "s3cret\n")?;
    for role in [Role::Device, Role::Observatory] {
        harness.start(role)?;
    }
    harness.until("the dome opens on a safe sky", 60.0, Harness::is_open).await?;
    Ok(harness)
}

const ID: &str = "dome-not-closed/dome";

#[tokio::test(flavor = "multi_thread")]
async fn a_critical_alert_is_sent_escalated_acknowledged_and_cleared() -> anyhow::Result<()> {
    let outside = Outside::default();
    let mut harness = harness(&outside).await?;
    let key = Key::Observatory(Address::new(SITE, TELESCOPE)?, Part::Alerts);
    let alerts = harness.bus.latest::<Alerts>(&key).await?;
    let find = |id: &str| {
        alerts.get().and_then(|received| received.sample.body.alerts.into_iter().find(|alert| alert.id == id))
    };

    harness.simulator.world().stick_shutter_half_open(true);
    harness.simulator.world().set_unsafe(true);
    harness.until("the alert is active on the bus", 60.0, |_| find(ID).is_some()).await?;
    let is_received = |_: &Harness| {
        let mailed = outside
            .mails
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .iter()
            .any(|mail| mail.contains(ID) && mail.contains("What to do"));
        mailed && outside.letters("chat Bearer s3cret", "raised", ID) == 1
    };
    harness.until("people get alerts within seconds", 5.0, is_received).await?;
    assert_eq!(outside.letters("chief", "raised", ID), 0, "too early to escalate");
    harness.until("it is escalated", 15.0, |_| outside.letters("chief", "raised", ID) == 1).await?;

    let refused = harness.order(&["ack", "dome-not-closed/other"]).await.unwrap_err().to_string();
    assert!(refused.contains(ID), "the refusal names what stands: {refused}");
    let refused = harness.order(&["shelve", ID]).await.unwrap_err().to_string();
    assert!(refused.contains("reason"), "{refused}");
    harness.order(&["ack", ID]).await?;
    harness.until("the list says who", 5.0, |_| find(ID).is_some_and(|alert| alert.acknowledged_by.is_some())).await?;
    harness.until("people learn who", 5.0, |_| outside.letters("chat", "acknowledged", ID) == 1).await?;

    let boot_id = alerts.get().map(|received| received.sample.boot_id);
    harness.kill(Role::Observatory)?;
    harness.start(Role::Observatory)?;
    let known = |_: &Harness| {
        let is_new = alerts.get().is_some_and(|received| Some(received.sample.boot_id) != boot_id);
        is_new && find(ID).is_some_and(|alert| alert.acknowledged_by.is_some())
    };
    harness.until("the acknowledgement outlives a restart", 60.0, known).await?;
    tokio::time::sleep(Duration::from_secs(8)).await;
    assert_eq!(outside.letters("chief", "raised", ID), 1, "it is not escalated again");
    assert_eq!(outside.letters("chat", "raised", ID), 1, "nor sent again");

    let dead = |_: &Harness| outside.letters("chat", "raised", "alert-not-sent/dead") >= 1;
    harness.until("a receiver that fails is an alert for the others", 40.0, dead).await?;

    harness.order(&["shelve", "alert-not-sent/dead", "--for-min", "10", "--reason", "known"]).await?;
    let shelved = |_: &Harness| find("alert-not-sent/dead").is_some_and(|alert| alert.shelved_until_utc.is_some());
    harness.until("the shelf shows", 5.0, shelved).await?;
    harness.order(&["unshelve", "alert-not-sent/dead"]).await?;
    harness.until("and can be emptied", 5.0, |harness| !shelved(harness)).await?;

    harness.simulator.world().stick_shutter_half_open(false);
    harness.until("the dome ends shut", 90.0, Harness::is_shut).await?;
    harness.until("the acknowledged alert clears", 90.0, |_| find(ID).is_none()).await?;
    Ok(())
}

/// The next sender knows what was sent: from its own disk after a restart, and from the bus where it is another host.
#[tokio::test(flavor = "multi_thread")]
async fn what_was_sent_is_not_sent_again_after_a_restart_or_by_the_standby_which_sends_what_is_new()
-> anyhow::Result<()> {
    let outside = Outside::default();
    let mut harness = harness(&outside).await?;
    let address = Address::new(SITE, TELESCOPE)?;
    let alerts = harness.bus.latest::<Alerts>(&Key::Observatory(address.clone(), Part::Alerts)).await?;
    let stands =
        |id: &str| alerts.get().is_some_and(|received| received.sample.body.alerts.iter().any(|alert| alert.id == id));
    let boot_id = || alerts.get().map(|received| received.sample.boot_id);
    let mailed = |id: &str| outside.mails(&format!("raised: {id}"));
    let counts = |id: &str| (outside.letters("chat", "raised", id), mailed(id));

    harness.simulator.world().stick_shutter_half_open(true);
    harness.simulator.world().set_unsafe(true);
    harness.until("people get it by webhook and mail", 90.0, |_| counts(ID) == (1, 1)).await?;
    // A sender knows that a letter arrived once its receiver has confirmed it, a moment after it has the letter: a
    // sender that is killed within that moment sends twice rather than never.
    tokio::time::sleep(Duration::from_secs(2)).await;

    let first = boot_id();
    harness.kill(Role::Observatory)?;
    harness.start(Role::Observatory)?;
    harness.until("its next incarnation publishes it", 60.0, |_| boot_id() != first && stands(ID)).await?;
    // Longer than it waits for the report of others.
    tokio::time::sleep(Duration::from_secs(15)).await;
    assert_eq!(counts(ID), (1, 1), "nobody acknowledged it, and it is sent once all the same");

    harness.start_standby_apart()?;
    let key = Key::Node(address, Role::Observatory, "second".parse()?, NodeTopic::State);
    let standby = harness.bus.latest::<NodeState>(&key).await?;
    harness.until("the standby is there", 30.0, |_| standby.get().is_some()).await?;
    tokio::time::sleep(Duration::from_secs(3)).await;
    harness.kill(Role::Observatory)?;
    let silent = "node-silent/observatory/main";
    harness.until("the standby alerts that the commander is dead", 75.0, |_| counts(silent) == (1, 1)).await?;
    assert!(stands(ID), "and goes on with what stood: {}", harness.last_words());
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert_eq!((counts(silent), counts(ID)), ((1, 1), (1, 1)), "and repeats nothing");

    harness.simulator.world().stick_shutter_half_open(false);
    harness.until("the dome ends shut", 90.0, Harness::is_shut).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn the_ping_stops_with_the_observatory_node() -> anyhow::Result<()> {
    let outside = Outside::default();
    let harness = harness(&outside).await?;
    let pings = || outside.pings.lock().unwrap_or_else(PoisonError::into_inner).len();
    harness.until("pings come", 15.0, |_| pings() >= 3).await?;
    harness.stop_in_its_tracks(Role::Observatory)?;
    tokio::time::sleep(Duration::from_secs(2)).await;
    let before = pings();
    tokio::time::sleep(Duration::from_secs(6)).await;
    assert_eq!(pings(), before, "a stuck node does not ping");
    harness.until("the guard closes", 60.0, Harness::is_shut).await?;
    Ok(())
}
