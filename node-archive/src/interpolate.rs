//! The value of a polled property at an instant between its polls.
//!
//! Numbers lie on the straight line between two polls, angles on the shorter arc, and values without an in-between
//! (states, switches, names) are those of the nearest poll. A property that was not polled near the instant is missing,
//! and the result says so.

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
    Nearest,
}

impl Rule {
    /// The rule for a property of a kind that the header table declares with this type.
    pub fn of(kind: Kind, property: &str, dtype: Dtype) -> Self {
        match (kind, property) {
            (_, _) if dtype != Dtype::Float => Self::Nearest,
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

/// The value at an instant, from the last poll before it and the first at or after it.  A poll further than `holds_s`
/// from the instant is not used; with only one poll in reach its value holds. `None` when there is none.
pub fn value_at(rule: Rule, before: Option<&Sample>, after: Option<&Sample>, at: Utc, holds_s: f64) -> Option<Scalar> {
    let distance_s = |sample: &&Sample| sample.at.seconds_since(at).abs();
    let before = before.filter(|sample| distance_s(sample) <= holds_s);
    let after = after.filter(|sample| distance_s(sample) <= holds_s);
    let (Some(first), Some(second)) = (before, after) else {
        return before.or(after).map(|sample| sample.value.clone());
    };
    let nearest = if distance_s(&first) <= distance_s(&second) { first } else { second };
    let span_s = second.at.seconds_since(first.at);
    let whole = |sample: &Sample| matches!(sample.value, Scalar::Int(_) | Scalar::Float(_));
    if span_s <= 0.0 || !whole(first) || !whole(second) {
        return Some(nearest.value.clone());
    }
    let (Some(start), Some(end)) = (first.value.number(), second.value.number()) else {
        return Some(nearest.value.clone());
    };
    let fraction = at.seconds_since(first.at) / span_s;
    match rule {
        Rule::Nearest => Some(nearest.value.clone()),
        Rule::Linear => Some(Scalar::Float(start + fraction * (end - start))),
        Rule::Circular { turn } => {
            let arc = (end - start + turn / 2.0).rem_euclid(turn) - turn / 2.0;
            Some(Scalar::Float((start + fraction * arc).rem_euclid(turn)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(second: f64, value: Scalar) -> Sample {
        Sample { at: Utc::from_seconds(1e9 + second), value }
    }

    /// The value 2 s after the first of two polls 8 s apart.
    fn between(rule: Rule, start: Scalar, end: Scalar) -> Scalar {
        let (first, second) = (sample(0.0, start), sample(8.0, end));
        value_at(rule, Some(&first), Some(&second), Utc::from_seconds(1e9 + 2.0), 60.0).unwrap()
    }

    #[test]
    fn numbers_lie_on_the_line() {
        assert_eq!(between(Rule::Linear, Scalar::Float(10.0), Scalar::Float(14.0)), Scalar::Float(11.0));
        assert_eq!(between(Rule::Linear, Scalar::Int(10), Scalar::Int(14)), Scalar::Float(11.0));
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
    fn a_state_has_no_in_between() {
        assert_eq!(between(Rule::Nearest, Scalar::Int(2), Scalar::Int(4)), Scalar::Int(2));
        assert_eq!(between(Rule::Linear, Scalar::Bool(true), Scalar::Bool(false)), Scalar::Bool(true));
        assert_eq!(between(Rule::Linear, Scalar::Text("R".into()), Scalar::Text("B".into())), Scalar::Text("R".into()));
    }

    #[test]
    fn one_poll_holds_within_its_time_and_shows_nothing_beyond() {
        let poll = sample(0.0, Scalar::Float(5.0));
        let at = |second: f64| Utc::from_seconds(1e9 + second);
        assert_eq!(value_at(Rule::Linear, Some(&poll), None, at(9.0), 10.0), Some(Scalar::Float(5.0)));
        assert_eq!(value_at(Rule::Linear, None, Some(&poll), at(-9.0), 10.0), Some(Scalar::Float(5.0)));
        assert_eq!(value_at(Rule::Linear, Some(&poll), None, at(11.0), 10.0), None);
        assert_eq!(value_at(Rule::Linear, None, None, at(0.0), 10.0), None);
        // A gap in the telemetry is not bridged.
        let late = sample(100.0, Scalar::Float(9.0));
        assert_eq!(value_at(Rule::Linear, Some(&poll), Some(&late), at(50.0), 10.0), None);
        assert_eq!(value_at(Rule::Linear, Some(&poll), Some(&late), at(5.0), 10.0), Some(Scalar::Float(5.0)));
    }

    #[test]
    fn the_table_decides_what_is_an_angle_and_what_is_a_state() {
        assert_eq!(Rule::of(Kind::Dome, "Azimuth", Dtype::Float), Rule::Circular { turn: 360.0 });
        assert_eq!(Rule::of(Kind::Telescope, "RightAscension", Dtype::Float), Rule::Circular { turn: 24.0 });
        assert_eq!(Rule::of(Kind::Telescope, "Declination", Dtype::Float), Rule::Linear);
        assert_eq!(Rule::of(Kind::Focuser, "Position", Dtype::Float), Rule::Linear);
        assert_eq!(Rule::of(Kind::Rotator, "Position", Dtype::Float), Rule::Circular { turn: 360.0 });
        assert_eq!(Rule::of(Kind::Camera, "CameraState", Dtype::Int), Rule::Nearest);
        assert_eq!(Rule::of(Kind::Telescope, "Tracking", Dtype::Bool), Rule::Nearest);
    }
}
