//! When people are told that the device node does not guard, and that it does again. Pure: time comes in.

use std::time::Duration;

use bus::MachineTime;

/// One restart takes seconds and is nobody's business: meanwhile the other one of the two processes guards.
pub const RESTART: Duration = Duration::from_secs(10);
/// A node that guards again is believed after this: one in a loop of crashes guards for a moment, too.
const CONFIRMED: Duration = Duration::from_secs(5);
/// What is wrong is told again so often while it lasts.
const REPEATED: Duration = Duration::from_secs(60);

/// What people are told now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum News {
    /// The node does not guard.
    Fault,
    /// It guards again.
    Over,
}

/// What has been told.
#[derive(Debug, Default)]
pub struct Complaint {
    /// Whether the node guards, and since when.
    state: Option<(bool, MachineTime)>,
    told: Option<(String, MachineTime)>,
}

impl Complaint {
    /// By whether the node guards, and why it does not run as it should. One that `fails_again` does not only restart.
    pub fn next(&mut self, guards: bool, error: Option<&str>, fails_again: bool, now: MachineTime) -> Option<News> {
        let since = self.state.filter(|(did, _)| *did == guards).map_or(now, |(_, since)| since);
        self.state = Some((guards, since));
        let lasted = now.since(since);
        if guards {
            return if lasted >= CONFIRMED { self.end() } else { None };
        }
        let error = error.filter(|_| fails_again || lasted >= RESTART)?;
        let is_told = |(told, at): &(String, MachineTime)| told == error && now.since(*at) < REPEATED;
        if self.told.as_ref().is_some_and(is_told) {
            return None;
        }
        self.told = Some((error.to_owned(), now));
        Some(News::Fault)
    }

    /// What was told no longer holds.
    pub fn end(&mut self) -> Option<News> {
        self.told.take().map(|_| News::Over)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_restart_is_nobodys_business_and_a_fault_ends_once_the_node_has_guarded_for_seconds() {
        let at = |s: f64| MachineTime::from_boot(Duration::from_secs_f64(1000.0 + s));
        let mut complaint = Complaint::default();
        let killed = Some("it was killed");
        for (name, guards, error, fails_again, now_s, news) in [
            ("it guards", true, None, false, 0.0, None),
            ("it was killed", false, killed, false, 1.0, None),
            ("and guards again 0.7 s later", true, killed, false, 1.7, None),
            ("that is all", true, killed, false, 60.0, None),
            ("it was killed", false, killed, false, 61.0, None),
            ("and does not start", false, killed, false, 70.9, None),
            ("which is no restart any more", false, killed, false, 71.0, Some(News::Fault)),
            ("it is told once", false, killed, false, 130.9, None),
            ("each minute", false, killed, false, 131.0, Some(News::Fault)),
            ("and when the cause is another", false, Some("no file"), false, 132.0, Some(News::Fault)),
            ("it guards", true, Some("no file"), false, 133.0, None),
            ("for a moment", false, Some("no file"), true, 136.0, None),
            ("it guards", true, Some("no file"), false, 137.0, None),
            ("and goes on to", true, Some("no file"), false, 142.0, Some(News::Over)),
            ("which is told once", true, Some("no file"), false, 143.0, None),
            ("it ends again and again", false, killed, true, 200.0, Some(News::Fault)),
            ("why is not known", false, None, true, 300.0, None),
        ] {
            assert_eq!(complaint.next(guards, error, fails_again, at(now_s)), news, "{name}, {now_s}");
        }
        assert_eq!((complaint.end(), complaint.end()), (Some(News::Over), None));
    }
}
