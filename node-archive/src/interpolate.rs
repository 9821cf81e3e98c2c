//! The value that a polled property had when an exposure began and kept while it lasted.
//!
//! Between two polls numbers lie on the straight line, and angles on the shorter arc. What has no in-between (whole
//! numbers, states, switches, names) is as it was polled during the exposure, else as it was polled last before it. An
//! exposure begins when what moves has come to rest, so only polls of the same [`Rest`] count: between a poll before a
//! move and one behind it nothing lies that held. A property that was not polled near the instant is missing, and the
//! result says so.

use config::header::Dtype;
use contract::{Kind, Scalar};
use units::Utc;

/// One polled value.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Sky time of the poll.
    pub at: Utc,
    /// The value that the device reported.
    pub value: Scalar,
}

/// The polls around the begin of an exposure, or of the rest of a device that began a moment later.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Around {
    /// The last two values before it, the newest first.
    pub before: Vec<Sample>,
    /// The first two values at it or after it, the oldest first.
    pub after: Vec<Sample>,
    /// The device has published a state after the instant, with a value or without.
    pub received_since: bool,
    /// Between which moves of the device that is.
    pub rest: Rest,
}

/// The time of an exposure and around it in which a device rested: without an end where it was not seen to move, and
/// without any where it moved all the time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rest {
    /// When it was last seen to move before.
    moved: Option<Utc>,
    /// When it was first seen to rest after that.
    from: Option<Utc>,
    /// When it was last seen to rest before it moved again.
    until: Option<Utc>,
}

/// The property by which a device says that it moves. A filter wheel between two filters says that it is at -1.
pub fn flag_of(kind: Kind) -> Option<&'static str> {
    match kind {
        Kind::Telescope | Kind::Dome => Some("Slewing"),
        Kind::Focuser | Kind::Rotator => Some("IsMoving"),
        Kind::FilterWheel => Some("Position"),
        _ => None,
    }
}

impl Around {
    /// The polls of a flag around an exposure from `start` to `end`, in the order of time, each with its value where it had one:
    /// those of within `holds_s` of the begin show the moves.
    pub fn of_flag(said: Vec<(Utc, Option<Scalar>)>, (start, end): (Utc, Utc), holds_s: f64) -> Self {
        let newest = said.last().map(|(at, _)| *at);
        let values = said.into_iter().filter_map(|(at, value)| Some(Sample { at, value: value? }));
        let values: Vec<Sample> = values.collect();
        let is_near = |sample: &&Sample| sample.at.seconds_since(start).abs() <= holds_s;
        let rest = Rest::of(&values.iter().filter(is_near).cloned().collect::<Vec<_>>(), (start, end));
        let begins = rest.begins(start);
        let (before, after) = values.split_at(values.partition_point(|sample| sample.at < begins));
        Self {
            before: before.iter().rev().take(2).cloned().collect(),
            after: after.iter().take(2).cloned().collect(),
            received_since: newest.is_some_and(|newest| newest >= begins),
            rest,
        }
    }
}

impl Rest {
    /// By what a device said of its moves around an exposure from `start` to `end`, in the order of time. It rests when the
    /// exposure begins; by clocks that disagree a little it may seem to rest a moment later.
    pub fn of(said: &[Sample], (start, end): (Utc, Utc)) -> Self {
        let moves = |sample: &Sample| match &sample.value {
            Scalar::Bool(moves) => *moves,
            position => position.number() == Some(-1.0),
        };
        let split = said.partition_point(|sample| sample.at < start);
        let mut rests = split;
        if said[..split].last().is_some_and(moves) {
            rests += said[split..].iter().take_while(|sample| moves(sample)).count();
            if rests > split && said.get(rests).is_none_or(|sample| sample.at > end) {
                return Self::default();
            }
        }
        // What was not polled at the begin of the exposure was as it was then.
        let rested_at = |place: usize| if place == split { start } else { said[place].at };
        let last = said[..rests].iter().rposition(moves);
        let next = said[rests..].iter().position(moves).map(|place| rests + place);
        Self {
            moved: last.map(|last| said[last].at),
            from: last.map(|last| rested_at(last + 1)),
            until: next.map(|next| if next == split { start } else { said[next - 1].at }),
        }
    }

    /// From when on polls show the device as it was in an exposure that began at `start`.
    pub fn begins(&self, start: Utc) -> Utc {
        self.from.map_or(start, |from| from.max(start))
    }

    fn has(&self, at: Utc) -> bool {
        self.from.is_none_or(|from| at >= from) && self.until.is_none_or(|until| at <= until)
    }

    /// Whether a poll came after the last one that saw the device move: devices are asked where they are, and then whether
    /// they move.
    fn ends_move(&self, at: Utc) -> bool {
        self.moved.is_some_and(|moved| at > moved)
    }
}

/// How a property runs between two polls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rule {
    /// On a straight line.
    Linear,
    /// On the shorter arc of a circle of so many units (24 h, 360 deg).
    Circular {
        /// One turn, in the property's unit.
        turn: f64,
    },
    /// The value has no in-between.
    Held,
}

impl Rule {
    /// The rule for a property of a kind that the header table declares with this type.
    pub fn of(kind: Kind, property: &str, dtype: Dtype) -> Self {
        match (kind, property) {
            (_, _) if dtype != Dtype::Float => Self::Held,
            // Whole steps and whole numbers, whatever a table makes of them.
            (Kind::Focuser | Kind::FilterWheel, "Position") => Self::Held,
            (Kind::Telescope, "RightAscension" | "SiderealTime" | "TargetRightAscension") => {
                Self::Circular { turn: 24.0 }
            }
            (_, "Azimuth")
            | (Kind::ObservingConditions, "WindDirection")
            | (Kind::Rotator, "Position" | "MechanicalPosition" | "TargetPosition") => Self::Circular { turn: 360.0 },
            _ => Self::Linear,
        }
    }
}

/// The value when an exposure from `start` to `end` began. A poll further than `holds_s` from the begin is not used, nor one
/// beyond a move. Where a move leaves polls on one side of the begin only, the line through two of them goes on to it, as the
/// sky does, for their own distance at most; else the nearest one holds. `None` when there is none.
pub fn value_at(rule: Rule, around: &Around, (start, end): (Utc, Utc), holds_s: f64) -> Option<Scalar> {
    let is_near = |sample: &&Sample| sample.at.seconds_since(start).abs() <= holds_s;
    let counts = |sample: &&Sample| is_near(sample) && around.rest.has(sample.at);
    let before: Vec<&Sample> = around.before.iter().filter(counts).collect();
    let after: Vec<&Sample> = around.after.iter().filter(counts).collect();
    let during = after.first().filter(|sample| sample.at <= end);
    let held = during.or(before.first()).or(after.first()).copied().or_else(|| {
        let last = around.before.first().filter(is_near);
        last.filter(|sample| around.rest.ends_move(sample.at))
    })?;
    let line = match (before.as_slice(), after.as_slice()) {
        ([first, ..], [second, ..]) => Some((*first, *second)),
        ([], [first, second]) | ([second, first], []) if around.rest != Rest::default() => Some((*first, *second)),
        _ => None,
    };
    Some(line.and_then(|(first, second)| along(rule, first, second, start)).unwrap_or_else(|| held.value.clone()))
}

/// The value at an instant on the line through two polls, between them or as far again to both sides; `None` where there is
/// nothing between their values.
fn along(rule: Rule, first: &Sample, second: &Sample, at: Utc) -> Option<Scalar> {
    let number = |sample: &Sample| match &sample.value {
        Scalar::Int(_) | Scalar::Float(_) => sample.value.number(),
        Scalar::Bool(_) | Scalar::Text(_) | Scalar::List(_) => None,
    };
    let (from, to) = (number(first)?, number(second)?);
    let are_whole = matches!((&first.value, &second.value), (Scalar::Int(_), Scalar::Int(_)));
    let fraction = at.seconds_since(first.at) / second.at.seconds_since(first.at);
    if are_whole || !(-1.0..=2.0).contains(&fraction) {
        return None;
    }
    match rule {
        Rule::Held => None,
        Rule::Linear => Some(Scalar::Float(from + fraction * (to - from))),
        Rule::Circular { turn } => {
            let arc = (to - from + turn / 2.0).rem_euclid(turn) - turn / 2.0;
            Some(Scalar::Float((from + fraction * arc).rem_euclid(turn)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(second: f64, value: Scalar) -> Sample {
        Sample { at: at(second), value }
    }

    fn at(second: f64) -> Utc {
        Utc::from_seconds(1e9 + second)
    }

    /// The polls of numbers around an exposure of a second, from second 0 on, of a device that said whether it moves.
    fn polls(numbers: &[(f64, f64)], said: &[(f64, bool)]) -> Around {
        around(numbers.iter().map(|(second, number)| sample(*second, Scalar::Float(*number))), said)
    }

    /// The same, of whole numbers.
    fn steps(numbers: &[(f64, i64)], said: &[(f64, bool)]) -> Around {
        around(numbers.iter().map(|(second, number)| sample(*second, Scalar::Int(*number))), said)
    }

    fn around(samples: impl Iterator<Item = Sample>, said: &[(f64, bool)]) -> Around {
        let said: Vec<Sample> = said.iter().map(|(second, moves)| sample(*second, Scalar::Bool(*moves))).collect();
        let rest = Rest::of(&said, (at(0.0), at(1.0)));
        let begins = rest.begins(at(0.0));
        let (mut before, mut after): (Vec<Sample>, Vec<Sample>) = samples.partition(|sample| sample.at < begins);
        before.reverse();
        before.truncate(2);
        after.truncate(2);
        Around { before, after, received_since: true, rest }
    }

    /// The number at the begin of an exposure of so many seconds.
    fn number(rule: Rule, around: &Around, exposure_s: f64) -> Option<f64> {
        value_at(rule, around, (at(0.0), at(exposure_s)), 60.0).and_then(|value| value.number())
    }

    /// The value 2 s after the first of two polls 8 s apart, in an exposure that is over before the second one.
    fn between(rule: Rule, start: Scalar, end: Scalar) -> Scalar {
        let (before, after) = (vec![sample(-2.0, start)], vec![sample(6.0, end)]);
        value_at(rule, &Around { before, after, ..Around::default() }, (at(0.0), at(5.0)), 60.0).unwrap()
    }

    #[test]
    fn numbers_lie_on_the_line() {
        assert_eq!(between(Rule::Linear, Scalar::Float(10.0), Scalar::Float(14.0)), Scalar::Float(11.0));
        assert_eq!(between(Rule::Linear, Scalar::Int(10), Scalar::Float(14.0)), Scalar::Float(11.0));
    }

    #[test]
    fn angles_take_the_shorter_arc_over_north_and_over_zero_hours() {
        let degrees = Rule::Circular { turn: 360.0 };
        assert_eq!(between(degrees, Scalar::Float(359.0), Scalar::Float(3.0)), Scalar::Float(0.0));
        assert_eq!(between(degrees, Scalar::Float(1.0), Scalar::Float(357.0)), Scalar::Float(0.0));
        assert_eq!(between(degrees, Scalar::Float(10.0), Scalar::Float(14.0)), Scalar::Float(11.0));
        let hours = Rule::Circular { turn: 24.0 };
        assert_eq!(between(hours, Scalar::Float(23.5), Scalar::Float(0.5)), Scalar::Float(23.75));
    }

    #[test]
    fn a_state_and_whole_numbers_have_no_in_between() {
        assert_eq!(between(Rule::Held, Scalar::Int(2), Scalar::Int(4)), Scalar::Int(2));
        assert_eq!(between(Rule::Linear, Scalar::Int(25_009), Scalar::Int(25_010)), Scalar::Int(25_009));
        assert_eq!(between(Rule::Linear, Scalar::Bool(true), Scalar::Bool(false)), Scalar::Bool(true));
        assert_eq!(between(Rule::Linear, Scalar::Text("R".into()), Scalar::Text("B".into())), Scalar::Text("R".into()));
    }

    #[test]
    fn what_was_polled_during_the_exposure_comes_before_what_was_polled_before_it_and_behind_it() {
        let focus = |numbers: &[(f64, i64)], exposure_s| number(Rule::Held, &steps(numbers, &[]), exposure_s);
        // Nobody saw the focuser move; while there is light it rests.
        assert_eq!(focus(&[(-0.1, 25_000), (0.9, 25_010)], 1.0), Some(25_010.0));
        // The next move began when the light was in.
        assert_eq!(focus(&[(-0.9, 25_010), (0.6, 25_025)], 0.5), Some(25_010.0));
        assert_eq!(focus(&[(0.6, 25_025)], 0.5), Some(25_025.0));
    }

    #[test]
    fn a_frame_after_a_move_has_what_was_polled_since_and_one_before_the_next_move_what_was_polled_until_then() {
        let slewed = [(-1.4, true), (-0.4, true), (-0.3, false), (0.7, false), (1.7, false)];
        let altitude = polls(&[(-1.5, 20.0), (-0.5, 40.0), (0.5, 45.002), (1.5, 45.006)], &slewed);
        // On the line of the two polls of its side, which is that of the sky.
        assert!((number(Rule::Linear, &altitude, 0.2).unwrap() - 45.0).abs() < 1e-9);
        let azimuth = polls(&[(-0.5, 90.0), (0.5, 0.05), (1.5, 0.25)], &slewed);
        assert!((number(Rule::Circular { turn: 360.0 }, &azimuth, 0.2).unwrap() - 359.95).abs() < 1e-9);
        // The line goes no further than its polls are apart, and one poll makes none.
        let near = polls(&[(-0.5, 40.0), (0.5, 45.0), (0.6, 46.0)], &slewed);
        let one = polls(&[(-0.5, 40.0), (0.5, 45.0)], &slewed);
        assert_eq!([near, one].map(|polls| number(Rule::Linear, &polls, 0.2)), [Some(45.0); 2]);
        // The exposure is over, and the next slew begins.
        let slews = [(-1.4, false), (-0.4, false), (0.3, true), (0.6, true)];
        let altitude = polls(&[(-1.5, 30.0), (-0.5, 30.004), (0.5, 33.0), (0.6, 36.0)], &slews);
        assert!((number(Rule::Linear, &altitude, 0.2).unwrap() - 30.006).abs() < 1e-9);
        // A side of the pier is asked for less often.
        let side = steps(&[(-1.5, 0), (0.5, 1)], &slewed);
        assert_eq!(number(Rule::Held, &side, 0.2), Some(1.0));
    }

    #[test]
    fn between_two_moves_there_is_one_position_also_if_it_was_polled_once() {
        let said = [(-0.4, true), (-0.2, false), (0.1, false), (0.3, true)];
        for position in [
            steps(&[(-0.5, 25_004), (-0.1, 25_010), (0.25, 25_013), (0.35, 25_018)], &said),
            // Asked for in the poll that saw the end of the move.
            steps(&[(-0.5, 25_004), (-0.25, 25_010), (0.25, 25_013), (0.35, 25_018)], &said),
        ] {
            assert_eq!(number(Rule::of(Kind::Focuser, "Position", Dtype::Float), &position, 0.1), Some(25_010.0));
        }
        // The camera's clock says that the exposure began before the move had ended.
        let late = [(-0.2, true), (0.1, true), (0.3, false)];
        let position = steps(&[(-0.2, 25_004), (0.1, 25_008), (0.2, 25_009), (0.4, 25_010), (0.6, 25_010)], &late);
        assert_eq!(number(Rule::Held, &position, 1.0), Some(25_010.0));
        // What was polled in moves only is not known.
        let moving = steps(&[(-0.5, 25_004), (0.35, 25_018)], &said);
        assert_eq!(number(Rule::Held, &moving, 0.1), None);
    }

    #[test]
    fn a_device_that_moves_before_and_during_the_exposure_is_on_the_line_all_the_same() {
        // Also one whose flag sticks.
        let said = [(-1.5, true), (-0.5, true), (0.5, true), (1.5, true)];
        let azimuth = polls(&[(-1.0, 10.0), (1.0, 12.0)], &said);
        assert_eq!(number(Rule::Linear, &azimuth, 30.0), Some(11.0));
        assert_eq!(azimuth.rest, Rest::default());
    }

    #[test]
    fn a_device_rests_from_the_end_of_its_last_move_to_the_begin_of_the_next_one() {
        let rest = |said: &[(f64, bool)]| {
            let Rest { moved, from, until } = polls(&[], said).rest;
            [moved, from, until].map(|instant| instant.map(|instant| instant.seconds_since(at(0.0))))
        };
        assert_eq!(rest(&[]), [None; 3]);
        assert_eq!(rest(&[(-1.0, false), (1.0, false)]), [None; 3]);
        assert_eq!(rest(&[(-3.0, true), (-2.0, false), (-1.0, false)]), [Some(-3.0), Some(-2.0), None]);
        assert_eq!(rest(&[(-1.0, true), (1.0, false)]), [Some(-1.0), Some(0.0), None], "exposed at rest");
        assert_eq!(rest(&[(-1.0, true)]), [Some(-1.0), Some(0.0), None]);
        assert_eq!(rest(&[(-1.0, true), (0.1, true), (0.3, false)]), [Some(0.1), Some(0.3), None], "clocks disagree");
        assert_eq!(rest(&[(-1.0, true), (0.1, true), (1.1, false)]), [None; 3], "it moves all the time");
        assert_eq!(rest(&[(-1.0, false), (1.0, true)]), [None, None, Some(0.0)]);
        assert_eq!(rest(&[(1.0, false), (2.0, false), (3.0, true)]), [None, None, Some(2.0)]);
        // A filter wheel between two filters.
        let wheel = [(-2.0, -1), (-1.0, 3)].map(|(second, position)| sample(second, Scalar::Int(position)));
        assert_eq!(Rest::of(&wheel, (at(0.0), at(1.0))).from, Some(at(-1.0)));
    }

    #[test]
    fn one_look_at_a_flag_shows_the_moves_the_values_and_whether_the_device_was_there_since() {
        let moves = |second: f64, moves: Option<bool>| (at(second), moves.map(Scalar::Bool));
        let flag = |said: &[(f64, Option<bool>)]| {
            let said = said.iter().map(|(second, value)| moves(*second, *value)).collect();
            Around::of_flag(said, (at(0.0), at(1.0)), 60.0)
        };
        let seconds = |samples: &[Sample]| -> Vec<f64> {
            samples.iter().map(|sample| sample.at.seconds_since(at(0.0))).collect()
        };
        let slewed = [(-3.0, false), (-2.0, true), (-1.0, false), (1.0, false), (2.0, false), (3.0, false)];
        let around = flag(&slewed.map(|(second, moves)| (second, Some(moves))));
        assert_eq!((seconds(&around.before), seconds(&around.after)), (vec![-1.0, -2.0], vec![1.0, 2.0]));
        assert_eq!(
            (around.rest.moved, around.rest.from, around.received_since),
            (Some(at(-2.0)), Some(at(-1.0)), true)
        );
        // Moves of long before and after are none of this exposure, and show that there is a flag and a device.
        let around = flag(&[(-90.0, Some(true)), (90.0, Some(true))]);
        assert_eq!((seconds(&around.before), seconds(&around.after)), (vec![-90.0], vec![90.0]));
        assert_eq!((around.rest, around.received_since), (Rest::default(), true));
        // The device is there, and gives no value.
        assert!(flag(&[(-1.0, Some(false)), (0.5, None)]).received_since);
        assert!(!flag(&[(-1.0, Some(false)), (-0.5, None)]).received_since);
        assert_eq!(flag(&[]), Around::default());
    }

    #[test]
    fn one_poll_holds_within_its_time_and_shows_nothing_beyond() {
        let value = |polls: &Around, holds_s| value_at(Rule::Linear, polls, (at(0.0), at(1.0)), holds_s);
        assert_eq!(value(&polls(&[(-9.0, 5.0)], &[]), 10.0), Some(Scalar::Float(5.0)));
        assert_eq!(value(&polls(&[(9.0, 5.0)], &[]), 10.0), Some(Scalar::Float(5.0)));
        assert_eq!(value(&polls(&[(-11.0, 5.0)], &[]), 10.0), None);
        assert_eq!(value(&Around::default(), 10.0), None);
        // Two of one side are no line: a wind that fell does not fall below 0.
        assert_eq!(value(&polls(&[(-2.0, 9.0), (-1.0, 5.0)], &[]), 10.0), Some(Scalar::Float(5.0)));
        // A gap in the telemetry is not bridged.
        assert_eq!(value(&polls(&[(-50.0, 5.0), (50.0, 9.0)], &[]), 10.0), None);
        assert_eq!(value(&polls(&[(-5.0, 5.0), (95.0, 9.0)], &[]), 10.0), Some(Scalar::Float(5.0)));
    }

    #[test]
    fn the_table_decides_what_is_an_angle_and_what_is_a_state() {
        assert_eq!(Rule::of(Kind::Dome, "Azimuth", Dtype::Float), Rule::Circular { turn: 360.0 });
        assert_eq!(Rule::of(Kind::Telescope, "RightAscension", Dtype::Float), Rule::Circular { turn: 24.0 });
        assert_eq!(Rule::of(Kind::Telescope, "Declination", Dtype::Float), Rule::Linear);
        assert_eq!(Rule::of(Kind::Focuser, "Position", Dtype::Float), Rule::Held);
        assert_eq!(Rule::of(Kind::Rotator, "Position", Dtype::Float), Rule::Circular { turn: 360.0 });
        assert_eq!(Rule::of(Kind::Camera, "CameraState", Dtype::Int), Rule::Held);
        assert_eq!(Rule::of(Kind::Telescope, "Tracking", Dtype::Bool), Rule::Held);
    }
}
