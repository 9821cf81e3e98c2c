//! Tracks which node publishes a safety input. Of two nodes that do so at the same time neither counts, and the value
//! of a new one does not cancel the warning of the one before. `interlock::Succession` decides which of them is the
//! newer one.

use contract::device::safety_monitor::Fields as Monitor;
use contract::{BootId, DeviceState, Link, NoData, Stamped};
use interlock::Succession;
use units::MachineTime;

/// So many times the period of its states a node may be silent before it is dead.
const SILENT_PERIODS: f64 = 3.0;

/// What is to be known of the fields of a kind.
pub struct Manners<F> {
    /// Is this state a warning?
    pub warns: fn(&DeviceState<F>) -> bool,
    /// Takes what the sender vouches for of the time before out of a state.
    pub forget_record: fn(&mut DeviceState<F>),
}

/// Those of a safety monitor.
pub const MONITOR: Manners<Monitor> = Manners {
    warns: |state| {
        let is_silent = state.fields.is_safe.as_result().is_err_and(NoData::is_silence);
        state.link == Link::Connected && !is_silent && state.fields.is_safe.known() != Some(&true)
    },
    forget_record: |state| state.fields.gapless_safe_s = 0.0,
};

impl<F> Manners<F> {
    /// Those of an input whose values are held against limits: a dwell separates a bad value from its end. A lost link is
    /// no value, so the incarnation after it is believed at once.
    pub fn of_values() -> Self {
        Self { warns: |_| false, forget_record: |_| () }
    }
}

/// The nodes that publish one input.
pub struct Writers<F> {
    manners: Manners<F>,
    succession: Succession,
    first: Option<BootId>,
    disputed: bool,
    /// The node that gave the last warning, the time, and how long such a node may be silent, s.
    warned: Option<(BootId, MachineTime, f64)>,
}

impl<F> Writers<F> {
    /// No node has published yet.
    pub fn new(manners: Manners<F>) -> Self {
        Self { manners, succession: Succession::default(), first: None, disputed: false, warned: None }
    }

    /// Takes in a state, and changes it where its sender cannot vouch for all of it; false where it is not to be used.
    pub fn take(&mut self, sample: &mut Stamped<DeviceState<F>>, arrived: MachineTime) -> bool {
        let newer = self.succession.is_newer(&sample.boot_id, sample.seq, arrived);
        if let Some(why) = self.dispute(arrived) {
            self.disputed = true;
            sample.body.link = Link::Lost { reason: NoData::new("two writers", why) };
            return true;
        }
        if !newer {
            return false;
        }
        let first = self.first.get_or_insert_with(|| sample.boot_id.clone());
        if self.disputed || *first != sample.boot_id {
            // This node did not receive the record of another incarnation, or of one of two, from the time before.
            (self.manners.forget_record)(&mut sample.body);
        }
        if (self.manners.warns)(&sample.body) {
            let silent_s =
                SILENT_PERIODS * if sample.body.period_s > 0.0 { sample.body.period_s.min(5.0) } else { 5.0 };
            self.warned = Some((sample.boot_id.clone(), arrived, silent_s));
            return true;
        }
        match &self.warned {
            // It is not known yet whether the node that warned is dead or will publish again.
            Some((boot_id, at, silent_s))
                if *boot_id != sample.boot_id && arrived.since(*at).as_secs_f64() < *silent_s =>
            {
                false
            }
            _ => {
                self.warned = None;
                true
            }
        }
    }

    /// Why none counts now, if two nodes publish.
    pub fn dispute(&self, now: MachineTime) -> Option<String> {
        let (one, other) = self.succession.rivals(now)?;
        Some(format!("the nodes with boot ids {one} and {other} both publish for this device; stop one of them"))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use contract::Datum;
    use units::Utc;

    use super::*;

    struct Scene {
        writers: Writers<Monitor>,
        seqs: std::collections::HashMap<BootId, u64>,
    }

    /// What becomes of a state: `None` where it is not used, else its value and its record.
    type Used = Option<(Result<bool, String>, f64)>;

    impl Scene {
        fn new() -> Self {
            Self { writers: Writers::new(MONITOR), seqs: Default::default() }
        }

        fn observe(&mut self, boot_id: &BootId, at_s: f64, is_safe: bool) -> Used {
            let seq = self.seqs.entry(boot_id.clone()).or_default();
            *seq += 1;
            let fields = Monitor { is_safe: Datum::Known(is_safe), gapless_safe_s: 3600.0 };
            let body = DeviceState {
                link: Link::Connected,
                busy: false,
                period_s: 1.0,
                poll_s: None,
                last_command: None,
                fields,
                readings: Default::default(),
            };
            let stamped = |body| Stamped {
                boot_id: boot_id.clone(),
                seq: *seq,
                at_utc: Utc::EPOCH,
                sent_s: None,
                held_s: None,
                body,
            };
            let mut sample = stamped(body);
            let arrived = MachineTime::from_boot(Duration::from_secs_f64(at_s));
            self.writers.take(&mut sample, arrived).then(|| {
                let word = match sample.body.link {
                    Link::Lost { reason } => Err(reason.0),
                    _ => Ok(sample.body.fields.is_safe.known() == Some(&true)),
                };
                (word, sample.body.fields.gapless_safe_s)
            })
        }
    }

    #[test]
    fn two_living_writers_are_unsafe_and_neither_the_newest_nor_a_clock_wins() {
        let (one, other) = (BootId::fresh(), BootId::fresh());
        for (real, second) in [(&one, &other), (&other, &one)] {
            let mut scene = Scene::new();
            assert_eq!(scene.observe(real, 0.0, true), Some((Ok(true), 3600.0)));
            assert_eq!(scene.observe(real, 1.0, false), Some((Ok(false), 3600.0)), "it rains");
            assert_eq!(scene.observe(second, 1.4, true), None, "the second one publishes safe");
            assert_eq!(scene.observe(second, 1.9, true), None);
            let (word, _) = scene.observe(real, 2.0, false).unwrap();
            assert!(word.unwrap_err().starts_with("two writers"));
            for second_at in [2.4, 3.4, 9.4, 17.9] {
                assert!(scene.observe(second, second_at, true).unwrap().0.is_err(), "{second_at}");
            }
            // The real one is gone: what is left counts, but its record was not received here.
            assert_eq!(scene.observe(second, 18.4, true), Some((Ok(true), 0.0)));
        }
    }

    #[test]
    fn a_restarted_node_is_believed_at_once_except_against_a_warning() {
        let (before, after) = (BootId::fresh(), BootId::fresh());
        let mut scene = Scene::new();
        scene.observe(&before, 0.0, true);
        assert_eq!(scene.observe(&after, 1.5, true), Some((Ok(true), 0.0)), "the night goes on");
        let mut scene = Scene::new();
        scene.observe(&before, 0.0, false);
        assert_eq!(scene.observe(&after, 1.5, true), None);
        assert_eq!(scene.observe(&after, 2.5, true), None);
        assert_eq!(scene.observe(&after, 3.1, true), Some((Ok(true), 0.0)), "it was silent for three periods");
        let mut scene = Scene::new();
        scene.observe(&before, 0.0, true);
        assert_eq!(scene.observe(&after, 1.5, false), Some((Ok(false), 0.0)), "a warning counts at once");
    }

    #[test]
    fn a_lost_link_is_no_warning() {
        let fields = |is_safe| Monitor { is_safe, gapless_safe_s: 0.0 };
        let state = |link, is_safe| DeviceState {
            link,
            busy: false,
            period_s: 1.0,
            poll_s: None,
            last_command: None,
            fields: fields(is_safe),
            readings: Default::default(),
        };
        let refused = NoData::new("transport", "connection refused");
        let silent = Datum::missing(refused.clone());
        assert!(!(MONITOR.warns)(&state(Link::Lost { reason: refused }, silent.clone())));
        assert!(!(MONITOR.warns)(&state(Link::Connecting, Datum::default())));
        assert!(!(MONITOR.warns)(&state(Link::Connected, silent)));
        assert!((MONITOR.warns)(&state(Link::Connected, Datum::missing(NoData::new("wrong type", "")))));
        assert!((MONITOR.warns)(&state(Link::Connected, Datum::Known(false))));
    }
}
