//! By when a step of a row should have ended: from how long such steps took on earlier nights, by the archive's telemetry,
//! or by assumed figures until there is some. A step that is silent beyond that raises an alert, although every process
//! and device answers.

use std::sync::{Mutex, PoisonError};

use bus::Clock;
use config::Observatory;
use contract::observatory::{ActionNow, AlertKind, RowState};
use schedule::plan::{Figure, Overheads, TimedPart};
use units::Utc;

/// A step may take so many times as long as usual, where that was measured, and where it is only assumed.
const MEASURED: f64 = 2.0;
const ASSUMED: f64 = 4.0;

/// The longest way of a slew, deg.
const LONGEST_WAY_DEG: f64 = 180.0;

/// A slit that follows from one side of the dome to the other, where none was measured, s.
const SLIT_S: f64 = 90.0;

/// How long a step lasts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lasts {
    /// As long as this part of a row usually takes.
    Part(TimedPart),
    /// A frame of this exposure time, s, until the next one begins or the last one is on disk.
    Frame(f64),
    /// So many seconds of sky time.
    Seconds(f64),
    /// Something else decides, and has its own limit or alert: clouds, the verdict, the end of the row.
    Unbounded,
}

impl From<TimedPart> for Lasts {
    fn from(part: TimedPart) -> Self {
        Self::Part(part)
    }
}

impl Lasts {
    /// Seconds of sky time after which a step of the action is overdue.
    fn longest_s(self, action: &str, overheads: &Overheads, allowance_s: f64) -> Option<f64> {
        let most = |figure: Figure| figure.value * if figure.measured > 0 { MEASURED } else { ASSUMED };
        let step_s = match self {
            Self::Unbounded => return None,
            Self::Seconds(seconds) => seconds,
            Self::Frame(exposure_s) => {
                exposure_s + most(overheads.frame(action)) + most(overheads.span(TimedPart::Spool))
            }
            Self::Part(part @ TimedPart::Slew) => {
                most(overheads.span(part)) + LONGEST_WAY_DEG * most(overheads.slew_s_per_deg)
            }
            Self::Part(part @ TimedPart::Slit) => most(overheads.span(part)).max(SLIT_S),
            Self::Part(part) => most(overheads.span(part)),
        };
        Some(step_s + allowance_s).filter(|longest_s| longest_s.is_finite())
    }
}

/// How long steps take at this telescope, as far as it is known.
#[derive(Debug)]
pub struct StepTimes {
    overheads: Mutex<Overheads>,
    /// This in addition, machine s: nobody is woken for less.
    allowance_s: f64,
}

impl StepTimes {
    /// Nothing measured yet.
    pub fn assumed(config: &Observatory) -> Self {
        Self { overheads: Mutex::new(Overheads::assumed(config)), allowance_s: config.faults.overdue_s }
    }

    /// What the telemetry of earlier nights says.
    pub fn learn(&self, overheads: Overheads) {
        *self.overheads.lock().unwrap_or_else(PoisonError::into_inner) = overheads;
    }

    /// By when a step of an action that begins now should have ended, sky time.
    pub fn expected_by(&self, lasts: Lasts, action: &str, clock: &Clock) -> Option<Utc> {
        let overheads = self.overheads.lock().unwrap_or_else(PoisonError::into_inner);
        // A busy machine is not quicker under a quick sky.
        let allowance_s = self.allowance_s * clock.speed();
        lasts.longest_s(action, &overheads, allowance_s).map(|longest_s| clock.utc().plus_seconds(longest_s))
    }
}

/// The alerts about steps that are silent for longer than they should.
pub fn overdue<'a>(
    actions: impl Iterator<Item = &'a ActionNow>,
    now: Utc,
) -> impl Iterator<Item = (AlertKind, String, String)> {
    actions.filter_map(move |action| {
        let by = action.expected_by_utc.filter(|by| *by < now)?.strftime("%H:%M:%S");
        let ActionNow { row, action, camera, step, .. } = action;
        let row = RowState::told(*row);
        let cause = format!("row {row} ({action}): \"{step}\" should have ended by {by} UTC");
        Some((AlertKind::StepOverdue, camera.clone(), cause))
    })
}

#[cfg(test)]
mod tests {
    use node::{NodeAlerts, StandingAlerts};

    use super::*;

    fn overheads() -> Overheads {
        let text = test_support::PARANAL;
        Overheads::assumed(&config::parse(text, std::path::Path::new("")).unwrap())
    }

    #[test]
    fn a_step_may_take_twice_as_long_as_measured_or_four_times_as_long_as_assumed() {
        let mut overheads = overheads();
        let close = Lasts::Part(TimedPart::Close);
        assert_eq!(close.longest_s("close", &overheads, 180.0), Some(4.0 * 60.0 + 180.0));
        overheads.set_span(TimedPart::Close, Figure { value: 100.0, measured: 5 });
        assert_eq!(close.longest_s("close", &overheads, 180.0), Some(2.0 * 100.0 + 180.0));
        assert_eq!(Lasts::Part(TimedPart::Slit).longest_s("object", &overheads, 180.0), Some(SLIT_S + 180.0));
        assert_eq!(Lasts::Seconds(30.0).longest_s("flats", &overheads, 180.0), Some(210.0));
        assert_eq!(Lasts::Unbounded.longest_s("object", &overheads, 180.0), None);
        assert_eq!(Lasts::Seconds(f64::NAN).longest_s("flats", &overheads, 180.0), None);
        let frame = Lasts::Frame(600.0).longest_s("object", &overheads, 180.0).unwrap();
        assert!(frame > 780.0 && frame < 900.0, "{frame}");
    }

    #[tokio::test]
    async fn a_step_beyond_its_time_is_an_alert_until_the_next_step() {
        let alerts = NodeAlerts::new(Clock::machine_clock());
        let active = || -> Vec<String> {
            let published = alerts.watch().borrow().alerts.clone();
            let active = published.into_iter().filter(|alert| alert.returned_utc.is_none());
            active.map(|alert| format!("{}: {}", alert.id, alert.cause)).collect()
        };
        let begun = Utc::from_seconds(1_795_228_200.0);
        let mut action = ActionNow {
            row: 4,
            action: "object".to_owned(),
            camera: "cam".to_owned(),
            object: None,
            step: "slewing".to_owned(),
            started_utc: begun,
            expected_by_utc: Some(begun.plus_seconds(300.0)),
        };
        let mut standing = StandingAlerts::default();
        standing.keep(overdue([&action].into_iter(), begun.plus_seconds(299.0)), &alerts);
        assert!(active().is_empty());
        standing.keep(overdue([&action].into_iter(), begun.plus_seconds(301.0)), &alerts);
        let [told] = &active()[..] else { panic!("{:?}", active()) };
        assert_eq!(told, "step-overdue/cam: row 5 (object): \"slewing\" should have ended by 02:35:00 UTC");
        action.expected_by_utc = None;
        standing.keep(overdue([&action].into_iter(), begun.plus_seconds(302.0)), &alerts);
        assert!(active().is_empty());
        action.expected_by_utc = Some(begun);
        standing.keep(overdue([&action].into_iter(), begun.plus_seconds(303.0)), &alerts);
        assert_eq!(active().len(), 1);
        standing.keep(overdue(std::iter::empty(), begun.plus_seconds(304.0)), &alerts);
        assert!(active().is_empty());
    }
}
