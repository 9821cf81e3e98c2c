//! Scenarios of a process that wants to command, and every order of the first steps of two.

use std::collections::BTreeMap;

use contract::Stamped;
use contract::observatory::Lease;
use units::Utc;

use super::*;
use crate::explore::explore;
use crate::guard::tests::boot;
use crate::holder::Claimant;
use crate::known_tokens::KnownTokens;
use crate::leases::Leases;

const MAIN: &str = "observatory/alpha/main";

fn at(seconds: u64) -> MachineTime {
    MachineTime::from_boot(Duration::from_secs(1000 + seconds))
}

fn claim(id: &str) -> CommandId {
    CommandId(id.to_owned())
}

fn holder(note: ClaimNote) -> LeaseHolder {
    LeaseHolder::new((MAIN.to_owned(), boot("own")), true, note, claim("a"), at(0))
}

/// A holder, and what it is asked to do after each event.
struct Scene {
    holder: LeaseHolder,
    /// The name and the incarnation in the lease that was published lately.
    published: Option<(&'static str, &'static str)>,
}

impl Scene {
    fn new() -> Self {
        Self { holder: holder(ClaimNote::default()), published: None }
    }

    fn step(&mut self, event: LeaseEvent, fresh: &str, second: u64) -> LeaseStep {
        let boot_id = self.published.map(|(_, boot_id)| boot(boot_id));
        let lease = self.published.zip(boot_id.as_ref());
        let lease = lease.map(|((holder, _), boot_id)| PublishedLease { holder, boot_id });
        self.holder.next(event, lease, claim(fresh), at(second))
    }

    fn task(&mut self, event: LeaseEvent, fresh: &str, second: u64) -> LeaseTask {
        self.step(event, fresh, second).task
    }

    /// Until it holds the lease with this token.
    fn hold(&mut self, token: u64, second: u64) {
        self.task(LeaseEvent::Answered(ClaimAnswer::Granted(token)), "-", second);
        self.task(LeaseEvent::TookOver, "-", second);
        assert_eq!(self.task(LeaseEvent::NoteRemoved(true), "-", second), LeaseTask::Publish(token));
        assert_eq!(self.holder.state(), LeaseState::Holding { token });
    }
}

fn note(id: &str) -> Noted {
    Noted { claim: Some(claim(id)), unused: BTreeSet::new() }
}

fn take_over(granted: u64, held: Option<u64>, unused: &[u64]) -> LeaseTask {
    LeaseTask::TakeOver { granted: Some(granted), held, unused: unused.iter().copied().collect() }
}

#[test]
fn it_commands_once_its_claim_was_noted_and_granted_the_orders_are_adopted_and_the_note_is_gone() {
    let mut scene = Scene::new();
    assert_eq!(scene.task(LeaseEvent::Due, "-", 0), LeaseTask::Note(note("a")));
    assert_eq!(scene.task(LeaseEvent::Noted(Some(note("a"))), "-", 0), LeaseTask::Claim(claim("a")));
    let granted = LeaseEvent::Answered(ClaimAnswer::Granted(7));
    assert_eq!(scene.task(granted, "-", 0), take_over(7, None, &[]));
    assert_eq!(scene.task(LeaseEvent::TookOver, "-", 0), LeaseTask::RemoveNote);
    assert_eq!(scene.holder.state(), LeaseState::Asking, "it does nothing yet");
    let step = scene.step(LeaseEvent::NoteRemoved(true), "-", 0);
    assert_eq!(step, LeaseStep { alert: Some(LeaseAlert::NoLease(false)), task: LeaseTask::Publish(7) });
    assert_eq!(scene.holder.state(), LeaseState::Holding { token: 7 });
}

#[test]
fn a_note_that_stays_on_disk_costs_one_more_claim() {
    let mut scene = Scene::new();
    scene.task(LeaseEvent::Noted(Some(note("a"))), "-", 0);
    scene.task(LeaseEvent::Answered(ClaimAnswer::Granted(7)), "-", 0);
    scene.task(LeaseEvent::TookOver, "-", 0);
    assert_eq!(scene.task(LeaseEvent::NoteRemoved(false), "b", 0), LeaseTask::Claim(claim("b")), "and it is not noted");
    let granted = LeaseEvent::Answered(ClaimAnswer::Granted(8));
    assert_eq!(scene.task(granted, "-", 0), take_over(8, Some(7), &[]));
    scene.task(LeaseEvent::TookOver, "-", 0);
    assert_eq!(scene.task(LeaseEvent::NoteRemoved(false), "-", 0), LeaseTask::Publish(8));
}

#[test]
fn the_claim_of_the_incarnation_before_is_asked_first_and_its_token_commands_nothing() {
    let mut scene = Scene { holder: holder(ClaimNote::new(note("left"))), published: None };
    assert_eq!(scene.task(LeaseEvent::Due, "-", 0), LeaseTask::Claim(claim("left")), "it is noted");
    let next = Noted { claim: Some(claim("b")), unused: [7].into() };
    assert_eq!(scene.task(LeaseEvent::Answered(ClaimAnswer::Granted(7)), "b", 0), LeaseTask::Note(next.clone()));
    assert_eq!(scene.task(LeaseEvent::Noted(Some(next)), "-", 0), LeaseTask::Claim(claim("b")));
    assert_eq!(scene.task(LeaseEvent::Answered(ClaimAnswer::Granted(8)), "-", 0), take_over(8, None, &[7]));
    // One that is refused was never granted.
    let mut scene = Scene { holder: holder(ClaimNote::new(note("left"))), published: None };
    scene.task(LeaseEvent::Answered(ClaimAnswer::Refused), "b", 0);
    scene.task(LeaseEvent::Due, "-", 1);
    assert_eq!(scene.task(LeaseEvent::Answered(ClaimAnswer::Granted(8)), "-", 1), take_over(8, None, &[]));
}

#[test]
fn a_standby_asks_each_second_anew_and_notes_nothing_while_the_other_runs() {
    let mut scene = Scene { published: Some(("observatory/alpha/other", "other")), ..Scene::new() };
    assert_eq!(scene.task(LeaseEvent::Due, "-", 0), LeaseTask::Claim(claim("a")));
    let step = scene.step(LeaseEvent::Answered(ClaimAnswer::Held), "b", 0);
    assert_eq!(step, LeaseStep { alert: Some(LeaseAlert::NoLease(false)), task: LeaseTask::Wait });
    assert_eq!(scene.holder.state(), LeaseState::Standby);
    assert_eq!(scene.task(LeaseEvent::Due, "-", 1), LeaseTask::Claim(claim("b")));
    scene.task(LeaseEvent::Answered(ClaimAnswer::Held), "c", 1);
    scene.published = None;
    assert_eq!(scene.task(LeaseEvent::Due, "-", 7), LeaseTask::Note(note("c")), "the other is silent");
    assert_eq!(scene.holder.state(), LeaseState::Standby, "until it is granted the lease");
}

#[test]
fn without_an_arbiter_that_answers_it_claims_after_ten_seconds_unless_another_publishes() {
    let silent = LeaseEvent::Answered(ClaimAnswer::Silent);
    // What is published, how long the arbiter was silent, and the state then.
    for (published, second, expected) in [
        (None, 9, LeaseState::Asking),
        (None, 10, LeaseState::Claiming),
        (Some((MAIN, "own")), 10, LeaseState::Claiming),
        (Some(("observatory/alpha/other", "other")), 29, LeaseState::Asking),
        (Some((MAIN, "another incarnation")), 29, LeaseState::Asking),
    ] {
        let mut scene = Scene { published, ..Scene::new() };
        let step = scene.step(silent.clone(), "b", second);
        assert_eq!((step.alert, scene.holder.state()), (None, expected), "{published:?} after {second} s");
        assert_eq!(scene.task(LeaseEvent::Noted(None), "-", second), LeaseTask::Claim(claim("a")), "asked again");
    }
    let mut scene = Scene::new();
    let step = scene.step(silent.clone(), "b", 31);
    assert_eq!(step.alert, Some(LeaseAlert::NoLease(true)));
    scene.published = Some(("observatory/alpha/other", "other"));
    scene.step(silent, "b", 32);
    assert_eq!(scene.holder.state(), LeaseState::Claiming, "it goes on until the arbiter answers");
    scene.step(LeaseEvent::Answered(ClaimAnswer::Held), "b", 33);
    assert_eq!(scene.holder.state(), LeaseState::Standby);
}

#[test]
fn an_arbiter_that_refuses_is_an_alert_as_soon_as_this_node_publishes_and_a_silent_one_after_half_a_minute() {
    for (answer, second, is_raised) in [
        (ClaimAnswer::Refused, 9, false),
        (ClaimAnswer::Refused, 10, true),
        (ClaimAnswer::Silent, 30, false),
        (ClaimAnswer::Silent, 31, true),
    ] {
        let step = Scene::new().step(LeaseEvent::Answered(answer), "b", second);
        assert_eq!(step.alert.is_some(), is_raised, "{answer:?} after {second} s: {step:?}");
    }
}

#[test]
fn a_lease_is_lost_at_once_to_a_newer_one_and_after_five_seconds_to_an_arbiter_that_forgot_it() {
    use LeaseKnown::{Disputed, Lost, Ours, Unknown};
    // What the guards publish in each second, and in which of them it asks again.
    let scenarios = [
        ("it is ours", vec![Some(Ours), None, Some(Ours)], None),
        ("somebody else was granted it", vec![Some(Ours), Some(Lost)], Some(1)),
        ("forgotten", vec![Some(Unknown); 7], Some(5)),
        ("right after a grant", vec![Some(Unknown), Some(Unknown), Some(Ours), Some(Unknown)], None),
        ("a stranger in the guard's name", vec![Some(Disputed); 8], None),
    ];
    for (name, each_second, lost) in scenarios {
        let mut scene = Scene::new();
        scene.hold(7, 100);
        let published = each_second.into_iter().enumerate();
        let mut asks = published.filter_map(|(second, known)| {
            let task = scene.task(LeaseEvent::Published(known), "b", 101 + second as u64);
            (task != LeaseTask::Publish(7)).then_some((second, task))
        });
        assert_eq!(asks.next(), lost.map(|second| (second, LeaseTask::Note(note("b")))), "{name}");
    }
    let mut scene = Scene::new();
    scene.hold(7, 100);
    // A device that knew a newer token follows the arbiter first.
    assert_eq!(scene.task(LeaseEvent::Doubted, "-", 102), LeaseTask::Publish(7));
    assert_eq!(scene.task(LeaseEvent::Doubted, "b", 103), LeaseTask::Note(note("b")));
    assert_eq!((scene.holder.state(), scene.holder.held()), (LeaseState::Asking, Some(7)));
    assert_eq!(scene.task(LeaseEvent::Answered(ClaimAnswer::Granted(9)), "-", 103), take_over(9, Some(7), &[]));
}

#[test]
fn a_dispute_is_an_alert_until_it_is_over() {
    let mut scene = Scene::new();
    scene.hold(7, 0);
    let mut alert = |known, second| scene.step(LeaseEvent::Published(Some(known)), "-", second).alert;
    let alerts = [
        alert(LeaseKnown::Ours, 1),
        alert(LeaseKnown::Disputed, 2),
        alert(LeaseKnown::Disputed, 3),
        alert(LeaseKnown::Ours, 4),
        alert(LeaseKnown::Disputed, 5),
        alert(LeaseKnown::Lost, 6),
    ];
    let (raised, cleared) = (LeaseAlert::Disputed(true), LeaseAlert::Disputed(false));
    assert_eq!(alerts, [None, Some(raised), None, Some(cleared), Some(raised), Some(cleared)]);
}

/// One process, and the file of its note.
#[derive(Clone, PartialEq, Eq, Hash)]
struct Process {
    name: &'static str,
    holder: LeaseHolder,
    task: LeaseTask,
    on_disk: Noted,
}

/// Two processes and an arbiter, which repeats its answer to a claim.
#[derive(Clone, PartialEq, Eq, Hash)]
struct World {
    leases: Leases,
    answered: BTreeMap<String, u64>,
    processes: [Process; 2],
    published: Option<(BootId, String, MachineTime)>,
    now_s: u64,
    restarts: u32,
    /// A file that was removed stays on disk all the same.
    disk_lies: bool,
    /// Tokens with which somebody commanded.
    commanded: BTreeSet<u64>,
}

impl World {
    fn new(disk_lies: bool) -> Self {
        let (mut tokens, _) = KnownTokens::of(BTreeMap::new());
        tokens.arbitrate("alpha");
        let process = |name: &'static str, boot_id| {
            let own = (name.to_owned(), boot(boot_id));
            let holder = LeaseHolder::new(own, true, ClaimNote::default(), claim(boot_id), at(0));
            Process { name, holder, task: LeaseTask::Wait, on_disk: Noted::default() }
        };
        Self {
            leases: Leases::new(tokens),
            answered: BTreeMap::new(),
            processes: [process("observatory/alpha/one", "one"), process("observatory/alpha/other", "other")],
            published: None,
            now_s: 0,
            restarts: 0,
            disk_lies,
            commanded: BTreeSet::new(),
        }
    }

    /// The first id that nobody has, so that ways that differ in nothing else lead to one state.
    fn fresh(&self) -> CommandId {
        let is_free = |id: &CommandId| {
            let has = |own: &Process| own.holder.claim == *id || own.on_disk.claim.as_ref() == Some(id);
            !self.answered.contains_key(&id.0) && !self.processes.iter().any(has)
        };
        (0..).map(|number: u32| claim(&number.to_string())).find(is_free).unwrap()
    }

    /// A process does what is next, and if `is_lost` the answer to its claim does not arrive.
    fn acts(&self, process: usize, is_lost: bool, way: &[&str]) -> Self {
        let mut after = self.clone();
        let Process { name, holder, task, .. } = self.processes[process].clone();
        let now = at(self.now_s);
        let event = match task {
            LeaseTask::Note(noted) => {
                after.processes[process].on_disk = noted.clone();
                LeaseEvent::Noted(Some(noted))
            }
            LeaseTask::Claim(id) => {
                let answer = after.claims(name, &holder.boot_id, &id, now);
                LeaseEvent::Answered(if is_lost { ClaimAnswer::Silent } else { answer })
            }
            LeaseTask::TakeOver { granted, unused, .. } => {
                let wrong = unused.intersection(&self.commanded).next();
                assert_eq!(wrong, None, "{way:?}: taken as unused, and somebody commanded with it");
                assert!(granted.is_some_and(|token| !unused.contains(&token)), "{way:?}");
                LeaseEvent::TookOver
            }
            LeaseTask::RemoveNote => {
                if !self.disk_lies {
                    after.processes[process].on_disk = Noted::default();
                }
                LeaseEvent::NoteRemoved(true)
            }
            LeaseTask::Publish(token) => {
                after.publishes(name, &holder.boot_id, token, now);
                let newest = after.leases.tokens().highest("alpha");
                LeaseEvent::Published(Some(if newest == token { LeaseKnown::Ours } else { LeaseKnown::Lost }))
            }
            LeaseTask::Wait => LeaseEvent::Due,
        };
        let fresh = after.fresh();
        let published = self.published.clone().filter(|(_, _, at)| now.since(*at) <= Duration::from_secs(5));
        let published = published.as_ref().map(|(boot_id, holder, _)| PublishedLease { holder, boot_id });
        after.processes[process].task = after.processes[process].holder.next(event, published, fresh, now).task;
        after.check(way);
        after
    }

    fn claims(&mut self, name: &str, boot_id: &BootId, id: &CommandId, now: MachineTime) -> ClaimAnswer {
        if let Some(token) = self.answered.get(&id.0) {
            return ClaimAnswer::Granted(*token);
        }
        let who = Claimant { name, boot_id: Some(boot_id) };
        if self.leases.claim("alpha", who, now).is_err() {
            return ClaimAnswer::Held;
        }
        let token = self.leases.tokens().next("alpha", None).token;
        self.leases.granted("alpha", token, who, now);
        self.answered.insert(id.0.clone(), token);
        ClaimAnswer::Granted(token)
    }

    fn publishes(&mut self, name: &str, boot_id: &BootId, token: u64, now: MachineTime) {
        let body = Lease { holder: name.to_owned(), token, since_utc: Utc::EPOCH, arbiter: String::new() };
        let (boot_id, at_utc) = (boot_id.clone(), Utc::EPOCH);
        let sample = Stamped { boot_id: boot_id.clone(), seq: 0, at_utc, sent_s: None, held_s: None, body };
        self.leases.receive_lease("alpha", &sample, now);
        self.published = Some((boot_id, name.to_owned(), now));
    }

    fn check(&mut self, way: &[&str]) {
        let held = self.processes.iter().filter_map(|process| match process.holder.state() {
            LeaseState::Holding { token } => Some(token),
            _ => None,
        });
        let held: Vec<u64> = held.collect();
        assert!(held.len() < 2 || held[0] != held[1], "{way:?}: two command with token {}", held[0]);
        self.commanded.extend(held);
    }

    /// A process is killed, and its next incarnation finds the note.
    fn restarts(&self, process: usize) -> Self {
        let mut after = Self { restarts: self.restarts + 1, ..self.clone() };
        let fresh = self.fresh();
        let own = &mut after.processes[process];
        let boot_id = boot(&format!("boot-{}", self.restarts));
        let note = ClaimNote::new(own.on_disk.clone());
        own.holder = LeaseHolder::new((own.name.to_owned(), boot_id), true, note, fresh, at(self.now_s));
        own.task = LeaseTask::Wait;
        after
    }
}

/// Far enough for a process that commanded, was killed and commands again.
fn every_order(start: World) -> usize {
    explore(start, 12, |world, way| {
        vec![
            ("one acts", world.acts(0, false, way)),
            ("one acts, and its answer is lost", world.acts(0, true, way)),
            ("the other acts", world.acts(1, false, way)),
            ("one is started anew", world.restarts(0)),
            ("6 s", World { now_s: world.now_s + 6, ..world.clone() }),
        ]
    })
}

#[test]
fn in_every_order_of_steps_and_ends_no_two_hold_one_token_and_no_commander_counts_as_none() {
    let states = every_order(World::new(false));
    assert!(states > 1000, "{states} states");
}

#[test]
#[should_panic(expected = "taken as unused, and somebody commanded with it")]
fn a_note_that_outlives_the_claim_would_be_found_out() {
    every_order(World::new(true));
}
