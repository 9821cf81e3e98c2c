//! An archive node that hands nights over by itself: to a share that is away, and comes.

use std::fs;

use bus::Clock;
use contract::CommandId;
use contract::Role;
use contract::device::camera::{Frame, Purpose};
use node::{Node, NodeAlerts};
use node_archive::database::{Database, StoredImage, Write};
use test_support::{PARANAL, RunningNode, private_bus, until};
use units::Utc;

fn frame(id: &str, started_utc: Utc) -> Frame {
    Frame {
        camera: "main".to_owned(),
        purpose: Purpose { image_type: "light".to_owned(), action: "object".to_owned(), ..Purpose::default() },
        started_utc,
        exposure_s: 1.0,
        sha256: "ab".to_owned(),
        ..test_support::frame(id)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_night_that_is_late_raises_an_alert_and_is_delivered_when_the_share_comes() {
    let folder = tempfile::tempdir().unwrap();
    let bus = private_bus(Clock::machine_clock()).await;
    let share = folder.path().join("share");
    let text = format!("{PARANAL}[archive]\nbackup_count = 0\n[[delivery]]\nname = \"share\"\ndirectory = \"share\"\n");
    let config = config::parse(&text, folder.path()).unwrap();
    let started = bus.clock().utc().plus_seconds(-3.0 * 86_400.0);
    let path = config.folders.images.join("a.fits");
    fs::create_dir_all(&config.folders.images).unwrap();
    fs::write(&path, "a frame").unwrap();
    let (database, writer) =
        Database::open(&config.archive.database, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let image = StoredImage { frame: frame("a", started), file: "a.fits".to_owned(), bytes: 7, stored: started };
    database
        .commit(vec![Write::Stored(Box::new(image), path), Write::Complete(CommandId("a".to_owned()))])
        .await
        .unwrap();
    drop(database);
    writer.end().await;

    let node = Node::new(Role::Archive, "main".parse().unwrap(), config, Default::default(), bus);
    let alerts = node.alerts.watch();
    let cause = move || {
        let alerts = serde_json::to_value(&*alerts.borrow()).unwrap();
        let list = alerts["alerts"].as_array().cloned().unwrap_or_default();
        list.into_iter().find(|alert| alert.to_string().contains("archive/delivery")).map(|alert| alert.to_string())
    };
    let _node = RunningNode::work(node, node_archive::run);
    until("the night is late", || cause().is_some_and(|cause| cause.contains("mount the share"))).await;
    assert!(!share.exists());
    fs::create_dir(&share).unwrap();
    let there = share.join("paranal/callisto");
    until("the night is there", || {
        let names = fs::read_dir(&there).into_iter().flatten().flatten().map(|entry| entry.file_name());
        names.into_iter().any(|name| name.to_string_lossy().ends_with(".manifest.json"))
    })
    .await;
    assert_eq!(fs::read(there.join("a.fits")).unwrap(), b"a frame");
    until("the alert is over", || cause().is_none()).await;
}
