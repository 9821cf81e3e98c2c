//! The record that the device node writes of every command, in its file and on the bus.

use std::path::PathBuf;

use audit::audit_file::examine;
use audit::chain::prove_value;
use bus::Catch;
use contract::audit::{AuditAnswer, AuditOutcome, AuditQuestion, AuditRecord, PublishedRecord};
use contract::device::{dome, focuser};
use contract::{Key, Kind, NodeTopic, Reason};
use serde_json::{Value, json};
use test_support::{LIMIT, until, within};

use crate::fake::Fake;
use crate::stage::{Commander, Stage, accepted, command, refused};
use crate::{a_dome, block, open};

fn file(stage: &Stage) -> PathBuf {
    stage.node().config.folders.data.join("audit-device-alpha-main.jsonl")
}

/// The records in the file, proven.
fn records(stage: &Stage) -> Vec<AuditRecord> {
    let found = examine(&std::fs::read(file(stage)).unwrap_or_default(), None);
    assert!(found.broken.is_none(), "{:?}", found.broken);
    found.good.into_iter().map(|proven| proven.record).collect()
}

async fn until_recorded(stage: &Stage, what: &str, is_there: impl Fn(&AuditRecord) -> bool) -> AuditRecord {
    let found = within(LIMIT, || records(stage).into_iter().find(&is_there)).await;
    found.unwrap_or_else(|| panic!("{what} is not in the audit: {:#?}", records(stage)))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_domes_night_stands_in_the_audit_from_the_claim_to_the_guards_closing() {
    let hardware = a_dome().await;
    let stage = Stage::start(&block("dome", "dome", &hardware, "period_s = 0.5\npermit_valid_s = 10.0")).await;
    let key = stage.node().key(NodeTopic::Audit).to_string();
    let received = stage.bus.subscribe::<PublishedRecord<Value>>(&key, Catch::All, 1000).await.unwrap();
    let (token, commander) = open(&stage).await;
    let rival =
        contract::Command { from: "observatory/alpha/second".to_owned(), ..command("c2", None, dome::Command::Claim) };
    for n in 0..5 {
        let id = contract::CommandId(format!("c2-{n}"));
        let again = contract::Command { id, ..rival.clone() };
        assert_eq!(refused(&stage.command(Kind::Dome, "dome", &again).await), Reason::LeaseHeld);
    }
    drop(commander);
    until_recorded(&stage, "the guard's closing", |record| {
        record.from == "guard" && record.outcome == AuditOutcome::Done
    })
    .await;
    let closings = hardware.puts("closeshutter").len();
    assert!(closings > 0);
    let is_by_guard = |record: &&AuditRecord| record.from == "guard" && record.outcome == AuditOutcome::Accepted;
    until("each closing of the guard is recorded", || records(&stage).iter().filter(is_by_guard).count() >= closings)
        .await;

    let all = records(&stage);
    let outcomes = |id: &str| -> Vec<String> {
        let mine = all.iter().filter(|record| record.id.0 == id);
        mine.map(|record| format!("{} {} {}", record.device, record.verb, record.outcome.word())).collect()
    };
    assert_eq!(outcomes("c1"), ["dome/dome claim granted"]);
    assert_eq!(outcomes("o1"), ["dome/dome open_shutter refused"]);
    assert_eq!(outcomes("o2"), ["dome/dome open_shutter refused"]);
    assert_eq!(outcomes("o3"), ["dome/dome open_shutter accepted", "dome/dome open_shutter done"]);
    let opened = all.iter().find(|record| record.id.0 == "o3").unwrap();
    assert_eq!((opened.from.as_str(), opened.token), ("observatory/alpha/main", Some(token)));
    assert_eq!(
        (opened.node.as_str(), opened.boot_id.clone()),
        ("device/alpha/main", stage.node().bus.boot_id().clone())
    );
    let stale = all.iter().find(|record| record.id.0 == "o2").unwrap();
    assert!(matches!(&stale.outcome, AuditOutcome::Refused { reason: Reason::StaleToken, .. }), "{stale:?}");
    let rivals = all.iter().filter(|record| record.from == "observatory/alpha/second").count();
    assert_eq!(rivals, 1, "a standby that claims each second leaves one record");

    // The bus has the same, byte for byte.
    let mut published = Vec::new();
    while published.len() < all.len() {
        let one = tokio::time::timeout(LIMIT, received.recv()).await.unwrap();
        published.push(prove_value(&one.sample.body.record).unwrap().record);
    }
    published.sort_by_key(|record| record.number);
    assert_eq!(published[..all.len()], all[..]);

    // And so does the node when it is asked, in portions.
    let key = stage.node().key(NodeTopic::AuditSince);
    let (mut after, mut asked) = (None, Vec::new());
    loop {
        let question = AuditQuestion { after_sha256: after.clone(), limit: Some(3) };
        let answer: AuditAnswer<Value> = stage.bus.ask(&key, &question, LIMIT).await.unwrap();
        assert!(answer.known && answer.records.len() <= 3);
        asked.extend(answer.records.iter().map(|record| prove_value(record).unwrap().record));
        after = asked.last().map(|record: &AuditRecord| record.sha256.clone());
        if !answer.more {
            break;
        }
    }
    assert_eq!(asked[..all.len()], all[..]);
    let strange = AuditQuestion { after_sha256: Some("00".to_owned()), limit: None };
    let answer: AuditAnswer<Value> = stage.bus.ask(&key, &strange, LIMIT).await.unwrap();
    assert!(!answer.known && answer.records.is_empty());
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_that_another_one_replaces_is_reported_as_superseded() {
    let hardware = Fake::start(&[
        ("position", json!(100)),
        ("ismoving", json!(true)),
        ("absolute", json!(true)),
        ("maxstep", json!(5000)),
    ])
    .await;
    hardware.on("halt", |hardware, _| hardware.answer("ismoving", crate::fake::FakeAnswer::Value(json!(false))));
    let stage = Stage::start(&block("focuser", "focus", &hardware, "settle_s = 0.0")).await;
    stage.until::<focuser::Focuser>("focus", |state| state.fields.position.known() == Some(&100)).await;
    let go = command("m1", Some(3), focuser::Command::Move { position: 2500 });
    accepted(&stage.command(Kind::Focuser, "focus", &go).await);
    let busy = command("m2", Some(3), focuser::Command::Move { position: 7 });
    for _ in 0..4 {
        assert_eq!(refused(&stage.command(Kind::Focuser, "focus", &busy).await), Reason::Busy);
    }
    accepted(&stage.command(Kind::Focuser, "focus", &command("h1", None, focuser::Command::Abort)).await);
    let ended = until_recorded(&stage, "how m1 ended", |record| {
        record.id.0 == "m1" && record.outcome != AuditOutcome::Accepted
    })
    .await;
    assert_eq!(ended.outcome, AuditOutcome::Superseded { by: contract::CommandId("h1".to_owned()) });
    assert_eq!((ended.token, ended.parameters.as_str()), (Some(3), "{\"position\":2500}"));
    let refusals = records(&stage).iter().filter(|record| record.id.0 == "m2").count();
    assert_eq!(refusals, 1, "the same command refused for the same reason");

    let key = Key::Command(stage.device(Kind::Focuser, "focus"));
    let reply: contract::Reply = stage.bus.ask(&key, &json!({"do": "fly"}), LIMIT).await.unwrap();
    assert_eq!(refused(&reply), Reason::Malformed);
    until_recorded(&stage, "what could not be read", |record| record.verb == "unreadable").await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_disk_that_takes_no_audit_is_an_alert_and_delays_no_closing() {
    let hardware = a_dome().await;
    let devices = block("dome", "dome", &hardware, "period_s = 0.5\npermit_valid_s = 10.0");
    // A folder where the file should be.
    let stage = Stage::start_in(&devices, |folder| {
        std::fs::create_dir_all(folder.join("data/audit-device-alpha-main.jsonl")).unwrap();
    })
    .await;
    let (_, _commander): (u64, Commander) = open(&stage).await;
    let close = command("c9", None, dome::Command::CloseShutter);
    accepted(&stage.command(Kind::Dome, "dome", &close).await);
    stage.until::<dome::Dome>("dome", |state| state.has_done(&close.id)).await;
    let alerts = stage.node().alerts.watch().borrow().clone();
    assert!(alerts.alerts.iter().any(|alert| alert.id == "audit"), "{alerts:?}");

    // The disk is repaired: nothing was lost.
    std::fs::remove_dir(file(&stage)).unwrap();
    until_recorded(&stage, "the closing", |record| record.id.0 == "c9" && record.outcome == AuditOutcome::Done).await;
    let all = records(&stage);
    assert!(all.iter().all(|record| record.verb != "records_lost"), "{all:#?}");
    assert!(all.iter().any(|record| record.id.0 == "o3"), "{all:#?}");
    stage.end().await;
}
