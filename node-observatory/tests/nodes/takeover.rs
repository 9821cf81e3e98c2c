//! A standby with a data folder of its own takes over what people ordered, and orders are on disk before they count.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Duration;

use contract::device::dome::{Command as Dome, Shutter};
use contract::observatory::{Alert, OperatorOrders};
use contract::{CommandId, Key, Order, OrderKind, Part, Reason, Reply};

use crate::MOST;
use crate::site::{Site, ask};

const SEEN: &str = "stay-closed";
pub const SHELVED: &str = "override/sun";

/// A site that opens whenever it may.
pub async fn eager_site() -> Site {
    let site = Site::new(1.0).await;
    // Near the zenith, and without an end.
    let object = r#"{"object": "x", "exptime": 10, "ra": 45.0, "dec": -24.6}"#;
    site.write_schedule(&[("object", object, "03:00:00", "05:00:00")]);
    site
}

pub fn is_open(site: &Site) -> bool {
    site.shutter() == Some(Shutter::Open)
}

pub fn is_shut(site: &Site) -> bool {
    site.shutter() == Some(Shutter::Closed)
}

fn openings(site: &Site) -> usize {
    site.dome.log.lock().unwrap().iter().filter(|(_, command)| *command == Dome::OpenShutter).count()
}

pub fn alert(site: &Site, id: &str) -> Option<Alert> {
    site.alerts.get()?.sample.body.alerts.into_iter().find(|alert| alert.id == id)
}

pub fn accepted(reply: Reply) {
    assert!(matches!(reply, Reply::Accepted(_)), "{reply:?}");
}

fn refused(reply: Reply) -> (Reason, String) {
    match reply {
        Reply::Refusal(refusal) => (refusal.reason, refusal.detail),
        Reply::Accepted(_) => panic!("it was accepted"),
    }
}

fn reason(site: &Site) -> String {
    let safety = site.safety.get().map(|received| received.sample.body.reasons).unwrap_or_default();
    safety.iter().map(|reason| reason.why.clone()).collect::<Vec<_>>().join("; ")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_veto_an_override_and_acknowledgements_outlive_the_commander_and_its_disk() {
    let site = eager_site().await;
    let first = site.start_as("main", "data-main").await;
    site.until("open", MOST, is_open).await;
    let second = site.start_as("second", "data-second").await;
    site.until_up("second").await;
    accepted(site.order(OrderKind::Override { input: "sun".to_owned(), for_s: 3600.0 }).await);
    accepted(site.order(OrderKind::StayClosed(true)).await);
    site.until("shut", MOST, is_shut).await;
    site.until("the alerts are active", MOST, |site| alert(site, SEEN).is_some() && alert(site, SHELVED).is_some())
        .await;
    accepted(site.order(OrderKind::Acknowledge(SEEN.to_owned())).await);
    accepted(site.order(OrderKind::Shelve { alert: SHELVED.to_owned(), for_s: 600.0 }).await);
    let marked = |site: &Site| {
        alert(site, SEEN).is_some_and(|alert| alert.acknowledged_by.as_deref() == Some("test"))
            && alert(site, SHELVED).is_some_and(|alert| alert.shelved_until_utc.is_some())
    };
    site.until("marked", MOST, marked).await;
    // The standby has had its two seconds.
    tokio::time::sleep(Duration::from_secs(2)).await;
    let (before, opened) = (site.alerts.get().unwrap().sample.boot_id, openings(&site));

    first.kill().await;
    std::fs::remove_dir_all(site.folder.path().join("data-main")).unwrap();
    let taken = |site: &Site| site.alerts.get().is_some_and(|received| received.sample.boot_id != before);
    site.until("taken over", MOST, taken).await;
    assert!(marked(&site), "the first word of the new commander knows: {:?}", site.alerts.get());
    site.until("the verdict says who ordered it", MOST, |site| reason(site).contains("test ordered it: a test")).await;
    let overridden = alert(&site, SHELVED).unwrap();
    assert!(overridden.cause.contains("by test: a test"), "{}", overridden.cause);
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert_eq!((openings(&site), is_shut(&site)), (opened, true), "the second does not open");

    // And nothing but the order kept it shut.
    accepted(site.order(OrderKind::StayClosed(false)).await);
    site.until("open again", MOST, is_open).await;
    second.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_standby_that_never_received_from_the_commander_stays_closed_until_a_person_decides() {
    let site = eager_site().await;
    let first = site.start_as("main", "data-main").await;
    site.until("open", MOST, is_open).await;
    first.kill().await;
    let opened = openings(&site);
    let second = site.start_as("second", "data-second").await;
    site.until("shut", MOST, is_shut).await;
    site.until("it says why", MOST, |site| reason(site).contains(" were not received")).await;
    assert_eq!(openings(&site), opened);
    accepted(site.order(OrderKind::StayClosed(false)).await);
    site.until("open again", MOST, is_open).await;
    // A restart knows this: it released the lease, and is granted it at once.
    second.stop().await;
    let moved = site.dome.log.lock().unwrap().len();
    let held = site.tokens.load(Ordering::SeqCst);
    let second = site.start_as("second", "data-second").await;
    let key = Key::Observatory(site.address.clone(), Part::OperatorOrders);
    let orders = site.bus.latest::<OperatorOrders>(&key).await.unwrap();
    // On a busy machine it may be granted more than one.
    let commands = |_: &Site| orders.get().is_some_and(|received| received.sample.body.token > Some(held));
    site.until("it commands", MOST, commands).await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(orders.get().unwrap().sample.body.stay_closed, None);
    assert_eq!(site.dome.log.lock().unwrap().len(), moved, "and nothing moves for it");
    second.stop().await;
}

/// Makes a disk fail for one file of the node `main`: a folder is where the file would be written.
pub fn part(site: &Site, file: &str) -> PathBuf {
    site.folder.path().join("data").join(format!("{file}-callisto.json.main.part"))
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_that_the_disk_does_not_take_is_refused_and_closing_acts_all_the_same() {
    let site = eager_site().await;
    let node = site.start().await;
    site.until("open", MOST, is_open).await;
    accepted(site.order(OrderKind::Override { input: "sun".to_owned(), for_s: 3600.0 }).await);
    site.until("the alert is active", MOST, |site| alert(site, SHELVED).is_some()).await;
    for file in ["operator-orders", "alerts"] {
        // A change that is just being written is there for a moment.
        site.until("a folder in the way", MOST, |site| std::fs::create_dir(part(site, file)).is_ok()).await;
    }
    let refusals = [
        OrderKind::Override { input: "sun".to_owned(), for_s: 60.0 },
        OrderKind::Acknowledge(SHELVED.to_owned()),
        OrderKind::Shelve { alert: SHELVED.to_owned(), for_s: 60.0 },
    ];
    for order in refusals {
        let (reason, why) = refused(site.order(order.clone()).await);
        assert_eq!(reason, Reason::NotNow, "{order:?}: {why}");
        assert!(why.contains("the disk does not take it") && why.contains("-callisto.json"), "{why}");
    }
    let seen = alert(&site, SHELVED).unwrap();
    assert_eq!((seen.acknowledged_by, seen.shelved_until_utc), (None, None), "and nothing is changed");

    let closes = Order {
        id: CommandId::fresh(),
        from: "cli/ana@dome-pc".to_owned(),
        reason: "a test".to_owned(),
        kind: OrderKind::StayClosed(true),
        seen: None,
    };
    let not_written = async || match ask(&site.bus, &site.address, &closes).await {
        Reply::Accepted(accepted) => accepted.not_written,
        refused @ Reply::Refusal(_) => panic!("{refused:?}"),
    };
    let why = not_written().await.unwrap();
    assert!(why.contains("operator-orders-callisto.json: "), "who orders learns that it is not on disk: {why}");
    site.until("shut", MOST, is_shut).await;
    let named = "what people ordered (stay-closed of ana, override sun of test) cannot be written down: ";
    let is_reported = |site: &Site| alert(site, "operator-orders").is_some_and(|alert| alert.cause.starts_with(named));
    site.until("it is reported", MOST, is_reported).await;
    let (_, why) = refused(site.order(OrderKind::StayClosed(false)).await);
    assert!(why.contains("the disk does not take it"), "{why}");
    site.until("still closed", MOST, |site| is_shut(site) && reason(site).contains("a test")).await;

    // The disk is repaired: what acted is written, and can be taken back.
    for file in ["operator-orders", "alerts"] {
        std::fs::remove_dir(part(&site, file)).unwrap();
    }
    let file = site.folder.path().join("data/operator-orders-callisto.json");
    let written = |_: &Site| std::fs::read_to_string(&file).is_ok_and(|text| text.contains("stay_closed"));
    site.until("written", MOST, written).await;
    // Whoever asks again learns that it is on disk now.
    let told = async { while not_written().await.is_some() {} };
    tokio::time::timeout(MOST, told).await.unwrap();
    accepted(site.order(OrderKind::StayClosed(false)).await);
    assert!(!std::fs::read_to_string(&file).unwrap().contains("stay_closed"), "on disk when it is answered");
    site.until("open again", MOST, is_open).await;
    node.stop().await;
}
