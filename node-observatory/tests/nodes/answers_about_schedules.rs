//! The bus answers what is wrong with a schedule without making it active, and shows what is found in the active one.

#[allow(dead_code, reason = "shared with the stories of a night")]
use std::time::{Duration, Instant};

use crate::site::Site;
use contract::Key;
use contract::observatory::{Check, RowStatus, ScheduleDraft, ScheduleFindings, Severity};

const MOST: Duration = Duration::from_secs(90);

async fn asked(site: &Site, text: &str) -> ScheduleFindings {
    let draft = ScheduleDraft { text: text.to_owned() };
    let key = Key::ScheduleCheck(site.address.clone());
    let begun = Instant::now();
    loop {
        // A session that has just opened does not know all its peers.
        match site.bus.ask(&key, &draft, Duration::from_secs(10)).await {
            Err(error) if begun.elapsed() > MOST => panic!("{error}"),
            Err(_) => tokio::time::sleep(Duration::from_millis(200)).await,
            Ok(answer) => return answer,
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn findings_are_answered_for_a_draft_and_shown_of_the_active_schedule() {
    let site = Site::new(1.0).await;
    // Sets long before its window ends.
    let sinking = r#"{"object": "x", "exptime": 10, "ra": 345.0, "dec": -24.6, "n": 1}"#;
    site.write_schedule(&[("object", sinking, "03:00:00", "09:00:00")]);
    let node = site.start().await;
    let findings = |site: &Site| site.schedule.get().map(|heard| heard.said.body.findings).unwrap_or_default();
    let rows = |site: &Site| site.schedule.get().map(|heard| heard.said.body.rows).unwrap_or_default();
    site.until("surveyed", MOST, |site| !findings(site).is_empty() && !rows(site).is_empty()).await;
    let found = findings(&site);
    let told: Vec<_> = found.iter().map(|f| (f.severity, f.check, f.line, f.field.as_deref())).collect();
    assert_eq!(told, [(Severity::Warning, Check::Visibility, 1, Some("end_time"))], "{found:?}");
    assert!(found[0].what.contains("x stands below 0 deg from 2026-11-21T0"), "{}", found[0].what);

    let draft = "// tonight\n{\"device_name\": \"cam\", \"action_type\": \"objekt\"}\n{\"device_name\": \"cam\",}\n";
    let answer = asked(&site, draft).await;
    assert!(!answer.valid && answer.rows == 0 && answer.errors == 4, "{answer:?}");
    let places: Vec<_> = answer.findings.iter().map(|f| (f.line, f.column, f.field.as_deref())).collect();
    assert_eq!(
        places,
        [(2, 1, Some("start_time")), (2, 1, Some("end_time")), (2, 39, Some("action_type")), (3, 23, None)]
    );
    let good = r#"{"device_name": "cam", "action_type": "close", "start_time": "2026-11-21 05:00:00", "end_time": "2026-11-21 06:00:00"}"#;
    let answer = asked(&site, good).await;
    assert!(answer.valid && answer.rows == 1 && answer.findings.is_empty(), "{answer:?}");
    let rows = site.schedule.get().unwrap().said.body;
    assert_eq!((rows.revision, rows.rows[0].action.as_str()), (1, "object"), "a question changes nothing");
    assert_ne!(rows.rows[0].status, RowStatus::Skipped);
    node.stop().await;
}
