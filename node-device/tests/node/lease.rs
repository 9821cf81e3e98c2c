//! The lease on a real bus: one process holds it, not each process of that name.

use std::time::{Duration, Instant};

use contract::device::dome;
use contract::observatory::Lease;
use contract::{Address, BootId, Command, Key, Kind, Part, Reason};
use test_support::{LIMIT, Lateness};
use units::Utc;

use crate::stage::{Commander, Stage, accepted, command, refused};
use crate::{a_dome, block};

fn claim(id: &str, boot_id: Option<&BootId>) -> Command<dome::Command> {
    Command { boot_id: boot_id.cloned(), ..command(id, None, dome::Command::Claim) }
}

/// Claims twice a second, as a node would, until the lease is granted.
async fn until_granted(stage: &Stage, name: &str, boot_id: &BootId) -> (u64, Duration) {
    let began = Instant::now();
    for number in 0.. {
        let asked = claim(&format!("{name}{number}"), Some(boot_id));
        let reply = stage.command(Kind::Dome, "dome", &asked).await;
        if let contract::Reply::Accepted(granted) = reply {
            return (granted.token.unwrap(), began.elapsed());
        }
        assert_eq!(refused(&reply), Reason::LeaseHeld);
        assert!(began.elapsed() < LIMIT, "the lease is never free");
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
    unreachable!("numbers do not end")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_process_of_the_same_name_gets_the_lease_when_the_first_is_silent_or_has_released_it() {
    let hardware = a_dome().await;
    let stage = Stage::start(&block("dome", "dome", &hardware, "period_s = 0.5")).await;
    // The process that publishes on this test's session is the first.
    let (first, twin) = (stage.bus.boot_id().clone(), BootId::fresh());
    let token = accepted(&stage.command(Kind::Dome, "dome", &claim("a", Some(&first))).await).unwrap();
    let commander = Commander::start(&stage, "dome", token).await;
    for (id, boot_id) in [("b", Some(&twin)), ("c", None)] {
        let reply = stage.command(Kind::Dome, "dome", &claim(id, boot_id)).await;
        assert_eq!(refused(&reply), Reason::LeaseHeld, "{boot_id:?}");
    }
    let again = accepted(&stage.command(Kind::Dome, "dome", &claim("d", Some(&first))).await).unwrap();
    assert_eq!(again, token + 1, "the holder may claim anew");

    let lateness = Lateness::begin();
    drop(commander);
    let (taken, after) = until_granted(&stage, "twin", &twin).await;
    assert_eq!(taken, again + 1);
    assert!(after > Duration::from_secs(4) && after < lateness.bound(Duration::from_secs(8)), "{after:?} of silence");

    let reply = stage.command(Kind::Dome, "dome", &claim("e", Some(&first))).await;
    assert_eq!(refused(&reply), Reason::LeaseHeld, "the twin holds it");
    // A release counts only from the incarnation that holds the lease, and the twin's is not on this session.
    let key = Key::Observatory(Address::new("site", "alpha").unwrap(), Part::Lease);
    let line = stage.bus.publisher::<Lease>(&key).await.unwrap();
    let released = Lease { holder: String::new(), token: taken, since_utc: Utc::EPOCH, arbiter: String::new() };
    line.put(released).await.unwrap();
    tokio::time::sleep(Duration::from_millis(300)).await;
    let reply = stage.command(Kind::Dome, "dome", &claim("f", Some(&first))).await;
    assert_eq!(refused(&reply), Reason::LeaseHeld, "nobody releases what is another's");

    let (mine, _) = until_granted(&stage, "first", &first).await;
    line.put(Lease { holder: String::new(), token: mine, since_utc: Utc::EPOCH, arbiter: String::new() })
        .await
        .unwrap();
    let (_, after) = until_granted(&stage, "next", &twin).await;
    assert!(after < lateness.bound(Duration::from_secs(2)), "released, and yet it took {after:?}");
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
