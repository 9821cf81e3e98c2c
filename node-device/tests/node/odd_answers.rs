//! Devices that answer oddly: with an error once or always, a step off, with a state that stays.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use bus::{Catch, Clock};
use contract::device::DeviceDescription;
use contract::device::camera::Frame;
use contract::device::{camera, cover_calibrator, dome, filter_wheel, focuser, rotator, switch, telescope};
use contract::{CommandOutcome, Key, Kind, Link};
use serde_json::{Value, json};
use test_support::LIMIT;
use units::Utc;

use crate::fake::{Fake, FakeAnswer};
use crate::stage::{Stage, accepted, command, until_received};
use crate::{a_camera, block, expose};

const DRIVER_ERROR: FakeAnswer = FakeAnswer::Error(0x500, "an error of the driver");

/// Waits for a description that is as wanted.
async fn described<K: contract::DeviceKind>(
    stage: &Stage,
    name: &str,
    wanted: impl Fn(&DeviceDescription<K::Capabilities>) -> bool,
) -> DeviceDescription<K::Capabilities> {
    let key = Key::Capabilities(stage.device(K::KIND, name)).to_string();
    let described = stage.bus.subscribe::<DeviceDescription<K::Capabilities>>(&key, Catch::Newest, 8).await.unwrap();
    until_received(name, &described, wanted).await
}

/// Waits until an alert is active; returns its cause.
async fn alert(stage: &Stage, id: &str) -> String {
    let mut alerts = stage.node().alerts.watch();
    let cause = |alerts: &contract::observatory::Alerts| {
        alerts
            .alerts
            .iter()
            .find(|alert| alert.id == id && alert.returned_utc.is_none())
            .map(|alert| alert.cause.clone())
    };
    let reached = tokio::time::timeout(LIMIT * 2, alerts.wait_for(|alerts| cause(alerts).is_some())).await;
    let reached = reached.unwrap_or_else(|_| panic!("{id} was not raised")).unwrap();
    cause(&reached).unwrap_or_default()
}

async fn a_focuser(answers: &[(&str, Value)]) -> Fake {
    let hardware = Fake::start(&[
        ("position", json!(1000)),
        ("ismoving", json!(false)),
        ("temperature", json!(8.0)),
        ("absolute", json!(true)),
        ("stepsize", json!(1.0)),
    ])
    .await;
    for (member, value) in answers {
        hardware.answer(member, FakeAnswer::Value(value.clone()));
    }
    hardware
}

/// Moves arrive at once, so many steps off.
fn arrives(hardware: &Fake, off: i64) {
    hardware.on("move", move |fake, form| {
        let position = form.split('&').find_map(|pair| pair.strip_prefix("Position=")).unwrap().parse::<i64>().unwrap();
        fake.answer("position", FakeAnswer::Value(json!(position + off)));
    });
}

async fn move_to(stage: &Stage, position: i64) -> CommandOutcome {
    let go = command(&format!("to-{position}"), None, focuser::Command::Move { position });
    accepted(&stage.command(Kind::Focuser, "focus", &go).await);
    let ended = |state: &contract::DeviceState<focuser::Fields>| {
        state.last_command.as_ref().is_some_and(|last| last.id == go.id && last.outcome != CommandOutcome::Running)
    };
    stage.until::<focuser::Focuser>("focus", ended).await.last_command.unwrap().outcome
}

#[tokio::test(flavor = "multi_thread")]
async fn a_capability_that_answers_with_an_error_is_unknown_named_and_asked_again() {
    let hardware = Fake::start(&[
        ("shutterstatus", json!(1)),
        ("canpark", json!(false)),
        ("cansetazimuth", json!(false)),
        ("canslave", json!(false)),
    ])
    .await;
    hardware.answer("cansetshutter", DRIVER_ERROR);
    let stage = Stage::start(&block("dome", "dome", &hardware, "period_s = 0.2")).await;
    let unknown = described::<dome::Dome>(&stage, "dome", |description| !description.unread.is_empty()).await;
    assert!(unknown.can.set_shutter && !unknown.can.park, "not known is not no: {unknown:?}");
    assert_eq!(unknown.unread.keys().collect::<Vec<_>>(), ["CanSetShutter"]);
    let cause = alert(&stage, "device-unread/dome/dome").await;
    assert!(cause.contains("CanSetShutter (ascom 0x500: an error of the driver)"), "{cause}");
    hardware.answer("cansetshutter", FakeAnswer::Value(json!(false)));
    let known = described::<dome::Dome>(&stage, "dome", |description| description.unread.is_empty()).await;
    assert!(!known.can.set_shutter);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_focuser_without_a_last_position_moves_and_one_a_step_off_has_arrived() {
    let hardware = a_focuser(&[]).await;
    hardware.answer("maxstep", FakeAnswer::Error(0x400, "not implemented"));
    arrives(&hardware, -1);
    let stage = Stage::start(&block("focuser", "focus", &hardware, "period_s = 0.2\nsettle_s = 0")).await;
    stage.until::<focuser::Focuser>("focus", |state| state.link == Link::Connected).await;
    assert_eq!(move_to(&stage, 70_000).await, CommandOutcome::Done);
    arrives(&hardware, -10);
    let CommandOutcome::Failed { reason } = move_to(&stage, 2000).await else { panic!("it is 10 steps off") };
    assert_eq!(reason, "it rests at 1990, 10 steps from 2000 (tolerance_steps = 2)");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_long_way_is_gone_in_moves_that_the_focuser_takes() {
    let hardware = a_focuser(&[("maxstep", json!(50_000)), ("maxincrement", json!(400))]).await;
    arrives(&hardware, 0);
    let stage = Stage::start(&block("focuser", "focus", &hardware, "period_s = 0.2\nsettle_s = 0")).await;
    stage.until::<focuser::Focuser>("focus", |state| state.link == Link::Connected).await;
    assert_eq!(move_to(&stage, 2000).await, CommandOutcome::Done);
    assert_eq!(hardware.puts("move").len(), 3, "1400, 1800, 2000");
    assert_eq!(move_to(&stage, 1700).await, CommandOutcome::Done);
    assert_eq!(hardware.puts("move").len(), 4);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_are_done_and_announced_though_the_camera_reports_a_download_for_ever() {
    let hardware = a_camera().await;
    hardware.answer("camerastate", FakeAnswer::Value(json!(4)));
    let stage = Stage::start(&block("camera", "cam", &hardware, "")).await;
    let key = Key::Frame(stage.device(Kind::Camera, "cam")).to_string();
    let frames = stage.bus.subscribe::<Frame>(&key, Catch::All, 100).await.unwrap();
    stage.until::<camera::Camera>("cam", |state| state.link == Link::Connected).await;
    let done = |id: contract::CommandId| {
        move |state: &contract::DeviceState<camera::Fields>| {
            state.last_command.as_ref().is_some_and(|last| last.id == id && last.outcome == CommandOutcome::Done)
        }
    };
    for index in 0..3 {
        let go = expose(&format!("f{index}"), 0.1);
        accepted(&stage.command(Kind::Camera, "cam", &go).await);
        stage.until::<camera::Camera>("cam", done(go.id)).await;
        tokio::time::timeout(LIMIT, frames.recv()).await.unwrap();
    }
    let stop = command("stop", None, camera::Command::Abort);
    accepted(&stage.command(Kind::Camera, "cam", &stop).await);
    stage.until::<camera::Camera>("cam", done(stop.id)).await;
    let cause = alert(&stage, "device-contradicts/camera/cam").await;
    assert!(cause.contains("CameraState stays Download although no exposure is under way"), "{cause}");
    stage.end().await;
}

/// Its header would say that it began when it was refused, or half way from there.
#[tokio::test(flavor = "multi_thread")]
async fn an_exposure_that_is_refused_during_a_readout_begins_when_it_is_taken() {
    let utc = || Clock::machine_clock().utc();
    for reports_start in [true, false] {
        let hardware = a_camera().await;
        // When the readout was over, and when the exposure began.
        let times: Arc<Mutex<Vec<Utc>>> = Arc::default();
        let noted = times.clone();
        hardware.on("startexposure", move |fake, _| {
            if noted.lock().unwrap().is_empty() {
                fake.answer("camerastate", FakeAnswer::Value(json!(3)));
                fake.answer("put startexposure", FakeAnswer::Error(0x40B, "the frame before is read out"));
                let (fake, noted) = (fake.clone(), noted.clone());
                tokio::spawn(async move {
                    tokio::time::sleep(Duration::from_secs(2)).await;
                    noted.lock().unwrap().push(utc());
                    fake.answer("camerastate", FakeAnswer::Value(json!(0)));
                });
                return;
            }
            let began = utc();
            noted.lock().unwrap().push(began);
            fake.answer("put startexposure", FakeAnswer::Value(Value::Null));
            fake.answer("imageready", FakeAnswer::Value(json!(true)));
            if reports_start {
                fake.answer("lastexposurestarttime", FakeAnswer::Value(json!(began.to_string())));
            }
        });
        let stage = Stage::start(&block("camera", "cam", &hardware, "period_s = 0.2")).await;
        let key = Key::Frame(stage.device(Kind::Camera, "cam")).to_string();
        let frames = stage.bus.subscribe::<Frame>(&key, Catch::All, 100).await.unwrap();
        stage.until::<camera::Camera>("cam", |state| state.link == Link::Connected).await;
        accepted(&stage.command(Kind::Camera, "cam", &expose("f0", 0.1)).await);
        let frame = tokio::time::timeout(LIMIT, frames.recv()).await.unwrap().sample.body;
        let times = times.lock().unwrap().clone();
        let [free, began] = times[..] else { panic!("it began once: {times:?}") };
        assert!(frame.started_utc >= free, "{} is in the readout before, {times:?}", frame.started_utc);
        if reports_start {
            assert_eq!(frame.started_utc, began, "the camera says when it began");
        }
        stage.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_without_cooleron_takes_its_set_point_and_reads_the_blocks_that_it_has() {
    let hardware = a_camera().await;
    for (member, value) in [
        ("cansetccdtemperature", json!(true)),
        ("setccdtemperature", json!(10.0)),
        ("exposuremin", json!(0.05)),
        ("exposuremax", json!(10.0)),
        ("exposureresolution", json!(0.05)),
        ("lastexposureduration", json!(0.15)),
        ("startx", json!(8)),
    ] {
        hardware.answer(member, FakeAnswer::Value(value));
    }
    hardware.answer("cooleron", FakeAnswer::Error(0x400, "not implemented"));
    hardware.on("setccdtemperature", |fake, _| fake.answer("setccdtemperature", FakeAnswer::Value(json!(-20.0))));
    hardware.answer("put cooleron", FakeAnswer::Error(0x400, "not implemented"));
    let stage = Stage::start(&block("camera", "cam", &hardware, "period_s = 0.2")).await;
    let key = Key::Frame(stage.device(Kind::Camera, "cam")).to_string();
    let frames = stage.bus.subscribe::<Frame>(&key, Catch::All, 100).await.unwrap();
    stage.until::<camera::Camera>("cam", |state| state.link == Link::Connected).await;
    let cool = command("cool", None, camera::Command::Cool { set_c: -20.0 });
    accepted(&stage.command(Kind::Camera, "cam", &cool).await);
    stage.until::<camera::Camera>("cam", |state| state.has_done(&cool.id)).await;
    let go = expose("f0", 0.137);
    accepted(&stage.command(Kind::Camera, "cam", &go).await);
    let frame = tokio::time::timeout(LIMIT, frames.recv()).await.unwrap().sample.body;
    assert_eq!((frame.exposure_s, frame.origin_px), (0.15, [8, 0]), "as the camera reports it");
    let starts = hardware.puts("startexposure");
    assert!(starts[0].form.contains("Duration=0.15&"), "{starts:?}");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slew_is_done_and_the_mount_named_though_ispulseguiding_stays_true() {
    let mount = crate::rates::a_mount(true).await;
    mount.answer("ispulseguiding", FakeAnswer::Value(json!(true)));
    let more = "period_s = 0.2\nsettle_s = 0.0\nlimits = { altitude_min_deg = -90.0 }";
    let stage = Stage::start(&block("telescope", "mount", &mount, more)).await;
    let token = crate::rates::ready(&stage).await;
    let slew = command("slew", token, telescope::Command::Slew { ra_deg: 45.0, dec_deg: -20.0 });
    accepted(&stage.command(Kind::Telescope, "mount", &slew).await);
    let done = |state: &contract::DeviceState<telescope::Fields>| {
        state.last_command.as_ref().is_some_and(|last| last.id == slew.id && last.outcome == CommandOutcome::Done)
    };
    let state = stage.until::<telescope::Telescope>("mount", done).await;
    assert!(state.busy, "the bus shows what the mount says");
    let cause = alert(&stage, "device-contradicts/telescope/mount").await;
    assert!(cause.contains("IsPulseGuiding stays true"), "{cause}");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mount_whose_server_hangs_is_named_until_it_answers_again() {
    let mount = crate::rates::a_mount(true).await;
    let more = "period_s = 0.2\nlimits = { altitude_min_deg = -90.0 }";
    let stage = Stage::start(&block("telescope", "mount", &mount, more)).await;
    stage.until::<telescope::Telescope>("mount", |state| state.link == Link::Connected).await;
    mount.hang(true);
    let cause = alert(&stage, "device-lost/telescope/mount").await;
    assert!(cause.starts_with("telescope/mount at 127.0.0.1:"), "{cause}");
    mount.hang(false);
    let mut alerts = stage.node().alerts.watch();
    let is_gone = |alert: &contract::observatory::Alert| {
        alert.id != "device-lost/telescope/mount" || alert.returned_utc.is_some()
    };
    let gone = alerts.wait_for(|alerts| alerts.alerts.iter().all(is_gone));
    tokio::time::timeout(LIMIT, gone).await.unwrap().unwrap();
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wheel_that_cannot_name_its_filters_at_first_is_asked_until_it_can() {
    let hardware = Fake::start(&[("position", json!(0)), ("focusoffsets", json!([0, 12]))]).await;
    hardware.answer("names", DRIVER_ERROR);
    let stage = Stage::start(&block("filterwheel", "wheel", &hardware, "period_s = 0.2")).await;
    described::<filter_wheel::FilterWheel>(&stage, "wheel", |wheel| wheel.unread.contains_key("Names")).await;
    hardware.answer("names", FakeAnswer::Value(json!(["R", "G"])));
    let wheel = described::<filter_wheel::FilterWheel>(&stage, "wheel", |wheel| wheel.unread.is_empty()).await;
    assert_eq!((wheel.can.names, wheel.can.focus_offsets), (vec!["R".to_owned(), "G".to_owned()], vec![0, 12]));
    let named = |state: &contract::DeviceState<filter_wheel::Fields>| state.fields.filter.known().is_some();
    stage.until::<filter_wheel::FilterWheel>("wheel", named).await;
    stage.end().await;
}

/// A limit that was believed once would refuse every row of the night, although the device is well again.
#[tokio::test(flavor = "multi_thread")]
async fn a_limit_that_cannot_be_is_unknown_named_and_asked_again() {
    let answer = |hardware: &Fake, answers: &[(&str, Value)]| {
        answers.iter().for_each(|(member, value)| hardware.answer(member, FakeAnswer::Value(value.clone())));
    };
    let camera = a_camera().await;
    answer(&camera, &[("exposuremin", json!(1e300)), ("exposuremax", json!(-1)), ("maxbinx", json!(0))]);
    answer(&camera, &[("exposureresolution", json!(1e9)), ("maxadu", json!("NaN")), ("cameraxsize", json!(-3))]);
    let focuser = a_focuser(&[("maxstep", json!(-1)), ("maxincrement", json!(1e12))]).await;
    let position = [("position", json!(0.0)), ("mechanicalposition", json!(0.0)), ("ismoving", json!(false))];
    let rotator = Fake::start(&position).await;
    answer(&rotator, &[("stepsize", json!(1e300))]);
    let panel = Fake::start(&[("coverstate", json!(0)), ("calibratorstate", json!(1)), ("brightness", json!(0))]).await;
    answer(&panel, &[("maxbrightness", json!(-5))]);
    let switches = Fake::start(&[("maxswitch", json!(1)), ("getswitchvalue", json!(0.0))]).await;
    answer(&switches, &[("minswitchvalue", json!(5.0)), ("maxswitchvalue", json!(-5.0)), ("switchstep", json!(1.0))]);
    let devices = [
        ("camera", "cam", &camera),
        ("focuser", "focus", &focuser),
        ("rotator", "rotator", &rotator),
        ("covercalibrator", "panel", &panel),
        ("switch", "switches", &switches),
    ];
    let blocks: String = devices.map(|(kind, name, hardware)| block(kind, name, hardware, "period_s = 0.2")).concat();
    let stage = Stage::start(&blocks).await;
    let has = |unread: &std::collections::BTreeMap<String, contract::NoData>, names: &[&str]| {
        names.iter().all(|name| unread.contains_key(*name))
    };
    let names = ["CameraXSize", "ExposureMax", "ExposureMin", "ExposureResolution", "MaxADU", "MaxBinX"];
    let unknown = described::<camera::Camera>(&stage, "cam", |cam| has(&cam.unread, &names)).await.can;
    assert_eq!((unknown.exposure_min_s, unknown.exposure_max_s, unknown.exposure_step_s), (None, None, None));
    assert_eq!((unknown.max_bin, unknown.width_px, unknown.max_adu.known()), (0, 0, None));
    let cause = alert(&stage, "device-unread/camera/cam").await;
    assert!(cause.contains("ExposureMin (wrong type: 1e300 is not possible; expected 0.0 to 60.0)"), "{cause}");
    let pair = ["MaxStep", "MaxIncrement"];
    let unknown = described::<focuser::Focuser>(&stage, "focus", |focus| has(&focus.unread, &pair)).await.can;
    assert_eq!((unknown.last_position(), unknown.max_increment), (None, None));
    described::<rotator::Rotator>(&stage, "rotator", |rotator| has(&rotator.unread, &["StepSize"])).await;
    described::<cover_calibrator::CoverCalibrator>(&stage, "panel", |panel| has(&panel.unread, &["MaxBrightness"]))
        .await;
    let pair = ["MinSwitchValue(0)", "MaxSwitchValue(0)"];
    let unknown = described::<switch::Switch>(&stage, "switches", |switch| has(&switch.unread, &pair)).await.can;
    assert_eq!((unknown.switches[0].minimum, unknown.switches[0].maximum), (f64::MIN, f64::MAX));

    answer(&camera, &[("exposuremin", json!(0.001)), ("exposuremax", json!(3600)), ("maxbinx", json!(4))]);
    answer(&camera, &[("exposureresolution", json!(0.0)), ("maxadu", json!(65535)), ("cameraxsize", json!(3))]);
    answer(&focuser, &[("maxstep", json!(5000)), ("maxincrement", json!(400))]);
    answer(&switches, &[("minswitchvalue", json!(-5.0)), ("maxswitchvalue", json!(5.0))]);
    let known = described::<camera::Camera>(&stage, "cam", |cam| cam.unread.is_empty()).await.can;
    assert_eq!((known.exposure_min_s, known.exposure_max_s, known.exposure_step_s), (Some(0.001), Some(3600.0), None));
    assert_eq!((known.max_bin, known.width_px, known.max_adu.known()), (4, 3, Some(&65535.0)));
    let known = described::<focuser::Focuser>(&stage, "focus", |focus| focus.unread.is_empty()).await.can;
    assert_eq!((known.last_position(), known.max_increment), (Some(5000), Some(400)));
    let known = described::<switch::Switch>(&stage, "switches", |switch| switch.unread.is_empty()).await.can;
    assert_eq!((known.switches[0].minimum, known.switches[0].maximum), (-5.0, 5.0));
    stage.end().await;
}

/// As a limit it would refuse every row, and as nonsense it would be an alert for good.
#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_states_no_limit_is_not_limited_and_is_no_alert() {
    let camera = a_camera().await;
    let limits = [("exposuremin", json!(0.001)), ("exposuremax", json!(0.0)), ("exposureresolution", json!(0.0))];
    limits.into_iter().for_each(|(member, value)| camera.answer(member, FakeAnswer::Value(value)));
    let focuser = a_focuser(&[("maxstep", json!(0)), ("maxincrement", json!(0))]).await;
    let rotator = Fake::start(&[
        ("position", json!(0.0)),
        ("mechanicalposition", json!(0.0)),
        ("ismoving", json!(false)),
        ("stepsize", json!(-1.0)),
    ])
    .await;
    let panel = [("coverstate", json!(0)), ("calibratorstate", json!(1)), ("brightness", json!(0))];
    let panel = Fake::start(&panel).await;
    panel.answer("maxbrightness", FakeAnswer::Value(json!(0)));
    let devices = [
        ("camera", "cam", &camera),
        ("focuser", "focus", &focuser),
        ("rotator", "rotator", &rotator),
        ("covercalibrator", "panel", &panel),
    ];
    let blocks: String = devices.map(|(kind, name, hardware)| block(kind, name, hardware, "period_s = 0.2")).concat();
    let stage = Stage::start(&blocks).await;
    let can = described::<camera::Camera>(&stage, "cam", |cam| !cam.unread.contains_key("ExposureMax")).await.can;
    assert_eq!((can.exposure_min_s, can.exposure_max_s), (Some(0.001), None));
    assert_eq!(can.exposure_s(3600.0), Ok(3600.0));
    let is_read = |focus: &DeviceDescription<focuser::Capabilities>| {
        !["MaxStep", "MaxIncrement"].iter().any(|name| focus.unread.contains_key(*name))
    };
    let can = described::<focuser::Focuser>(&stage, "focus", is_read).await.can;
    assert_eq!((can.last_position(), can.max_increment), (None, None));
    let can = described::<rotator::Rotator>(&stage, "rotator", |one| !one.unread.contains_key("StepSize")).await.can;
    assert_eq!(can.step_deg, None);
    let is_read =
        |panel: &DeviceDescription<cover_calibrator::Capabilities>| !panel.unread.contains_key("MaxBrightness");
    let can = described::<cover_calibrator::CoverCalibrator>(&stage, "panel", is_read).await.can;
    assert!(can.calibrator && can.max_brightness == 0);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_a_shortest_exposure_that_is_longer_than_the_longest_nobody_knows_which_is_wrong() {
    let hardware = a_camera().await;
    hardware.answer("exposuremin", FakeAnswer::Value(json!(20.0)));
    hardware.answer("exposuremax", FakeAnswer::Value(json!(10.0)));
    let stage = Stage::start(&block("camera", "cam", &hardware, "period_s = 0.2")).await;
    let unknown = described::<camera::Camera>(&stage, "cam", |cam| cam.unread.contains_key("ExposureMax")).await;
    assert_eq!(unknown.unread.keys().collect::<Vec<_>>(), ["ExposureMax", "ExposureMin"]);
    assert_eq!((unknown.can.exposure_min_s, unknown.can.exposure_max_s), (None, None));
    hardware.answer("exposuremin", FakeAnswer::Value(json!(0.02)));
    let known = described::<camera::Camera>(&stage, "cam", |cam| cam.unread.is_empty()).await.can;
    assert_eq!((known.exposure_min_s, known.exposure_max_s), (Some(0.02), Some(10.0)));
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_image_of_another_size_than_was_asked_for_is_refused_where_it_comes_as_json_too() {
    let hardware = a_camera().await;
    hardware.answer("imagearray", FakeAnswer::Value(json!([[1, 2], [3, 4]])));
    let stage = Stage::start(&block("camera", "cam", &hardware, "period_s = 0.2")).await;
    stage.until::<camera::Camera>("cam", |state| state.link == Link::Connected).await;
    accepted(&stage.command(Kind::Camera, "cam", &expose("f0", 0.1)).await);
    let cause = alert(&stage, "image-unreadable/cam").await;
    assert!(cause.contains("the image has 2 x 2 px, asked for 3 x 2 px"), "{cause}");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_ragged_image_is_told_as_a_fault_of_the_cameras_answer_and_not_of_the_disk() {
    let hardware = a_camera().await;
    hardware.answer("imagearray", FakeAnswer::Value(json!([[1, 2], [3], [5, 6]])));
    let stage = Stage::start(&block("camera", "cam", &hardware, "period_s = 0.2")).await;
    stage.until::<camera::Camera>("cam", |state| state.link == Link::Connected).await;
    let go = expose("f0", 0.1);
    accepted(&stage.command(Kind::Camera, "cam", &go).await);
    let cause = alert(&stage, "image-unreadable/cam").await;
    stage.until::<camera::Camera>("cam", |state| state.has_done(&go.id)).await;
    assert!(cause.starts_with("frame f0 could not be kept: what cam answered as its image cannot be read"), "{cause}");
    assert!(cause.contains("its lists are of different length, such as 2 and 1 values"), "{cause}");
    let ids = |stage: &Stage| -> Vec<String> {
        let alerts = stage.node().alerts.watch().borrow().alerts.clone();
        alerts.into_iter().filter(|alert| alert.returned_utc.is_none()).map(|alert| alert.id).collect()
    };
    assert!(!ids(&stage).iter().any(|id| id.starts_with("spool-cannot-write")), "{:?}", ids(&stage));
    hardware.answer("imagearray", FakeAnswer::Value(json!([[1, 2], [3, 4], [5, 6]])));
    accepted(&stage.command(Kind::Camera, "cam", &expose("f1", 0.1)).await);
    let mut alerts = stage.node().alerts.watch();
    let is_over = alerts.wait_for(|alerts| alerts.alerts.iter().all(|alert| alert.id != "image-unreadable/cam"));
    tokio::time::timeout(LIMIT, is_over).await.unwrap().unwrap();
    stage.end().await;
}
