//! Scenarios of leases, and every order of the first messages.

use std::time::Duration;

use contract::device::dome::{GrantedToken, GuardAction};
use contract::{Address, BootId, Kind};
use units::Utc;

use super::*;
use crate::explore::explore;
use crate::guard::tests::boot;

const ALPHA: &str = "alpha";

fn at(seconds: u64) -> MachineTime {
    MachineTime::from_boot(Duration::from_secs(1000 + seconds))
}

fn stamped<T>(boot_id: &BootId, seq: u64, body: T) -> Stamped<T> {
    Stamped { boot_id: boot_id.clone(), seq, at_utc: Utc::EPOCH, sent_s: None, held_s: None, body }
}

fn lease(boot_id: &BootId, holder: &str, token: u64) -> Stamped<Lease> {
    let (holder, arbiter) = (holder.to_owned(), "dome/d".to_owned());
    stamped(boot_id, 0, Lease { holder, token, since_utc: Utc::EPOCH, arbiter })
}

fn roof() -> Device {
    Address::new("site", ALPHA).unwrap().device(Kind::Dome, &"roof".parse().unwrap())
}

fn guard(number: u64, token: u64) -> Guard {
    Guard {
        number,
        token,
        permit_valid_s: 10.0,
        permits: Vec::new(),
        may_be_open: false,
        action: GuardAction::Watching,
        hold: false,
        dropped: 0,
        verified_closed: None,
        waits_for_mounts: None,
        watchdog_s: None,
        granted: vec![GrantedToken { telescope: ALPHA.to_owned(), token }],
    }
}

fn arbiter(token: u64) -> Leases {
    let (mut tokens, _) = KnownTokens::of([(ALPHA.to_owned(), token)].into());
    tokens.arbitrate(ALPHA);
    Leases::new(tokens)
}

fn followed(token: u64) -> Followed {
    Followed { telescope: ALPHA.to_owned(), token }
}

#[test]
fn a_node_follows_the_guard_up_and_down_and_the_commander_only_where_no_guard_speaks() {
    let (boot_id, mut node) = (BootId::fresh(), Leases::default());
    let held = |token| lease(&boot_id, "observatory/alpha/main", token);
    assert_eq!(node.receive_lease(ALPHA, &held(3), at(0)), Some(followed(3)), "no guard publishes");
    assert_eq!(node.receive_lease(ALPHA, &held(3), at(1)), None, "known");
    assert_eq!(node.receive_guard(&roof(), &stamped(&boot_id, 0, guard(1, 5)), at(2)), [followed(5)]);
    assert_eq!(node.receive_lease(ALPHA, &held(6), at(3)), None, "the guard counts");
    assert_eq!(node.receive_guard(&roof(), &stamped(&boot_id, 1, guard(2, 4)), at(4)), [followed(4)]);
    assert_eq!(node.receive_lease(ALPHA, &held(5), at(30)), Some(followed(5)), "the guard has been silent");
    assert_eq!(node.tokens().highest(ALPHA), 5);
}

#[test]
fn an_arbiter_counts_alone() {
    let (boot_id, mut node) = (BootId::fresh(), arbiter(3));
    assert_eq!(node.receive_lease(ALPHA, &lease(&boot_id, "observatory/alpha/main", 9), at(0)), None);
    assert_eq!(node.receive_guard(&roof(), &stamped(&boot_id, 0, guard(1, 9)), at(0)), []);
    assert_eq!(node.follow(ALPHA, 9), None);
    assert_eq!(node.tokens().highest(ALPHA), 3);
}

#[test]
fn a_lease_that_was_granted_meanwhile_is_not_taken_back_by_an_older_grant() {
    let (one, other, mut node) = (BootId::fresh(), BootId::fresh(), arbiter(0));
    let who = |boot_id| Claimant { name: "observatory/alpha/main", boot_id: Some(boot_id) };
    node.granted(ALPHA, 2, who(&other), at(1));
    node.granted(ALPHA, 1, who(&one), at(1));
    assert_eq!(node.tokens().highest(ALPHA), 2);
    assert!(node.claim(ALPHA, who(&other), at(2)).is_ok() && node.claim(ALPHA, who(&one), at(2)).is_err());
}

/// Two processes of one name, an arbiter, and the file of its tokens.
#[derive(Clone, PartialEq, Eq, Hash)]
struct World {
    leases: Leases,
    now_s: u64,
    on_disk: u64,
    /// The newest token of each process.
    tokens: [Option<u64>; 2],
    /// When the newest holder was granted the lease or published last, unless it gave it back.
    received: Option<(usize, u64)>,
}

const NAMES: [&str; 2] = ["one", "other"];

impl World {
    fn claims(&self, process: usize, way: &[&str]) -> Self {
        let (mut after, boot_id) = (self.clone(), boot(NAMES[process]));
        let who = Claimant { name: "observatory/alpha/main", boot_id: Some(&boot_id) };
        if after.leases.claim(ALPHA, who, at(self.now_s)).is_ok() {
            if let Some((holder, received_s)) = self.received {
                let is_silent = self.now_s - received_s >= 5;
                assert!(holder == process || is_silent, "{way:?}: a lease was taken from one that lives");
            }
            let token = after.leases.tokens().next(ALPHA, None).token;
            assert!(token > self.on_disk, "{way:?}: token {token} was granted twice");
            after.on_disk = token;
            after.leases.granted(ALPHA, token, who, at(self.now_s));
            (after.tokens[process], after.received) = (Some(token), Some((process, self.now_s)));
        }
        after
    }

    /// Publishes its lease, or gives it back.
    fn publishes(&self, process: usize, holder: &str) -> Self {
        let (mut after, boot_id) = (self.clone(), boot(NAMES[process]));
        let Some(token) = self.tokens[process] else { return after };
        after.leases.receive_lease(ALPHA, &lease(&boot_id, holder, token), at(self.now_s));
        if token == self.on_disk && self.received.is_some_and(|(received, _)| received == process) {
            after.received = (!holder.is_empty()).then_some((process, self.now_s));
        }
        after
    }

    /// The arbiter comes back with what is on disk.
    fn restarts(&self) -> Self {
        Self { leases: arbiter(self.on_disk), received: None, ..self.clone() }
    }

    fn waits(&self, seconds: u64) -> Self {
        Self { now_s: self.now_s + seconds, ..self.clone() }
    }
}

#[test]
fn in_every_order_of_messages_a_token_has_one_holder_and_no_living_one_is_robbed() {
    let start = World { leases: arbiter(0), now_s: 0, on_disk: 0, tokens: [None; 2], received: None };
    let states = explore(start, 7, |world, way| {
        let name = "observatory/alpha/main";
        let steps = vec![
            ("one claims", world.claims(0, way)),
            ("the other claims", world.claims(1, way)),
            ("one publishes", world.publishes(0, name)),
            ("the other publishes", world.publishes(1, name)),
            ("one gives it back", world.publishes(0, "")),
            ("the other gives it back", world.publishes(1, "")),
            ("2 s", world.waits(2)),
            ("5 s", world.waits(5)),
            ("the arbiter is started anew", world.restarts()),
        ];
        for (step, after) in &steps {
            let [one, other] = after.tokens;
            assert!(one.is_none() || one != other, "{way:?} {step}: two hold token {one:?}");
            assert_eq!(after.leases.tokens().highest(ALPHA), after.on_disk, "{way:?} {step}");
        }
        steps
    });
    assert!(states > 1000, "{states} states");
}

/// What of the data folders of both hosts is lost, one at a time and all together: the tokens of the dome's node (its
/// holders' file changes nothing here), the note of the claim and the orders with their token of the observatory node.
/// The lease is granted once, no device takes its token for an old one, and the token before it is the last
/// commander's where anybody remembers it.
#[test]
fn whatever_file_is_lost_the_lease_is_granted_in_one_step() {
    let (commander, mount_boot) = (BootId::fresh(), BootId::fresh());
    let who = Claimant { name: "observatory/alpha/main", boot_id: Some(&commander) };
    for lost in 0..8_u32 {
        let [tokens_lost, memory_lost, bus_silent] = [0, 1, 2].map(|bit| lost >> bit & 1 == 1);
        let mut dome = arbiter(if tokens_lost { 0 } else { 2000 });
        let mut mount = Leases::new(KnownTokens::of([(ALPHA.to_owned(), 2000)].into()).0);
        if !bus_silent {
            // The commander publishes the lease that it has.
            dome.receive_lease(ALPHA, &lease(&commander, who.name, 2000), at(0));
        }
        dome.claim(ALPHA, who, at(6)).unwrap();
        let next = dome.tokens().next(ALPHA, (!memory_lost).then_some(2000));
        dome.granted(ALPHA, next.token, who, at(6));
        let nobody_knows = tokens_lost && memory_lost && bus_silent;
        assert_eq!(next.token, if nobody_knows { 1 } else { 2001 }, "{lost:03b}");
        assert_eq!(next.left_behind, (tokens_lost && !nobody_knows).then_some(0), "{lost:03b}");
        // A device takes the next token before its guard has published it, and follows the guard also down.
        let refused = crate::fence::fence(Some(next.token), mount.tokens().highest(ALPHA), false).is_err();
        assert_eq!(refused, nobody_knows, "{lost:03b}");
        mount.receive_guard(&roof(), &stamped(&mount_boot, 1, guard(1, next.token)), at(7));
        assert!(crate::fence::fence(Some(next.token), mount.tokens().highest(ALPHA), false).is_ok(), "{lost:03b}");
    }
}
