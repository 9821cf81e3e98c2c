//! `starmesh node device` as a supervisor starts it, on a configuration with which it cannot run.

use std::fs;
use std::process::Stdio;

use bus::{Bus, Catch, Clock, Received, Subscriber};
use contract::observatory::{Alert, Alerts};
use contract::{Address, Key, NodeTopic, Role};
use test_support::{ALPHA, LIMIT, block, private_bus};
use tokio::process::Child;

/// A device node that cannot start: a file takes the place of its data folder.
struct DeviceNode {
    folder: tempfile::TempDir,
    _bus: Bus,
    alerts: Subscriber<Alerts>,
}

impl DeviceNode {
    async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("data"), "").unwrap();
        let bus = private_bus(Clock::machine_clock()).await;
        let meeting = format!("[bus]\nconnect = {:?}\nmulticast = false\n", bus.locators().await);
        let dome = block("dome", "dome", "127.0.0.1:9", "node = \"main\"");
        fs::write(folder.path().join("observatory.toml"), format!("{ALPHA}{meeting}{dome}")).unwrap();
        let address = Address::new("site", "alpha").unwrap();
        let key = Key::Node(address, Role::Device, "main-guard".parse().unwrap(), NodeTopic::Alerts);
        let alerts = bus.subscribe::<Alerts>(&key.to_string(), Catch::Newest, 100).await.unwrap();
        Self { folder, _bus: bus, alerts }
    }

    /// It ends with the test.
    fn start(&self) -> Child {
        tokio::process::Command::new(env!("CARGO_BIN_EXE_starmesh"))
            .args(["node", "device", "--id", "main", "--with-parent", "--config"])
            .arg(self.folder.path().join("observatory.toml"))
            .current_dir(self.folder.path())
            .env("STATE_DIRECTORY", self.folder.path().join("state"))
            .env_remove("NOTIFY_SOCKET")
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .spawn()
            .unwrap()
    }

    /// Waits for such a list of its guard process's alerts.
    async fn until(&self, what: &str, is_it: impl Fn(&Received<Alerts>) -> bool) -> Received<Alerts> {
        let listening = async {
            loop {
                let received = self.alerts.recv().await;
                if is_it(&received) {
                    return received;
                }
            }
        };
        tokio::time::timeout(LIMIT, listening).await.unwrap_or_else(|_| panic!("{what}"))
    }
}

fn guard_process(list: &Received<Alerts>) -> Option<&Alert> {
    list.sample.body.alerts.iter().find(|alert| alert.id == "guard-process/dome")
}

/// Nothing has worked yet, so there is no copy of a configuration that worked; the alert needs only one that can be
/// read.
#[tokio::test(flavor = "multi_thread")]
async fn a_device_node_that_fails_from_its_first_start_on_raises_guard_process() {
    let node = DeviceNode::new().await;
    let _program = node.start();
    let raised = node.until("no alert guard-process/dome", |list| guard_process(list).is_some()).await;
    let cause = &guard_process(&raised).unwrap().cause;
    assert!(cause.contains("does not guard"), "{cause}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_guard_process_raised_before_it_was_killed_is_taken_back_by_the_next_one() {
    let node = DeviceNode::new().await;
    let mut program = node.start();
    let raised = node.until("no alert guard-process/dome", |list| guard_process(list).is_some()).await;
    let noted = node.folder.path().join(".observatory.toml.main.alerts");
    test_support::until("the alert is noted on disk", || noted.exists()).await;
    program.kill().await.unwrap();
    fs::remove_file(node.folder.path().join("data")).unwrap();
    let _next = node.start();
    let is_taken_back =
        |list: &Received<Alerts>| list.sample.boot_id != raised.sample.boot_id && guard_process(list).is_none();
    node.until("the alert stands although the next guard process runs", is_taken_back).await;
}
