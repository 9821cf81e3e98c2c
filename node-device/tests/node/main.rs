//! The device node as others see it: on a real bus, with real HTTP servers in place of hardware.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test ends by panicking")]

mod audit_log;
mod closing;
mod evidence;
mod fake;
mod lease;
mod limits;
mod odd_answers;
mod outages;
mod proof;
mod rates;
mod stage;
mod vendor;

use std::time::Duration;

use bus::{Catch, Clock};
use contract::device::camera::{self, Frame, Purpose};
use contract::device::dome::{self, Shutter};
use contract::device::safety_monitor::{self, SafetyMonitor};
use contract::device::{filter_wheel, focuser};
use contract::{DeviceState, Key, Kind, Link, NodeTopic, Reason};
use serde_json::json;
use test_support::{LIMIT, until};

use closing::{until_guard, until_permitted};
use fake::{Fake, FakeAnswer};
use lease::until_granted;
use stage::{Commander, Stage, accepted, command, refused, until_received};

/// A device of the node under test, which is called `main` for all kinds.
fn block(kind: &str, name: &str, server: &Fake, more: &str) -> String {
    test_support::block(kind, name, server.address, &format!("node = \"main\"\n{more}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hung_device_is_lost_and_another_is_read_meanwhile() {
    let healthy = Fake::start(&[("issafe", json!(true))]).await;
    let hung = Fake::start(&[("issafe", json!(true))]).await;
    let devices = block("safetymonitor", "healthy", &healthy, "period_s = 0.2")
        + &block("safetymonitor", "hung", &hung, "period_s = 0.2");
    let stage = Stage::start(&devices).await;
    for name in ["healthy", "hung"] {
        stage.until::<SafetyMonitor>(name, |state| state.fields.is_safe.known() == Some(&true)).await;
    }
    hung.hang(true);
    until("a question hangs", || hung.hanging() > 0).await;
    healthy.answer("issafe", FakeAnswer::Value(json!(false)));
    stage.until::<SafetyMonitor>("healthy", |state| state.fields.is_safe.known() == Some(&false)).await;

    let lost = stage.until::<SafetyMonitor>("hung", |state| matches!(state.link, Link::Lost { .. })).await;
    let reason = lost.fields.is_safe.as_result().unwrap_err().clone();
    assert!(reason.0.starts_with("timeout"), "{reason}");
    hung.hang(false);
    stage.until::<SafetyMonitor>("hung", |state| state.fields.is_safe.known() == Some(&true)).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_monitor_that_hangs_is_lost_as_well() {
    let hardware = Fake::start(&[("issafe", json!(true))]).await;
    // More than a quarter of the period.
    hardware.slow(Duration::from_millis(100), false);
    let stage = Stage::start(&block("safetymonitor", "monitor", &hardware, "period_s = 0.2")).await;
    let is_safe = |state: &DeviceState<safety_monitor::Fields>| state.fields.is_safe.known() == Some(&true);
    let states = stage.states::<SafetyMonitor>("monitor").await;
    // After some readings it is known to be slow.
    for _ in 0..5 {
        until_received("the monitor", &states, is_safe).await;
    }
    hardware.hang(true);
    let lost = until_received("the monitor", &states, |state| matches!(state.link, Link::Lost { .. })).await;
    assert_eq!(lost.fields.is_safe.known(), None);
    hardware.hang(false);
    until_received("the monitor", &states, is_safe).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_repeated_command_is_answered_again_and_done_once() {
    let hardware = Fake::start(&[
        ("position", json!(100)),
        ("ismoving", json!(false)),
        ("temperature", json!("NaN")),
        ("absolute", json!(true)),
        ("maxstep", json!(5000)),
    ])
    .await;
    hardware.on("move", |hardware, form| {
        let position = form.split('&').find_map(|pair| pair.strip_prefix("Position=")).unwrap();
        hardware.answer("position", FakeAnswer::Value(json!(position.parse::<i64>().unwrap())));
    });
    let stage = Stage::start(&block("focuser", "focus", &hardware, "settle_s = 0.0")).await;
    let ready = stage.until::<focuser::Focuser>("focus", |state| state.fields.position.known() == Some(&100)).await;
    assert_eq!(ready.fields.temperature_c.as_result().unwrap_err().0, "not a number");
    assert!(!ready.busy);

    let go = command("m1", None, focuser::Command::Move { position: 2500 });
    for _ in 0..3 {
        accepted(&stage.command(Kind::Focuser, "focus", &go).await);
    }
    stage.until::<focuser::Focuser>("focus", |state| state.has_done(&go.id)).await;
    accepted(&stage.command(Kind::Focuser, "focus", &go).await);
    assert_eq!(hardware.puts("move").len(), 1);

    let too_far = command("m2", None, focuser::Command::Move { position: 5001 });
    assert_eq!(refused(&stage.command(Kind::Focuser, "focus", &too_far).await), Reason::Malformed);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sloppy_device_keeps_what_it_has_and_the_reason_for_what_it_lacks() {
    let wheel = Fake::start(&[("position", json!("1")), ("names", json!(["R", "G"])), ("name", json!(7))]).await;
    wheel.answer("focusoffsets", FakeAnswer::Error(0x400, "no offsets"));
    let stage = Stage::start(&block("filterwheel", "wheel", &wheel, "period_s = 0.2")).await;
    let state = stage
        .until::<filter_wheel::FilterWheel>("wheel", |state| state.fields.filter.known() == Some(&"G".to_owned()))
        .await;
    assert_eq!(state.link, Link::Connected);
    let published = serde_json::to_value(&state.readings).unwrap();
    assert_eq!(published["Name"]["value"], 7);
    assert_eq!(published["DriverVersion"]["no_data"], "not implemented");
    wheel.answer("position", FakeAnswer::Value(json!(-1)));
    stage
        .until::<filter_wheel::FilterWheel>("wheel", |state| state.busy && state.fields.filter.known().is_none())
        .await;
    wheel.answer("position", FakeAnswer::Error(0x407, "unplugged"));
    stage.until::<filter_wheel::FilterWheel>("wheel", |state| matches!(state.link, Link::Lost { .. })).await;
    let turn = command("t1", None, filter_wheel::Command::Turn { position: 0 });
    assert_eq!(refused(&stage.command(Kind::FilterWheel, "wheel", &turn).await), Reason::NotConnected);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_vanishes_from_its_server_is_lost_and_comes_back() {
    let monitor = Fake::start(&[("issafe", json!(true))]).await;
    let stage = Stage::start(&block("safetymonitor", "monitor", &monitor, "period_s = 0.2")).await;
    let is_safe = |state: &contract::DeviceState<contract::device::safety_monitor::Fields>| {
        state.fields.is_safe.known() == Some(&true)
    };
    stage.until::<SafetyMonitor>("monitor", is_safe).await;
    // The server was restarted and knows no such number for a while.
    monitor.deny("issafe");
    stage.until::<SafetyMonitor>("monitor", |state| matches!(state.link, Link::Lost { .. })).await;
    monitor.answer("issafe", FakeAnswer::Value(json!(true)));
    stage.until::<SafetyMonitor>("monitor", is_safe).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_that_never_arrived_ends_as_soon_as_the_device_is_seen_to_rest() {
    let hardware = Fake::start(&[
        ("position", json!(100)),
        ("ismoving", json!(false)),
        ("absolute", json!(true)),
        ("maxstep", json!(5000)),
    ])
    .await;
    hardware.answer("put move", FakeAnswer::Hangs);
    let stage = Stage::start(&block("focuser", "focus", &hardware, "settle_s = 0.0")).await;
    stage.until::<focuser::Focuser>("focus", |state| state.fields.position.known() == Some(&100)).await;
    let go = command("m1", None, focuser::Command::Move { position: 2500 });
    accepted(&stage.command(Kind::Focuser, "focus", &go).await);
    let failed = stage
        .until::<focuser::Focuser>("focus", |state| {
            state
                .last_command
                .as_ref()
                .is_some_and(|last| matches!(last.outcome, contract::CommandOutcome::Failed { .. }))
        })
        .await;
    assert!(!failed.busy, "free for the next command");
    stage.end().await;
}

async fn a_dome() -> Fake {
    let hardware = Fake::start(&[
        ("shutterstatus", json!(1)),
        ("slewing", json!(false)),
        ("cansetshutter", json!(true)),
        ("athome", json!(true)),
    ])
    .await;
    hardware.on("openshutter", |hardware, _| hardware.answer("shutterstatus", FakeAnswer::Value(json!(0))));
    hardware.on("closeshutter", |hardware, _| hardware.answer("shutterstatus", FakeAnswer::Value(json!(1))));
    hardware
}

async fn open(stage: &Stage) -> (u64, Commander) {
    let token = accepted(&stage.command(Kind::Dome, "dome", &command("c1", None, dome::Command::Claim)).await).unwrap();
    let early = command("o1", Some(token), dome::Command::OpenShutter);
    stage.until::<dome::Dome>("dome", |state| state.fields.shutter.known() == Some(&Shutter::Closed)).await;
    assert_eq!(refused(&stage.command(Kind::Dome, "dome", &early).await), Reason::NoPermit);
    let commander = Commander::start(stage, "dome", token).await;
    until_permitted(stage, token).await;

    let stale = command("o2", Some(token - 1), dome::Command::OpenShutter);
    assert_eq!(refused(&stage.command(Kind::Dome, "dome", &stale).await), Reason::StaleToken);
    let go = command("o3", Some(token), dome::Command::OpenShutter);
    accepted(&stage.command(Kind::Dome, "dome", &go).await);
    stage.until::<dome::Dome>("dome", |state| state.has_done(&go.id)).await;
    (token, commander)
}

/// A permit that lasts for long even where the machine is busy, for a dome that is read twice a second.
const PERMITTED: &str = "period_s = 0.5\npermit_valid_s = 10.0";

#[tokio::test(flavor = "multi_thread")]
async fn a_dome_closes_by_itself_when_its_commander_dies_even_while_its_polls_hang() {
    let hardware = a_dome().await;
    let stage = Stage::start(&block("dome", "dome", &hardware, PERMITTED)).await;
    let (token, commander) = open(&stage).await;
    let before = hardware.puts("closeshutter").len();
    hardware.hang(true);
    drop(commander);
    until("the guard closes", || hardware.puts("closeshutter").len() > before).await;
    hardware.hang(false);

    // It holds the dome until the commander resumes.
    let commander = Commander::start(&stage, "dome", token).await;
    until_guard(&stage, |guard| guard.hold && guard.may_be_open).await;
    // The poll that hung has lost the link, and without it every command is refused for that reason.
    stage.until::<dome::Dome>("dome", |state| state.link == Link::Connected).await;
    let go = command("o4", Some(token), dome::Command::OpenShutter);
    assert_eq!(refused(&stage.command(Kind::Dome, "dome", &go).await), Reason::NoPermit);
    let resume = command("r1", Some(token), dome::Command::Resume);
    accepted(&stage.command(Kind::Dome, "dome", &resume).await);
    accepted(&stage.command(Kind::Dome, "dome", &go).await);
    drop(commander);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_close_command_is_done_while_polls_hang_and_needs_no_token() {
    let hardware = a_dome().await;
    let stage = Stage::start(&block("dome", "dome", &hardware, PERMITTED)).await;
    let (_, _commander) = open(&stage).await;
    let before = hardware.puts("closeshutter").len();
    hardware.hang(true);
    until("a poll hangs", || hardware.hanging() > 0).await;
    let close = command("c9", None, dome::Command::CloseShutter);
    accepted(&stage.command(Kind::Dome, "dome", &close).await);
    // Every poll hangs until this is seen.
    until("it closes", || hardware.puts("closeshutter").len() > before).await;
    hardware.hang(false);
    stage.until::<dome::Dome>("dome", |state| state.has_done(&close.id)).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dome_that_moves_no_shutter_while_it_turns_is_stopped_and_closed_and_not_turned_meanwhile() {
    let hardware = a_dome().await;
    for (member, answer) in [("cansetazimuth", json!(true)), ("azimuth", json!(10.0))] {
        hardware.answer(member, FakeAnswer::Value(answer));
    }
    hardware.on("slewtoazimuth", |hardware, _| hardware.answer("slewing", FakeAnswer::Value(json!(true))));
    hardware.answer("put closeshutter", FakeAnswer::Error(0x40B, "it turns"));
    hardware.on("closeshutter", |_, _| {});
    hardware.on("abortslew", |hardware, _| {
        hardware.answer("slewing", FakeAnswer::Value(json!(false)));
        hardware.answer("put closeshutter", FakeAnswer::Value(json!(null)));
        hardware.on("closeshutter", |hardware, _| hardware.answer("shutterstatus", FakeAnswer::Value(json!(3))));
    });
    let stage = Stage::start(&block("dome", "dome", &hardware, "period_s = 0.2\npermit_valid_s = 10.0")).await;
    let (token, _commander) = open(&stage).await;
    let turn = |id| command(id, Some(token), dome::Command::SlewToAzimuth { azimuth_deg: 200.0 });
    accepted(&stage.command(Kind::Dome, "dome", &turn("t1")).await);
    stage.until::<dome::Dome>("dome", |state| state.fields.slewing.known() == Some(&true)).await;

    accepted(&stage.command(Kind::Dome, "dome", &command("c9", None, dome::Command::CloseShutter)).await);
    stage.until::<dome::Dome>("dome", |state| state.fields.shutter.known() == Some(&Shutter::Closing)).await;
    let (closes, stopped) = (hardware.puts("closeshutter"), hardware.puts("abortslew")[0].at);
    assert!(closes.len() >= 2, "{closes:?}");
    assert!(closes[0].at < stopped && stopped < closes[1].at, "closing is asked first, and waits for nothing");
    assert_eq!(refused(&stage.command(Kind::Dome, "dome", &turn("t2")).await), Reason::WrongState);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_lease_is_granted_to_one_at_a_time() {
    let hardware = a_dome().await;
    let stage = Stage::start(&block("dome", "dome", &hardware, "period_s = 0.5")).await;
    let claim =
        |id: &str, from: &str| contract::Command { from: from.to_owned(), ..command(id, None, dome::Command::Claim) };
    let first = claim("a", "observatory/alpha/main");
    assert_eq!(accepted(&stage.command(Kind::Dome, "dome", &first).await), Some(1));
    // It publishes permits, so that it is not silent however slow this machine is.
    let commander = Commander::start(&stage, "dome", 1).await;
    until_permitted(&stage, 1).await;
    assert_eq!(accepted(&stage.command(Kind::Dome, "dome", &first).await), Some(1), "a repeat is not granted again");
    let other = claim("b", "observatory/alpha/standby");
    assert_eq!(refused(&stage.command(Kind::Dome, "dome", &other).await), Reason::LeaseHeld);
    let again = claim("c", "observatory/alpha/main");
    assert_eq!(accepted(&stage.command(Kind::Dome, "dome", &again).await), Some(2));
    drop(commander);
    let granted = until_granted(&stage, |number| claim(&format!("d{number}"), "observatory/alpha/standby")).await;
    assert_eq!(granted, 3, "once the holder was silent");
    stage.end().await;
}

fn expose(id: &str, exposure_s: f64) -> contract::Command<camera::Command> {
    let purpose = Box::new(Purpose { action: "object".to_owned(), ..Purpose::default() });
    command(id, None, camera::Command::Expose { exposure_s, light: true, bin: 1, subframe: None, purpose })
}

async fn a_camera() -> Fake {
    let hardware = Fake::start(&[
        ("cameraxsize", json!(3)),
        ("cameraysize", json!(2)),
        ("maxbinx", json!(2)),
        ("maxadu", json!(65535)),
        ("canabortexposure", json!(true)),
        ("electronsperadu", json!(1.3)),
        ("binx", json!(1)),
    ])
    .await;
    hardware.be_a_camera();
    hardware
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_are_taken_one_after_another_announced_served_and_released() {
    let hardware = a_camera().await;
    let stage = Stage::start(&block("camera", "cam", &hardware, "")).await;
    let key = Key::Frame(stage.device(Kind::Camera, "cam")).to_string();
    let frames = stage.bus.subscribe::<Frame>(&key, Catch::All, 100).await.unwrap();
    stage.until::<camera::Camera>("cam", |state| state.link == Link::Connected && !state.busy).await;
    let count = 5;
    for index in 0..count {
        let go = expose(&format!("f{index}"), 0.1);
        accepted(&stage.command(Kind::Camera, "cam", &go).await);
        stage.until::<camera::Camera>("cam", |state| state.has_done(&go.id)).await;
    }
    let mut received = Vec::new();
    while received.len() < count {
        let frame = tokio::time::timeout(LIMIT, frames.recv()).await.unwrap().sample.body;
        received.push(frame);
    }
    let frame = received.iter().find(|frame| frame.id.0 == "f0").unwrap();
    assert_eq!((frame.width_px, frame.height_px, frame.bytes), (3, 2, 12));
    let readings = serde_json::to_value(&frame.readings).unwrap();
    assert_eq!(readings["BinX"]["value"], 1);
    // What the noise and the saturation of a frame are known by, although no row of the header table asks for it.
    assert_eq!((&readings["ElectronsPerADU"]["value"], &readings["MaxADU"]["value"]), (&json!(1.3), &json!(65535)));
    let get = async |range: Option<&str>, url: &str| {
        let request = reqwest::Client::new().get(url);
        let request = range.into_iter().fold(request, |request, range| request.header("Range", range));
        let response = request.send().await.unwrap();
        (response.status().as_u16(), response.bytes().await.unwrap().to_vec())
    };
    // Columns 1 2 | 3 4 | 5 6 as rows.
    let pixels: Vec<u8> = [1_u16, 3, 5, 2, 4, 6].into_iter().flat_map(u16::to_le_bytes).collect();
    assert_eq!(get(None, &frame.url).await, (200, pixels.clone()));
    assert_eq!(get(Some("bytes=4-"), &frame.url).await, (206, pixels[4..].to_vec()));
    assert_eq!(get(Some("bytes=0-11"), &frame.url).await, (206, pixels.clone()));
    assert_eq!(get(Some("bytes=12-"), &frame.url).await.0, 416);
    assert_eq!(get(None, frame.url.split('?').next().unwrap()).await.0, 404);

    let release = |sha256: &str| {
        command("r", None, camera::Command::Release { frame: frame.id.clone(), sha256: sha256.to_owned() })
    };
    assert_eq!(refused(&stage.command(Kind::Camera, "cam", &release("0")).await), Reason::Malformed);
    accepted(&stage.command(Kind::Camera, "cam", &release(&frame.sha256)).await);
    stage.until::<camera::Camera>("cam", |state| state.fields.spooled == count as u32 - 1).await;
    // It can still be fetched for a while.
    assert_eq!(get(None, &frame.url).await.0, 200);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_exposes_is_busy_and_an_aborted_exposure_leaves_no_frame_and_a_free_camera() {
    let hardware = a_camera().await;
    let stage = Stage::start(&block("camera", "cam", &hardware, "")).await;
    stage.until::<camera::Camera>("cam", |state| state.link == Link::Connected && !state.busy).await;
    let long = expose("long", 600.0);
    accepted(&stage.command(Kind::Camera, "cam", &long).await);
    stage.until::<camera::Camera>("cam", |state| state.fields.exposure.as_ref().is_some_and(|e| e.id == long.id)).await;
    assert_eq!(refused(&stage.command(Kind::Camera, "cam", &expose("x", 0.1)).await), Reason::Busy);
    let stop = command("stop", None, camera::Command::Abort);
    accepted(&stage.command(Kind::Camera, "cam", &stop).await);
    stage.until::<camera::Camera>("cam", |state| state.has_done(&stop.id)).await;
    assert_eq!(hardware.puts("abortexposure").len(), 1);
    let next = expose("next", 0.1);
    accepted(&stage.command(Kind::Camera, "cam", &next).await);
    let state = stage.until::<camera::Camera>("cam", |state| state.has_done(&next.id)).await;
    assert!(state.fields.exposure.is_none());
    stage.until::<camera::Camera>("cam", |state| state.fields.spooled == 1).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn real_devices_refuse_another_speed_than_1() {
    let hardware = Fake::start(&[("issafe", json!(true))]).await;
    let clock = Clock::simulated("2026-11-21T03:00:00Z".parse().unwrap(), 100.0);
    let stage = Stage::start_with(&block("safetymonitor", "real", &hardware, ""), clock).await;
    let error = stage.running.ended().await.unwrap_err().to_string();
    assert!(error.contains("\"real\"") && error.contains("speed 100"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_node_on_the_same_device_is_an_alert() {
    let hardware = Fake::start(&[("issafe", json!(true))]).await;
    let devices = block("safetymonitor", "shared", &hardware, "");
    let stage = Stage::start(&devices).await;
    stage.until::<SafetyMonitor>("shared", |state| state.link == Link::Connected).await;
    let key = Key::Capabilities(stage.device(Kind::SafetyMonitor, "shared"));
    let intruder = stage.bus.publisher(&key).await.unwrap();
    let description = contract::device::DeviceDescription {
        server: "elsewhere:1".to_owned(),
        number: 0,
        device_name: String::new(),
        driver: String::new(),
        interface_version: 1,
        simulated: false,
        can: json!({}),
        unread: Default::default(),
    };
    intruder.put(description).await.unwrap();
    let mut alerts = stage.node().alerts.watch();
    let raised = alerts.wait_for(|alerts| alerts.alerts.iter().any(|alert| alert.id.starts_with("second-writer/")));
    tokio::time::timeout(LIMIT, raised).await.unwrap().unwrap();
    assert_eq!(stage.node().key(NodeTopic::Alerts).address(), &stage.node().config.address());
    stage.end().await;
}
