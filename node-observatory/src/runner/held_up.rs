//! The rows that rest or have failed for a device's sake, and the alerts about them: one for each kind of device, however
//! many rows it holds up.

use std::collections::BTreeMap;

use contract::Kind;
use contract::observatory::{AlertKind, RowState};
use node::NodeAlerts;
use schedule::RowId;

/// What the alert is called where no device is to blame.
const NO_DEVICE: &str = "other";

/// The rows that rest, or those that have failed.
#[derive(Debug)]
pub(super) struct HeldUp {
    alert: AlertKind,
    /// What is true of them, in words.
    they: &'static str,
    rows: BTreeMap<RowId, Reason>,
}

#[derive(Debug)]
struct Reason {
    number: u32,
    instance: &'static str,
    detail: String,
}

impl HeldUp {
    /// Rows that rest, and are tried again.
    pub fn postponed() -> Self {
        Self { alert: AlertKind::RowPostponed, they: "rest", rows: BTreeMap::new() }
    }

    /// Rows that have failed, and are not tried again.
    pub fn failed() -> Self {
        Self { alert: AlertKind::RowFailed, they: "have failed", rows: BTreeMap::new() }
    }

    /// A row is held up.
    pub fn add(&mut self, id: &RowId, number: u32, kind: Option<Kind>, detail: &str, alerts: &NodeAlerts) {
        let instance = kind.map_or(NO_DEVICE, Kind::word);
        let reason = Reason { number, instance, detail: detail.to_owned() };
        // It may have rested for another device before.
        let before =
            self.rows.insert(id.clone(), reason).map(|before| before.instance).filter(|before| *before != instance);
        for instance in before.into_iter().chain([instance]) {
            self.report(instance, alerts);
        }
    }

    /// A row is held up no more; returns what held it up.
    pub fn remove(&mut self, id: &RowId, alerts: &NodeAlerts) -> Option<String> {
        let reason = self.rows.remove(id)?;
        self.report(reason.instance, alerts);
        Some(reason.detail)
    }

    /// Forgets the rows that the schedule has no longer.
    pub fn keep_only(&mut self, is_there: impl Fn(&RowId) -> bool, alerts: &NodeAlerts) {
        let gone: Vec<RowId> = self.rows.keys().filter(|id| !is_there(id)).cloned().collect();
        gone.iter().for_each(|id| drop(self.remove(id, alerts)));
    }

    fn report(&self, instance: &'static str, alerts: &NodeAlerts) {
        let mut rows: Vec<&Reason> = self.rows.values().filter(|reason| reason.instance == instance).collect();
        rows.sort_by_key(|reason| reason.number);
        match rows.as_slice() {
            [] => alerts.clear(self.alert, instance),
            [only] => {
                alerts.raise(self.alert, instance, &format!("{}: {}", told(only.number), only.detail));
            }
            [first, ..] => {
                let (count, first, detail) = (rows.len(), told(first.number), &first.detail);
                let cause = format!("{count} rows {}; the first of them, {first}: {detail}", self.they);
                alerts.raise(self.alert, instance, &cause);
            }
        }
    }
}

fn told(number: u32) -> String {
    format!("row {}", RowState::told(number))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_camera_that_holds_up_a_hundred_rows_is_one_alert() {
        let alerts = NodeAlerts::new(bus::Clock::machine_clock());
        let active = || -> Vec<(String, String)> {
            let published = alerts.watch().borrow().alerts.clone();
            let active = published.into_iter().filter(|alert| alert.returned_utc.is_none());
            active.map(|alert| (alert.id, alert.cause)).collect()
        };
        let row = |number: u32| RowId(format!("row-{number:03}"));
        let mut postponed = HeldUp::postponed();
        for number in 1..=100 {
            postponed.add(&row(number), number, Some(Kind::Camera), "the camera hangs", &alerts);
        }
        postponed.add(&row(200), 200, Some(Kind::Dome), "the dome does not turn", &alerts);
        let [(camera, cause), (dome, _)] = &active()[..] else { panic!("{:?}", active()) };
        assert_eq!((camera.as_str(), dome.as_str()), ("row-postponed/camera", "row-postponed/dome"));
        assert_eq!(cause, "100 rows rest; the first of them, row 2: the camera hangs");
        // One goes on, one now waits for another device, and a new schedule has only two of them.
        postponed.remove(&row(1), &alerts);
        postponed.add(&row(200), 200, Some(Kind::Camera), "the camera hangs", &alerts);
        postponed.keep_only(|id| [row(7), row(8)].contains(id), &alerts);
        assert!(active().iter().any(|(_, cause)| cause == "2 rows rest; the first of them, row 8: the camera hangs"));
        postponed.remove(&row(7), &alerts);
        postponed.remove(&row(8), &alerts);
        alerts.watch();
        assert!(postponed.rows.is_empty());
    }

    #[tokio::test]
    async fn rows_that_have_failed_are_an_alert_until_the_schedule_has_them_no_longer() {
        let alerts = NodeAlerts::new(bus::Clock::machine_clock());
        let active = || -> Vec<(String, String)> {
            let published = alerts.watch().borrow().alerts.clone();
            let active = published.into_iter().filter(|alert| alert.returned_utc.is_none());
            active.map(|alert| (alert.id, alert.cause)).collect()
        };
        let row = |number: u32| RowId(format!("row-{number:03}"));
        let mut failed = HeldUp::failed();
        failed.add(&row(1), 1, None, "focus position 60000 is outside the focuser's 0 to 50000", &alerts);
        let [(id, cause)] = &active()[..] else { panic!("{:?}", active()) };
        assert_eq!(id, "row-failed/other");
        assert_eq!(cause, "row 2: focus position 60000 is outside the focuser's 0 to 50000");
        failed.add(&row(2), 2, None, "the camera takes no such exposure", &alerts);
        assert!(active()[0].1.starts_with("2 rows have failed; the first of them, row 2: "), "{:?}", active());
        failed.keep_only(|id| *id == row(2), &alerts);
        assert_eq!(active()[0].1, "row 3: the camera takes no such exposure");
        failed.remove(&row(2), &alerts);
        assert!(active().is_empty());
    }
}
