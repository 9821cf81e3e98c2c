//! The tables of what happened in a night: the states of the observatory node, the rows of the schedule, alerts, and
//! the fluxes of stars.

use contract::observatory::{Alert, RowState};
use rusqlite::{OptionalExtension as _, Transaction, params};
use units::Utc;

use super::stamp::{json, stamp, word};
use super::write::{StoredAlerts, StoredFluxes, StoredRow, StoredState};

/// A state is one row from `datetime` to `last`, however often it was received. A sample that is received again
/// changes nothing; nor does one that comes late.
pub(super) const SCHEMA: &str = "
CREATE TABLE states (
    part TEXT NOT NULL, datetime TEXT NOT NULL, last TEXT NOT NULL, same TEXT NOT NULL, state TEXT NOT NULL,
    boot_id TEXT NOT NULL, seq INTEGER NOT NULL, UNIQUE (part, boot_id, seq)
);
CREATE INDEX states_date ON states (part, datetime);
CREATE TABLE schedule_rows (
    number INTEGER NOT NULL, datetime TEXT NOT NULL, action TEXT NOT NULL, camera_name TEXT NOT NULL, object TEXT,
    starts TEXT NOT NULL, ends TEXT NOT NULL, status TEXT NOT NULL, frames INTEGER NOT NULL, frames_wanted INTEGER,
    detail TEXT NOT NULL, row TEXT NOT NULL, boot_id TEXT NOT NULL, seq INTEGER NOT NULL,
    UNIQUE (number, boot_id, seq)
);
CREATE INDEX schedule_rows_date ON schedule_rows (number, datetime);
CREATE TABLE alerts (
    id TEXT NOT NULL, raised TEXT NOT NULL, priority TEXT NOT NULL, cause TEXT NOT NULL, acknowledged_by TEXT,
    cleared TEXT, last TEXT NOT NULL, boot_id TEXT NOT NULL, seq INTEGER NOT NULL, PRIMARY KEY (id, raised)
);
CREATE INDEX alerts_date ON alerts (raised);
CREATE TABLE series_stars (
    series TEXT NOT NULL, star INTEGER NOT NULL, ra_deg REAL NOT NULL, dec_deg REAL NOT NULL,
    PRIMARY KEY (series, star)
);
CREATE TABLE fluxes (
    frame_id TEXT NOT NULL, star INTEGER NOT NULL, series TEXT NOT NULL, x_px REAL NOT NULL, y_px REAL NOT NULL,
    flux_adu REAL NOT NULL, error_adu REAL NOT NULL, saturated INTEGER NOT NULL, PRIMARY KEY (frame_id, star)
);
CREATE INDEX fluxes_series ON fluxes (series);
";

/// The addition of version 12: verdicts with their reasons, one a row.
pub(super) const VERDICTS: &str = "
CREATE VIEW verdicts AS
    SELECT telescope, CAST(replace(datetime, ' ', 'T') || 'Z' AS TEXT) AS began_utc,
        CAST(replace(last, ' ', 'T') || 'Z' AS TEXT) AS last_utc, CAST(json_extract(state, '$.verdict') AS TEXT) AS verdict,
        CAST(json_extract(reason.value, '$.input') AS TEXT) AS input, CAST(json_extract(reason.value, '$.why') AS TEXT) AS why
    FROM states LEFT JOIN json_each(states.state, '$.reasons') AS reason
    WHERE part = 'safety';
";

/// Writes a state where it is another one than before, or comes after a gap.
pub(super) fn write_state(
    transaction: &Transaction<'_>,
    telescope: &str,
    stored: &StoredState,
) -> rusqlite::Result<usize> {
    let StoredState { part, same, state, at, gap_s, origin: (boot_id, seq) } = stored;
    let before = transaction
        .prepare_cached(
            "SELECT rowid, same, boot_id, last FROM states WHERE part = ? AND datetime <= ? AND telescope = ?
             ORDER BY datetime DESC, seq DESC LIMIT 1",
        )?
        .query_row(params![part, stamp(*at), telescope], |row| {
            Ok((row.get::<_, i64>(0)?, row.get::<_, String>(1)?, row.get::<_, String>(2)?, row.get::<_, String>(3)?))
        })
        .optional()?;
    if let Some((rowid, was, boot, last)) = before
        && was == *same
        && boot == boot_id.as_str()
        && last.parse::<Utc>().is_ok_and(|last| at.seconds_since(last) <= *gap_s)
    {
        transaction
            .prepare_cached("UPDATE states SET last = max(last, ?) WHERE rowid = ?")?
            .execute(params![stamp(*at), rowid])?;
        return Ok(0);
    }
    transaction.prepare_cached("INSERT INTO states VALUES (?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING")?.execute(params![
        part,
        stamp(*at),
        stamp(*at),
        same,
        state,
        boot_id.as_str(),
        *seq as i64,
        telescope
    ])
}

/// Writes a row of the schedule where it is not as it was before.
pub(super) fn write_row(transaction: &Transaction<'_>, telescope: &str, stored: &StoredRow) -> rusqlite::Result<usize> {
    let StoredRow { row, at, origin: (boot_id, seq) } = stored;
    let json = json(row)?;
    let before: Option<String> = transaction
        .prepare_cached(
            "SELECT row FROM schedule_rows WHERE number = ? AND datetime <= ? AND telescope = ?
             ORDER BY datetime DESC, seq DESC LIMIT 1",
        )?
        .query_row(params![row.row, stamp(*at), telescope], |row| row.get(0))
        .optional()?;
    if before.as_deref() == Some(&json) {
        return Ok(0);
    }
    let RowState { row: number, action, camera, object, start_utc, end_utc, status, frames, frames_wanted, detail } =
        row;
    transaction
        .prepare_cached("INSERT INTO schedule_rows VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING")?
        .execute(params![
            number,
            stamp(*at),
            action,
            camera,
            object,
            stamp(*start_utc),
            stamp(*end_utc),
            word(status)?,
            frames,
            frames_wanted,
            detail,
            json,
            boot_id.as_str(),
            *seq as i64,
            telescope,
        ])
}

/// Writes the alerts that are active; those that were active before and are not in the list were cleared.
pub(super) fn write_alerts(
    transaction: &Transaction<'_>,
    telescope: &str,
    stored: &StoredAlerts,
) -> rusqlite::Result<usize> {
    let StoredAlerts { alerts, at, origin: (boot_id, seq) } = stored;
    let mut put = transaction.prepare_cached(
        "INSERT INTO alerts VALUES (?,?,?,?,?,?,?,?,?,?) ON CONFLICT (id, raised, telescope) DO UPDATE SET
            cause = excluded.cause, acknowledged_by = excluded.acknowledged_by, cleared = excluded.cleared,
            last = excluded.last
         WHERE excluded.last > alerts.last",
    )?;
    let now = stamp(*at);
    for Alert { id, priority, raised_utc, cause, returned_utc, acknowledged_by, .. } in alerts {
        let (raised, returned) = (stamp(*raised_utc), returned_utc.map(stamp));
        let seq = *seq as i64;
        put.execute(params![
            id,
            raised,
            priority.word(),
            cause,
            acknowledged_by,
            returned,
            now,
            boot_id.as_str(),
            seq,
            telescope
        ])?;
    }
    // What this list has was written with `last` equal to now.
    transaction
        .prepare_cached(
            "UPDATE alerts SET cleared = ?1, last = ?1
             WHERE cleared IS NULL AND last < ?1 AND raised < ?1 AND telescope = ?2",
        )?
        .execute([now.as_str(), telescope])?;
    Ok(0)
}

/// Writes the fluxes of a frame, and the stars of its series where they are new.
pub(super) fn write_fluxes(transaction: &Transaction<'_>, stored: &StoredFluxes) -> rusqlite::Result<usize> {
    for (star, [ra_deg, dec_deg]) in stored.new_stars.iter().enumerate() {
        transaction
            .prepare_cached("INSERT INTO series_stars VALUES (?,?,?,?) ON CONFLICT DO NOTHING")?
            .execute(params![stored.series, star as i64, ra_deg, dec_deg])?;
    }
    let mut put = transaction.prepare_cached("INSERT INTO fluxes VALUES (?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING")?;
    let mut count = 0;
    for flux in &stored.fluxes {
        count += put.execute(params![
            stored.frame.0,
            flux.star,
            stored.series,
            flux.x_px,
            flux.y_px,
            flux.flux_adu,
            flux.error_adu,
            flux.is_saturated,
        ])?;
    }
    Ok(count)
}

#[cfg(test)]
mod tests;
