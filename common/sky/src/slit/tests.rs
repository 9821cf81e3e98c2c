use proptest::prelude::*;

use super::*;

fn deg(degrees: f64) -> Angle {
    Angle::from_degrees(degrees)
}

/// A dome of 5 m with a slit of 1.2 m, and a German mount that stands a little off its middle.
fn dome() -> Slit {
    Slit {
        latitude: deg(-24.6),
        radius_m: 2.5,
        width_m: 1.2,
        past_zenith_m: 0.6,
        axes_m: [0.1, -0.15, 0.2],
        arm_m: 0.45,
        aperture_m: 0.35,
    }
}

fn fork() -> Slit {
    Slit { axes_m: [0.0; 3], arm_m: 0.0, ..dome() }
}

/// Rays of chance through the aperture, followed in small steps to the dome and looked at in the dome's own frame: how
/// many of them the slit lets through. It shares only the frame of the mount with the formulas.
fn rays_through(slit: &Slit, aim: &Aim, azimuth: Angle, rays: u32, seed: u64) -> u32 {
    let (through, along) = slit.optical_axis(aim);
    let mut state = seed.wrapping_mul(2).wrapping_add(1);
    let mut even = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let free = |point: [f64; 3]| {
        let forward = point[0] * azimuth.sin() + point[1] * azimuth.cos();
        let aside = point[0] * azimuth.cos() - point[1] * azimuth.sin();
        aside.abs() <= 0.5 * slit.width_m && forward >= -slit.past_zenith_m
    };
    let through_slit = |_: &u32| {
        // A point within the disc by rejection, in a plane that Gram and Schmidt make.
        let [x, y] = loop {
            let point = [2.0 * even() - 1.0, 2.0 * even() - 1.0];
            if point[0] * point[0] + point[1] * point[1] <= 1.0 {
                break point;
            }
        };
        let least = if along[0].abs() < 0.5 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let first = add(least, scaled(along, -dot(least, along)));
        let first = scaled(first, 1.0 / dot(first, first).sqrt());
        let second = cross(along, first);
        let half_m = 0.5 * slit.aperture_m;
        let from = add(through, add(scaled(first, x * half_m), scaled(second, y * half_m)));
        let (mut inside_m, mut outside_m) = (0.0, 4.0 * slit.radius_m);
        for _ in 0..40 {
            let half_way = 0.5 * (inside_m + outside_m);
            let at = add(from, scaled(along, half_way));
            if dot(at, at) < slit.radius_m * slit.radius_m { inside_m = half_way } else { outside_m = half_way }
        }
        free(add(from, scaled(along, inside_m)))
    };
    u32::try_from((0..rays).filter(through_slit).count()).unwrap()
}

#[test]
fn what_is_left_of_the_aperture_is_what_rays_of_chance_find() {
    let (mut partly, mut most) = (0, 0.0_f64);
    for hour_angle in [-60.0, -20.0, 5.0, 45.0] {
        for dec in [-70.0, -24.0, 10.0] {
            let aim = Aim::at(deg(hour_angle), deg(dec));
            let middle = dome().azimuth(&aim);
            for off in (-40..=40).step_by(8).map(f64::from) {
                let free = dome().free(&aim, middle + deg(off));
                let found = f64::from(rays_through(&dome(), &aim, middle + deg(off), 500, 3)) / 500.0;
                partly += i32::from(free > 0.0 && free < 1.0);
                most = most.max((free - found).abs());
                assert!((free - found).abs() < 0.08, "{aim:?} {off}: {free} {found}");
            }
        }
    }
    assert!(partly > 10 && most > 0.0, "{partly} views were partly hidden");
}

#[test]
fn a_whole_arc_is_free_and_what_lies_far_from_it_is_hidden() {
    for slit in [dome(), fork(), Slit::of_tolerance(deg(-24.6), deg(5.0))] {
        let aim = Aim::at(deg(-50.0), deg(-10.0));
        let arc = slit.clear(&aim).unwrap();
        let ends = arc.shrunk(deg(0.01));
        for azimuth in [arc.middle(), ends.nearest(arc.middle() + deg(90.0)), ends.nearest(arc.middle() - deg(90.0))] {
            assert_eq!(slit.free(&aim, azimuth), 1.0, "{azimuth:?}");
        }
        assert_eq!(slit.free(&aim, arc.middle() + deg(90.0)), 0.0);
    }
}

#[test]
fn a_telescope_in_the_middle_looks_where_its_slit_belongs() {
    for (altitude, azimuth) in [(10.0, 0.0), (30.0, 77.0), (60.0, 200.0), (85.0, 359.0)] {
        let aim = Aim::towards(&Horizontal::from_degrees(altitude, azimuth), deg(-24.6));
        let off = (fork().azimuth(&aim) - deg(azimuth)).wrapped_signed().degrees();
        assert!(off.abs() < 1e-9, "{altitude} {azimuth}: {off}");
        assert!(fork().clear(&aim).unwrap().contains(deg(azimuth)));
    }
}

#[test]
fn the_tube_of_a_german_mount_looks_out_beside_the_middle_and_a_flip_takes_it_to_the_other_side() {
    // On the meridian in the north, 45 deg high, from a latitude of 0: the tube lies one arm to the west or the east.
    let slit = Slit { latitude: deg(0.0), axes_m: [0.0; 3], ..dome() };
    let aim = Aim::at(deg(0.0), deg(45.0));
    // Distance along the ray to the sphere, and its part along the ground.
    let ground_m = (2.5_f64.powi(2) - 0.45_f64.powi(2)).sqrt() * 45.0_f64.to_radians().cos();
    let beside_deg = (0.45 / ground_m).atan().to_degrees();
    let west = slit.azimuth(&aim.on(TubeSide::West)).wrapped_signed().degrees();
    let east = slit.azimuth(&aim.on(TubeSide::East)).wrapped_signed().degrees();
    assert!((west + beside_deg).abs() < 1e-9 && (east - beside_deg).abs() < 1e-9, "{west} {east} {beside_deg}");
    // A target before the meridian is looked at from the west of the pier.
    assert_eq!(
        (Aim::at(deg(-10.0), deg(0.0)).side, Aim::at(deg(10.0), deg(0.0)).side),
        (TubeSide::West, TubeSide::East)
    );
}

#[test]
fn a_mount_south_of_the_middle_looks_north_straight_and_east_to_the_south() {
    let slit = Slit { axes_m: [0.0, -0.5, 0.0], ..fork() };
    let looking =
        |azimuth| slit.azimuth(&Aim::towards(&Horizontal::from_degrees(20.0, azimuth), slit.latitude)).degrees();
    assert!(Angle::from_degrees(looking(0.0)).wrapped_signed().abs().degrees() < 1e-9);
    assert!((91.0..115.0).contains(&looking(90.0)), "{}", looking(90.0));
}

#[test]
fn near_the_zenith_every_azimuth_is_clear_and_low_down_only_a_few() {
    let width = |altitude| {
        let aim = Aim::towards(&Horizontal::from_degrees(altitude, 120.0), deg(-24.6));
        fork().clear(&aim).unwrap().width().degrees()
    };
    // At the horizon the slit leaves (1.2 - 0.35) / 2 to each side of the aperture, 2.5 m away.
    let expected = 2.0 * (0.425_f64 / 2.5).asin().to_degrees();
    assert!((width(0.0) - expected).abs() < 0.5, "{} {expected}", width(0.0));
    assert!(width(30.0) > width(0.0) && width(60.0) > width(30.0) && width(80.0) > width(60.0));
    assert_eq!(width(89.0), 360.0);
}

#[test]
fn a_slit_that_ends_at_the_zenith_hides_part_of_it() {
    let short = Slit { past_zenith_m: 0.0, ..fork() };
    let zenith = Aim::towards(&Horizontal::from_degrees(90.0, 0.0), deg(-24.6));
    assert_eq!((short.clear(&zenith), fork().clear(&zenith)), (None, Some(Arc::FULL)));
    let narrow = Slit { width_m: 0.3, ..fork() };
    assert_eq!(narrow.clear(&Aim::at(deg(30.0), deg(0.0))), None, "no slit of 0.3 m lets 0.35 m through");
}

#[test]
fn without_a_geometry_the_tolerance_holds_at_the_horizon_and_grows_towards_the_zenith() {
    let slit = Slit::of_tolerance(deg(-24.6), deg(5.0));
    let clear =
        |altitude: f64| slit.clear(&Aim::towards(&Horizontal::from_degrees(altitude, 300.0), slit.latitude)).unwrap();
    assert!((clear(0.0).width().degrees() - 10.0).abs() < 1e-6 && clear(0.0).contains(deg(304.9)));
    assert!((clear(60.0).width().degrees() - 20.07).abs() < 0.01, "{:?}", clear(60.0));
    assert_eq!(clear(86.0), Arc::FULL);
}

#[test]
fn rays_of_chance_all_pass_within_the_arc_and_some_do_not_beyond_it() {
    for hour_angle in (-75..=75).step_by(15).map(f64::from) {
        for dec in [-85.0, -60.0, -24.0, 0.0, 30.0] {
            for slit in [dome(), fork()] {
                let aim = Aim::at(deg(hour_angle), deg(dec));
                let Some(arc) = slit.clear(&aim) else { continue };
                let half = arc.width().degrees() * 0.5;
                for part in [-1.0, -0.5, 0.0, 0.7, 1.0] {
                    let azimuth = arc.middle() + deg(part * half);
                    assert_eq!(rays_through(&slit, &aim, azimuth, 120, 7), 120, "{aim:?} {azimuth:?}");
                }
                if half < 80.0 {
                    for beyond in [-half - 2.5, half + 2.5] {
                        let passed = rays_through(&slit, &aim, arc.middle() + deg(beyond), 1000, 11);
                        assert!(passed < 1000, "{aim:?} {beyond}: nothing of the aperture is hidden");
                    }
                }
            }
        }
    }
}

/// A night of a tracking mount: what a slit that follows hides, how often it turns, and, by random rays, whether
/// anything was hidden.
fn follow(mut turn_to: impl FnMut(&Aim, Angle) -> Option<Angle>, slit: &Slit, start: Aim, hours: f64) -> (u32, u32) {
    let mut azimuth = slit.azimuth(&start);
    let (mut turns, mut hidden) = (0, 0);
    for minute in 0..(hours * 60.0) as u32 {
        let aim = start.after(f64::from(minute) * 60.0);
        if let Some(wanted) = turn_to(&aim, azimuth) {
            (azimuth, turns) = (wanted, turns + 1);
        }
        hidden += 50 - rays_through(slit, &aim, azimuth, 50, u64::from(minute));
    }
    (turns, hidden)
}

#[test]
fn turning_ahead_hides_nothing_and_turns_far_less_often_than_following() {
    let (slit, margin) = (dome(), deg(1.0));
    for dec in [-70.0, -30.0, -20.0, 10.0] {
        // From four hours east of the meridian, on one side of the pier.
        let start = Aim::at(deg(-60.0), deg(dec));
        let ahead = |aim: &Aim, azimuth: Angle| match slit.clear_for_s(aim, azimuth, margin, 120.0) {
            Some(s) if s >= 120.0 => None,
            _ => Some(slit.lasting(aim, azimuth, margin, 4.0 * 3600.0).unwrap().0),
        };
        let naive = |aim: &Aim, azimuth: Angle| {
            let wanted = slit.azimuth(aim);
            ((wanted - azimuth).wrapped_signed().abs().degrees() > 2.0).then_some(wanted)
        };
        let (turns, hidden) = follow(ahead, &slit, start, 4.0);
        let (naive_turns, _) = follow(naive, &slit, start, 4.0);
        println!("dec {dec}: {turns} turns in 4 h, {naive_turns} of a follower at 2 deg");
        assert_eq!(hidden, 0, "dec {dec}");
        assert!(turns * 3 <= naive_turns, "dec {dec}: {turns} against {naive_turns}");
    }
}

#[test]
fn nothing_lasts_where_no_azimuth_is_clear() {
    let narrow = Slit { width_m: 0.3, ..fork() };
    let aim = Aim::at(deg(30.0), deg(0.0));
    assert_eq!(narrow.lasting(&aim, deg(0.0), deg(1.0), 3600.0), None);
    assert_eq!(narrow.clear_for_s(&aim, narrow.azimuth(&aim), deg(1.0), 3600.0), None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn whatever_the_dome_a_ray_within_the_arc_is_free(
        latitude in -89.0..89.0_f64,
        hour_angle in -180.0..180.0_f64,
        dec in -90.0..90.0_f64,
        east in any::<bool>(),
        radius in 1.0..10.0_f64,
        (width, aperture) in (0.1..0.9_f64, 0.05..0.95_f64),
        past in 0.0..0.5_f64,
        axes in prop::array::uniform3(-0.15..0.15_f64),
        arm in 0.0..0.25_f64,
        part in -1.0..1.0_f64,
        seed in any::<u64>(),
    ) {
        let width_m = width * radius;
        let slit = Slit {
            latitude: deg(latitude),
            radius_m: radius,
            width_m,
            past_zenith_m: past * radius,
            axes_m: axes.map(|part| part * radius),
            arm_m: arm * radius,
            aperture_m: aperture * width_m,
        };
        let aim = Aim::at(deg(hour_angle), deg(dec)).on(if east { TubeSide::East } else { TubeSide::West });
        let above = slit.optical_axis(&aim).1[2] > 0.0;
        if let Some(arc) = slit.clear(&aim).filter(|_| above) {
            let azimuth = arc.middle() + deg(0.5 * arc.width().degrees() * part);
            prop_assert_eq!(rays_through(&slit, &aim, azimuth, 100, seed), 100);
        }
    }

    #[test]
    fn what_lasts_is_clear_from_its_first_second_to_its_last(
        hour_angle in -80.0..80.0_f64, dec in -89.0..60.0_f64, near in 0.0..360.0_f64,
    ) {
        let (slit, aim) = (dome(), Aim::at(deg(hour_angle), deg(dec)));
        if let Some((azimuth, lasts_s)) = slit.lasting(&aim, deg(near), deg(1.0), 7200.0) {
            for s in [0.0, 0.3 * lasts_s, lasts_s] {
                let at = aim.after((s / STEP_S).round() * STEP_S);
                prop_assert!(slit.clear(&at).unwrap().contains(azimuth), "{} s of {}", s, lasts_s);
            }
            prop_assert!(slit.clear_for_s(&aim, azimuth, deg(0.999), 7200.0).unwrap() >= lasts_s);
        }
    }
}
