//! Whatever is fed to the guider: no pulse beyond the cap, no number that is none, no panic.

use imaging::guide::calibration::pulses::{CalibrationRun, Next};
use imaging::guide::{Calibration, Exposure, GuideSettings, Guider, Pulses, Reference};
use imaging::shift::{Method, NoShift, Shift};
use imaging::{Camera, Frame, Pixels};
use proptest::prelude::*;

fn wild() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => -60.0..60.0_f64,
        1 => Just(0.0),
        1 => -1e300..1e300_f64,
        1 => prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN_POSITIVE]),
    ]
}

fn shift() -> impl Strategy<Value = Shift> {
    (wild(), wild(), wild(), prop_oneof![3 => 1e-6..0.2_f64, 1 => wild()], wild(), 0..30_usize).prop_map(
        |(dx_px, dy_px, rotation_deg, variance, covariance, stars)| Shift {
            dx_px,
            dy_px,
            rotation_deg,
            covariance: [[variance, covariance, 0.0], [covariance, variance, 0.0], [0.0, 0.0, variance]],
            stars,
            transparency: Some(dx_px),
            method: Method::Stars,
        },
    )
}

#[derive(Debug, Clone)]
enum Event {
    Frame(f64, f64, Option<Shift>),
    Report(f64, i32),
    Aim(f64, f64),
    Moved,
}

fn event() -> impl Strategy<Value = Event> {
    // times step on, and now and then go back or nowhere
    let time = prop_oneof![8 => 0.1..200.0_f64, 1 => -500.0..0.0_f64, 1 => wild()];
    prop_oneof![
        12 => (time, wild(), prop::option::weighted(0.8, shift())).prop_map(|(t, e, s)| Event::Frame(t, e.abs(), s)),
        1 => (wild(), any::<i32>()).prop_map(|(t, ms)| Event::Report(t, ms)),
        1 => (wild(), wild()).prop_map(|(x, y)| Event::Aim(x, y)),
        1 => Just(Event::Moved),
    ]
}

/// Every decision keeps to the cap, and every number in it is one.
fn guided(events: Vec<Event>, pid: bool, longest_pulse_ms: u32) {
    let base = if pid { GuideSettings::pid() } else { GuideSettings::default() };
    let settings = GuideSettings { longest_pulse_ms, ..base };
    let calibration = Calibration::from_wcs([[-7e-5, 7e-5], [7e-5, 7e-5]], [2e-3, 2e-3], None).unwrap();
    let mut guider = Guider::new(settings, &calibration, 30.0).unwrap();
    let clouds = NoShift::NoPeak { reference: 9, check: 0, agree: 0 };
    let mut now_s = 0.0;
    for event in events {
        match event {
            Event::Frame(step_s, length_s, seen) => {
                let mid_s = now_s + step_s;
                if mid_s.is_finite() && mid_s.abs() < 1e12 {
                    now_s = mid_s;
                }
                let decision = guider.step(Exposure { mid_s, length_s }, seen.as_ref().ok_or(&clouds));
                let Pulses { east_ms, north_ms } = decision.pulses;
                let most = longest_pulse_ms as i32;
                assert!(east_ms.abs() <= most && north_ms.abs() <= most, "{decision:?}");
                for log in [decision.log.east, decision.log.north] {
                    assert!(log.drift_px_s.is_finite() && log.expected_px.is_finite(), "{decision:?}");
                    assert!(log.error_px.is_none_or(f64::is_finite), "{decision:?}");
                }
            }
            Event::Report(begun_s, ms) => {
                guider.report([Some((begun_s, ms)), (ms % 2 == 0).then_some((-begun_s, ms))]);
            }
            Event::Aim(dx_px, dy_px) => guider.aim(dx_px, dy_px),
            Event::Moved => guider.moved(),
        }
    }
}

/// The property below found this: a frame that is as far ahead as a number can be, after frames that taught something.
#[test]
fn a_time_that_no_clock_shows_gives_no_pulse_and_no_number_that_is_none() {
    let frame = |step_s: f64, dx_px: f64| {
        let (covariance, method) = ([[1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0], [0.0, 0.0, 1e-3]], Method::Stars);
        let seen = Shift { dx_px, dy_px: -dx_px, rotation_deg: 0.01, covariance, stars: 9, transparency: None, method };
        Event::Frame(step_s, 20.0, Some(seen))
    };
    for pid in [false, true] {
        for furthest_s in [1e13, 1e300, f64::MAX] {
            let before = (0..12).map(|n| frame(30.0, 0.3 + 0.1 * f64::from(n)));
            let after = (0..12).map(|n| frame(30.0, 0.5 - 0.1 * f64::from(n)));
            let absurd = [frame(furthest_s, 0.4), Event::Frame(furthest_s, 20.0, None), Event::Aim(f64::MAX, f64::MAX)];
            let seen_there = frame(30.0, f64::MAX);
            guided(before.chain(absurd).chain([seen_there]).chain(after).collect(), pid, 2500);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn no_pulse_is_ever_beyond_the_cap(events in prop::collection::vec(event(), 1..40), pid in any::<bool>(), longest_pulse_ms in 1..5000_u32) {
        guided(events, pid, longest_pulse_ms);
    }

    #[test]
    fn calibrations_end_whatever_is_seen(places in prop::collection::vec(prop::option::weighted(0.9, [wild(), wild()]), 1..400)) {
        let mut run = CalibrationRun::new(Default::default());
        let mut ended = false;
        for (n, place) in places.into_iter().enumerate() {
            match run.next(n as f64, place) {
                Next::Done { calibration, .. } => {
                    prop_assert!(calibration.at(0.0).is_ok());
                    ended = true;
                }
                Next::Failed(_) => ended = true,
                Next::Pulse { length_ms, .. } => prop_assert!(!ended && length_ms == 750),
                Next::Measure => prop_assert!(!ended),
            }
        }
    }

    #[test]
    fn frames_of_any_kind_are_measured_or_refused(value in any::<u16>(), expected in [wild(), wild()]) {
        let star = |n: usize| imaging::Star {
            x_px: 20.0 + 15.0 * n as f64, y_px: 40.0, x_error_px: 0.02, y_error_px: 0.02, flux_adu: 1e4,
            flux_error_adu: 1.0, snr: 50.0, significance: 50.0, peak_adu: 1e3, fwhm_px: 3.0, ellipticity: 0.0,
            angle_deg: 0.0, flags: imaging::Flags::default(),
        };
        let mut reference = Reference::from_lists(&[(0..5).map(star).collect()], 100, 80).unwrap();
        let flat = vec![value; 8000];
        let frame = Frame::new(100, 80, Pixels::U16(&flat)).unwrap();
        prop_assert!(reference.measure(&frame, &Camera::default(), expected).is_err());
        let nothing = vec![f32::NAN; 8000];
        let frame = Frame::new(100, 80, Pixels::F32(&nothing)).unwrap();
        prop_assert!(reference.measure(&frame, &Camera::default(), expected).is_err());
        prop_assert!(reference.register(&[]).is_err());
        prop_assert!(Reference::from_lists(&[], 100, 80).is_err());
    }
}
