//! A telescope whose observatory node is gone: it is seen, explained and closed by its dome's device node. And a bus that
//! is found without its address.

use std::path::Path;
use std::process::Stdio;
use std::sync::atomic::Ordering;
use std::time::Duration;

use bus::{Bus, Catch, Clock};
use contract::device::dome::{Command as DomeCommand, Guard, Shutter};
use contract::observatory::NightState;
use contract::{Address, Key, Kind, Part};
use serde_json::json;
use sysinfo::{Pid, ProcessesToUpdate, System};
use test_support::{DomeNode, LIMIT, until};
use tokio::io::{AsyncBufReadExt as _, BufReader, Lines};
use tokio::process::{Child, ChildStdout};
use tokio::sync::watch;

use crate::asks_telescopes::Telescope;
use crate::command::{Output, starmesh, starmesh_of};

fn europa() -> Address {
    Address::new("paranal", "europa").unwrap()
}

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
        let dome = europa().device(Kind::Dome, &"dome_1".parse().unwrap());
        Self { dome: DomeNode::start(&bus, dome, "europa").await, bus, connect }
    }

    async fn until_the_dome_is_told(&self) {
        until("the dome is told to close", || !self.dome.commands.lock().unwrap().is_empty()).await;
    }

    async fn starmesh(&self, arguments: &[&str]) -> Output {
        let mut all: Vec<String> = arguments.iter().map(|&word| word.to_owned()).collect();
        all.extend(["--no-multicast".to_owned(), "--connect".to_owned(), self.connect.clone()]);
        tokio::task::spawn_blocking(move || starmesh(all)).await.unwrap()
    }

    async fn until_the_guard_reports_it_open(&self) {
        let dome = europa().device(Kind::Dome, &"dome_1".parse().unwrap());
        let guards = self.bus.subscribe::<Guard>(&Key::Guard(dome), Catch::Newest, 16).await.unwrap();
        let opens = async { while guards.recv().await.sample.body.verified_closed != Some(false) {} };
        tokio::time::timeout(LIMIT, opens).await.unwrap();
    }

    /// Orders to close, and waits so long for it, and so long beyond that.
    fn close(&self, runtime: &Path, wait_s: &str, beyond_s: &str) -> Child {
        tokio::process::Command::new(env!("CARGO_BIN_EXE_starmesh"))
            .args(["order", "paranal/europa", "close", "--wait", wait_s, "--give-on", beyond_s])
            .args(["--no-multicast", "--connect", &self.connect])
            .env("XDG_RUNTIME_DIR", runtime)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .unwrap()
    }
}

/// The state of an observatory node that has taken an order of Ben just now.
fn newer_order(bus: &Bus) -> NightState {
    let newer = json!({ "id": "newer", "from": "web/ben", "verb": "robotic", "at_utc": bus.clock().utc() });
    let night = json!({
        "robotic": true, "posture": "closed", "actions": [], "frames": 0, "open_s": 0.0, "speed": 1.0, "simulated": false,
        "ended": false, "last_order": newer,
    });
    serde_json::from_value(night).unwrap()
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
    assert_eq!(lines[4], "    alerts: 1 active; those of the observatory node are not known");
    assert!(lines[5].contains("critical dome-not-closed/dome_1: it is half open"), "{lines:#?}");
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
    assert!(!output.success && output.err.contains("no observatory node answers"), "{}", output.err);
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

const STAY_CLOSED: [&str; 5] = ["order", "paranal/europa", "stay-closed", "--give-on", "120"];

#[tokio::test(flavor = "multi_thread")]
async fn a_close_order_prints_that_the_observatory_node_answers_after_all() {
    let alone = Alone::start().await;
    let back = async {
        alone.until_the_dome_is_told().await;
        Telescope::command(alone.bus.clone(), europa()).await
    };
    let (output, _europa) = tokio::join!(alone.starmesh(&STAY_CLOSED), back);
    assert!(output.success, "{}{}", output.out, output.err);
    let silent = output.out.find("no observatory node of paranal/europa has answered yet");
    assert!(silent.is_some() && silent < output.out.find("answers now"), "{}", output.out);
    alone.bus.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_close_order_that_only_the_dome_took_ends_with_an_error_when_a_newer_one_was_taken_from_somebody_else() {
    let alone = Alone::start().await;
    let ordered_otherwise = async {
        alone.until_the_dome_is_told().await;
        let (_night, shown) = watch::channel(newer_order(&alone.bus));
        let nights = alone.bus.publisher(&Key::Observatory(europa(), Part::Night)).await.unwrap();
        nights.follow(shown, Duration::from_secs(1)).await.unwrap();
    };
    let output = tokio::select! {
        output = alone.starmesh(&STAY_CLOSED) => output,
        () = ordered_otherwise => panic!("nothing was published any more"),
    };
    assert!(!output.success && output.err.contains("it was only closed"), "{}{}", output.out, output.err);
    assert!(output.err.contains("has taken a newer order of ben at "), "{}", output.err);
    alone.bus.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_close_order_that_was_replaced_while_the_dome_did_not_close_is_not_given_again_and_says_so() {
    let alone = Alone::start().await;
    alone.dome.sticks.store(true, Ordering::Relaxed);
    let opened_by_ben = async {
        let nights = alone.bus.publisher::<NightState>(&Key::Observatory(europa(), Part::Night)).await.unwrap();
        while nights.put(newer_order(&alone.bus)).await.is_ok() {
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    let output = tokio::select! {
        output = alone.starmesh(&["order", "paranal/europa", "close", "--wait", "1", "--give-on", "20"]) => output,
        () = opened_by_ben => panic!("nothing was published any more"),
    };
    assert!(!output.success, "{}{}", output.out, output.err);
    assert!(output.err.contains("NOT verified closed within 1 s: paranal/europa/dome/dome_1"), "{}", output.err);
    assert!(output.err.contains("has taken a newer order of ben at "), "{}", output.err);
    assert!(!output.out.contains("This order is followed and asked for"), "{}", output.out);
    alone.bus.close().await;
}

/// The lines that `starmesh` prints, up to the one that holds these words; none of them where it ends before.
async fn printed_until(lines: &mut Lines<BufReader<ChildStdout>>, words: &str) -> Vec<String> {
    let mut printed = Vec::new();
    let reading = async {
        while let Some(line) = lines.next_line().await.unwrap() {
            printed.push(line);
            if printed.last().is_some_and(|line| line.contains(words)) {
                return;
            }
        }
        printed.clear();
    };
    tokio::time::timeout(LIMIT, reading).await.unwrap_or_else(|_| panic!("{words:?} is never printed"));
    printed
}

#[tokio::test(flavor = "multi_thread")]
async fn a_close_order_that_the_dome_carries_out_late_is_told_given_on_and_followed_until_it_is_closed() {
    let alone = Alone::start().await;
    alone.dome.sticks.store(true, Ordering::Relaxed);
    let runtime = tempfile::tempdir().unwrap();
    let mut order = alone.close(runtime.path(), "1", "240");
    let mut lines = BufReader::new(order.stdout.take().unwrap()).lines();
    let late = printed_until(&mut lines, "NOT verified closed within 1 s: paranal/europa/dome/dome_1").await;
    let words = late.last().map_or("", String::as_str);
    assert!(words.contains("the guard of each dome goes on to ask it to close until that is verified"), "{late:#?}");
    assert!(words.contains("This order is followed and asked for 240 s more"), "{late:#?}");

    let _europa = Telescope::command(alone.bus.clone(), europa()).await;
    let taken = printed_until(&mut lines, "the observatory node of paranal/europa answers now: accepted").await;
    assert!(!taken.is_empty(), "the order was forgotten");
    alone.dome.shutter.send_replace(Shutter::Closed);
    assert_eq!(printed_until(&mut lines, "verified closed").await, ["verified closed"]);
    assert!(tokio::time::timeout(LIMIT, order.wait()).await.unwrap().unwrap().success());
    alone.bus.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_close_order_is_followed_again_when_the_observatory_node_is_back_and_had_begun_to_open() {
    for (wait_s, closes) in [("300", true), ("1", false)] {
        let alone = Alone::start().await;
        let runtime = tempfile::tempdir().unwrap();
        let mut order = alone.close(runtime.path(), wait_s, "240");
        let mut lines = BufReader::new(order.stdout.take().unwrap()).lines();
        let closed = printed_until(&mut lines, "It is asked for 240 s more").await;
        assert!(!closed.is_empty(), "the guard did not close it");

        alone.dome.shutter.send_replace(Shutter::Opening);
        alone.until_the_guard_reports_it_open().await;
        let _europa = Telescope::command(alone.bus.clone(), europa()).await;
        let taken = printed_until(&mut lines, "the observatory node of paranal/europa answers now: accepted").await;
        assert!(!taken.is_empty(), "the order was forgotten");
        if closes {
            alone.dome.shutter.send_replace(Shutter::Closed);
            assert_eq!(printed_until(&mut lines, "verified closed").await, ["verified closed"]);
        }
        let ended = tokio::time::timeout(LIMIT, order.wait_with_output()).await.unwrap().unwrap();
        let words = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.success(), closes, "{words}");
        assert_eq!(words.contains("NOT verified closed within 1 s: paranal/europa is "), !closes, "{words}");
        alone.bus.close().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_close_order_whose_dome_falls_silent_after_it_was_late_ends_with_the_name_of_that_dome() {
    let alone = Alone::start().await;
    alone.dome.sticks.store(true, Ordering::Relaxed);
    let runtime = tempfile::tempdir().unwrap();
    let mut order = alone.close(runtime.path(), "1", "1");
    let mut lines = BufReader::new(order.stdout.take().unwrap()).lines();
    let late = printed_until(&mut lines, "This order is followed and asked for 1 s more").await;
    assert!(!late.is_empty(), "it was not told that the dome is late");
    let Alone { bus, dome, .. } = alone;
    drop(dome);
    let ended = tokio::time::timeout(LIMIT, order.wait_with_output()).await.unwrap().unwrap();
    let words = String::from_utf8_lossy(&ended.stderr);
    assert!(!ended.status.success(), "{words}");
    assert!(words.contains("NOT verified closed within 2 s: paranal/europa/dome/dome_1"), "{words}");
    bus.close().await;
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
