//! Changes become rows once, in whatever order and however often they are received.

use contract::BootId;
use contract::observatory::{AlertKind, RowStatus};
use rusqlite::Connection;

use super::*;

fn database() -> Connection {
    let mut connection = Connection::open_in_memory().unwrap();
    super::super::migrations::bring_up(&mut connection).unwrap();
    connection
}

fn at(second: f64) -> Utc {
    Utc::from_seconds(1_795_230_000.0 + second)
}

/// Writes a state that is published each second, `seq` being its second.
fn put(connection: &mut Connection, boot: &BootId, second: u64, state: &str) {
    let stored = StoredState {
        part: "night",
        same: state.to_owned(),
        state: state.to_owned(),
        at: at(second as f64),
        gap_s: 15.0,
        origin: (boot.clone(), second),
    };
    let transaction = connection.transaction().unwrap();
    write_state(&transaction, "callisto", &stored).unwrap();
    transaction.commit().unwrap();
}

/// State, first and last second of each row.
fn rows(connection: &Connection) -> Vec<(String, f64, f64)> {
    let mut all = connection.prepare("SELECT state, datetime, last FROM states ORDER BY datetime").unwrap();
    let second = |text: String| text.parse::<Utc>().unwrap().seconds_since(at(0.0));
    let rows = all.query_map([], |row| Ok((row.get(0)?, second(row.get(1)?), second(row.get(2)?)))).unwrap();
    rows.map(Result::unwrap).collect()
}

#[test]
fn a_repeated_state_is_one_row_and_what_is_received_twice_or_late_changes_nothing() {
    let (mut connection, boot) = (database(), BootId::fresh());
    let one = |state: &str, from, to| (state.to_owned(), from, to);
    for second in (0..=10).chain(40..=50) {
        put(&mut connection, &boot, second, "open");
    }
    assert_eq!(rows(&connection), [one("open", 0.0, 10.0), one("open", 40.0, 50.0)], "a gap is seen");
    // The archive was away; the bus sends what it stored, after what was newer.
    for second in 0..=39 {
        put(&mut connection, &boot, second, if second < 20 { "open" } else { "closing" });
    }
    let whole = [one("open", 0.0, 19.0), one("closing", 20.0, 39.0), one("open", 40.0, 50.0)];
    assert_eq!(rows(&connection), whole);
    for second in (0..=50).rev() {
        put(&mut connection, &boot, second, if (20..40).contains(&second) { "closing" } else { "open" });
    }
    assert_eq!(rows(&connection), whole);
    // Another incarnation in the same state is another row.
    put(&mut connection, &BootId::fresh(), 51, "open");
    assert_eq!(rows(&connection).len(), 4);
}

#[test]
fn a_row_of_the_schedule_is_stored_when_it_changes() {
    let (mut connection, boot) = (database(), BootId::fresh());
    let mut row = RowState {
        row: 3,
        action: "object".to_owned(),
        camera: "andor".to_owned(),
        object: Some("Żuraw'; DROP TABLE alerts".to_owned()),
        start_utc: at(0.0),
        end_utc: at(100.0),
        status: RowStatus::Pending,
        frames: 0,
        frames_wanted: None,
        detail: String::new(),
    };
    for seq in 0..6 {
        row.status = if seq < 3 { RowStatus::Pending } else { RowStatus::Running };
        let stored = StoredRow { row: row.clone(), at: at(10.0 * seq as f64), origin: (boot.clone(), seq) };
        let transaction = connection.transaction().unwrap();
        write_row(&transaction, "callisto", &stored).unwrap();
        write_row(&transaction, "callisto", &stored).unwrap();
        transaction.commit().unwrap();
    }
    let mut all = connection.prepare("SELECT status, frames_wanted FROM schedule_rows ORDER BY datetime").unwrap();
    let statuses = all.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    let statuses: Vec<(String, Option<u32>)> = statuses.map(Result::unwrap).collect();
    assert_eq!(statuses, [("pending".to_owned(), None), ("running".to_owned(), None)]);
}

#[test]
fn an_alert_that_is_in_the_list_no_more_was_cleared_and_an_old_list_clears_nothing() {
    let (mut connection, boot) = (database(), BootId::fresh());
    let alert = |name: &str, raised_s| AlertKind::DomeHeld.alert(name, at(raised_s), "nobody renewed it");
    let lists =
        [(10, vec![alert("a", 5.0)]), (20, vec![alert("a", 5.0), alert("b", 15.0)]), (30, vec![alert("b", 15.0)])];
    // The second list once more at the end: it comes late.
    for (second, alerts) in lists.iter().chain(&lists[1..2]) {
        let stored = StoredAlerts {
            alerts: alerts.clone(),
            at: at(f64::from(*second)),
            origin: (boot.clone(), u64::try_from(*second).unwrap()),
        };
        let transaction = connection.transaction().unwrap();
        write_alerts(&transaction, "callisto", &stored).unwrap();
        transaction.commit().unwrap();
    }
    let mut all = connection.prepare("SELECT id, cleared FROM alerts ORDER BY id").unwrap();
    let found = all.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    let found: Vec<(String, Option<String>)> = found.map(Result::unwrap).collect();
    assert_eq!(found, [("dome-held/a".to_owned(), Some(stamp(at(30.0)))), ("dome-held/b".to_owned(), None)]);
}
