//! The lease on a real bus: one process holds it, not each process of that name.

use std::time::Duration;

use contract::device::dome;
use contract::observatory::Lease;
use contract::{Address, BootId, Command, Key, Kind, Part, Reason};
use test_support::{LIMIT, join};
use tokio::time::Instant;
use units::Utc;

use crate::closing::until_permitted;
use crate::stage::{Commander, Stage, accepted, command, refused};
use crate::{a_dome, block};

pub fn claim(id: &str, boot_id: Option<&BootId>) -> Command<dome::Command> {
    Command { boot_id: boot_id.cloned(), ..command(id, None, dome::Command::Claim) }
}

/// Claims several times a second until the lease is granted, and returns its token.
pub async fn until_granted(stage: &Stage, claim: impl Fn(u32) -> Command<dome::Command>) -> u64 {
    let began = Instant::now();
    for number in 0.. {
        let reply = stage.command(Kind::Dome, "dome", &claim(number)).await;
        if let contract::Reply::Accepted(granted) = reply {
            return granted.token.unwrap();
        }
        assert_eq!(refused(&reply), Reason::LeaseHeld);
        assert!(began.elapsed() < LIMIT, "the lease is never free");
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    unreachable!("numbers do not end")
}

/// One that gives a lease up.
pub fn released(token: u64) -> Lease {
    Lease { holder: String::new(), token, since_utc: Utc::EPOCH, arbiter: String::new() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_process_of_the_same_name_gets_the_lease_when_the_first_is_silent_or_has_released_it() {
    let hardware = a_dome().await;
    let stage = Stage::start(&block("dome", "dome", &hardware, "period_s = 0.5")).await;
    // The process that publishes on this test's session is the first, that on another one its twin.
    let other = join(&stage.bus).await;
    let (first, twin) = (stage.bus.boot_id().clone(), other.boot_id().clone());
    let token = accepted(&stage.command(Kind::Dome, "dome", &claim("a", Some(&first))).await).unwrap();
    // Who commands is never silent, however slow this machine is.
    let commander = Commander::start(&stage, "dome", token).await;
    until_permitted(&stage, token).await;
    for (id, boot_id) in [("b", Some(&twin)), ("c", None)] {
        let reply = stage.command(Kind::Dome, "dome", &claim(id, boot_id)).await;
        assert_eq!(refused(&reply), Reason::LeaseHeld, "{boot_id:?}");
    }
    let again = accepted(&stage.command(Kind::Dome, "dome", &claim("d", Some(&first))).await).unwrap();
    assert_eq!(again, token + 1, "the holder may claim anew");

    drop(commander);
    let taken = until_granted(&stage, |number| claim(&format!("twin{number}"), Some(&twin))).await;
    assert_eq!(taken, again + 1);
    let commander = Commander::start_on(&other, &stage, "dome", taken).await;
    until_permitted(&stage, taken).await;
    let reply = stage.command(Kind::Dome, "dome", &claim("e", Some(&first))).await;
    assert_eq!(refused(&reply), Reason::LeaseHeld, "the twin holds it");
    // A release counts only from the incarnation that holds the lease.
    let key = Key::Observatory(Address::new("site", "alpha").unwrap(), Part::Lease);
    let line = stage.bus.publisher::<Lease>(&key).await.unwrap();
    line.put(released(taken)).await.unwrap();
    tokio::time::sleep(Duration::from_millis(300)).await;
    let reply = stage.command(Kind::Dome, "dome", &claim("f", Some(&first))).await;
    assert_eq!(refused(&reply), Reason::LeaseHeld, "nobody releases what is another's");

    // The twin goes on publishing, and yet what it has released is free.
    other.publisher::<Lease>(&key).await.unwrap().put(released(taken)).await.unwrap();
    let mine = until_granted(&stage, |number| claim(&format!("first{number}"), Some(&first))).await;
    assert_eq!(mine, taken + 1);
    drop(commander);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dome_on_a_new_host_goes_on_from_the_lease_that_the_commander_remembers_in_one_step_and_raises_an_alert() {
    let hardware = a_dome().await;
    let stage = Stage::start(&block("dome", "dome", &hardware, "period_s = 0.5")).await;
    let claimant = stage.bus.boot_id().clone();
    let remembers = Command { token: Some(2000), ..claim("a", Some(&claimant)) };
    assert_eq!(accepted(&stage.command(Kind::Dome, "dome", &remembers).await), Some(2001));
    let mut alerts = stage.node().alerts.watch();
    let is_raised = |alerts: &contract::observatory::Alerts, word: &str| {
        alerts.alerts.iter().any(|alert| alert.id.starts_with(word) && alert.returned_utc.is_none())
    };
    let raised = alerts.wait_for(|alerts| is_raised(alerts, "lease-count-lost/alpha")).await.unwrap().clone();
    let cause = &raised.alerts.iter().find(|alert| alert.id.starts_with("lease-count-lost")).unwrap().cause;
    assert!(cause.contains("2000") && cause.contains("2001"), "{cause}");
    // The next one is one more, and there is nothing to say of it.
    let again = Command { token: Some(2001), ..claim("b", Some(&claimant)) };
    assert_eq!(accepted(&stage.command(Kind::Dome, "dome", &again).await), Some(2002));
    let cleared = alerts.wait_for(|alerts| !is_raised(alerts, "lease-count-lost/alpha"));
    tokio::time::timeout(LIMIT, cleared).await.unwrap().unwrap();
    stage.end().await;
}
