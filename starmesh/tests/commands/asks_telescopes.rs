//! Commands that ask telescopes over the bus: what a telescope waits for and why, rows from any host, and mistyped
//! names.

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::process::{Command, Stdio};
use std::time::Duration;

use bus::{Bus, Clock, Service};
use contract::node::NodeState;
use contract::observatory::{
    NightState, OrderTaken, Posture, SafetyState, ScheduleDraft, ScheduleFindings, ScheduleState,
};
use contract::{Accepted, Address, Key, NodeTopic, Order, OrderKind, Part, Reason, Refusal, Reply, Role};
use serde_json::{Value, json};
use tokio::sync::watch;

use crate::command::{Output, starmesh};

/// Text that would end its line, write another one, and clear the terminal.
const FORGED: &str = "x\nparanal/io SAFE\u{1b}[2J\u{9b}2J\u{2028}y";

/// The reason of an order that holds and that the disk does not take.
const FULL_DISK: &str = "a full disk";

/// A telescope on a bus of its own that publishes what a test wants, and the address of that bus.
pub struct Telescope {
    bus: Bus,
    connect: String,
    /// The state that it publishes.
    night: watch::Sender<NightState>,
    _services: [Service; 2],
}

impl Telescope {
    async fn start() -> Self {
        let bus = test_support::private_bus(Clock::machine_clock()).await;
        Self::command(bus, Address::new("paranal", "callisto").unwrap()).await
    }

    /// A telescope whose observatory node commands.
    pub async fn command(bus: Bus, address: Address) -> Self {
        let connect = bus.locators().await.first().unwrap().clone();
        let shown_at = Key::Observatory(address.clone(), Part::Night);
        let (order, check) = (Key::Order(address.clone()), Key::ScheduleCheck(address));
        // Closed, and it shows the order that it took last.
        let night = json!({
            "robotic": true, "posture": "closed", "actions": [], "frames": 0, "open_s": 0.0, "speed": 1.0, "simulated": false,
            "ended": false,
        });
        let night = watch::channel(serde_json::from_value::<NightState>(night).unwrap()).0;
        let nights = bus.publisher::<NightState>(&shown_at).await.unwrap();
        let shown = night.subscribe();
        tokio::spawn(async move { nights.follow(shown, Duration::from_secs(1)).await });
        let (clock, taken_by) = (bus.clock().clone(), night.clone());
        let orders = bus.serve(&order, move |order: Result<Order, String>| {
            let Order { id, from, kind, reason, .. } = order.unwrap();
            let taken = OrderTaken { id: id.clone(), from, verb: "order".to_owned(), at_utc: clock.utc(), night: None };
            taken_by.send_modify(|night| night.last_order = Some(taken));
            let refused = matches!(kind, OrderKind::ReloadSchedule);
            let refusal = Refusal { id: id.clone(), reason: Reason::Malformed, detail: FORGED.to_owned() };
            let not_written = (reason == FULL_DISK).then(|| "/data/orders.json: No space left on device".to_owned());
            let accepted = Accepted { id, token: None, not_written };
            async move { if refused { Reply::Refusal(refusal) } else { Reply::Accepted(accepted) } }
        });
        let checks = bus.serve(&check, |draft: Result<ScheduleDraft, String>| async move {
            let is_bad = draft.unwrap().text.contains("bad");
            let finding = json!({
                "severity": if is_bad { "error" } else { "warning" }, "check": "visibility", "line": 1, "column": 2,
                "field": "ra", "what": "M42 stands below 20 deg over the whole window",
            });
            let found = json!({
                "valid": !is_bad, "rows": 1, "errors": u32::from(is_bad), "warnings": u32::from(!is_bad), "findings": [finding],
                "unchecked": ["where \"Vega\" stands"],
            });
            serde_json::from_value::<ScheduleFindings>(found).unwrap()
        });
        let services = [orders.await.unwrap(), checks.await.unwrap()];
        Self { bus, connect, night, _services: services }
    }

    fn key(part: Part) -> Key {
        Key::Observatory(Address::new("paranal", "callisto").unwrap(), part)
    }

    /// Runs the program on this bus.
    async fn starmesh(&self, arguments: &[&str]) -> Output {
        let mut all: Vec<String> = arguments.iter().map(|&word| word.to_owned()).collect();
        all.extend(["--no-multicast".to_owned(), "--connect".to_owned(), self.connect.clone()]);
        tokio::task::spawn_blocking(move || starmesh(all)).await.unwrap()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_that_holds_and_is_not_on_disk_fails_with_the_file_and_the_error() {
    let telescope = Telescope::start().await;
    for (words, closed) in [
        (&["stay-closed"][..], "verified closed, but the order holds now and "),
        (&["stay-closed", "--wait", "0"], "the order holds now and "),
        (&["restore", "wx/Humidity"], "the order holds now and "),
    ] {
        let mut order = vec!["order", "paranal/callisto"];
        order.extend(words);
        order.extend(["--reason", FULL_DISK]);
        let output = telescope.starmesh(&order).await;
        let told = format!("{closed}is NOT on disk (/data/orders.json: No space left on device)");
        assert!(!output.success && output.err.contains(&told), "{words:?}: {}{}", output.out, output.err);
        let is_closing = words[0] == "stay-closed";
        assert_eq!(output.out.contains("accepted"), is_closing, "{words:?}: {}", output.out);
    }
    // One that does not close either: neither hides the other.
    telescope.night.send_modify(|night| night.posture = Posture::Closing);
    let late = ["order", "paranal/callisto", "stay-closed", "--wait", "1", "--reason", FULL_DISK];
    let output = telescope.starmesh(&late).await;
    for told in ["NOT verified closed within 1 s: ", ". And the order holds now and is NOT on disk (/data/"] {
        assert!(!output.success && output.err.contains(told), "{told}: {}{}", output.out, output.err);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_waits_for_a_node_that_has_just_started_and_does_not_command_yet() {
    let callisto = Telescope::start().await;
    let io = Address::new("paranal", "io").unwrap();
    let bus = test_support::join(&callisto.bus).await;
    let state = Key::Node(io.clone(), Role::Observatory, "main".parse().unwrap(), NodeTopic::State);
    let node = bus.publisher::<NodeState>(&state).await.unwrap();
    let sample: Value =
        serde_json::from_str(include_str!("../../../common/contract/golden/v1/node.state.json")).unwrap();
    node.put(serde_json::from_value(sample).unwrap()).await.unwrap();

    let output = callisto.starmesh(&["order", "paranal/io", "start"]).await;
    assert!(!output.success && output.err.contains("does not command yet; try again"), "{}", output.err);

    let ordered = callisto.starmesh(&["order", "paranal/io", "start"]);
    let granted = async {
        tokio::time::sleep(Duration::from_secs(3)).await;
        Telescope::command(bus, io).await
    };
    let (output, _io) = tokio::join!(ordered, granted);
    assert!(output.success && output.out.contains("accepted"), "{}{}", output.out, output.err);
}

#[tokio::test(flavor = "multi_thread")]
async fn reasons_rows_and_names_are_printed_from_any_host() {
    let telescope = Telescope::start().await;
    let verdicts = telescope.bus.publisher::<SafetyState>(&Telescope::key(Part::Safety)).await.unwrap();
    let schedules = telescope.bus.publisher::<ScheduleState>(&Telescope::key(Part::Schedule)).await.unwrap();
    let now = Clock::machine_clock().utc();
    let (soon, later) = (now.plus_seconds(1800.0), now.plus_seconds(7200.0));
    let verdict = json!({
        "verdict": "unsafe", "since_utc": now, "inputs": [], "reasons": [
            { "input": "wx/Humidity", "why": "91 is above 80" },
            { "input": "sun", "why": "3.0 deg is above 0", "clears_in_s": 1500.0 },
        ],
    });
    verdicts.put(serde_json::from_value(verdict).unwrap()).await.unwrap();
    let row = |row: u32, status: &str, object: &str| {
        json!({
            "row": row, "action": "object", "camera": "main", "object": object, "start_utc": soon, "end_utc": later,
            "status": status, "frames": 3, "frames_wanted": 10, "detail": if status == "failed" { "the mount is away" } else { "" },
        })
    };
    let rows =
        json!({ "file": "night.jsonl", "revision": 2, "rows": [row(0, "failed", "M42"), row(1, "pending", "M31")] });
    schedules.put(serde_json::from_value(rows).unwrap()).await.unwrap();

    let output = telescope.starmesh(&["status"]).await;
    assert!(output.success, "{}{}", output.out, output.err);
    let table = &output.out;
    assert!(
        table.contains("waits for row 2, object M31, which starts at")
            && ["(in 30 min)", "(in 29 min)", "(in 28 min)"].iter().any(|left| table.contains(left)),
        "{table}"
    );
    assert!(table.contains("not safe: wx/Humidity: 91 is above 80; when it clears cannot be known"), "{table}");
    assert!(table.contains("not safe: sun: 3.0 deg is above 0; can clear in 25 min"), "{table}");
    assert!(table.lines().any(|line| line.contains("ROBOTIC") && line.contains("real")), "{table}");

    let output = telescope.starmesh(&["schedule", "rows", "paranal/callisto"]).await;
    assert!(output.success, "{}{}", output.out, output.err);
    let lines: Vec<&str> = output.out.lines().collect();
    assert!(lines[0].contains("night.jsonl") && lines[2].contains("failed") && lines[2].ends_with("the mount is away"));
    assert!(lines[3].contains("pending") && lines[3].contains("M31") && lines[3].contains("3/10"), "{lines:#?}");

    for arguments in [
        &["schedule", "rows", "paranal/calisto"][..],
        &["order", "paranal/calisto", "close"],
        &["order", "callisto", "close"],
        &["schedule", "put", "paranal/calisto", "Cargo.toml", "--reason", "x"],
    ] {
        let output = telescope.starmesh(arguments).await;
        let message = output.err;
        assert!(!output.success && message.contains("did you mean paranal/callisto?"), "{arguments:?}: {message}");
        assert!(message.contains("On the bus: paranal/callisto"), "{message}");
    }
    let output = telescope.starmesh(&["order", "paranal/callisto", "close"]).await;
    assert!(output.success && output.out.contains("verified closed\n"), "{}{}", output.out, output.err);

    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("new.jsonl").display().to_string();
    fs::write(&file, "{\"good\": 1}\n").unwrap();
    let put = ["schedule", "put", "paranal/callisto", file.as_str(), "--reason", "a test", "--operator", "ana"];
    let output = telescope.starmesh(&put).await;
    assert!(output.success && output.out.contains("accepted"), "{}{}", output.out, output.err);
    let from = telescope.night.borrow().last_order.clone().unwrap().from;
    assert_eq!(contract::command::operator(&from), "ana", "{from}");
    assert!(output.out.contains("new.jsonl:1:2: warning: ra: M42 stands below 20 deg"), "{}", output.out);
    assert!(output.out.contains("not checked: where \"Vega\" stands"), "{}", output.out);
    fs::write(&file, "{\"bad\": 1}\n").unwrap();
    let output = telescope.starmesh(&put).await;
    assert!(
        !output.success && output.err.contains("refused") && output.out.contains(": error: "),
        "{}{}",
        output.out,
        output.err
    );
    telescope.bus.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn text_from_the_bus_forges_no_line_and_steers_no_terminal() {
    let telescope = Telescope::start().await;
    let verdicts = telescope.bus.publisher::<SafetyState>(&Telescope::key(Part::Safety)).await.unwrap();
    let schedules = telescope.bus.publisher::<ScheduleState>(&Telescope::key(Part::Schedule)).await.unwrap();
    let now = Clock::machine_clock().utc();
    let verdict =
        json!({ "verdict": "unsafe", "since_utc": now, "inputs": [], "reasons": [{ "input": FORGED, "why": FORGED }] });
    verdicts.put(serde_json::from_value(verdict).unwrap()).await.unwrap();
    let row = json!({
        "row": 0, "action": FORGED, "camera": FORGED, "object": FORGED, "start_utc": now, "end_utc": now.plus_seconds(60.0),
        "status": "failed", "frames": 0, "detail": FORGED,
    });
    let schedule = json!({ "file": FORGED, "revision": 1, "refused": FORGED, "rows": [row] });
    schedules.put(serde_json::from_value(schedule).unwrap()).await.unwrap();
    let step =
        json!({ "action": FORGED, "object": FORGED, "step": FORGED, "camera": "main", "row": 0, "started_utc": now });
    telescope.night.send_modify(|night| night.actions.push(serde_json::from_value(step).unwrap()));

    for (arguments, lines) in [
        (&["status"][..], 4),
        (&["schedule", "rows", "paranal/callisto"], 4),
        (&["order", "paranal/callisto", "reload"], 1),
    ] {
        let output = telescope.starmesh(arguments).await;
        let all = format!("{}{}", output.out, output.err);
        assert!(all.contains("x\\nparanal/io SAFE\\u{1b}[2J\\u{9b}2J\\u{2028}y"), "{arguments:?}: {all}");
        assert_eq!(all.lines().count(), lines, "{arguments:?}: {all}");
        assert!(!all.chars().any(|c| c != '\n' && (c.is_control() || c == '\u{2028}')), "{arguments:?}: {all:?}");
    }
    let key = Telescope::key(Part::Night).to_string();
    let mut tail = Command::new(env!("CARGO_BIN_EXE_starmesh"))
        .args(["tail", &key, "--no-multicast", "--connect", &telescope.connect])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut out = BufReader::new(tail.stdout.take().unwrap());
    let first = tokio::task::spawn_blocking(move || {
        let mut first = String::new();
        out.read_line(&mut first).map(|_| first)
    });
    let first = first.await.unwrap().unwrap();
    tail.kill().unwrap();
    tail.wait().unwrap();
    assert!(first.contains("SAFE\\u001b[2J\\u{9b}2J\\u{2028}y"), "{first}");
    telescope.bus.close().await;
}
