//! The objections to an action: the robotic switch, the lease, the verdict, and the direction in which the action
//! looks.

use contract::device::dome::Shutter;
use contract::observatory::{RowState, Sector};
use units::MachineTime;

use crate::current_verdict::CurrentVerdict;

/// Why an action may not go on.
#[derive(Debug, Clone, PartialEq)]
pub enum Objection {
    /// The sky is not safe.
    Unsafe(String),
    /// Nothing needs to close, but the sky is not to be exposed.
    Suspended(String),
    /// The robotic switch is off.
    NotRobotic,
    /// This node does not command.
    NoLease,
    /// This node was asked to end.
    Ending,
}

impl std::fmt::Display for Objection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Unsafe(why) => write!(f, "{}{why}", RowState::NOT_SAFE),
            Self::Suspended(why) => write!(f, "{}{why}", RowState::SUSPENDED),
            Self::NotRobotic => f.write_str("the robotic switch is off"),
            Self::NoLease => f.write_str("this node does not command"),
            Self::Ending => f.write_str("this node was asked to end"),
        }
    }
}

/// An objection to an action: the robotic switch, that another node commands, and, where it needs a safe sky, what
/// `sky` has against it.
pub fn stands_against(
    is_robotic: bool,
    commands: bool,
    needs_safe: bool,
    sky: impl FnOnce() -> Option<Objection>,
) -> Option<Objection> {
    if !is_robotic {
        return Some(Objection::NotRobotic);
    }
    if !commands {
        return Some(Objection::NoLease);
    }
    if needs_safe { sky() } else { None }
}

/// The objection of the newest verdict to the sky, or to the direction in which an action looks.
pub fn sky_stands_against(
    verdict: &CurrentVerdict,
    now: MachineTime,
    azimuth_deg: impl FnOnce() -> Option<f64>,
) -> Option<Objection> {
    if !verdict.is_safe(now) {
        return Some(Objection::Unsafe(verdict.why()));
    }
    let avoided = || avoided(&verdict.state.avoid, azimuth_deg);
    verdict.suspension().or_else(avoided).map(Objection::Suspended)
}

/// The objection of the newest verdict to opening what is shut: a dwell runs over something that was missed of a safety
/// input. An answer that is awaited is none: it comes in a moment, and opening waits for it. A row that `begins` has the
/// objection unless all domes are known to be open; one that is at work only where one is known not to be, since the state
/// of one may be unknown for a moment.
pub fn keeps_shut(
    verdict: &CurrentVerdict,
    begins: bool,
    shutters: impl IntoIterator<Item = Option<Shutter>>,
) -> Option<Objection> {
    let why = verdict.shut_for_a_dwell()?;
    let may_be_shut = |shutter| match shutter {
        Some(Shutter::Error) | None => begins,
        Some(shutter) => shutter != Shutter::Open,
    };
    shutters.into_iter().any(may_be_shut).then_some(Objection::Suspended(why))
}

/// Why an action's direction is to be avoided now, if it is; where it looks is asked only if any is.
fn avoided(sectors: &[Sector], azimuth_deg: impl FnOnce() -> Option<f64>) -> Option<String> {
    if sectors.is_empty() {
        return None;
    }
    let azimuth_deg = azimuth_deg()?;
    let sector = sectors.iter().find(|sector| sector.contains(azimuth_deg))?;
    let (why, half_width_deg) = (&sector.why, sector.half_width_deg);
    Some(format!("{why}; azimuth {azimuth_deg:.0} deg is within {half_width_deg:.0} deg of it"))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use contract::observatory::{Unsafe, Verdict};
    use units::Utc;

    use super::*;

    fn at(second: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(second))
    }

    fn safe() -> CurrentVerdict {
        let mut verdict = CurrentVerdict::none(at(100), Utc::EPOCH);
        verdict.state.verdict = Verdict::Safe;
        verdict
    }

    #[test]
    fn the_switch_and_the_lease_come_before_the_sky_and_only_some_actions_ask_it() {
        let sky = || Some(Objection::Unsafe("rain".to_owned()));
        assert_eq!(stands_against(false, false, true, sky), Some(Objection::NotRobotic));
        assert_eq!(stands_against(true, false, true, sky), Some(Objection::NoLease));
        assert_eq!(stands_against(true, true, true, sky), sky());
        assert_eq!(stands_against(true, true, false, sky), None);
    }

    #[test]
    fn an_unsafe_an_old_and_a_suspending_verdict_stand_against_every_direction() {
        let nowhere = || None;
        assert_eq!(sky_stands_against(&safe(), at(101), nowhere), None);
        assert!(matches!(sky_stands_against(&safe(), at(106), nowhere), Some(Objection::Unsafe(_))), "old");
        let none = CurrentVerdict::none(at(100), Utc::EPOCH);
        assert!(matches!(sky_stands_against(&none, at(101), nowhere), Some(Objection::Unsafe(_))));
        let mut verdict = safe();
        let (input, why) = ("node/s/device/main".to_owned(), "its clock is off".to_owned());
        verdict.state.suspended = vec![Unsafe { input, why, clears_in_s: None }];
        let words = "node/s/device/main: its clock is off".to_owned();
        assert_eq!(sky_stands_against(&verdict, at(101), nowhere), Some(Objection::Suspended(words)));
    }

    #[test]
    fn what_keeps_a_dome_shut_stands_against_who_would_open_it_and_not_against_who_looks_out_of_an_open_one() {
        let (open, shut) = (Some(Shutter::Open), Some(Shutter::Closed));
        assert_eq!(keeps_shut(&safe(), true, [shut, None]), None);
        let mut verdict = safe();
        let why = "asks its device node".to_owned();
        verdict.keeps_shut = vec![Unsafe { input: "safetymonitor/m".to_owned(), why, clears_in_s: None }];
        assert_eq!(keeps_shut(&verdict, true, [shut]), None, "opening waits for an answer");
        let why = "its answer contradicts it".to_owned();
        verdict.keeps_shut.push(Unsafe { input: "safetymonitor/m".to_owned(), why, clears_in_s: Some(600.0) });
        let stands = Some(Objection::Suspended("safetymonitor/m: its answer contradicts it".to_owned()));
        for begins in [true, false] {
            assert_eq!(keeps_shut(&verdict, begins, []), None, "no dome");
            assert_eq!(keeps_shut(&verdict, begins, [open, open]), None);
            assert_eq!(keeps_shut(&verdict, begins, [open, shut]), stands);
            assert_eq!(keeps_shut(&verdict, begins, [Some(Shutter::Opening)]), stands);
        }
        for unknown in [None, Some(Shutter::Error)] {
            assert_eq!(keeps_shut(&verdict, true, [open, unknown]), stands);
            assert_eq!(keeps_shut(&verdict, false, [open, unknown]), None, "its state is unknown for a moment");
        }
    }

    #[test]
    fn a_direction_to_avoid_stands_against_who_looks_there() {
        let mut verdict = safe();
        let why = "wx: wind 12.0 m/s from 350 deg".to_owned();
        verdict.state.avoid = vec![Sector { azimuth_deg: 350.0, half_width_deg: 45.0, why }];
        let objection = |azimuth_deg| sky_stands_against(&verdict, at(101), || azimuth_deg);
        let words = "wx: wind 12.0 m/s from 350 deg; azimuth 20 deg is within 45 deg of it".to_owned();
        assert_eq!(objection(Some(20.0)), Some(Objection::Suspended(words)));
        assert_eq!((objection(Some(60.0)), objection(None)), (None, None));
    }
}
