//! A dome as its device node shows it, for the telescopes under it.

use contract::device::dome::{Guard, GuardAction, ReceivedPermit, Shutter};
use contract::observatory::Posture;
use contract::{Address, Device};
use units::Utc;

/// What a guard published, and when.
#[derive(Debug, Clone, PartialEq)]
pub struct PublishedGuard {
    /// Its payload.
    pub guard: Guard,
    /// Sky time of the publication; the ages in the payload count from here.
    pub at_utc: Utc,
    /// Sky seconds per machine second at its node.
    pub speed: f64,
}

impl PublishedGuard {
    /// Sky time at which a permit was renewed last: the guard counts its age from the number in it.
    fn renewed(&self, permit: &ReceivedPermit) -> Utc {
        self.at_utc.plus_seconds((permit.left_s - self.guard.permit_valid_s) * self.speed)
    }

    /// Sky time at which a permit runs out, or ran out.
    fn runs_out(&self, permit: &ReceivedPermit) -> Utc {
        self.at_utc.plus_seconds(permit.left_s * self.speed)
    }

    /// The permit that runs out first.
    fn first_permit(&self) -> Option<&ReceivedPermit> {
        self.guard.permits.iter().min_by(|a, b| a.left_s.total_cmp(&b.left_s))
    }
}

/// The newest samples about one dome that are young enough to count.
#[derive(Debug, Clone, PartialEq)]
pub struct DomeView {
    /// Which dome.
    pub dome: Device,
    /// Its shutter, where its device node reads it.
    pub shutter: Option<Shutter>,
    /// Its guard.
    pub guard: Option<PublishedGuard>,
}

impl DomeView {
    /// Stands it over this telescope? One that a site shares names its telescopes in the guard's payload.
    pub fn is_over(&self, telescope: &Address) -> bool {
        let names = |guard: &Guard| {
            let name = telescope.telescope.as_str();
            guard.granted.iter().any(|granted| granted.telescope == name)
                || guard.permits.iter().any(|permit| permit.telescope == name)
        };
        let is_shared = self.dome.address == telescope.shared();
        self.dome.address == *telescope || (is_shared && self.guard.as_ref().is_some_and(|seen| names(&seen.guard)))
    }

    /// Does the guard vouch that it is closed?
    pub fn is_verified_closed(&self) -> bool {
        self.guard.as_ref().is_some_and(|seen| seen.guard.verified_closed == Some(true))
    }

    /// How it stands. A status of closed counts only where a guard is there and does not doubt it.
    pub fn posture(&self) -> Posture {
        let is_doubted = self.guard.as_ref().is_none_or(|seen| seen.guard.verified_closed == Some(false));
        Posture::of_shutter(self.shutter.filter(|shutter| *shutter != Shutter::Closed || !is_doubted))
    }

    /// Sky time at which a telescope's observatory node last renewed its permit; `None` where it never did.
    pub fn renewed(&self, telescope: &Address) -> Option<Utc> {
        let seen = self.guard.as_ref()?;
        let permit = seen.guard.permits.iter().find(|permit| permit.telescope == telescope.telescope.as_str())?;
        Some(seen.renewed(permit))
    }

    /// How the dome stands while no observatory node answers, and what closes it by itself, and when.
    pub fn words(&self) -> String {
        let shutter = match self.shutter {
            Some(Shutter::Open) => "open",
            Some(Shutter::Closed) => "closed",
            Some(Shutter::Opening) => "opening",
            Some(Shutter::Closing) => "closing",
            Some(Shutter::Error) => "in error, it may be half open",
            None => "unknown",
        };
        let head = format!("dome {}: shutter {shutter}", self.dome.name);
        let Some(seen) = &self.guard else {
            return format!("{head}; its guard is silent, so what closes it is not known: look at the dome");
        };
        if self.is_verified_closed() {
            return format!("{head}, verified by its guard; nothing opens it without an observatory node");
        }
        let guard = match (seen.guard.action, seen.first_permit()) {
            (GuardAction::Closing, permit) => format!("its guard closes it now: {}", lacking(seen, permit)),
            (GuardAction::Watching, Some(permit)) if seen.guard.may_be_open => {
                let (valid_s, at) = (seen.guard.permit_valid_s, seen.runs_out(permit).time_of_day());
                format!("its guard closes it at {at}, {valid_s:.0} s after the last permit, unless a newer one comes")
            }
            (GuardAction::Watching, permit) => format!("its guard closes it next: {}", lacking(seen, permit)),
        };
        let watchdog = match (seen.guard.watchdog_s, seen.first_permit()) {
            (None, _) => String::new(),
            (Some(limit_s), _) if limit_s <= 0.0 => "; it has no watchdog of its own".to_owned(),
            (Some(limit_s), None) => {
                format!("; if that fails, its own watchdog closes it within {limit_s:.0} s")
            }
            (Some(limit_s), Some(permit)) => {
                let at = seen.runs_out(permit).plus_seconds(limit_s * seen.speed).time_of_day();
                format!("; if that fails, its own watchdog ({limit_s:.0} s) closes it by {at}")
            }
        };
        format!("{head}, not verified closed; {guard}{watchdog}")
    }
}

/// Why the dome may not be open.
fn lacking(seen: &PublishedGuard, permit: Option<&ReceivedPermit>) -> String {
    match permit {
        None => "it has received no permit".to_owned(),
        Some(permit) if permit.left_s <= 0.0 => {
            let (renewed, valid_s) = (seen.renewed(permit), seen.guard.permit_valid_s);
            let out = seen.runs_out(permit).time_of_day();
            format!("the permit of {} ran out at {out}, after {valid_s:.0} s", renewed.time_of_day())
        }
        Some(_) if seen.guard.permits.iter().any(|permit| !permit.safe) => "the last verdict is unsafe".to_owned(),
        Some(_) => "it was ordered to".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

    use contract::Kind;

    use super::*;

    fn view(shutter: Shutter, change: impl FnOnce(&mut Guard)) -> DomeView {
        let sample = include_str!("../../contract/golden/v1/dome.guard.json");
        let mut guard: Guard = serde_json::from_str(sample).unwrap();
        change(&mut guard);
        let at_utc = "2026-11-21T03:12:55Z".parse().unwrap();
        DomeView {
            dome: Address::new("paranal", "callisto").unwrap().device(Kind::Dome, &"dome_1".parse().unwrap()),
            shutter: Some(shutter),
            guard: Some(PublishedGuard { guard, at_utc, speed: 1.0 }),
        }
    }

    fn lapsed(guard: &mut Guard) {
        guard.permits[0].left_s = -5.0;
        (guard.may_be_open, guard.action) = (false, GuardAction::Closing);
    }

    #[test]
    fn a_shutter_is_closed_only_with_the_word_of_its_guard() {
        for (verified, posture) in
            [(Some(true), Posture::Closed), (None, Posture::Closed), (Some(false), Posture::Unknown)]
        {
            assert_eq!(view(Shutter::Closed, |guard| guard.verified_closed = verified).posture(), posture);
        }
        let unguarded = DomeView { guard: None, ..view(Shutter::Closed, |_| {}) };
        assert_eq!((unguarded.posture(), unguarded.is_verified_closed()), (Posture::Unknown, false));
        assert_eq!(DomeView { guard: None, ..view(Shutter::Open, |_| {}) }.posture(), Posture::Open);
        assert_eq!(view(Shutter::Error, |_| {}).posture(), Posture::Unknown, "half open");
    }

    #[test]
    fn it_is_known_what_closes_a_dome_without_an_observatory_node_and_when() {
        let callisto = Address::new("paranal", "callisto").unwrap();
        let open = view(Shutter::Open, |guard| guard.permits[0].left_s = 4.0);
        assert_eq!(open.renewed(&callisto).unwrap().time_of_day(), "03:12:49 UTC");
        assert_eq!(
            open.words(),
            "dome dome_1: shutter open, not verified closed; its guard closes it at 03:12:59 UTC, 10 s after the last permit, \
             unless a newer one comes; if that fails, its own watchdog (120 s) closes it by 03:14:59 UTC"
        );
        assert_eq!(
            view(Shutter::Error, lapsed).words(),
            "dome dome_1: shutter in error, it may be half open, not verified closed; its guard closes it now: the permit of \
             03:12:40 UTC ran out at 03:12:50 UTC, after 10 s; if that fails, its own watchdog (120 s) closes it by 03:14:50 UTC"
        );
        let none = view(Shutter::Closing, |guard| {
            lapsed(guard);
            (guard.permits, guard.watchdog_s) = (Vec::new(), Some(0.0));
        });
        assert!(none.words().contains("it has received no permit; it has no watchdog of its own"), "{}", none.words());
        let closed = view(Shutter::Closed, |guard| guard.verified_closed = Some(true));
        assert!(closed.words().contains("verified by its guard; nothing opens it"), "{}", closed.words());
        let unguarded = DomeView { guard: None, ..open };
        assert!(unguarded.words().contains("its guard is silent"), "{}", unguarded.words());
    }

    #[test]
    fn times_of_a_simulated_sky_pass_faster_than_the_seconds_of_a_permit() {
        let mut fast = view(Shutter::Open, lapsed);
        fast.guard.as_mut().unwrap().speed = 60.0;
        assert!(
            fast.words().contains("the permit of 02:57:55 UTC ran out at 03:07:55 UTC, after 10 s"),
            "{}",
            fast.words()
        );
    }

    #[test]
    fn a_shared_dome_stands_over_the_telescopes_that_its_guard_names() {
        let own = view(Shutter::Open, |_| {});
        let [callisto, io, other] = [("paranal", "callisto"), ("paranal", "io"), ("teide", "callisto")]
            .map(|(s, t)| Address::new(s, t).unwrap());
        assert!(own.is_over(&callisto) && !own.is_over(&io));
        let dome = callisto.shared().device(Kind::Dome, &own.dome.name);
        let shared = DomeView { dome, ..own };
        assert!(shared.is_over(&callisto) && !shared.is_over(&io) && !shared.is_over(&other));
        assert!(!DomeView { guard: None, ..shared }.is_over(&callisto));
    }
}
