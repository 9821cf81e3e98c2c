//! What drivers make of commands as they come by the bus and of answers as sloppy devices give them.

use std::sync::Arc;

use bus::Clock;
use contract::DeviceKind as _;
use serde_json::{Value, json};
use units::Utc;

use super::camera::Camera;
use super::cover_calibrator::CoverCalibrator;
use super::filter_wheel::FilterWheel;
use super::focuser::Focuser;
use super::observing_conditions::ObservingConditions;
use super::rotator::Rotator;
use super::telescope::Telescope;
use super::*;
use crate::spool::Spool;

pub(super) fn focuser(tolerance_steps: i64) -> Focuser {
    Focuser { settle_s: 2.0, tolerance_steps, ..Focuser::default() }
}

/// The fields of a device that gave these answers.
pub(super) fn fields<D: Driver>(driver: &D, answers: &Value) -> Fields<D> {
    let mut readings = Readings::default();
    for (property, answer) in answers.as_object().unwrap() {
        let refused = answer.get("ascom").and_then(Value::as_u64).map(|code| {
            AlpacaError::Ascom { code: u32::try_from(code).unwrap(), message: "refused".to_owned() }.no_data()
        });
        readings.keep(property, refused.map_or_else(|| Ok(answer.clone()), Err), Utc::EPOCH);
    }
    driver.fields(&readings)
}

/// In place of an answer: the driver does not have it.
fn ascom_error() -> Value {
    json!({"ascom": 0x400})
}

pub(super) fn command<D: Driver>(command: &Value) -> Command<D> {
    serde_json::from_value(command.clone()).unwrap()
}

fn check_progress<D: Driver>(driver: &D, asked: Value, rows: &[(Value, Progress)]) {
    for (answers, wanted) in rows {
        let progress = driver.progress(&command::<D>(&asked), &fields(driver, answers));
        assert_eq!(progress, *wanted, "{} {asked} {answers}", D::Kind::KIND);
    }
}

pub(super) fn check_busy<D: Driver>(driver: &D, rows: &[(Value, bool)]) {
    for (answers, wanted) in rows {
        assert_eq!(driver.is_busy(&fields(driver, answers)), *wanted, "{} {answers}", D::Kind::KIND);
    }
}

pub(super) fn mount() -> Telescope {
    let text = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0.0\nlongitude_deg = 0.0\n\
                elevation_m = 0.0\n[[telescope]]\nname = \"m\"\nserver = \"h:1\"\nsettle_s = 3.0\n";
    Telescope::new(&config::parse(text, std::path::Path::new(".")).unwrap().telescope[0], bus::Clock::machine_clock())
}

pub(super) fn camera(folder: &std::path::Path) -> Camera {
    let spool = Spool::open(folder, "http://127.0.0.1:1".to_owned(), (&"alpha".parse().unwrap(), &[])).unwrap().0;
    Camera::new("cam".parse().unwrap(), Clock::machine_clock(), Arc::new(spool), Vec::new())
}

#[test]
fn a_move_is_done_when_the_device_is_seen_to_rest_where_it_was_sent() {
    use Progress::{Done, Failed, Running, SaysItMoves, Settling, Stranded};
    let stranded = |off: f64, why: &str| Stranded { off, why: why.to_owned() };
    let at = |position: Value, moving: Value| json!({"Position": position, "IsMoving": moving});
    let rows = [
        (at(json!(500), json!(false)), Settling(2.0)),
        (at(json!("500"), json!("False")), Settling(2.0)),
        (at(json!(500), json!(true)), SaysItMoves),
        (at(json!(499), json!(true)), Running),
        (at(json!(499), json!(false)), stranded(1.0, "it rests at 499, 1 steps from 500 (tolerance_steps = 0)")),
        (at(json!(500), json!("perhaps")), Running),
        (at(json!(null), json!(false)), Running),
    ];
    check_progress(&focuser(0), json!({"move": {"position": 500}}), &rows);
    let rows = [
        (at(json!(495), json!(false)), Settling(3.0)),
        (at(json!(505), json!(true)), SaysItMoves),
        (at(json!(506), json!(true)), Running),
        (at(json!(494), json!(false)), stranded(1.2, "it rests at 494, 6 steps from 500 (tolerance_steps = 5)")),
    ];
    check_progress(&focuser(5), json!({"move": {"position": 500}}), &rows);
    let rows = [(at(json!(7), json!(false)), Done), (at(json!(7), json!(true)), Running), (json!({}), Running)];
    check_progress(&focuser(0), json!("abort"), &rows);
    check_progress(&Rotator::new(0.1), json!("abort"), &rows);

    // Its driver refuses to say whether it moves: the position shows it, some seconds later.
    let refused = [(at(json!(500), ascom_error()), Settling(12.0)), (at(json!(501), ascom_error()), Running)];
    check_progress(&focuser(0), json!({"move": {"position": 500}}), &refused);
    check_progress(&focuser(0), json!("abort"), &[(at(json!(7), ascom_error()), Settling(10.0))]);

    let rows = [
        (at(json!(359.995), json!(false)), Done),
        (at(json!(359.95), json!(false)), Settling(3.0)),
        (at(json!(0.05), json!(0)), Settling(3.0)),
        (
            at(json!(0.25), json!(false)),
            stranded(2.5, "it rests at 0.25 deg, 0.25 deg from 360.00 (tolerance_deg = 0.1)"),
        ),
        (at(json!(359.95), json!(true)), SaysItMoves),
        (at(json!(359.995), ascom_error()), Settling(10.0)),
        (at(json!("NaN"), json!(false)), Running),
    ];
    check_progress(&Rotator::new(0.1), json!({"move": {"position_deg": 360.0}}), &rows);

    let positions = |[there, turning, other]: [Progress; 3]| {
        [(json!({"Position": 1}), there), (json!({"Position": -1}), turning), (json!({"Position": 0}), other)]
    };
    let rows = positions([Done, Running, stranded(-1.0, "it rests at position 0, not at 1")]);
    check_progress(&FilterWheel::default(), json!({"turn": {"position": 1}}), &rows);

    let failed = |what: &str| Failed(format!("the {what} is in error"));
    for (asked, done) in [("open_cover", 3), ("close_cover", 1)] {
        let rows = (0..=6).map(|state| {
            let progress = match state {
                5 => failed("cover"),
                state => Progress::done_if(state == done),
            };
            (json!({"CoverState": state}), progress)
        });
        check_progress(&CoverCalibrator, json!(asked), &rows.collect::<Vec<_>>());
    }
    let rows = [(json!({"CoverState": 2}), Running), (json!({"CoverState": 4}), Done), (json!({}), Running)];
    check_progress(&CoverCalibrator, json!("halt_cover"), &rows);
    let panel = |state: i64| json!({"CalibratorState": state});
    let rows = [(panel(2), Running), (panel(3), Done), (panel(5), failed("panel")), (panel(1), Running)];
    check_progress(&CoverCalibrator, json!({"calibrator_on": {"brightness": 9}}), &rows);
    check_progress(&CoverCalibrator, json!("calibrator_off"), &[(panel(1), Done), (panel(3), Running)]);
}

#[test]
fn a_mount_has_arrived_when_it_rests_near_its_target_on_the_sky() {
    use Progress::{Done, Running, SaysItMoves, Settling, Stranded};
    let stranded = |off: f64, deg: &str| Stranded {
        off,
        why: format!("it rests {deg} deg from where it was sent (arrival_tolerance_deg = 0.5)"),
    };
    let at = |hours: f64, dec_deg: f64, slewing: Value| json!({"RightAscension": hours, "Declination": dec_deg, "Slewing": slewing});
    let slew = |ra_deg: f64, dec_deg: f64| json!({"slew": {"ra_deg": ra_deg, "dec_deg": dec_deg}});
    let still = json!(false);
    let rows = [
        (at(23.98, 0.3, still.clone()), Settling(3.0)),
        (at(0.0, 0.6, still.clone()), stranded(1.2, "0.60")),
        (at(0.1, 0.0, still.clone()), stranded(3.0, "1.50")),
        (at(0.0, 0.0, json!(true)), SaysItMoves),
        (at(0.1, 0.0, json!(true)), Running),
        (at(0.0, 0.0, ascom_error()), Settling(13.0)),
        (at(0.0, 0.0, json!("NaN")), Running),
        (json!({"Slewing": false, "Declination": 0.0}), Running),
    ];
    check_progress(&mount(), slew(0.0, 0.0), &rows);
    // An hour of right ascension is little at the pole.
    check_progress(&mount(), slew(0.0, 89.0), &[(at(1.0, 89.0, still.clone()), Settling(3.0))]);
    let rows = [
        (json!({"AtPark": true}), Done),
        (json!({"AtPark": true, "Slewing": false, "Tracking": false}), Done),
        (json!({"AtPark": true, "Slewing": ascom_error(), "Tracking": ascom_error()}), Done),
        (json!({"AtPark": true, "Slewing": true}), Running),
        (json!({"AtPark": true, "Slewing": false, "Tracking": true}), Running),
        (json!({"AtPark": false}), Running),
        (json!({}), Running),
    ];
    check_progress(&mount(), json!("park"), &rows);
    let rows = [(json!({"Tracking": 1}), Done), (json!({"Tracking": "on"}), Running)];
    check_progress(&mount(), json!({"track": {"on": true}}), &rows);
}

#[test]
fn what_a_mount_refuses_to_tell_is_taken_for_done_after_a_while_and_not_at_once() {
    use Progress::{Running, Settling};
    for refused in [ascom_error(), json!({"ascom": 0x500})] {
        let parks =
            |slewing: Value, tracking: Value| json!({"AtPark": refused, "Slewing": slewing, "Tracking": tracking});
        let rows = [
            (parks(json!(false), json!(false)), Settling(10.0)),
            (parks(refused.clone(), refused.clone()), Settling(10.0)),
            (parks(json!(true), json!(false)), Running),
            (parks(json!(false), json!(true)), Running),
            (json!({"AtPark": refused, "Slewing": false}), Running),
            (json!({"Slewing": false, "Tracking": false}), Running),
        ];
        check_progress(&mount(), json!("park"), &rows);
        check_progress(
            &mount(),
            json!("unpark"),
            &[(json!({"AtPark": refused}), Settling(10.0)), (json!({}), Running)],
        );
        check_progress(&mount(), json!("abort"), &[(json!({"Slewing": refused}), Settling(10.0))]);
        check_progress(&mount(), json!({"track": {"on": true}}), &[(json!({"Tracking": refused}), Settling(10.0))]);
        check_progress(&mount(), json!({"track": {"on": false}}), &[(json!({"Tracking": refused}), Running)]);
    }
}

#[test]
fn what_is_not_known_counts_as_moving() {
    for (moving, is_busy) in [(json!(false), false), (json!("False"), false), (json!(true), true), (json!("no"), true)]
    {
        let rows = [(json!({"Position": 1, "IsMoving": moving}), is_busy)];
        check_busy(&focuser(0), &rows);
        check_busy(&Rotator::new(0.1), &rows);
    }
    let rows = [(json!({"Position": 0}), false), (json!({"Position": -1}), true), (json!({}), true)];
    check_busy(&FilterWheel::default(), &rows);
    let state = |cover: i64, panel: i64| json!({"CoverState": cover, "CalibratorState": panel});
    let rows =
        [(state(1, 0), false), (state(2, 0), true), (state(3, 2), true), (state(9, 1), true), (state(0, 9), true)];
    check_busy(&CoverCalibrator, &rows);
    let rows = [
        (json!({"Slewing": false}), false),
        (json!({"Slewing": false, "IsPulseGuiding": true}), true),
        (json!({"Slewing": null}), true),
    ];
    check_busy(&mount(), &rows);
}

#[test]
fn a_sloppy_answer_is_read_and_one_of_another_type_is_missing_with_the_reason() {
    let mount = |answers: Value| serde_json::to_value(fields(&mount(), &answers)).unwrap();
    for (answers, name, wanted) in [
        (json!({"RightAscension": "1.5"}), "ra_deg", json!(22.5)),
        (json!({"RightAscension": "1,5"}), "ra_deg", json!("wrong type: expected a number, got \"1,5\"")),
        (json!({"RightAscension": [1.5]}), "ra_deg", json!("wrong type: expected a number, got [1.5]")),
        (json!({"Declination": "Infinity"}), "dec_deg", json!("not a number")),
        (json!({"Tracking": "True"}), "tracking", json!(true)),
        (json!({"Tracking": 2}), "tracking", json!("wrong type: expected true or false, got 2")),
        (json!({"AtPark": null}), "at_park", json!("missing: null")),
        (json!({"SideOfPier": "0"}), "pier_side", json!("east")),
        (json!({"SideOfPier": 3}), "pier_side", json!("wrong type: SideOfPier is 3")),
        (json!({}), "slewing", json!("never read")),
    ] {
        let field = mount(answers.clone())[name].clone();
        assert_eq!(field.get("no_data").unwrap_or(&field), &wanted, "{answers}");
    }
    let wheel = |position: Value| serde_json::to_value(fields(&FilterWheel::default(), &json!({"Position": position})));
    assert_eq!(wheel(json!(3.0)).unwrap()["filter"]["no_data"], "missing: position 3 has no name");
    assert_eq!(wheel(json!(1.5)).unwrap()["position"]["no_data"], "wrong type: expected a whole number, got 1.5");
}

#[test]
fn a_weather_station_reports_the_age_of_each_sensor_that_gives_one() {
    let answers = json!({"Humidity": 50, "TimeSinceLastUpdate": 4.0, "TimeSinceLastUpdate(Humidity)": 90.0,
                         "TimeSinceLastUpdate(RainRate)": "old"});
    let fields = fields(&ObservingConditions, &answers);
    assert_eq!((fields.humidity_percent.known(), fields.sensor_age_s.known()), (Some(&50.0), Some(&4.0)));
    let ages: Vec<_> = fields.sensor_ages_s.iter().map(|(name, age)| (name.as_str(), age.known().copied())).collect();
    assert_eq!(ages, [("Humidity", Some(90.0)), ("RainRate", None)]);
    let asked = |property: &str| crate::readings::member(property);
    let of_humidity = vec![("SensorName", "Humidity".to_owned())];
    assert_eq!(asked("TimeSinceLastUpdate(Humidity)"), ("timesincelastupdate".to_owned(), of_humidity));
    assert_eq!(asked("GetSwitchValue3"), ("getswitchvalue".to_owned(), vec![("Id", "3".to_owned())]));
}

fn contradicts<D: Driver>(driver: &D, asked: Option<Value>, answers: &Value) -> Option<String> {
    let command = asked.map(|asked| command::<D>(&asked));
    driver.contradiction(command.as_ref(), &fields(driver, answers))
}

#[test]
fn what_a_device_does_besides_does_not_hold_a_command_up() {
    let mount = mount();
    let works = |asked: Value, answers: Value| mount.works_at(&command::<Telescope>(&asked), &fields(&mount, &answers));
    let stuck = json!({"Slewing": false, "IsPulseGuiding": true});
    assert!(mount.is_busy(&fields(&mount, &stuck)), "as the bus has it");
    assert!(!works(json!({"slew": {"ra_deg": 1.0, "dec_deg": 1.0}}), stuck.clone()));
    assert!(!works(json!("park"), stuck.clone()));
    assert!(works(json!({"pulse_guide": {"direction": "north", "duration_ms": 100}}), stuck));
    assert!(works(json!("park"), json!({"Slewing": "perhaps"})), "what is not known may move");
    let cover = |asked: Value, answers: Value| {
        CoverCalibrator.works_at(&command::<CoverCalibrator>(&asked), &fields(&CoverCalibrator, &answers))
    };
    let warming = json!({"CoverState": 1, "CalibratorState": 2});
    assert!(!cover(json!("close_cover"), warming.clone()) && cover(json!("calibrator_off"), warming));
}

#[test]
fn a_flag_that_stays_is_a_contradiction_and_what_a_command_explains_is_none() {
    let stuck = json!({"Slewing": false, "IsPulseGuiding": true});
    let pulse = |ms: u32| Some(json!({"pulse_guide": {"direction": "north", "duration_ms": ms}}));
    assert!(contradicts(&mount(), None, &stuck).unwrap().starts_with("IsPulseGuiding stays true"));
    assert!(contradicts(&mount(), pulse(300), &stuck).is_some(), "seen between all pulses");
    assert_eq!(contradicts(&mount(), pulse(60_000), &stuck), None);
    assert_eq!(contradicts(&mount(), None, &json!({"Slewing": true, "AtPark": false})), None, "by hand");
    assert!(contradicts(&mount(), None, &json!({"Slewing": true, "AtPark": true})).is_some());

    let moves = json!({"Position": 3, "IsMoving": true});
    assert!(
        contradicts(&focuser(0), None, &moves).is_some() && contradicts(&Rotator::new(0.1), None, &moves).is_some()
    );
    assert_eq!(contradicts(&focuser(0), Some(json!({"move": {"position": 500}})), &moves), None);
    let turns = json!({"Position": -1});
    assert!(contradicts(&FilterWheel::default(), None, &turns).is_some());
    assert_eq!(contradicts(&FilterWheel::default(), Some(json!({"turn": {"position": 1}})), &turns), None);
    assert!(contradicts(&CoverCalibrator, None, &json!({"CoverState": 2})).is_some());

    let folder = tempfile::tempdir().unwrap();
    let camera = camera(folder.path());
    let state = |state: i64| json!({"CameraState": state});
    assert!(contradicts(&camera, None, &state(4)).unwrap().contains("Download although no exposure is under way"));
    assert_eq!([0, 5].map(|idle| contradicts(&camera, None, &state(idle))), [None, None]);
    let exposing = |begun_s: f64| {
        let started_utc = Clock::machine_clock().utc().plus_seconds(-begun_s);
        let id = CommandId("f1".to_owned());
        camera.memory(|memory| {
            memory.exposure = Some(contract::device::camera::Exposure { id, started_utc, exposure_s: 600.0 });
        });
    };
    exposing(1.0);
    assert!(contradicts(&camera, None, &state(4)).unwrap().contains("while the exposure collects light"));
    assert_eq!(contradicts(&camera, None, &state(2)), None);
    exposing(700.0);
    assert_eq!(contradicts(&camera, None, &state(4)), None, "it is read out");
}

#[test]
fn a_cooler_and_an_abort_are_done_by_what_was_asked_and_not_by_an_odd_state() {
    use Progress::{Done, Running, Settling};
    let folder = tempfile::tempdir().unwrap();
    let camera = camera(folder.path());
    let cooler = |on: Value| json!({"CoolerOn": on, "SetCCDTemperature": -20.0});
    let rows = [(cooler(json!(true)), Done), (cooler(json!(false)), Settling(3.0)), (json!({}), Settling(3.0))];
    check_progress(&camera, json!({"cool": {"set_c": -20.0}}), &rows);
    let rows = [(cooler(json!(false)), Done), (cooler(json!(true)), Running), (json!({}), Settling(3.0))];
    check_progress(&camera, json!("warm"), &rows);
    let state = |state: i64| json!({"CameraState": state});
    let rows = [(state(0), Done), (state(5), Done), (state(4), Settling(10.0)), (json!({}), Settling(10.0))];
    check_progress(&camera, json!("abort"), &rows);
}
