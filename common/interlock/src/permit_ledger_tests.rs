//! Every order of permits: of the commander, of the one before it, and of peers that invent, repeat or steal.

use super::*;
use crate::explore::explore;
use crate::guard::tests::{at, boot, permit, telescope};

const VALID_S: u64 = 10;

/// One that publishes permits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Speaker {
    /// To whom the newest lease was granted.
    Commander,
    /// To whom the lease before was granted.
    Predecessor,
    /// A peer that was granted nothing and says a token that is one too large.
    Inventor,
    /// A peer with the commander's lease and boot id, and a count of its own.
    Thief,
}

/// The ledger of one telescope's dome, and what was truly published.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct World {
    ledger: PermitLedger,
    now_s: u64,
    sent_s: Vec<u64>,
    leases: u64,
    seq: u64,
    /// Number and verdict of the newest permit of a commander: the new one's takes the place of the one before.
    published: Option<(u64, bool)>,
    /// A permit of a thief was taken under this lease, and then one of the commander.
    stolen: bool,
    published_since: bool,
}

impl World {
    fn new() -> Self {
        let own = telescope("alpha");
        let ledger = PermitLedger::new(boot("guard"), vec![own], Duration::from_secs(VALID_S), BTreeMap::new());
        Self {
            ledger,
            now_s: 0,
            sent_s: Vec::new(),
            leases: 0,
            seq: 0,
            published: None,
            stolen: false,
            published_since: false,
        }
        .granted()
        .beats()
    }

    fn now(&self) -> MachineTime {
        at(self.now_s as f64)
    }

    fn incarnation(lease: u64) -> BootId {
        boot(&format!("observatory-{lease}"))
    }

    /// Another incarnation gets the lease.
    fn granted(&self) -> Self {
        let mut after = self.clone();
        after.leases += 1;
        (after.stolen, after.published_since) = (false, false);
        after.ledger.grant("alpha", after.leases, Some(&Self::incarnation(after.leases)));
        after
    }

    fn beats(&self) -> Self {
        let mut after = self.clone();
        let number = after.ledger.beat(after.now());
        assert_eq!(number, after.sent_s.len() as u64);
        after.sent_s.push(after.now_s);
        after
    }

    fn passes(&self, seconds: u64) -> Self {
        Self { now_s: self.now_s + seconds, ..self.clone() }
    }

    /// `number` counts back from the newest.
    fn publishes(&self, speaker: Speaker, back: u64, is_safe: bool) -> Option<Self> {
        let number = (self.sent_s.len() as u64).checked_sub(1 + back)?;
        let mut after = self.clone();
        let verdict = if is_safe { Verdict::Safe } else { Verdict::Unsafe };
        let mut sample = permit(after.seq, number, verdict);
        (sample.boot_id, sample.body.token) = match speaker {
            Speaker::Commander => (Self::incarnation(self.leases), self.leases),
            Speaker::Predecessor => (Self::incarnation(self.leases.checked_sub(1)?), self.leases - 1),
            Speaker::Inventor => (boot("stranger"), self.leases + 1),
            Speaker::Thief => (Self::incarnation(self.leases), self.leases),
        };
        if speaker == Speaker::Commander {
            after.seq += 1;
            (after.published, after.published_since) = (Some((number, is_safe)), after.stolen);
        }
        if speaker == Speaker::Thief {
            after.seq += 1;
            sample.seq = 1000 + after.seq;
        }
        let is_taken = after.ledger.observe(&telescope("alpha"), &sample).is_ok();
        after.stolen |= speaker == Speaker::Thief && is_taken;
        Some(after)
    }

    /// The commander's newest permit is safe and answers a number of the last ten seconds.
    fn may_be_open(&self) -> bool {
        self.published.is_some_and(|(number, is_safe)| is_safe && self.now_s < self.sent_s[number as usize] + VALID_S)
    }

    fn prove(&self, way: &[&str]) {
        let is_safe = self.ledger.are_safe(self.now());
        if self.stolen {
            // The first word follows on the commander's. The commander's next one shows that there are two, and from
            // then on what it calls unsafe stays closed, whoever else speaks.
            let is_young = |number: u64| self.now_s < self.sent_s[number as usize] + VALID_S;
            let is_unsafe =
                self.published_since && self.published.is_some_and(|(number, is_safe)| !is_safe && is_young(number));
            assert!(!(is_safe && is_unsafe), "{way:?}: a thief opens what the commander closed");
        } else {
            assert_eq!(is_safe, self.may_be_open(), "{way:?}");
            let left = self.ledger.are_safe_for(self.now());
            let expected = self.published.filter(|_| is_safe).map(|(number, _)| self.sent_s[number as usize] + VALID_S);
            assert_eq!(left.as_secs(), expected.map_or(0, |until_s| until_s - self.now_s), "{way:?}");
        }
        assert!(!(is_safe && self.ledger.is_reported_unsafe(self.now())), "{way:?}: safe and unsafe at once");
    }

    fn after(&self, way: &[&str], steps: Vec<(&'static str, Option<Self>)>) -> Vec<(&'static str, Self)> {
        let steps = steps.into_iter().filter_map(|(step, after)| Some((step, after?))).collect::<Vec<_>>();
        for (step, after) in &steps {
            let way: Vec<&str> = way.iter().copied().chain([*step]).collect();
            after.prove(&way);
        }
        steps
    }
}

#[test]
fn in_every_order_the_commanders_newest_permit_alone_decides_and_strangers_change_nothing() {
    let states = explore(World::new(), 6, |world, way| {
        world.after(
            way,
            vec![
                ("4 s", Some(world.passes(4))),
                ("a number", Some(world.passes(1).beats())),
                ("safe", world.publishes(Speaker::Commander, 0, true)),
                ("unsafe", world.publishes(Speaker::Commander, 0, false)),
                ("the lease goes to another", Some(world.granted())),
                ("the one before says safe", world.publishes(Speaker::Predecessor, 0, true)),
                ("the one before says unsafe", world.publishes(Speaker::Predecessor, 0, false)),
                ("a stranger says safe", world.publishes(Speaker::Inventor, 0, true)),
                ("a stranger says unsafe", world.publishes(Speaker::Inventor, 0, false)),
            ],
        )
    });
    assert!(states > 3000, "{states} states");
}

#[test]
fn in_every_order_a_thief_with_the_commanders_lease_never_opens_what_the_commander_closed() {
    let states = explore(World::new(), 6, |world, way| {
        world.after(
            way,
            vec![
                ("4 s", Some(world.passes(4))),
                ("a number", Some(world.passes(1).beats())),
                // It answers each number once.
                ("safe", world.passes(1).beats().publishes(Speaker::Commander, 0, true)),
                ("unsafe", world.passes(1).beats().publishes(Speaker::Commander, 0, false)),
                ("the thief says safe", world.publishes(Speaker::Thief, 0, true)),
                ("the thief says unsafe", world.publishes(Speaker::Thief, 0, false)),
                ("the thief repeats an old number", world.publishes(Speaker::Thief, 1, true)),
            ],
        )
    });
    assert!(states > 1500, "{states} states");
}

#[test]
fn a_dome_over_two_telescopes_needs_both_and_one_without_telescopes_is_never_safe() {
    let (alpha, beta) = (telescope("alpha"), telescope("beta"));
    let telescopes = vec![alpha.clone(), beta.clone()];
    let tokens = telescopes.iter().map(|name| (name.clone(), 1)).collect();
    let mut ledger = PermitLedger::new(boot("guard"), telescopes, Duration::from_secs(VALID_S), tokens);
    let number = ledger.beat(at(0.0));
    assert!(ledger.observe(&alpha, &permit(0, number, Verdict::Safe)).is_ok());
    assert!(!ledger.are_safe(at(1.0)), "nothing is known of the other");
    assert!(ledger.observe(&beta, &permit(0, number, Verdict::Safe)).is_ok());
    assert!(ledger.are_safe(at(1.0)));
    let later = ledger.beat(at(6.0));
    assert!(ledger.observe(&alpha, &permit(1, later, Verdict::Safe)).is_ok());
    assert_eq!(ledger.are_safe_for(at(7.0)), Duration::from_secs(3), "until the older of the two ends");
    assert!(!ledger.are_safe(at(10.0)), "only one was renewed");
    assert_eq!(ledger.observe(&telescope("gamma"), &permit(0, later, Verdict::Safe)), Err(Dropped::Stranger));
    assert_eq!(ledger.dropped(), 1);
    let mut none = PermitLedger::new(boot("guard"), Vec::new(), Duration::from_secs(VALID_S), BTreeMap::new());
    none.beat(at(0.0));
    assert!(!none.are_safe(at(0.0)));
}

#[test]
fn a_number_that_is_forgotten_or_of_another_guard_counts_as_never_sent() {
    let alpha = telescope("alpha");
    let tokens = BTreeMap::from([(alpha.clone(), 1)]);
    let mut ledger = PermitLedger::new(boot("guard"), vec![alpha.clone()], Duration::from_secs(VALID_S), tokens);
    for second in 0..=NUMBERS {
        ledger.beat(at(second as f64));
    }
    assert_eq!(ledger.observe(&alpha, &permit(0, 0, Verdict::Safe)), Err(Dropped::UnknownNumber));
    assert_eq!(ledger.observe(&alpha, &permit(0, 1000, Verdict::Safe)), Err(Dropped::UnknownNumber));
    let mut other = permit(0, NUMBERS as u64, Verdict::Safe);
    other.body.guard_boot_id = boot("the guard before");
    assert_eq!(ledger.observe(&alpha, &other), Err(Dropped::OtherBoot));
    assert_eq!(ledger.observe(&alpha, &permit(0, NUMBERS as u64, Verdict::Safe)), Ok(Taken::Next));
    assert_eq!(ledger.observe(&alpha, &permit(0, NUMBERS as u64, Verdict::Safe)), Err(Dropped::Replayed));
    assert_eq!(ledger.dropped(), 4);
}
