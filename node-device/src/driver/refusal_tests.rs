//! Which commands a driver refuses and why: what its device cannot do, values beyond its limits, and a state that has to
//! be left first.

use contract::DeviceKind as _;
use serde_json::{Value, json};

use super::cover_calibrator::CoverCalibrator;
use super::filter_wheel::FilterWheel;
use super::rotator::Rotator;
use super::switch::Switch;
use super::tests::{camera, check_busy, command, fields, focuser, mount};
use super::*;

/// A command, and why it is refused, or `None`.
type Refused<'a> = (Value, Option<(Reason, &'a str)>);

fn check_refusals<D: Driver>(driver: &D, can: Value, answers: Value, rows: &[Refused]) {
    let can: Capabilities<D> = serde_json::from_value(can).unwrap();
    let fields = fields(driver, &answers);
    for (asked, wanted) in rows {
        let refused = driver.refuse(&CommandId("c1".to_owned()), &command::<D>(asked), &can, &fields);
        let is_wanted = match (&refused, wanted) {
            (None, None) => true,
            (Some((reason, detail)), Some((wanted, text))) => reason == wanted && detail.contains(text),
            _ => false,
        };
        assert!(is_wanted, "{} {asked}: {refused:?}", D::Kind::KIND);
    }
}

#[test]
fn what_a_device_cannot_do_is_refused_with_the_reason_and_nothing_else_is() {
    use Reason::{Malformed, NotImplemented};
    let to = |position: i64| json!({"move": {"position": position}});
    let too_far = Some((Malformed, "expected 0 to 1000"));
    let rows = [(to(0), None), (to(1000), None), (to(1001), too_far), (to(-1), too_far), (json!("abort"), None)];
    check_refusals(&focuser(0), json!({"absolute": true, "max_step": 1000, "step_um": 1.0}), json!({}), &rows);
    let unknown = json!({"absolute": true, "max_step": 0, "step_um": 1.0});
    check_refusals(&focuser(0), unknown, json!({}), &[(to(70_000), None), (to(-1), Some((Malformed, "-1")))]);
    let relative = json!({"absolute": false, "max_step": 1000, "step_um": 1.0});
    let rows = [(to(5), Some((NotImplemented, "does not know its position"))), (json!("abort"), None)];
    check_refusals(&focuser(0), relative, json!({}), &rows);

    let to = |position_deg: f64| json!({"move": {"position_deg": position_deg}});
    let outside = Some((Malformed, "expected 0 to 360"));
    let rows = [(to(0.0), None), (to(360.0), None), (to(360.1), outside), (to(-0.1), outside), (json!("abort"), None)];
    check_refusals(&Rotator::new(0.1), json!({"reverse": true}), json!({}), &rows);

    let to = |position: u32| json!({"turn": {"position": position}});
    let wheel = FilterWheel::default();
    let rows = [(to(0), None), (to(1), None), (to(2), Some((Malformed, "the wheel has 2, counted from 0")))];
    check_refusals(&wheel, json!({"names": ["R", "G"], "focus_offsets": []}), json!({}), &rows);
    check_refusals(&wheel, json!({"names": [], "focus_offsets": []}), json!({}), &[(to(7), None)]);

    let set = |number: u32, value: f64| json!({"set": {"number": number, "value": value}});
    let can =
        |name: &str, can_write: bool| json!({"name": name, "can_write": can_write, "minimum": 0.0, "maximum": 12.0});
    let rows = [
        (set(0, 12.0), None),
        (set(0, 12.5), Some((Malformed, "expected 0 to 12"))),
        (set(1, 1.0), Some((NotImplemented, "switch 1 (UPS) is a gauge"))),
        (set(2, 1.0), Some((Malformed, "switch 2: there are 2"))),
    ];
    check_refusals(&Switch::default(), json!({"switches": [can("fan", true), can("UPS", false)]}), json!({}), &rows);
}

#[test]
fn half_of_a_cover_with_a_panel_takes_the_commands_of_that_half() {
    let on = |brightness: i64| json!({"calibrator_on": {"brightness": brightness}});
    let (no_cover, no_panel) = (Some((Reason::NotImplemented, "no cover")), Some((Reason::NotImplemented, "no panel")));
    let can = |cover: bool, panel: bool| json!({"cover": cover, "calibrator": panel, "max_brightness": 100});
    let of_cover = ["open_cover", "close_cover", "halt_cover"].map(|command| json!(command));
    for (has_cover, why) in [(true, None), (false, no_cover)] {
        let rows = of_cover.clone().map(|command| (command, why));
        check_refusals(&CoverCalibrator, can(has_cover, !has_cover), json!({}), &rows);
    }
    let rows = [(on(1), no_panel), (json!("calibrator_off"), no_panel)];
    check_refusals(&CoverCalibrator, can(true, false), json!({}), &rows);
    let too_bright = Some((Reason::Malformed, "expected 0 to 100"));
    let rows = [(on(0), None), (on(100), None), (on(101), too_bright), (on(-1), too_bright)];
    check_refusals(&CoverCalibrator, can(false, true), json!({}), &rows);
}

#[test]
fn a_camera_exposes_only_what_its_sensor_has() {
    let folder = tempfile::tempdir().unwrap();
    let camera = camera(folder.path());
    let can = |has_cooler: bool| {
        json!({"width_px": 100, "height_px": 80, "pixel_width_um": 4.0, "pixel_height_um": 4.0, "max_bin": 2,
               "max_adu": 65535.0, "set_temperature": has_cooler, "abort": true, "electrons_per_adu": 1.0})
    };
    let expose = |exposure_s: f64, bin: u32, part: Option<[u32; 4]>| {
        let part = part.map(|[x, y, w, h]| json!({"x_px": x, "y_px": y, "width_px": w, "height_px": h}));
        let purpose = json!({"action": "object", "image_type": "light", "night": "2026-11-24", "sequence": 1});
        json!({"expose": {"exposure_s": exposure_s, "light": true, "bin": bin, "subframe": part, "purpose": purpose}})
    };
    let cool = |set_c: f64| json!({"cool": {"set_c": set_c}});
    let bad = |text| Some((Reason::Malformed, text));
    let outside = bad("leaves the sensor");
    let rows = [
        (expose(0.0, 1, None), None),
        (expose(86_400.0, 2, None), None),
        (expose(-0.1, 1, None), bad("exposure_s")),
        (expose(86_401.0, 1, None), bad("exposure_s")),
        (expose(1.0, 0, None), bad("bin 0: expected 1 to 2")),
        (expose(1.0, 3, None), bad("bin 3: expected 1 to 2")),
        (expose(1.0, 1, Some([0, 0, 100, 80])), None),
        (expose(1.0, 2, Some([0, 0, 50, 40])), None),
        (expose(1.0, 2, Some([0, 0, 51, 40])), outside),
        (expose(1.0, 1, Some([1, 0, 100, 80])), outside),
        (expose(1.0, 1, Some([0, 1, 100, 80])), outside),
        (expose(1.0, 1, Some([0, 0, 0, 80])), outside),
        (expose(1.0, 1, Some([u32::MAX, 0, 2, 2])), outside),
        (cool(-20.0), None),
        (cool(-201.0), bad("set_c")),
        (json!("warm"), None),
    ];
    check_refusals(&camera, can(true), json!({}), &rows);
    let no_cooler = Some((Reason::NotImplemented, "no cooler"));
    let rows = [(cool(-20.0), no_cooler), (json!("warm"), no_cooler), (json!("abort"), None)];
    check_refusals(&camera, can(false), json!({}), &rows);
    let rows = [
        (json!({"CameraState": 0}), false),
        (json!({"CameraState": 2}), true),
        (json!({"CameraState": 5}), false),
        (json!({"CameraState": 9}), true),
    ];
    check_busy(&camera, &rows);
}

#[test]
fn a_parked_mount_and_one_that_lacks_an_ability_refuse_with_the_reason() {
    use Reason::{Malformed, NotImplemented, WrongState};
    let can = |able: bool| {
        json!({"park": able, "slew_async": able, "set_tracking": able, "pulse_guide": able, "sync": able,
               "set_rates": able, "equatorial_system": "topocentric", "site_latitude_deg": 0.0,
               "site_longitude_deg": 0.0, "site_elevation_m": 0.0})
    };
    let to = |verb: &str, ra_deg: f64, dec_deg: f64| json!({verb: {"ra_deg": ra_deg, "dec_deg": dec_deg}});
    let track = |on: bool| json!({"track": {"on": on}});
    let pulse = |ms: u32| json!({"pulse_guide": {"direction": "north", "duration_ms": ms}});
    let rows = [
        (to("slew", 360.0, -90.0), None),
        (to("slew", 361.0, 0.0), Some((Malformed, "ra_deg"))),
        (to("slew", 0.0, 90.1), Some((Malformed, "dec_deg"))),
        (to("sync", 10.0, 10.0), None),
        (pulse(1), None),
        (pulse(0), Some((Malformed, "duration_ms"))),
        (pulse(60_001), Some((Malformed, "duration_ms"))),
        (track(true), None),
    ];
    check_refusals(&mount(), can(true), json!({"AtPark": false, "Tracking": false}), &rows);
    let parked = Some((WrongState, "unpark it first"));
    let rows = [(to("slew", 1.0, 1.0), parked), (to("sync", 1.0, 1.0), parked), (track(true), parked)];
    check_refusals(&mount(), can(true), json!({"AtPark": true, "Tracking": false}), &rows);
    let cannot = |text| Some((NotImplemented, text));
    let rows = [
        (to("slew", 1.0, 1.0), cannot("slew without blocking")),
        (to("sync", 1.0, 1.0), cannot("be synced")),
        (track(false), cannot("switch tracking")),
        (track(true), None),
        (json!("park"), cannot("park")),
        (pulse(100), cannot("take guide pulses")),
        (json!("abort"), None),
    ];
    check_refusals(&mount(), can(false), json!({"AtPark": false, "Tracking": true}), &rows);
}

#[test]
fn what_is_no_number_is_sent_to_no_device() {
    for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let (reason, detail) = within("azimuth_deg", number, 0.0, 360.0).unwrap();
        assert!(reason == Reason::Malformed && detail.contains("expected 0 to 360"), "{detail}");
    }
}

#[test]
fn a_limit_that_is_not_known_is_none_and_each_device_has_its_own_grid() {
    use Reason::Malformed;
    let folder = tempfile::tempdir().unwrap();
    let camera = camera(folder.path());
    let can = |more: Value| {
        let mut can = json!({"width_px": 0, "height_px": 0, "pixel_width_um": {"no_data": "x"},
            "pixel_height_um": {"no_data": "x"}, "max_bin": 0, "max_adu": {"no_data": "x"}, "set_temperature": true,
            "abort": true, "electrons_per_adu": {"no_data": "x"}});
        can.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        can
    };
    let expose = |exposure_s: f64, bin: u32| {
        let purpose = json!({"action": "object", "image_type": "light", "night": "2026-11-24", "sequence": 1});
        json!({"expose": {"exposure_s": exposure_s, "light": true, "bin": bin, "purpose": purpose}})
    };
    check_refusals(&camera, can(json!({})), json!({}), &[(expose(7200.0, 4), None), (expose(0.0, 1), None)]);
    let limits = json!({"exposure_min_s": 0.001, "exposure_max_s": 3600.0, "exposure_step_s": 0.001});
    let beyond = Some((Malformed, "expected 0, or 0.001 to 3600 s, which this camera can take"));
    let rows = [(expose(3600.0, 1), None), (expose(3601.0, 1), beyond), (expose(0.0001, 1), beyond)];
    check_refusals(&camera, can(limits), json!({}), &rows);

    let panel = json!({"cover": false, "calibrator": true, "max_brightness": 0});
    let on = |brightness: i64| json!({"calibrator_on": {"brightness": brightness}});
    check_refusals(&CoverCalibrator, panel, json!({}), &[(on(250), None), (on(-1), Some((Malformed, "-1")))]);

    assert_eq!(
        [on_grid(7.34, 0.0, Some(0.25)), on_grid(7.34, 1.0, Some(0.4)), on_grid(7.34, 0.0, None)],
        [7.25, 7.4, 7.34]
    );
    assert_eq!(on_grid(0.3, 0.0, Some(0.1)), 0.3);
}
