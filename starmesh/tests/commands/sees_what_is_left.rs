//! A telescope whose observatory node is gone: it is seen, explained and closed by its dome's device node. And a bus that
//! is found without its address.

use bus::{Bus, Clock};
use contract::device::dome::Command as DomeCommand;
use contract::{Address, Kind};
use serde_json::json;
use sysinfo::{Pid, ProcessesToUpdate, System};
use test_support::DomeNode;

use crate::command::{Output, starmesh, starmesh_of};

/// A bus with the device node of the dome of `paranal/europa`, and no observatory node.
struct Alone {
    bus: Bus,
    connect: String,
    dome: DomeNode,
}

impl Alone {
    async fn start() -> Self {
        let bus = test_support::private_bus(Clock::machine_clock()).await;
        let connect = bus.locators().await.first().unwrap().clone();
        let europa = Address::new("paranal", "europa").unwrap();
        let dome = europa.device(Kind::Dome, &"dome_1".parse().unwrap());
        Self { dome: DomeNode::start(&bus, dome, "europa").await, bus, connect }
    }

    async fn starmesh(&self, arguments: &[&str]) -> Output {
        let mut all: Vec<String> = arguments.iter().map(|&word| word.to_owned()).collect();
        all.extend(["--no-multicast".to_owned(), "--connect".to_owned(), self.connect.clone()]);
        tokio::task::spawn_blocking(move || starmesh(all)).await.unwrap()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_telescope_without_an_observatory_node_shows_its_dome_its_alerts_and_what_closes_it() {
    let alone = Alone::start().await;
    let output = alone.starmesh(&["status", "--seconds", "10"]).await;
    assert!(output.success, "{}{}", output.out, output.err);
    let lines: Vec<&str> = output.out.lines().collect();
    assert!(lines[1].starts_with("paranal/europa               UNKNOWN  UNKNOWN "), "{lines:#?}");
    assert!(lines[1].contains("  1  the observatory node is silent since ") && lines[1].contains(" UTC"), "{lines:#?}");
    assert!(lines[2].contains("dome dome_1: shutter in error, it may be half open, not verified closed"), "{lines:#?}");
    assert!(
        lines[2].contains("its guard closes it now") && lines[2].contains("its own watchdog (120 s)"),
        "{lines:#?}"
    );
    assert!(lines[3].contains("nodes of this telescope that answer: device/enclosure"), "{lines:#?}");
    assert!(lines[4].contains("critical dome-not-closed/dome_1: it is half open"), "{lines:#?}");
    alone.bus.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_close_order_that_no_observatory_node_answers_goes_to_the_dome_and_no_other_telescope_is_proposed() {
    let alone = Alone::start().await;
    let output = alone.starmesh(&["order", "paranal/europa", "start"]).await;
    let message = output.err;
    assert!(!output.success && message.contains("no observatory node of paranal/europa answers"), "{message}");
    assert!(message.contains("device/enclosure") && !message.contains("did you mean"), "{message}");
    assert!(alone.dome.commands.lock().unwrap().is_empty(), "nothing closes by itself at another order");

    let output = alone.starmesh(&["order", "paranal/europa", "close", "--operator", "ana", "--give-on", "0"]).await;
    // It is closed, and a script must not take that for kept.
    assert!(!output.success && output.err.contains("no observatory node has taken the order"), "{}", output.err);
    assert!(
        output.out.contains("the device node of paranal/europa/dome/dome_1 was ordered to close"),
        "{}",
        output.out
    );
    assert!(output.out.contains("verified closed by the guard of paranal/europa/dome/dome_1"), "{}", output.out);
    assert!(output.out.contains("does not know of this order"), "{}", output.out);
    {
        let commands = alone.dome.commands.lock().unwrap();
        let close = commands.first().unwrap();
        assert_eq!((&close.action, close.token), (&DomeCommand::CloseShutter, None));
        assert_eq!(contract::command::operator(&close.from), "ana", "{}", close.from);
    }

    // It is closed, and nobody has noted that it is to stay so.
    let output = alone.starmesh(&["order", "paranal/europa", "stay-closed", "--give-on", "0"]).await;
    assert!(!output.success && output.err.contains("only closed"), "{}{}", output.out, output.err);
    assert!(output.out.contains("verified closed by the guard"), "{}", output.out);

    let output = alone.starmesh(&["order", "paranal/eropa", "close"]).await;
    assert!(!output.success && output.err.contains("did you mean paranal/europa?"), "{}", output.err);
    alone.bus.close().await;
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn a_program_that_runs_here_is_found_without_its_address_and_without_one_it_is_printed_where_was_looked() {
    use std::os::unix::fs::DirBuilderExt as _;
    let alone = Alone::start().await;
    let runtime = tempfile::tempdir().unwrap();
    let (at, none) = (runtime.path().to_owned(), ["status", "--no-multicast", "--seconds", "0.5"]);
    let output = tokio::task::spawn_blocking(move || starmesh_of(&at, none)).await.unwrap();
    assert!(
        !output.success && output.err.contains("no `starmesh demo` or `starmesh up` of this account runs here"),
        "{}",
        output.err
    );
    assert!(output.err.contains("--no-multicast") && output.err.contains("--connect"), "{}", output.err);

    let pid = Pid::from_u32(std::process::id());
    let mut system = System::new().unwrap();
    system.refresh_processes(ProcessesToUpdate::Some(&[pid]), true);
    let running = json!({
        "command": "demo", "telescope": { "site": "paranal", "telescope": "europa" }, "bus": alone.connect, "folder": "/data",
        "pid": std::process::id(), "started_s": system.process(pid).unwrap().start_time(),
    });
    let place = runtime.path().join("starmesh");
    std::fs::DirBuilder::new().mode(0o700).create(&place).unwrap();
    std::fs::write(place.join("demo-1.json"), running.to_string()).unwrap();
    let (at, found) = (runtime.path().to_owned(), ["status", "--no-multicast", "--seconds", "10"]);
    let output = tokio::task::spawn_blocking(move || starmesh_of(&at, found)).await.unwrap();
    assert!(output.success && output.out.contains("paranal/europa"), "{}{}", output.out, output.err);
    alone.bus.close().await;
}
