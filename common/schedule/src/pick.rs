//! Chooses the row that is to be started now: a pure function.

use contract::observatory::RowStatus;
use units::Utc;

use crate::row::Row;

/// Will this row not be started again?
pub fn has_ended(status: RowStatus) -> bool {
    match status {
        RowStatus::Finished | RowStatus::Failed | RowStatus::Skipped => true,
        RowStatus::Pending | RowStatus::Running | RowStatus::Interrupted => false,
    }
}

/// The first row in order whose window is open and that `may` run; none while a row runs that the next ones must wait
/// for, or that needs the same camera or mount.
pub fn pick(rows: &[Row], statuses: &[RowStatus], now: Utc, may: impl Fn(usize, &Row) -> bool) -> Option<usize> {
    let each = || rows.iter().zip(statuses);
    let running: Vec<&Row> = each().filter(|(_, status)| **status == RowStatus::Running).map(|(row, _)| row).collect();
    if running.iter().any(|row| !row.action.needs().parallel) {
        return None;
    }
    let next = each().enumerate().position(|(index, (row, status))| {
        let waits = matches!(status, RowStatus::Pending | RowStatus::Interrupted);
        let in_turn = !row.action.needs().all_before || statuses.iter().take(index).all(|status| has_ended(*status));
        waits && in_turn && row.start <= now && now <= row.end && may(index, row)
    })?;
    let row = rows.get(next)?;
    let clashes =
        |other: &&&Row| other.camera == row.camera || (other.action.needs().mount && row.action.needs().mount);
    running.iter().find(clashes).is_none().then_some(next)
}

#[cfg(test)]
mod tests {
    use RowStatus::{Finished, Interrupted, Pending, Running, Skipped};

    use super::*;
    use crate::parse::parse;

    const CALIBRATION: &str = r#"{"exptime": [0], "n": [1]}"#;
    const PARALLEL: &str = r#"{"exptime": [0], "n": [1], "execute_parallel": true}"#;
    const OBJECT: &str = r#"{"object": "x", "exptime": 1, "ra": 1, "dec": 1}"#;

    /// Rows of (camera, action, value, start hour, end hour).
    fn rows(of: &[(&str, &str, &str, u32, u32)]) -> Vec<Row> {
        let text: String = of
            .iter()
            .map(|(camera, action, value, start, end)| {
                format!(
                    r#"{{"device_name": "{camera}", "action_type": "{action}", "action_value": {value},
                    "start_time": "2026-11-21 {start:02}:00:00", "end_time": "2026-11-21 {end:02}:00:00"}}"#
                )
            })
            .collect();
        parse(&text, &["a".parse().unwrap(), "b".parse().unwrap()]).unwrap()
    }

    fn any(_: usize, _: &Row) -> bool {
        true
    }

    fn no_sky(_: usize, row: &Row) -> bool {
        !row.action.needs().safe
    }

    fn at(hour: u32) -> Utc {
        format!("2026-11-21T{hour:02}:30:00Z").parse().unwrap()
    }

    #[test]
    fn rows_go_one_after_another_within_their_windows() {
        let rows = rows(&[("a", "object", OBJECT, 1, 3), ("a", "calibration", CALIBRATION, 2, 4)]);
        assert_eq!(pick(&rows, &[Pending, Pending], at(0), any), None);
        assert_eq!(pick(&rows, &[Pending, Pending], at(2), any), Some(0));
        assert_eq!(pick(&rows, &[Running, Pending], at(2), any), None);
        assert_eq!(pick(&rows, &[Finished, Pending], at(2), any), Some(1));
        assert_eq!(pick(&rows, &[Skipped, Pending], at(5), any), None);
    }

    #[test]
    fn an_unsafe_sky_lets_only_those_go_that_need_none() {
        let rows = rows(&[("a", "object", OBJECT, 1, 3), ("a", "calibration", CALIBRATION, 1, 4)]);
        assert_eq!(pick(&rows, &[Interrupted, Pending], at(2), no_sky), Some(1));
        assert_eq!(pick(&rows, &[Interrupted, Pending], at(2), any), Some(0), "resumed when it is safe again");
    }

    #[test]
    fn headers_are_summed_up_only_when_no_interrupted_row_is_left() {
        let rows =
            rows(&[("a", "object", OBJECT, 1, 3), ("a", "complete_headers", "{}", 1, 4), ("a", "close", "{}", 1, 4)]);
        assert_eq!(pick(&rows, &[Interrupted, Pending, Pending], at(2), no_sky), Some(2));
        assert_eq!(pick(&rows, &[Interrupted, Pending, Finished], at(2), any), Some(0));
        assert_eq!(pick(&rows, &[Finished, Pending, Finished], at(2), any), Some(1));
    }

    #[test]
    fn alongside_a_parallel_row_only_another_camera_and_no_second_mount() {
        let rows = rows(&[
            ("a", "calibration", PARALLEL, 1, 4),
            ("b", "object", OBJECT, 2, 4),
            ("a", "calibration", CALIBRATION, 3, 4),
        ]);
        assert_eq!(pick(&rows, &[Running, Pending, Pending], at(2), any), Some(1));
        assert_eq!(pick(&rows, &[Running, Finished, Pending], at(3), any), None);
        assert_eq!(pick(&rows, &[Finished, Finished, Pending], at(3), any), Some(2));
    }
}
