//! A mount that comes to a limit of its, seen at its server: what is ordered reaches it.

use std::time::{Duration, Instant};

use contract::Kind;
use contract::device::telescope::{Command, Telescope};
use serde_json::json;
use test_support::LIMIT;

use crate::block;
use crate::fake::{Fake, FakeAnswer};
use crate::stage::{Stage, accepted, command, until_received};

/// A mount that says that it tracks, near the celestial pole which is below the horizon at all hours of a southern site,
/// and does nothing that it is ordered.
async fn a_deaf_mount() -> Fake {
    Fake::start(&[
        ("rightascension", json!(3.0)),
        ("declination", json!(89.0)),
        ("altitude", json!(-24.0)),
        ("azimuth", json!(0.0)),
        ("tracking", json!(true)),
        ("slewing", json!(false)),
        ("atpark", json!(false)),
        ("sideofpier", json!(0)),
        ("ispulseguiding", json!(false)),
        ("canpark", json!(true)),
        ("canslewasync", json!(true)),
        ("cansettracking", json!(true)),
        ("equatorialsystem", json!(1)),
    ])
    .await
}

async fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let began = Instant::now();
    while !is_so() {
        assert!(began.elapsed() < 2 * LIMIT, "never {what}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mount_that_ignores_the_end_of_tracking_at_its_limit_is_aborted_and_then_parked() {
    let mount = a_deaf_mount().await;
    mount.on("park", |mount, _| mount.answer("atpark", FakeAnswer::Value(json!(true))));
    let blocks = block("telescope", "mount", &mount, "period_s = 0.5\nlimits = { altitude_min_deg = 20.0 }");
    let stage = Stage::start(&blocks).await;
    let states = stage.states::<Telescope>("mount").await;
    until("aborted", || !mount.puts("abortslew").is_empty()).await;
    let beyond = until_received("the mount", &states, |state| state.fields.beyond_limit.is_some()).await;
    assert!(beyond.fields.beyond_limit.is_some_and(|beyond| !beyond.not_stopped));
    until("parked", || !mount.puts("park").is_empty()).await;
    let at = |member| mount.puts(member)[0].at;
    assert!(at("tracking") < at("abortslew") && at("abortslew") < at("park"));
    assert!(mount.puts("tracking").iter().any(|off| off.at > at("abortslew")), "each of the two stops was sent");
    stage.until::<Telescope>("mount", |state| state.fields.beyond_limit.is_none()).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_whose_request_hangs_keeps_no_other_stop_from_the_wire() {
    let mount = a_deaf_mount().await;
    mount.answer("put abortslew", FakeAnswer::Hangs);
    let blocks = block("telescope", "mount", &mount, "period_s = 0.5\nlimits = { altitude_min_deg = -90.0 }");
    let stage = Stage::start(&blocks).await;
    stage.until::<Telescope>("mount", |state| state.fields.tracking.known() == Some(&true)).await;
    let token = accepted(&stage.command(Kind::Telescope, "mount", &command("claim", None, Command::Claim)).await);
    for (id, stop) in [("1", Command::Abort), ("2", Command::Track { on: false }), ("3", Command::Park)] {
        accepted(&stage.command(Kind::Telescope, "mount", &command(id, token, stop)).await);
    }
    for member in ["abortslew", "tracking", "park"] {
        until(member, || !mount.puts(member).is_empty()).await;
    }
    let at = |member| mount.puts(member)[0].at;
    assert!(at("abortslew") < at("tracking") && at("tracking") < at("park"), "in the order in which they came");
    stage.end().await;
}
