//! The robotic switch: off closes what it had opened, and acts before it is on disk.

use std::sync::Arc;

use contract::observatory::AlertKind;
use node::{NodeAlerts, Stop};
use tokio::sync::watch;

use crate::authority::Authority;
use crate::hold::Hold;
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
    tokio::spawn(until_written(journal.clone(), node.alerts.clone(), authority.hold.clone(), node.stop.clone()));
}

/// Writes again and again that the switch is off, with an alert, until the disk takes it or the node ends. A standby
/// writes nothing: the file may be that of the node which commands, and say by now that it is on.
async fn until_written(journal: Arc<Journal>, alerts: NodeAlerts, mut hold: watch::Receiver<Hold>, stop: Stop) {
    loop {
        if !hold.borrow().may_publish() {
            alerts.clear(AlertKind::Journal, "");
            let commands = async { hold.wait_for(Hold::may_publish).await.is_ok() };
            if stop.or(commands).await != Some(true) {
                return;
            }
        }
        let complain = |why: &str| {
            let cause = format!("the robotic switch is off, and a restart will not know it: {why}");
            alerts.raise(AlertKind::Journal, "", &cause);
        };
        let Err(error) = answer_of_disk(journal.write_switch_in_turn(), complain).await else {
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
        let hold = watch::channel(Hold::Claiming).1;
        let writing = tokio::spawn(until_written(journal, alerts, hold, Stop::default()));
        let stands = |alerts: &Alerts| alerts.alerts.iter().any(|alert| alert.cause.contains("j.jsonl: "));
        timeout(LIMIT, shown.wait_for(stands)).await.unwrap().unwrap();
        std::fs::create_dir(&data).unwrap();
        timeout(LIMIT, writing).await.unwrap().unwrap();
        assert_eq!(Journal::last_robotic_in(&path).unwrap(), Some((at, false)));
        assert!(!stands(&shown.borrow()), "it is gone with its cause");
    }

    #[test]
    fn a_standby_does_not_write_into_the_file_of_the_node_that_commands() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j.jsonl");
        let (journal, at) = (Arc::new(Journal::open(&path).unwrap()), Utc::from_seconds(1000.0));
        let (lease, hold) = watch::channel(Hold::Standby);
        journal.robotic_off(at);
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_time().max_blocking_threads(1).build().unwrap();
        runtime.block_on(async {
            let alerts = NodeAlerts::new(Clock::machine_clock());
            let writing = tokio::spawn(until_written(journal, alerts, hold, Stop::default()));
            tokio::task::yield_now().await;
            // The only thread comes to this after what it was asked to write.
            tokio::task::spawn_blocking(|| {}).await.unwrap();
            assert_eq!(Journal::last_robotic_in(&path).unwrap(), None);
            lease.send_replace(Hold::Claiming);
            timeout(LIMIT, writing).await.unwrap().unwrap();
        });
        assert_eq!(Journal::last_robotic_in(&path).unwrap(), Some((at, false)));
    }
}
