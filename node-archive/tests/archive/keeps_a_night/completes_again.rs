//! A header that was complete before the telemetry came is completed again when a person orders it.

use bus::{Catch, Quality};
use contract::archive::Stored;
use contract::observatory::{NightState, OrderTaken, Posture};
use contract::{CommandId, Key, Part};
use test_support::until;

use super::{Spool, address, archive, header_of, mount, recv_stored, run, state_of_mount, two_buses};

fn night(order: Option<OrderTaken>) -> NightState {
    NightState {
        robotic: true,
        posture: Posture::Closed,
        actions: Vec::new(),
        frames: 1,
        open_s: 0.0,
        speed: 1.0,
        simulated: false,
        ended: false,
        last_frame: None,
        triggers: Vec::new(),
        last_order: order,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_completes_a_night_again_with_telemetry_that_came_late() {
    let folder = tempfile::tempdir().unwrap();
    let (device_bus, archive_bus) = two_buses().await;
    let spool = Spool::start(device_bus.clone()).await;
    let stored = device_bus.subscribe::<Stored>(&Key::Stored(address()).to_string(), Catch::All, 100).await.unwrap();
    let node = archive(folder.path(), archive_bus);
    let place = node.config.place.clone();
    let running = run(node);
    let started = device_bus.clock().utc();
    spool.frames.put(spool.frame("frame-1", started)).await.unwrap();
    let file = recv_stored(&stored, true).await.file;
    let path = folder.path().join("images").join(file);
    let notes = || header_of(&path).cards().filter(|card| card.starts_with("HISTORY not known")).collect::<String>();
    assert!(header_of(&path).value("ALTITUDE").is_none() && notes().contains("ALTITUDE"), "{}", notes());

    // The mount's node was away, and now publishes what it read before and after the exposure.
    let states = device_bus.publisher_as(&Key::State(mount()), Quality::State { cache: 600 }).await.unwrap();
    for seconds in [-1.0, 1.0] {
        let at = started.plus_seconds(seconds);
        let readings = serde_json::json!({ "Altitude": { "value": 50.0 + seconds, "unit": "deg", "at_utc": at } });
        states.put(state_of_mount(readings)).await.unwrap();
    }
    let nights = device_bus.publisher(&Key::Observatory(address(), Part::Night)).await.unwrap();
    nights.put(night(None)).await.unwrap();
    tokio::time::sleep(std::time::Duration::from_secs(2)).await;
    assert!(header_of(&path).value("ALTITUDE").is_none(), "nobody has ordered it");
    let longitude = units::Angle::from_degrees(place.longitude_deg);
    let date = |utc| sky::night_date(longitude, utc).to_string();
    let order = |id: &str, verb: &str, night: Option<String>| {
        let (id, from) = (CommandId(id.to_owned()), "cli/ana@dome-pc".to_owned());
        Some(OrderTaken { id, from, verb: verb.to_owned(), at_utc: started, night })
    };
    // Another order, and one about another night.
    nights.put(night(order("a", "close", None))).await.unwrap();
    nights.put(night(order("b", "complete_headers", Some("20200101".to_owned())))).await.unwrap();
    nights.put(night(order("c", "complete_headers", Some(date(started))))).await.unwrap();
    until("the altitude is in the header", || header_of(&path).value("ALTITUDE").as_deref() == Some("50.0")).await;
    assert!(!notes().contains("ALTITUDE"), "{}", notes());
    let again = recv_stored(&stored, true).await;
    assert_eq!(again.frame.0, "frame-1");

    // The disk goes away, and another order comes while this one waits for it.
    let (images, away) = (folder.path().join("images"), folder.path().join("away"));
    std::fs::rename(&images, &away).unwrap();
    nights.put(night(order("d", "complete_headers", Some(date(started))))).await.unwrap();
    let alerts = running.node.alerts.watch();
    let active = |words: &str| {
        alerts.borrow().alerts.iter().any(|alert| alert.cause.contains(words) && alert.returned_utc.is_none())
    };
    until("the alert names the folder", || active("images/.part is not there: its disk may be away. Mount it")).await;
    nights.put(night(order("e", "close", None))).await.unwrap();
    std::fs::rename(&away, &images).unwrap();
    assert_eq!(recv_stored(&stored, true).await.frame.0, "frame-1", "it goes on when the disk is back");
    until("the alert is over", || !active("its disk may be away")).await;
    running.stop().await;
}
