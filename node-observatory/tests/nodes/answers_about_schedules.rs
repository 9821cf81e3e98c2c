//! The bus answers what is wrong with a schedule without making it active, and shows what is found in the active one.

use std::time::{Duration, Instant};

use contract::observatory::{
    Check, RowStatus, ScheduleDraft, ScheduleFindings, SchedulePlan, SchedulePlanQuestion, ScheduleTextQuestion,
    ScheduleTexts, Severity,
};
use contract::{Key, OrderKind, Payload, Reply};
use serde::de::DeserializeOwned;

use crate::MOST;
use crate::site::Site;

async fn asked(site: &Site, text: &str) -> ScheduleFindings {
    let draft = ScheduleDraft { text: text.to_owned() };
    ask(site, Key::ScheduleCheck(site.address.clone()), &draft).await
}

async fn ask<A: DeserializeOwned>(site: &Site, key: Key, question: &impl Payload) -> A {
    let begun = Instant::now();
    loop {
        // A session that has just opened does not know all its peers.
        match site.bus.ask(&key, question, Duration::from_secs(10)).await {
            Err(error) if begun.elapsed() > MOST => panic!("{error}"),
            Err(_) => tokio::time::sleep(Duration::from_millis(200)).await,
            Ok(answer) => return answer,
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn findings_are_answered_for_a_draft_and_published_of_the_active_schedule() {
    let site = Site::new(1.0).await;
    // Sets long before its window ends.
    let sinking = r#"{"object": "x", "exptime": 10, "ra": 345.0, "dec": -24.6, "n": 1}"#;
    site.write_schedule(&[("object", sinking, "03:00:00", "09:00:00")]);
    let node = site.start().await;
    let findings = |site: &Site| site.schedule.get().map(|received| received.sample.body.findings).unwrap_or_default();
    let rows = |site: &Site| site.schedule.get().map(|received| received.sample.body.rows).unwrap_or_default();
    site.until("surveyed", MOST, |site| !findings(site).is_empty() && !rows(site).is_empty()).await;
    let found = findings(&site);
    let listed: Vec<_> = found.iter().map(|f| (f.severity, f.check, f.line, f.field.as_deref())).collect();
    assert_eq!(listed, [(Severity::Warning, Check::Visibility, 1, Some("end_time"))], "{found:?}");
    assert!(found[0].what.contains("x stands below 0 deg from 2026-11-21T0"), "{}", found[0].what);

    let draft = "// tonight\n{\"device_name\": \"cam\", \"action_type\": \"objekt\"}\n{\"device_name\": \"cam\",}\n";
    let answer = asked(&site, draft).await;
    assert!(!answer.valid && answer.rows == 0 && answer.errors == 9, "{answer:?}");
    let places: Vec<_> = answer.findings.iter().map(|f| (f.line, f.column, f.field.as_deref())).collect();
    // Of both rows everything is told, as if their slips were mended.
    let missing = |line: u32, fields: &[&'static str]| fields.iter().map(|field| (line, 1, Some(*field))).collect();
    let expected: [Vec<(u32, u32, Option<&str>)>; 4] = [
        missing(2, &["object", "exptime", "start_time", "end_time"]),
        vec![(2, 39, Some("action_type"))],
        missing(3, &["action_type", "start_time", "end_time"]),
        vec![(3, 23, None)],
    ];
    assert_eq!(places, expected.concat());
    let good = r#"{"device_name": "cam", "action_type": "close", "start_time": "2026-11-21 05:00:00", "end_time": "2026-11-21 06:00:00"}"#;
    let answer = asked(&site, good).await;
    assert!(answer.valid && answer.rows == 1 && answer.findings.is_empty(), "{answer:?}");
    let rows = site.schedule.get().unwrap().sample.body;
    assert_eq!((rows.revision, rows.rows[0].action.as_str()), (1, "object"), "a question changes nothing");
    assert_ne!(rows.rows[0].status, RowStatus::Skipped);
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_forecast_of_a_draft_and_the_text_of_each_schedule_are_answered() {
    let site = Site::new(1.0).await;
    let high = r#"{"object": "x", "exptime": 60, "ra": 45.0, "dec": -24.6, "n": 3}"#;
    site.write_schedule(&[("object", high, "05:00:00", "06:00:00")]);
    let node = site.start().await;
    site.until("read", MOST, |site| site.schedule.get().is_some_and(|found| !found.sample.body.rows.is_empty())).await;
    let file = site.folder.path().join("schedule.jsonl");
    let text = std::fs::read_to_string(&file).unwrap();
    let published = site.schedule.get().unwrap().sample.body.sha256.unwrap();

    let plan = async |text: String, unsafe_utc| -> SchedulePlan {
        ask(&site, Key::SchedulePlan(site.address.clone()), &SchedulePlanQuestion { text, unsafe_utc, begun: None })
            .await
    };
    let good = plan(text.clone(), vec![]).await;
    let row = &good.rows[0];
    assert!(good.findings.is_empty() && good.problem.is_none(), "{good:?}");
    assert_eq!((row.status, row.frames, row.whole, row.line), (RowStatus::Finished, 3, true, 1), "{row:?}");
    assert!(row.start_utc >= Some(row.window_utc[0]) && row.exposed_s == 180.0, "{row:?}");
    assert!(row.altitude_max_deg.unwrap() > 30.0 && !row.altitude_curve.as_ref().unwrap().is_empty(), "{row:?}");
    assert!(good.night.as_ref().unwrap().rows_at_risk == 0 && !good.overheads.is_empty(), "{good:?}");
    let [from, to] = row.window_utc;
    let closed = plan(text.clone(), vec![[from.plus_seconds(-60.0), to.plus_seconds(60.0)]]).await;
    assert_eq!((closed.rows[0].status, closed.night.unwrap().rows_at_risk), (RowStatus::Skipped, 1));
    let refused = plan(text.replace("object\"", "objekt\""), vec![]).await;
    assert!(refused.rows.is_empty() && refused.findings[0].severity == Severity::Error, "{refused:?}");
    let turned = plan(text.clone(), vec![[to, from]]).await;
    assert!(turned.problem.unwrap().contains("a begin before its end"));

    let texts = async |question: ScheduleTextQuestion| -> ScheduleTexts {
        ask(&site, Key::ScheduleTexts(site.address.clone()), &question).await
    };
    let now = texts(ScheduleTextQuestion::default()).await;
    assert_eq!((now.text.as_deref(), now.sha256.as_deref()), (Some(text.as_str()), Some(published.as_str())));
    let other = text.replace("06:00:00", "06:30:00");
    let put = OrderKind::PutSchedule { text: other.clone(), instead_of: Some(published.clone()) };
    assert!(matches!(site.order(put).await, Reply::Accepted(_)));
    let replaced = texts(ScheduleTextQuestion::default()).await;
    assert_eq!(replaced.text.as_deref(), Some(other.as_str()));
    site.until("both are stored", MOST, |site| {
        site.schedule.get().is_some_and(|found| found.sample.body.sha256 == replaced.sha256)
    })
    .await;
    let list = texts(ScheduleTextQuestion { list: Some(10), ..Default::default() }).await;
    let newest = list.versions.first().unwrap();
    assert_eq!((newest.author.as_str(), newest.reason.as_str(), newest.rows), ("test", "a test", 1), "{list:?}");
    // What stood in the file is a version, however soon it was replaced.
    let authors: Vec<&str> = list.versions.iter().map(|version| version.author.as_str()).collect();
    assert_eq!(authors, ["test", "file"], "{list:?}");
    let before =
        texts(ScheduleTextQuestion { list: Some(10), before: Some(newest.version), ..Default::default() }).await;
    assert!(before.versions.iter().all(|version| version.version < newest.version), "{before:?}");
    let own = texts(ScheduleTextQuestion { version: Some(newest.version), ..Default::default() }).await;
    assert_eq!((own.text.as_deref(), own.versions.len()), (Some(other.as_str()), 1));
    let none = texts(ScheduleTextQuestion { version: Some(99), ..Default::default() }).await;
    assert_eq!((none.text, none.problem), (None, None), "that there is none is no problem");
    node.stop().await;
}
