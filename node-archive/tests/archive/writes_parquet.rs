//! An archive node that writes the nights that are over as Parquet, and reports when it cannot.

use std::path::Path;

use contract::{Address, Kind, Role, Scalar};
use node::{Node, NodeAlerts};
use node_archive::database::{Database, Write};
use node_archive::night::Night;
use test_support::{PARANAL, RunningNode, block, join, private_bus, until};
use units::Utc;

use crate::in_the_night;

fn folders(table: &Path) -> Vec<String> {
    let telescope = table.join("site=paranal/telescope=callisto");
    let entries = std::fs::read_dir(telescope).into_iter().flatten().flatten();
    let mut found: Vec<String> = entries.map(|entry| entry.file_name().into_string().unwrap()).collect();
    found.sort();
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn finished_nights_are_written_and_a_folder_that_takes_none_raises_an_alert() {
    let folder = tempfile::tempdir().unwrap();
    let bus = private_bus(in_the_night()).await;
    let station = block("observingconditions", "wx", "localhost:1", "");
    let text = format!("{PARANAL}[archive]\nparquet = \"network\"\n{station}");
    let config = config::parse(&text, folder.path()).unwrap();

    // One value a day: today, in each of the last three nights, and long ago.
    let now = bus.clock().utc();
    let device = Address::new("paranal", "callisto").unwrap().device(Kind::ObservingConditions, &"wx".parse().unwrap());
    let alerts = NodeAlerts::new(bus.clock().clone());
    let (database, writer) = Database::open(&config.archive.database, "callisto", alerts).unwrap();
    let days_ago = [0.0, 1.0, 2.0, 3.0, 30.0].map(|days| now.plus_seconds(-days * 86_400.0));
    for at in days_ago {
        let value = Ok(Scalar::Float(12.5));
        let write = Write::Reading { device: device.clone(), property: "WindGust".to_owned(), value, at };
        database.commit(vec![write]).await.unwrap();
    }
    drop(database);
    writer.end().await;
    let name = |at: &Utc| format!("night={}", Night::at(*at, &config.place).date);
    let mut finished: Vec<String> = days_ago[1..].iter().map(name).collect();
    finished.sort();

    let network = folder.path().join("network");
    std::fs::create_dir_all(&network).unwrap();
    std::fs::write(network.join("minutes"), "in the way").unwrap();
    let start = async || {
        let node =
            Node::new(Role::Archive, "main".parse().unwrap(), config.clone(), Default::default(), join(&bus).await);
        RunningNode::work(node, node_archive::run)
    };
    let running = start().await;
    let cause = || {
        let alerts = running.node.alerts.watch();
        let found = alerts.borrow().alerts.iter().find(|alert| alert.id.contains("archive/parquet")).cloned();
        found.map(|alert| alert.cause)
    };
    until("an alert", || cause().is_some()).await;
    let cause = cause().unwrap();
    assert!(cause.contains("network/minutes") && cause.contains("tried again"), "{cause}");
    running.stop().await;
    assert!(folders(&network.join("nights")).is_empty());

    // A night whose file is damaged keeps no other from being written.
    std::fs::remove_file(network.join("minutes")).unwrap();
    let damaged = network.join(format!("minutes/site=paranal/telescope=callisto/{}/part-0.parquet", finished[0]));
    std::fs::create_dir_all(damaged.parent().unwrap()).unwrap();
    std::fs::write(&damaged, "no Parquet").unwrap();
    let running = start().await;
    until("all other nights", || folders(&network.join("nights")) == finished[1..]).await;
    until("an alert", || {
        running.node.alerts.watch().borrow().alerts.iter().any(|alert| alert.cause.contains("part-0"))
    })
    .await;
    running.stop().await;
    std::fs::remove_file(&damaged).unwrap();

    let running = start().await;
    until("the finished nights", || folders(&network.join("nights")) == finished).await;
    running.stop().await;
    assert_eq!(folders(&network.join("telemetry")), finished, "and not the night that is not over");
    let read = |night: &str| {
        std::fs::read(network.join(format!("telemetry/site=paranal/telescope=callisto/{night}/part-0.parquet")))
    };
    assert!(finished.iter().all(|night| read(night).unwrap().starts_with(b"PAR1")));
}
