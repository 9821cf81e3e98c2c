use super::*;

const WANT: Want = Want { target_adu: 30_000.0, tolerance_adu: 6000.0, bias_adu: 500.0, min_s: 1.0, max_s: 60.0 };

fn at(seconds: f64) -> Utc {
    "2026-11-21T00:00:00Z".parse::<Utc>().unwrap().plus_seconds(seconds)
}

/// A sky whose rate at 0 s is `rate` ADU per s, with this slope.
struct Sky {
    rate: f64,
    slope: f64,
}

impl Sky {
    fn frame(&self, start_s: f64, exposure_s: f64) -> Seen {
        let rate = self.rate * (self.slope * start_s).exp();
        let adu = WANT.bias_adu + signal_adu(exposure_s, rate, self.slope);
        let level = if adu > 60_000.0 { Level::Saturated } else { Level::Adu(adu) };
        Seen { started: at(start_s), exposure_s, level, is_part: false }
    }
}

fn now(light: &Light, at_s: f64) -> f64 {
    match light.ready(0, at(at_s)) {
        Some(Ready::Now(exposure_s)) => exposure_s,
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_exposure_collects_what_it_is_made_for_in_any_light() {
    for rate in [0.5, 500.0, 30_000.0] {
        for slope in [0.0, 1e-9, 0.004, -0.004, 0.02, -0.02] {
            let long_s = exposure_s(20_000.0, rate, slope);
            if long_s.is_finite() {
                assert!((signal_adu(long_s, rate, slope) / 20_000.0 - 1.0).abs() < 1e-6, "{rate} {slope}");
            } else {
                assert!(rate / -slope <= 20_000.0, "all the light there will ever be: {rate} {slope}");
            }
        }
    }
    assert_eq!(exposure_s(1.0, f64::NAN, 0.0), f64::INFINITY);
    assert_eq!(exposure_s(1.0, 0.0, 0.1), f64::INFINITY);
}

#[test]
fn frame_after_frame_keeps_its_level_while_the_sky_fades_and_while_it_brightens() {
    for slope in [-0.0035, 0.0035, -0.006] {
        let sky = Sky { rate: if slope < 0.0 { 14_000.0 } else { 1200.0 }, slope };
        // The expected slope is 30 % off.
        let mut light = Light::new(WANT, 1, slope * 0.7);
        light.see(0, &sky.frame(0.0, 1.0));
        let (mut at_s, mut levels) = (5.0, Vec::new());
        while let Some(Ready::Now(exposure_s)) = light.ready(0, at(at_s)) {
            let seen = sky.frame(at_s, exposure_s);
            assert!(WANT.accepts(seen.level), "{slope}: {seen:?}");
            let Level::Adu(adu) = seen.level else { panic!("{seen:?}") };
            levels.push(adu);
            light.see(0, &seen);
            at_s += exposure_s + 8.0;
        }
        assert!(levels.len() > 15, "{slope}: {}", levels.len());
        // The frames at the ends are at the limits of the exposure.
        let inner = &levels[2..levels.len() - 4];
        let worst = inner.iter().map(|adu| (adu / 30_000.0 - 1.0).abs()).fold(0.0, f64::max);
        assert!(worst < 0.02, "{slope}: {worst} {levels:?}");
        assert!((light.slope() / slope - 1.0).abs() < 0.1, "learned: {} of {slope}", light.slope());
        let end = light.ready(0, at(at_s));
        assert_eq!(end, Some(if slope < 0.0 { Ready::TooDark } else { Ready::TooBright }));
    }
}

#[test]
fn the_old_rule_of_scaling_by_the_last_frame_is_worse() {
    // The predictor exists for this case: the light changes from frame to frame, and within one.
    let sky = Sky { rate: 1500.0, slope: -0.005 };
    let first = sky.frame(0.0, 20.0);
    let mut light = Light::new(WANT, 1, -0.005);
    light.see(0, &first);
    let Level::Adu(adu) = first.level else { panic!() };
    let scaled_s = 20.0 * (30_000.0 - 500.0) / (adu - 500.0);
    let off = |exposure_s: f64| match sky.frame(30.0, exposure_s).level {
        Level::Adu(adu) => (adu - 30_000.0).abs(),
        Level::Saturated => f64::INFINITY,
    };
    assert!(off(now(&light, 30.0)) < 100.0 && off(scaled_s) > 3000.0, "{} {}", off(now(&light, 30.0)), off(scaled_s));
}

#[test]
fn what_no_exposure_can_do_is_reported_with_the_time_until_it_can() {
    let fading = Sky { rate: 300_000.0, slope: -0.004 };
    let mut light = Light::new(WANT, 1, -0.004);
    assert_eq!((light.ready(0, at(0.0)), light.age_s(0, at(0.0))), (None, None));
    light.see(0, &fading.frame(0.0, 1.0));
    assert_eq!(light.ready(0, at(3.0)), Some(Ready::TooBright));
    assert!((100.0..500.0).contains(&light.wait_s(0, at(3.0))));
    // Too dark and fading: never.
    let dark = Sky { rate: 2.0, slope: -0.004 };
    light.see(0, &dark.frame(3.0, 6.0));
    assert_eq!((light.ready(0, at(10.0)), light.wait_s(0, at(10.0))), (Some(Ready::TooDark), f64::INFINITY));
    // Too dark and brightening: in time for the longest exposure.
    let mut dawn = Light::new(WANT, 1, 0.004);
    let sky = Sky { rate: 100.0, slope: 0.004 };
    dawn.see(0, &sky.frame(0.0, 6.0));
    let wait_s = dawn.wait_s(0, at(10.0));
    assert_eq!(dawn.ready(0, at(10.0)), Some(Ready::TooDark));
    assert!((now(&dawn, 10.0 + wait_s + 0.1) - 60.0).abs() < 0.5, "{wait_s}");
    assert!((dawn.age_s(0, at(13.0)).unwrap() - 10.0).abs() < 1e-6);
    dawn.forget(0);
    assert_eq!(dawn.ready(0, at(13.0)), None);
}

#[test]
fn at_its_limits_an_exposure_is_taken_while_its_level_is_good_enough() {
    // 1 s gives 8 % too much, 60 s 8 % too little.
    for (rate, limit_s) in [(32_000.0, 1.0), (450.0, 60.0)] {
        let sky = Sky { rate, slope: 0.0 };
        let mut light = Light::new(WANT, 1, 0.0);
        light.see(0, &sky.frame(0.0, 1.5));
        assert_eq!(light.ready(0, at(5.0)), Some(Ready::Now(limit_s)), "{rate}");
    }
}

#[test]
fn a_look_that_shows_too_little_is_repeated_longer_or_shorter() {
    let seen = |exposure_s, level| Seen { started: at(0.0), exposure_s, level, is_part: true };
    assert_eq!(WANT.sounding_max_s(), 6.0);
    assert_eq!(WANT.sound_again_s(&seen(1.0, Level::Adu(510.0))), Some(6.0));
    assert_eq!(WANT.sound_again_s(&seen(6.0, Level::Adu(510.0))), None, "too dark for anything");
    assert_eq!(WANT.sound_again_s(&seen(1.0, Level::Adu(1500.0))), None);
    assert_eq!(WANT.sound_again_s(&seen(6.0, Level::Saturated)), Some(1.0));
    assert_eq!(WANT.sound_again_s(&seen(1.0, Level::Saturated)), None, "too bright for anything");
}

#[test]
fn frames_out_of_tolerance_do_not_count() {
    for (level, counts) in [
        (Level::Adu(30_000.0), true),
        (Level::Adu(24_000.0), true),
        (Level::Adu(23_999.0), false),
        (Level::Adu(36_001.0), false),
        (Level::Adu(f64::NAN), false),
        (Level::Saturated, false),
    ] {
        assert_eq!(WANT.accepts(level), counts, "{level:?}");
    }
}

#[test]
fn a_cloud_does_not_turn_the_slope_and_a_part_teaches_none() {
    let mut light = Light::new(WANT, 2, -0.004);
    let seen = |start_s, adu, is_part| Seen { started: at(start_s), exposure_s: 5.0, level: Level::Adu(adu), is_part };
    light.see(0, &seen(0.0, 10_000.0, true));
    light.see(0, &seen(30.0, 20_000.0, false));
    assert_eq!(light.slope(), -0.004);
    light.see(0, &seen(60.0, 40_000.0, false));
    assert!((-0.004..0.0).contains(&light.slope()), "it brightened: {}", light.slope());
    light.see(7, &seen(60.0, 40_000.0, false));
}

proptest::proptest! {
    #[test]
    fn whatever_was_seen_the_answer_lies_within_the_limits(
        frames in proptest::collection::vec((0.0..3000.0_f64, 0.0..100.0_f64, -1e3..7e4_f64, proptest::bool::ANY), 0..20),
        slope in -0.02..0.02_f64,
    ) {
        let mut light = Light::new(WANT, 1, slope);
        for (start_s, exposure_s, adu, saturated) in frames {
            let level = if saturated { Level::Saturated } else { Level::Adu(adu) };
            light.see(0, &Seen { started: at(start_s), exposure_s, level, is_part: false });
            for later_s in [0.0, 60.0, 5000.0] {
                if let Some(Ready::Now(exposure_s)) = light.ready(0, at(start_s + later_s)) {
                    proptest::prop_assert!((1.0..=60.0).contains(&exposure_s), "{exposure_s}");
                }
                proptest::prop_assert!(light.wait_s(0, at(start_s + later_s)) >= 0.0);
            }
        }
    }
}
