//! The robotic switch: off closes what it had opened, and acts before it is on disk.

use std::sync::Arc;

use contract::observatory::AlertKind;
use node::{NodeAlerts, Stop};

use crate::authority::Authority;
use crate::journal::Journal;
use crate::persisted::{AGAIN, answer_of_disk};

/// Turns the switch off; that closes what it had opened.
pub fn turn_off(authority: &Authority, journal: &Arc<Journal>, why: &str) {
    if authority.robotic.send_replace(false) {
        authority.close_request.send_replace(Some(why.to_owned()));
        note_off(authority, journal);
    }
}

/// Records that the switch is off, in parallel with all else.
pub fn note_off(authority: &Authority, journal: &Arc<Journal>) {
    let node = &authority.node;
    journal.robotic_off(node.bus.clock().utc());
    tokio::spawn(until_written(journal.clone(), node.alerts.clone(), node.stop.clone()));
}

/// Writes again and again that the switch is off, with an alert, until the disk takes it or the node ends.
async fn until_written(journal: Arc<Journal>, alerts: NodeAlerts, stop: Stop) {
    loop {
        let writing = journal.clone();
        let complain = |why: &str| {
            let cause = format!("the robotic switch is off, and a restart will not know it: {why}");
            alerts.raise(AlertKind::Journal, "", &cause);
        };
        let written = answer_of_disk(tokio::task::spawn_blocking(move || writing.write_switch()), complain).await;
        let Err(error) = written.map_err(std::io::Error::other).and_then(|written| written) else {
            return alerts.clear(AlertKind::Journal, "");
        };
        complain(&error.to_string());
        if stop.or(tokio::time::sleep(AGAIN)).await.is_none() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use bus::Clock;
    use contract::observatory::Alerts;
    use test_support::LIMIT;
    use tokio::time::timeout;
    use units::Utc;

    use super::*;

    #[tokio::test]
    async fn an_alert_stands_until_the_disk_has_taken_that_the_switch_is_off() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        let path = data.join("j.jsonl");
        let journal = Arc::new(Journal::open(&path).unwrap());
        std::fs::remove_dir(&data).unwrap();
        let (alerts, at) = (NodeAlerts::new(Clock::machine_clock()), Utc::from_seconds(1000.0));
        let mut shown = alerts.watch();
        journal.robotic_off(at);
        let writing = tokio::spawn(until_written(journal, alerts, Stop::default()));
        let stands = |alerts: &Alerts| alerts.alerts.iter().any(|alert| alert.cause.contains("j.jsonl: "));
        timeout(LIMIT, shown.wait_for(stands)).await.unwrap().unwrap();
        std::fs::create_dir(&data).unwrap();
        timeout(LIMIT, writing).await.unwrap().unwrap();
        assert_eq!(Journal::last_robotic_in(&path).unwrap(), Some((at, false)));
        assert!(!stands(&shown.borrow()), "it is gone with its cause");
    }
}
