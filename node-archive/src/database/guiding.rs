//! The table of the corrections that guiding made: the predecessor's `autoguider_log` with all that is known today.

use contract::observatory::AxisCorrection;
use rusqlite::{Transaction, params};

use super::StoredCorrection;
use super::stamp::stamp;

/// A frame is guided on once, so a correction that is received again is the same correction. Lengths are px of the
/// frame.
pub(super) const SCHEMA: &str = "
CREATE TABLE IF NOT EXISTS guiding (
    frame_id TEXT PRIMARY KEY, datetime TEXT NOT NULL, telescope TEXT NOT NULL, camera_name TEXT NOT NULL,
    object TEXT, filter TEXT, pier_side TEXT, reference TEXT NOT NULL, stage TEXT NOT NULL,
    shift_x REAL, shift_y REAL, error_px REAL, rotation_deg REAL, stars INTEGER NOT NULL, fwhm_px REAL,
    transparency REAL, method TEXT, reason TEXT, further_action TEXT, rms_px REAL,
    east_why TEXT NOT NULL, east_error_px REAL, east_expected_px REAL NOT NULL, east_drift_px_per_s REAL NOT NULL,
    east_pulse_ms INTEGER NOT NULL, east_given_ms INTEGER NOT NULL,
    north_why TEXT NOT NULL, north_error_px REAL, north_expected_px REAL NOT NULL, north_drift_px_per_s REAL NOT NULL,
    north_pulse_ms INTEGER NOT NULL, north_given_ms INTEGER NOT NULL,
    correction TEXT NOT NULL, boot_id TEXT NOT NULL, seq INTEGER NOT NULL
);
CREATE INDEX IF NOT EXISTS guiding_date ON guiding (datetime);
";

/// SQL for the guided frames that show how well a telescope was held while others were exposed. `$spans` is a table of
/// these: `frame_id`, `telescope`, `camera_name`, and stamps of when they begin and end (`begins`, `ends`). The result has
/// their `frame_id`, and of each guided frame `guide_id`, `camera`, `shift_x` and `shift_y`.
///
/// Those count that were in the middle of their own exposures then and whose stars were measured; a reference itself was
/// guided by nothing. Pixels of two cameras are two units, so only one camera counts: the frame's own where it is guided
/// on itself, else that which measured most.
macro_rules! holding {
    ($spans:literal) => {
        // SQLite keeps the order of a cross join, and looks for the times in their index.
        concat!(
            "SELECT frame_id, guide_id, camera, shift_x, shift_y FROM (
                SELECT *, rank() OVER (PARTITION BY frame_id ORDER BY is_own DESC, of_camera DESC, camera DESC) AS place FROM (
                    SELECT spans.frame_id, guiding.frame_id AS guide_id, guiding.camera_name AS camera,
                        guiding.camera_name = spans.camera_name AS is_own, shift_x, shift_y,
                        count(*) OVER (PARTITION BY spans.frame_id, guiding.camera_name) AS of_camera
                    FROM ",
            $spans,
            " AS spans CROSS JOIN guiding ON +guiding.telescope = spans.telescope
                        AND guiding.datetime >= spans.begins AND guiding.datetime <= spans.ends
                    WHERE shift_x IS NOT NULL AND shift_y IS NOT NULL AND guiding.frame_id <> guiding.reference
                )
            ) WHERE place = 1"
        )
    };
}
pub(crate) use holding;

const PUT: &str = "
INSERT INTO guiding VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING
";

/// Writes a correction; returns how many rows were new.
pub(super) fn write(transaction: &Transaction<'_>, stored: &StoredCorrection) -> rusqlite::Result<usize> {
    let StoredCorrection { correction, telescope, origin: (boot_id, seq) } = stored;
    let json = serde_json::to_string(correction).map_err(refused)?;
    let (east, north) = (&correction.east, &correction.north);
    let side = correction.pier_side.as_ref().map(word).transpose()?;
    let method = correction.method.as_ref().map(word).transpose()?;
    let why = |axis: &AxisCorrection| word(&axis.why);
    transaction.prepare_cached(PUT)?.execute(params![
        correction.frame.0,
        stamp(correction.mid_utc),
        telescope,
        correction.camera,
        correction.object,
        correction.filter,
        side,
        correction.reference.0,
        word(&correction.stage)?,
        correction.dx_px,
        correction.dy_px,
        correction.shift_error_px,
        correction.rotation_deg,
        correction.stars,
        correction.fwhm_px,
        correction.transparency,
        method,
        correction.reason,
        correction.further_action,
        correction.rms_px,
        why(east)?,
        east.error_px,
        east.expected_px,
        east.drift_px_per_s,
        east.pulse_ms,
        east.given_ms,
        why(north)?,
        north.error_px,
        north.expected_px,
        north.drift_px_per_s,
        north.pulse_ms,
        north.given_ms,
        json,
        boot_id.as_str(),
        *seq as i64,
    ])
}

/// A word of the contract as it is published, without its quotes.
fn word<T: serde::Serialize>(word: &T) -> rusqlite::Result<String> {
    Ok(serde_json::to_string(word).map_err(refused)?.trim_matches('"').to_owned())
}

fn refused(error: serde_json::Error) -> rusqlite::Error {
    rusqlite::Error::ToSqlConversionFailure(Box::new(error))
}
