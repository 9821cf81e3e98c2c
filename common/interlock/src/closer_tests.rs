//! Scenarios of a dome that the guard process closes.

use contract::device::dome::{CloseWithMount, Shutter};

use super::*;
use crate::explore::explore;
use crate::guard::tests::{at, boot, telescope};

fn closer(policy: CloseWithMount, mounts: KnownMounts) -> Closer {
    let settings = Settings {
        boot_id: boot("guard"),
        telescopes: vec![telescope("alpha")],
        permit_valid: Duration::from_secs(10),
        policy,
        parked_within: Duration::from_secs(120),
        travel: Duration::from_secs(90),
    };
    Closer::new(settings, mounts)
}

const NO_MOUNT: KnownMounts = KnownMounts { some: false, all: true };
const ITS_MOUNTS: KnownMounts = KnownMounts { some: true, all: true };

fn dome() -> Closer {
    closer(CloseWithMount::Alongside, NO_MOUNT)
}

fn look(second: f64) -> CloserEffect {
    CloserEffect::Look { asked: at(second) }
}

#[test]
fn a_shutter_is_looked_at_before_it_is_asked_to_close_and_a_server_that_is_away_is_asked_all_the_same() {
    for read in [Some((Shutter::Open, at(0.0))), None] {
        let mut dome = dome();
        assert_eq!(dome.step(Who::This, at(0.0)), [look(0.0)]);
        assert_eq!(dome.step(Who::This, at(0.5)), [], "the answer is not there");
        dome.take(CloserEvent::Looked(read), at(0.6));
        assert_eq!(dome.step(Who::This, at(0.6)), [CloserEffect::Send(Request::Close)]);
        assert_eq!(dome.step(Who::This, at(1.0)), [look(1.0)], "it is watched on its way");
    }
}

#[test]
fn a_shutter_that_waits_is_closed_once_its_mounts_are_parked() {
    let mut dome = closer(CloseWithMount::ParkedOnly, ITS_MOUNTS);
    dome.step(Who::This, at(0.0));
    dome.take(CloserEvent::Looked(Some((Shutter::Open, at(0.0)))), at(0.1));
    let ask = |second, park| CloserEffect::AskMounts { asked: at(second), park };
    assert_eq!(dome.step(Who::Both, at(1.0)), [look(1.0), ask(1.0, true)]);
    dome.take(CloserEvent::Looked(Some((Shutter::Open, at(1.0)))), at(1.1));
    dome.take(CloserEvent::Mounts(false, at(1.0)), at(1.1));
    assert_eq!(dome.step(Who::Both, at(2.0)), [look(2.0), ask(2.0, false)], "asked to park once in 30 s");
    dome.take(CloserEvent::Looked(Some((Shutter::Open, at(2.0)))), at(2.1));
    dome.take(CloserEvent::Mounts(true, at(2.0)), at(2.1));
    assert_eq!(dome.step(Who::Both, at(2.2)), [CloserEffect::Send(Request::Close)]);
}

#[test]
fn a_shutter_that_waits_for_a_mount_of_another_file_is_never_moved() {
    let mut dome = closer(CloseWithMount::ParkedOnly, KnownMounts { some: true, all: false });
    for second in 0..400 {
        let now = at(f64::from(second));
        let effects = dome.step(Who::This, now);
        assert!(!effects.iter().any(|effect| matches!(effect, CloserEffect::Send(_))), "{second} s: {effects:?}");
        dome.take(CloserEvent::Looked(Some((Shutter::Open, now))), now);
        dome.take(CloserEvent::Mounts(true, now), now);
    }
}

#[test]
fn what_was_begun_is_forgotten_when_the_node_guards_again() {
    let mut dome = dome();
    let before = dome.clone();
    assert_eq!(dome.step(Who::Node, at(0.0)), [], "nothing was begun");
    dome.step(Who::This, at(0.0));
    dome.take(CloserEvent::Looked(None), at(0.1));
    dome.step(Who::This, at(0.2));
    dome.take(CloserEvent::Answered(Answer::Refused), at(0.3));
    let raised = dome.step(Who::This, at(200.0));
    assert!(raised.contains(&CloserEffect::Raise(Alarm::NotClosed)), "{raised:?}");
    assert_eq!(dome.step(Who::Permit, at(201.0)), [CloserEffect::Clear(Alarm::NotClosed)]);
    dome.take(CloserEvent::Lost, at(201.0));
    assert_eq!(dome, before);
}

#[test]
fn a_dome_that_no_configuration_names_is_let_go_when_it_is_closed_or_nobody_answers_for_an_hour() {
    let mut gone = dome();
    gone.leave(at(0.0));
    assert_eq!((gone.is_let_go(at(3599.0)), gone.is_let_go(at(3600.0)).is_some()), (None, true));
    assert_eq!((gone.holds_up_the_end(at(19.0)), gone.holds_up_the_end(at(20.0))), (true, false));
    let mut open = dome();
    open.leave(at(0.0));
    open.take(CloserEvent::Looked(Some((Shutter::Open, at(0.0)))), at(1.0));
    assert_eq!(open.is_let_go(at(7200.0)), None);
    assert!(open.holds_up_the_end(at(7200.0)), "it was seen open");
    open.leave(at(7200.0));
    open.take(CloserEvent::Answered(Answer::Accepted), at(7201.0));
    open.take(CloserEvent::Looked(Some((Shutter::Closed, at(7202.0)))), at(7202.0));
    open.leave(at(7202.0));
    assert!(open.is_let_go(at(7202.0)).is_some());
}

/// A dome, its server, and the process that may have to close it.
#[derive(Clone, PartialEq, Eq, Hash)]
struct World {
    closer: Closer,
    now_s: u64,
    shutter: Shutter,
    looks: Option<MachineTime>,
    sends: bool,
}

impl World {
    fn step(&self, who: Who, way: &[&str]) -> Self {
        let mut after = Self { now_s: self.now_s + 1, ..self.clone() };
        let now = at(after.now_s as f64);
        let effects = after.closer.step(who, now);
        for effect in &effects {
            match effect {
                CloserEffect::Look { asked } => {
                    assert_eq!(after.looks.replace(*asked), None, "{way:?}: two questions under way");
                }
                CloserEffect::Send(_) => {
                    assert!(!std::mem::replace(&mut after.sends, true), "{way:?}: two requests under way");
                }
                _ => {}
            }
        }
        let guards = matches!(who, Who::This | Who::Both);
        assert!(guards || after.sends == self.sends, "{way:?}: it closes although the node guards");
        let is_closed = after.closer.is_verified_closed(now);
        assert!(!is_closed || after.shutter == Shutter::Closed, "{way:?}: believes that an open dome is closed");
        let tries = after.sends || is_closed || after.looks.is_some() || self.closer.asked_at.is_some();
        assert!(!guards || tries, "{way:?}: it neither looks nor closes");
        after
    }

    fn answers(&self, reads: bool) -> Option<Self> {
        let asked = self.looks?;
        let mut after = Self { looks: None, ..self.clone() };
        after.closer.take(CloserEvent::Looked(reads.then_some((self.shutter, asked))), at(self.now_s as f64));
        Some(after)
    }

    fn closes(&self, arrives: bool, answer: Answer) -> Option<Self> {
        let mut after = self.sends.then(|| Self { sends: false, ..self.clone() })?;
        if arrives {
            after.shutter = Shutter::Closed;
        }
        after.closer.take(CloserEvent::Answered(answer), at(self.now_s as f64));
        Some(after)
    }
}

#[test]
fn in_every_order_of_answers_it_asks_one_thing_at_a_time_and_believes_no_open_dome_to_be_closed() {
    let start = World { closer: dome(), now_s: 0, shutter: Shutter::Open, looks: None, sends: false };
    let states = explore(start, 8, |world, way| {
        let steps = [
            ("this process guards", Some(world.step(Who::This, way))),
            ("the node guards", Some(world.step(Who::Node, way))),
            ("a reading", world.answers(true)),
            ("no reading", world.answers(false)),
            ("it closes", world.closes(true, Answer::Accepted)),
            ("it closes and does not answer", world.closes(true, Answer::Unknown)),
            ("it refuses", world.closes(false, Answer::Refused)),
        ];
        steps.into_iter().filter_map(|(step, after)| Some((step, after?))).collect()
    });
    assert!(states > 100, "{states} states");
}
