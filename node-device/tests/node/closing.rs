//! Closing against a status that lies, commands that hinder it, and tokens that nobody granted.

use std::time::{Duration, Instant};

use bus::Catch;
use contract::device::dome::Shutter;
use contract::device::{dome, telescope};
use contract::observatory::{AlertKind, Lease, Permit, Verdict};
use contract::{Address, CommandId, Key, Kind, Order, OrderKind, Part, Reason};
use orders::{Follower, TakenBy};
use serde_json::json;
use test_support::{LIMIT, until};
use units::Utc;

use crate::fake::{Fake, FakeAnswer};
use crate::stage::{Commander, Stage, accepted, command, refused, until_received};
use crate::{a_dome, block, open};

async fn until_alert(stage: &Stage, kind: AlertKind) {
    let mut alerts = stage.node().alerts.watch();
    let stands = alerts.wait_for(|all| all.alerts.iter().any(|alert| alert.id.starts_with(kind.entry().word)));
    tokio::time::timeout(LIMIT, stands).await.unwrap_or_else(|_| panic!("{kind:?} was never raised")).unwrap();
}

/// A mount that answers, does not move and is not parked.
async fn a_mount() -> Fake {
    let mount = Fake::start(&[
        ("canpark", json!(true)),
        ("cansettracking", json!(true)),
        ("canslewasync", json!(true)),
        ("atpark", json!(false)),
        ("tracking", json!(true)),
        ("slewing", json!(false)),
    ])
    .await;
    // It takes the command, and never arrives.
    mount.on("park", |mount, _| mount.answer("slewing", FakeAnswer::Value(json!(true))));
    mount
}

async fn claim(stage: &Stage) -> u64 {
    accepted(&stage.command(Kind::Dome, "dome", &command("c1", None, dome::Command::Claim)).await).unwrap()
}

/// Waits until a permit with this token counts.
pub async fn until_permitted(stage: &Stage, token: u64) {
    until_guard(stage, |guard| guard.may_be_open && guard.token == token).await;
}

/// Waits until the dome's guard is as wanted.
pub async fn until_guard(stage: &Stage, wanted: impl Fn(&dome::Guard) -> bool) {
    let key = Key::Guard(stage.device(Kind::Dome, "dome")).to_string();
    let guard = stage.bus.subscribe::<dome::Guard>(&key, Catch::Newest, 8).await.unwrap();
    until_received("the guard", &guard, wanted).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dome_whose_status_sticks_at_closed_after_an_opening_is_closed_and_reported() {
    let hardware = a_dome().await;
    hardware.on("openshutter", |_, _| {});
    hardware.on("closeshutter", |_, _| {});
    let stage = Stage::start(&block("dome", "dome", &hardware, "period_s = 0.5\npermit_valid_s = 10.0")).await;
    let token = claim(&stage).await;
    let commander = Commander::start(&stage, "dome", token).await;
    stage.until::<dome::Dome>("dome", |state| state.fields.shutter.known() == Some(&dome::Shutter::Closed)).await;
    until_permitted(&stage, token).await;
    accepted(&stage.command(Kind::Dome, "dome", &command("o1", Some(token), dome::Command::OpenShutter)).await);
    until("the opening arrives", || hardware.puts("openshutter").len() == 1).await;
    let before = hardware.puts("closeshutter").len();

    // A close order of the commander is sent, and its end is not believed.
    let close = command("c2", Some(token), dome::Command::CloseShutter);
    accepted(&stage.command(Kind::Dome, "dome", &close).await);
    until("the close request arrives", || hardware.puts("closeshutter").len() > before).await;
    tokio::time::sleep(Duration::from_secs(1)).await;
    let state = stage.until::<dome::Dome>("dome", |_| true).await;
    assert!(!state.has_done(&close.id), "a status that never changed proves nothing");

    // And the guard sends it by itself.
    let before = hardware.puts("closeshutter").len();
    drop(commander);
    until("the guard's close request arrives", || hardware.puts("closeshutter").len() > before).await;
    until_alert(&stage, AlertKind::DomeContradicts).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_stop_no_turn_and_no_park_from_anybody_ends_a_closing_that_is_due() {
    let hardware = a_dome().await;
    for (member, answer) in [("cansetazimuth", json!(true)), ("canpark", json!(true)), ("azimuth", json!(10.0))] {
        hardware.answer(member, FakeAnswer::Value(answer));
    }
    hardware.on("closeshutter", |hardware, _| hardware.answer("shutterstatus", FakeAnswer::Value(json!(3))));
    let stage = Stage::start(&block("dome", "dome", &hardware, "period_s = 0.2\npermit_valid_s = 10.0")).await;
    let (token, commander) = open(&stage).await;
    let stop = |id: &str| command(id, None, dome::Command::Abort);
    accepted(&stage.command(Kind::Dome, "dome", &stop("a1")).await);
    until("a stop under a safe sky is taken", || hardware.puts("abortslew").len() == 1).await;
    let (before, stops) = (hardware.puts("closeshutter").len(), hardware.puts("abortslew").len());
    drop(commander);
    until("the guard closes", || hardware.puts("closeshutter").len() > before).await;
    for (id, token, what) in [
        ("a2", None, dome::Command::Abort),
        ("a3", Some(token), dome::Command::Abort),
        ("t1", Some(token), dome::Command::SlewToAzimuth { azimuth_deg: 200.0 }),
        ("p1", None, dome::Command::Park),
    ] {
        let reply = stage.command(Kind::Dome, "dome", &command(id, token, what.clone())).await;
        assert_eq!(refused(&reply), Reason::WrongState, "{what:?}");
    }
    assert_eq!(hardware.puts("abortslew").len(), stops);
    assert!(hardware.puts("slewtoazimuth").is_empty() && hardware.puts("park").is_empty());
    // A close that the guard repeats meanwhile finds it closed.
    hardware.on("closeshutter", |hardware, _| hardware.answer("shutterstatus", FakeAnswer::Value(json!(1))));
    hardware.answer("shutterstatus", FakeAnswer::Value(json!(1)));
    stage.until::<dome::Dome>("dome", |state| state.fields.shutter.known() == Some(&dome::Shutter::Closed)).await;
    let began = Instant::now();
    while let contract::Reply::Refusal(refusal) = stage.command(Kind::Dome, "dome", &stop("a4")).await {
        assert!(began.elapsed() < LIMIT, "{refusal}");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bare_close_moves_a_roof_only_over_its_parked_mount_and_has_it_parked() {
    let (hardware, mount) = (a_dome().await, a_mount().await);
    let policy = "period_s = 0.5\npermit_valid_s = 30.0\nclose_with_mount = \"parked_only\"";
    let stage =
        Stage::start(&(block("dome", "dome", &hardware, policy) + &block("telescope", "mount", &mount, ""))).await;
    let (_, _commander) = open(&stage).await;
    stage.until::<telescope::Telescope>("mount", |state| state.fields.at_park.known() == Some(&false)).await;
    // A permit that came late on a busy machine may have had it parked before.
    let (before, parks) = (hardware.puts("closeshutter").len(), mount.puts("park").len());
    accepted(&stage.command(Kind::Dome, "dome", &command("x1", None, dome::Command::CloseShutter)).await);
    until("the mount is asked to park", || mount.puts("park").len() > parks).await;
    // An abort from anybody ends no park that a roof waits for, nor does a commander that does not know of it.
    for what in [telescope::Command::Abort, telescope::Command::Slew { ra_deg: 1.0, dec_deg: 2.0 }] {
        let reply = stage.command(Kind::Telescope, "mount", &command("s1", None, what.clone())).await;
        // The park that is being done refuses a slew as well.
        assert!(matches!(refused(&reply), Reason::WrongState | Reason::Busy), "{what:?}: {reply:?}");
    }
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(hardware.puts("closeshutter").len(), before, "the mount is not parked");
    mount.answer("atpark", FakeAnswer::Value(json!(true)));
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(hardware.puts("closeshutter").len(), before, "it says that it is parked, and slews");
    mount.answer("slewing", FakeAnswer::Value(json!(false)));
    mount.answer("tracking", FakeAnswer::Value(json!(false)));
    until("the roof closes over the parked mount", || hardware.puts("closeshutter").len() > before).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn payloads_with_the_largest_token_end_no_lease_and_are_reported() {
    let hardware = a_dome().await;
    let stage = Stage::start(&block("dome", "dome", &hardware, "period_s = 0.5\npermit_valid_s = 30.0")).await;
    let (token, _commander) = open(&stage).await;
    let before = hardware.puts("closeshutter").len();
    let lease = Key::Observatory(Address::new("site", "alpha").unwrap(), Part::Lease);
    let lease = stage.bus.publisher::<Lease>(&lease).await.unwrap();
    let device = stage.device(Kind::Dome, "dome");
    let guard =
        stage.bus.subscribe::<dome::Guard>(&Key::Guard(device.clone()).to_string(), Catch::Newest, 8).await.unwrap();
    let permits = Key::Permit(device.address, device.name);
    let permits = stage.bus.publisher::<Permit>(&permits).await.unwrap();
    for invented in [token + 1, u64::MAX] {
        let sample = guard.recv().await.sample;
        let holder = "observatory/alpha/other".to_owned();
        lease
            .put(Lease { holder: holder.clone(), token: invented, since_utc: Utc::EPOCH, arbiter: String::new() })
            .await
            .unwrap();
        let (guard_number, guard_boot_id) = (sample.body.number, sample.boot_id);
        let permit =
            Permit { verdict: Verdict::Unsafe, commander: holder, token: invented, guard_number, guard_boot_id };
        permits.put(permit).await.unwrap();
    }
    until_alert(&stage, AlertKind::Impostor).await;
    for _ in 0..4 {
        let sample = guard.recv().await.sample.body;
        assert!(sample.may_be_open && sample.token == token, "{sample:?}");
    }
    assert_eq!(hardware.puts("closeshutter").len(), before, "the real permits count");
    let again = accepted(&stage.command(Kind::Dome, "dome", &command("c7", None, dome::Command::Claim)).await);
    assert_eq!(again, Some(token + 1), "and the next lease is the next one");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_persons_order_closes_a_dome_by_its_device_node_where_no_observatory_node_answers() {
    let hardware = a_dome().await;
    let stage = Stage::start(&block("dome", "dome", &hardware, "period_s = 0.2\npermit_valid_s = 6.0")).await;
    // Somebody renews the permit, and answers no order: the guard has no reason of its own to close.
    let (_, _commander) = open(&stage).await;
    let before = hardware.puts("closeshutter").len();
    let address = Address::new("site", "alpha").unwrap();
    let follower = Follower::open(&stage.bus, &address).await.unwrap();
    let order = Order {
        id: CommandId::fresh(),
        from: "cli/ana@dome-pc".to_owned(),
        reason: String::new(),
        kind: OrderKind::Close,
        seen: None,
    };
    let mut taken = Vec::new();
    let closed = orders::close(&stage.bus, &follower, &order, LIMIT, |by| taken.push(by.clone())).await.unwrap();
    assert_eq!(closed, TakenBy::Domes(vec![stage.device(Kind::Dome, "dome")]));
    assert_eq!(taken, [closed]);
    assert!(hardware.puts("closeshutter").len() > before);
    let state = stage.until::<dome::Dome>("dome", |state| state.fields.shutter.known() == Some(&Shutter::Closed)).await;
    assert!(
        state.last_command.is_some_and(|last| last.id == order.id && last.from == order.from),
        "who closed is shown"
    );
    stage.end().await;
}
