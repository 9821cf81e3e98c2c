use proptest::prelude::*;

use super::*;
use crate::focus::smooth::Smoother;

/// A focuser with play and a hyperbola over it.
struct Focuser {
    at: i32,
    /// Where the optics stand: behind the focuser by the play.
    optics: f64,
    play: f64,
    focus: f64,
    moves: Vec<i32>,
}

impl Focuser {
    fn new(at: i32, focus: f64) -> Self {
        Self { at, optics: f64::from(at), play: 0.0, focus, moves: Vec::new() }
    }

    fn go(&mut self, to: i32) {
        self.at = to;
        self.moves.push(to);
        // the gears drag the optics along once the play is taken up
        self.optics = self.optics.clamp(f64::from(to) - self.play, f64::from(to));
    }

    fn size(&self) -> f64 {
        2.5_f64.hypot(0.025 * (self.optics - self.focus))
    }
}

fn run(
    plan: Plan,
    focuser: &mut Focuser,
    see: impl Fn(&Focuser, usize) -> Option<f64>,
) -> (Result<Focused, Failed>, Sweep) {
    let mut sweep = Sweep::new(plan).unwrap();
    for _ in 0..400 {
        match sweep.next() {
            FocusStep::Move(to) => focuser.go(to),
            FocusStep::Expose(_) => {
                let value = see(focuser, sweep.points().len());
                sweep.measured(value.map(|value| Estimate { value, error: 0.02 * value.abs() })).unwrap();
            }
            FocusStep::Done(result) => {
                assert_eq!(sweep.next(), FocusStep::Done(result.clone()), "the end stays the end");
                return (result, sweep);
            }
        }
    }
    panic!("the run does not end: {:?}", sweep.points());
}

fn plan(start: i32) -> Plan {
    Plan::about(start, 400, 0..=20_000)
}

#[test]
fn a_plain_run_finds_the_focus_in_some_seventeen_frames() {
    let mut focuser = Focuser::new(10_000, 10_137.0);
    let (result, sweep) = run(plan(10_000), &mut focuser, |f, _| Some(f.size()));
    let focused = result.unwrap();
    assert_eq!((focused.position, focuser.at), (10_137, 10_137));
    assert_eq!(sweep.points().len(), 17);
    assert!((focused.fit.best_position() - 10_137.0).abs() < 0.01 && (focused.verified - 2.5).abs() < 1e-6);
}

#[test]
fn the_closer_look_is_as_wide_as_asked_for() {
    for (closer_percent, width) in [(Some(100), 800), (Some(60), 480)] {
        let mut focuser = Focuser::new(10_000, 10_037.0);
        let (result, sweep) = run(Plan { closer_percent, ..plan(10_000) }, &mut focuser, |f, _| Some(f.size()));
        assert_eq!(result.unwrap().position, 10_037);
        let fine = sweep.points().iter().filter(|point| point.pass == Pass::Fine).map(|point| point.position);
        let seen = fine.clone().max().unwrap() - fine.min().unwrap();
        assert!((seen - width).abs() <= 1, "{closer_percent:?}: {seen}");
    }
}

#[test]
fn play_of_the_gears_does_not_move_the_focus() {
    for approach in [ApproachSide::Upward, ApproachSide::Downward] {
        let mut focuser = Focuser::new(10_200, 10_000.0);
        focuser.play = 90.0;
        let (result, _) = run(Plan { backlash: 120, approach, ..plan(10_200) }, &mut focuser, |f, _| Some(f.size()));
        let focused = result.unwrap();
        assert!((focuser.optics - 10_000.0).abs() <= 1.0, "{approach:?}: optics at {}", focuser.optics);
        let lag = if approach == ApproachSide::Upward { 90 } else { 0 };
        assert!((focused.position - 10_000 - lag).abs() <= 1, "{approach:?}: {focused:?}");
    }
}

#[test]
fn a_focus_beyond_the_end_is_followed() {
    for focus in [9_350.0, 10_700.0, 11_400.0, 8_600.0] {
        let mut focuser = Focuser::new(10_000, focus);
        let (result, sweep) = run(plan(10_000), &mut focuser, |f, _| Some(f.size()));
        let found = result.unwrap().position;
        assert!((f64::from(found) - focus).abs() <= 1.0, "{focus}: {found}");
        assert!(sweep.points().len() <= 17 + 12, "{}", sweep.points().len());
    }
}

#[test]
fn a_run_that_fails_ends_where_it_began() {
    type See = fn(&Focuser, usize) -> Option<f64>;
    let far = |f: &Focuser, _: usize| Some(f.size());
    let cases: [(&str, f64, std::ops::RangeInclusive<i32>, See); 6] = [
        ("TooFar", 14_000.0, 0..=20_000, far),
        ("AtLimit", 14_000.0, 0..=10_400, far),
        ("TooFewValues", 10_000.0, 0..=20_000, |_, _| None),
        ("NoMinimum", 10_000.0, 0..=20_000, |_, _| Some(3.0)),
        // after 16 frames clouds come
        ("NotVerified", 10_000.0, 0..=20_000, |f, n| (n < 16).then(|| f.size())),
        ("NotVerified", 10_000.0, 0..=20_000, |f, n| Some(if n < 16 { f.size() } else { 4.0 })),
    ];
    for (word, focus, limits, see) in cases {
        let mut focuser = Focuser::new(10_050, focus);
        let plan = Plan { start: 10_050, backlash: 50, limits, ..plan(10_000) };
        let (result, _) = run(plan, &mut focuser, see);
        let failed = result.unwrap_err();
        assert!(format!("{:?}", failed.reason).starts_with(word), "{word}: {}", failed.reason);
        assert_eq!((failed.position, focuser.at), (10_050, 10_050), "{word}");
        let last = &focuser.moves[focuser.moves.len() - 2..];
        assert!(last[0] <= 10_000, "approached from below: {last:?}");
    }
}

#[test]
fn a_caller_can_end_a_run() {
    let mut sweep = Sweep::new(plan(10_000)).unwrap();
    assert_eq!(sweep.measured(None), Err(NotAsked));
    let first = [sweep.next(), sweep.next()];
    assert_eq!(first, [FocusStep::Move(9_600), FocusStep::Expose(Pass::Coarse)]);
    sweep.end("clouds");
    assert_eq!(sweep.next(), FocusStep::Move(10_000));
    let FocusStep::Done(Err(failed)) = sweep.next() else { panic!("not done") };
    assert_eq!(failed.reason, NoFocus::Ended("clouds".to_owned()));
}

#[test]
fn one_bad_verification_frame_is_outvoted() {
    let mut focuser = Focuser::new(10_000, 10_000.0);
    let gust = |f: &Focuser, n: usize| Some(if n == 16 { 4.0 } else { f.size() });
    let (result, sweep) = run(plan(10_000), &mut focuser, gust);
    assert!((result.unwrap().verified - 2.5).abs() < 0.01);
    assert_eq!(sweep.points().len(), 19);
}

#[test]
fn a_range_far_too_wide_is_narrowed() {
    let mut focuser = Focuser::new(10_000, 10_030.0);
    // stars are seen within 300 steps only, the first positions lie 250 apart
    let near = |f: &Focuser, _: usize| ((f.optics - f.focus).abs() < 300.0).then(|| f.size());
    let (result, _) = run(Plan { half_range: 1000, ..plan(10_000) }, &mut focuser, near);
    assert!((result.unwrap().position - 10_030).abs() <= 1);
}

#[test]
fn another_operator_is_followed_by_a_smoothed_curve() {
    let contrast = |f: &Focuser, _: usize| Some(1e4 / (f.size() * f.size()));
    for name in ["spline", "rbf", "lowess"] {
        let curve = Curve::Smoothed(Smoother::named(name).unwrap(), Better::Larger);
        let mut focuser = Focuser::new(10_000, 10_110.0);
        let (result, _) = run(Plan { curve, ..plan(10_000) }, &mut focuser, contrast);
        let found = result.unwrap().position;
        // c/a is 100 steps; the fine positions lie 50 apart, and lowess answers at one of them only
        assert!((found - 10_110).abs() <= if name == "lowess" { 100 } else { 50 }, "{name}: {found}");
    }
}

#[test]
fn plans_that_cannot_be_made_are_refused() {
    let bad = |change: fn(&mut Plan)| {
        let mut plan = plan(10_000);
        change(&mut plan);
        Sweep::new(plan).map(|_| ()).unwrap_err()
    };
    assert!(matches!(bad(|p| p.coarse = 4), BadPlan::Count { what: "coarse", count: 4 }));
    assert!(matches!(bad(|p| p.fine = 1000), BadPlan::Count { what: "fine", .. }));
    assert!(matches!(bad(|p| p.closer_percent = Some(0)), BadPlan::Closer { percent: 0 }));
    assert!(matches!(bad(|p| p.closer_percent = Some(101)), BadPlan::Closer { percent: 101 }));
    assert!(matches!(bad(|p| p.half_range = 0), BadPlan::Length { .. }));
    assert!(matches!(bad(|p| p.backlash = -1), BadPlan::Length { .. }));
    assert!(matches!(bad(|p| p.limits = 5..=7), BadPlan::NoRoom { .. }));
    assert!(matches!(bad(|p| p.limits = std::ops::RangeInclusive::new(9, 3)), BadPlan::NoRoom { .. }));
    assert!(matches!(bad(|p| p.backlash = 19_999), BadPlan::NoRoom { .. }));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn any_values_end_and_no_move_leaves_the_travel(
        values in prop::collection::vec(prop_oneof![
            4 => 0.5_f64..20.0, 1 => Just(f64::NAN), 1 => Just(0.0), 1 => Just(-1.0), 1 => Just(1e300), 1 => Just(5.0)
        ], 1..60),
        start in 0_i32..1000, centre in -2000_i32..3000, half_range in 2_i32..2000, backlash in 0_i32..200,
        smoothed in any::<bool>(), downward in any::<bool>(),
    ) {
        let curve = Curve::Smoothed(&crate::focus::smooth::SMOOTHERS[backlash as usize % 4], Better::Larger);
        let plan = Plan {
            start, half_range, backlash,
            curve: if smoothed { curve } else { Curve::Hyperbola },
            approach: if downward { ApproachSide::Downward } else { ApproachSide::Upward },
            ..Plan::about(centre, half_range, 0..=1000)
        };
        let mut focuser = Focuser::new(start, 500.0);
        let (result, _) = run(plan, &mut focuser, |_, n| Some(values[n % values.len()]));
        prop_assert!(focuser.moves.iter().all(|to| (0..=1000).contains(to)), "{:?}", focuser.moves);
        let position = match result {
            Ok(focused) => focused.position,
            Err(failed) => { prop_assert_eq!(failed.position, start); failed.position }
        };
        prop_assert_eq!(focuser.at, position);
    }
}
