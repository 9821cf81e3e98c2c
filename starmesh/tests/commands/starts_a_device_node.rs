//! `starmesh node device` as a supervisor starts it, on a configuration with which it cannot run.

use std::fs;
use std::process::Stdio;

use bus::{Catch, Clock};
use contract::observatory::Alerts;
use contract::{Address, Key, NodeTopic, Role};
use test_support::{ALPHA, LIMIT, block, private_bus};

/// Nothing has worked yet, so there is no copy of a configuration that worked; the alert needs only one that can be
/// read.
#[tokio::test(flavor = "multi_thread")]
async fn a_device_node_that_fails_from_its_first_start_on_raises_guard_process() {
    let folder = tempfile::tempdir().unwrap();
    // A file takes the place of the data folder.
    fs::write(folder.path().join("data"), "").unwrap();
    let bus = private_bus(Clock::machine_clock()).await;
    let meeting = format!("[bus]\nconnect = {:?}\nmulticast = false\n", bus.locators().await);
    let file = folder.path().join("observatory.toml");
    fs::write(&file, format!("{ALPHA}{meeting}{}", block("dome", "dome", "127.0.0.1:9", "node = \"main\""))).unwrap();
    let key = Key::Node(
        Address::new("site", "alpha").unwrap(),
        Role::Device,
        "main-guard".parse().unwrap(),
        NodeTopic::Alerts,
    );
    let alerts = bus.subscribe::<Alerts>(&key.to_string(), Catch::Newest, 100).await.unwrap();
    let _program = tokio::process::Command::new(env!("CARGO_BIN_EXE_starmesh"))
        .args(["node", "device", "--id", "main", "--config"])
        .arg(&file)
        .current_dir(folder.path())
        .env("STATE_DIRECTORY", folder.path().join("state"))
        .env_remove("NOTIFY_SOCKET")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .kill_on_drop(true)
        .spawn()
        .unwrap();
    let raised = async {
        loop {
            let raised = alerts.recv().await.sample.body.alerts;
            if let Some(alert) = raised.into_iter().find(|alert| alert.id.as_str() == "guard-process/dome") {
                return alert;
            }
        }
    };
    let alert = tokio::time::timeout(LIMIT, raised).await.expect("no alert guard-process/dome");
    assert!(alert.cause.contains("does not guard"), "{}", alert.cause);
}
