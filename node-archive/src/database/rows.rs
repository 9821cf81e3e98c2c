//! The tables, and how each thing becomes a row of one.

use contract::device::camera::Frame;
use contract::node::Level;
use rusqlite::{Transaction, params};

use super::stamp::{json, stamp, word};
use super::{Memory, StoredFacts, StoredRun, Write, happenings};

/// The predecessor's tables with its columns first. Uniqueness makes a repeated message harmless.
pub(super) const SCHEMA: &str = "
CREATE TABLE polling (
    device_type TEXT NOT NULL, device_name TEXT NOT NULL, device_command TEXT NOT NULL,
    device_value TEXT, datetime TEXT NOT NULL,
    value_type TEXT NOT NULL, no_data TEXT, telescope TEXT NOT NULL, boot_id TEXT NOT NULL, seq INTEGER NOT NULL,
    UNIQUE (device_type, device_name, device_command, datetime, telescope)
);
CREATE TABLE images (
    filename TEXT NOT NULL, camera_name TEXT NOT NULL, complete_hdr INTEGER NOT NULL, date_obs TEXT NOT NULL,
    frame_id TEXT NOT NULL UNIQUE, file TEXT NOT NULL, sha256 TEXT NOT NULL, bytes INTEGER NOT NULL,
    stored TEXT NOT NULL, frame TEXT NOT NULL
);
CREATE INDEX images_incomplete ON images (date_obs) WHERE complete_hdr = 0;
CREATE INDEX images_date ON images (date_obs);
CREATE TABLE writing (frame_id TEXT PRIMARY KEY, file TEXT NOT NULL);
CREATE TABLE log (
    datetime TEXT NOT NULL, level TEXT NOT NULL, message TEXT NOT NULL,
    node TEXT NOT NULL, target TEXT NOT NULL, telescope TEXT NOT NULL, boot_id TEXT NOT NULL, seq INTEGER NOT NULL,
    UNIQUE (boot_id, seq, node)
);
CREATE INDEX log_date ON log (datetime);
";

/// The addition of version 2. A record counts once; two records with the same place in a chain are both stored, as
/// evidence.
pub(super) const AUDIT: &str = "
CREATE TABLE audit (
    node TEXT NOT NULL, chain TEXT NOT NULL, number INTEGER NOT NULL, datetime TEXT,
    who TEXT NOT NULL, device TEXT NOT NULL, verb TEXT NOT NULL, token INTEGER, outcome TEXT NOT NULL,
    line TEXT NOT NULL, sha256 TEXT NOT NULL, fault TEXT,
    UNIQUE (node, chain, number, sha256)
);
CREATE INDEX audit_date ON audit (datetime);
";

/// The addition of version 3. `in_header`: 0 not yet, 1 yes, 2 the file is gone.
pub(super) const FACTS: &str = "
CREATE TABLE facts (
    frame_id TEXT PRIMARY KEY, camera_name TEXT, filter TEXT, image_type TEXT, date_obs TEXT,
    stars INTEGER, fwhm_px REAL, fwhm_error_px REAL, ellipticity REAL, elongation_deg REAL, trailed INTEGER,
    sky_adu REAL, noise_adu REAL, saturated_fraction REAL, defect_fraction REAL,
    zero_point_mag REAL, transparency REAL, reason TEXT,
    facts TEXT NOT NULL, datetime TEXT NOT NULL, boot_id TEXT NOT NULL, seq INTEGER NOT NULL,
    in_header INTEGER NOT NULL
);
CREATE INDEX facts_date ON facts (date_obs);
CREATE INDEX facts_new ON facts (frame_id) WHERE in_header = 0;
";

/// The addition of version 4: where a frame points, or the class of the reason why that is not known.
pub(super) const SOLUTIONS: &str = "
ALTER TABLE facts ADD COLUMN ra_deg REAL;
ALTER TABLE facts ADD COLUMN dec_deg REAL;
ALTER TABLE facts ADD COLUMN scale_arcsec_px REAL;
ALTER TABLE facts ADD COLUMN rotation_deg REAL;
ALTER TABLE facts ADD COLUMN mirrored INTEGER;
ALTER TABLE facts ADD COLUMN matched INTEGER;
ALTER TABLE facts ADD COLUMN rms_px REAL;
ALTER TABLE facts ADD COLUMN false_alarm REAL;
ALTER TABLE facts ADD COLUMN off_target_arcmin REAL;
ALTER TABLE facts ADD COLUMN airmass REAL;
ALTER TABLE facts ADD COLUMN zero_point_error_mag REAL;
ALTER TABLE facts ADD COLUMN unsolved TEXT;
";

/// By what frames are looked for; the columns are computed from the announcement.
pub(super) const SEARCH: &str = "
ALTER TABLE images ADD COLUMN night TEXT GENERATED ALWAYS AS (json_extract(frame, '$.purpose.night')) VIRTUAL;
ALTER TABLE images ADD COLUMN object TEXT GENERATED ALWAYS AS (json_extract(frame, '$.purpose.object')) VIRTUAL;
ALTER TABLE images ADD COLUMN filter TEXT GENERATED ALWAYS AS (json_extract(frame, '$.purpose.filter')) VIRTUAL;
ALTER TABLE images ADD COLUMN image_type TEXT GENERATED ALWAYS AS (json_extract(frame, '$.purpose.image_type')) VIRTUAL;
CREATE INDEX images_night ON images (night, date_obs);
CREATE INDEX images_object ON images (object COLLATE NOCASE, date_obs);
CREATE INDEX images_type ON images (image_type, date_obs);
CREATE INDEX facts_dec ON facts (dec_deg) WHERE dec_deg IS NOT NULL;
";

/// Focus runs with all that was measured; a run that is received again is the same run.
pub(super) const FOCUS: &str = "
CREATE TABLE IF NOT EXISTS focus_runs (
    run_id TEXT PRIMARY KEY, camera_name TEXT NOT NULL, focuser_name TEXT NOT NULL, filter TEXT,
    date_obs TEXT NOT NULL, ended TEXT, outcome TEXT NOT NULL, reason TEXT, start_position INTEGER NOT NULL,
    best_position REAL, best_position_error REAL, stored_position REAL, critical_zone REAL, verified REAL,
    operator TEXT NOT NULL, temperature_c REAL, altitude_deg REAL, plot TEXT NOT NULL,
    run TEXT NOT NULL, datetime TEXT NOT NULL, boot_id TEXT NOT NULL, seq INTEGER NOT NULL
);
CREATE INDEX IF NOT EXISTS focus_runs_date ON focus_runs (date_obs);
CREATE TABLE IF NOT EXISTS focus_points (
    run_id TEXT NOT NULL, number INTEGER NOT NULL, position INTEGER NOT NULL, pass TEXT NOT NULL,
    value REAL, error REAL, stars INTEGER, reason TEXT, temperature_c REAL, used INTEGER,
    UNIQUE (run_id, number)
);
";

/// The newest facts of a frame count, but measured facts are never replaced by the reason why nothing was measured.
const PUT_FACTS: &str = "
INSERT INTO facts (
    frame_id, camera_name, filter, image_type, date_obs, stars, fwhm_px, fwhm_error_px, ellipticity, elongation_deg,
    trailed, sky_adu, noise_adu, saturated_fraction, defect_fraction, zero_point_mag, transparency, reason, facts,
    datetime, boot_id, seq, ra_deg, dec_deg, scale_arcsec_px, rotation_deg, mirrored, matched, rms_px, false_alarm,
    off_target_arcmin, airmass, zero_point_error_mag, unsolved, telescope, in_header
) VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,0)
ON CONFLICT (frame_id) DO UPDATE SET
    camera_name = excluded.camera_name, filter = excluded.filter, image_type = excluded.image_type,
    date_obs = excluded.date_obs, stars = excluded.stars, fwhm_px = excluded.fwhm_px,
    fwhm_error_px = excluded.fwhm_error_px, ellipticity = excluded.ellipticity,
    elongation_deg = excluded.elongation_deg, trailed = excluded.trailed, sky_adu = excluded.sky_adu,
    noise_adu = excluded.noise_adu, saturated_fraction = excluded.saturated_fraction,
    defect_fraction = excluded.defect_fraction, zero_point_mag = excluded.zero_point_mag,
    transparency = excluded.transparency, reason = excluded.reason, facts = excluded.facts,
    datetime = excluded.datetime, boot_id = excluded.boot_id, seq = excluded.seq,
    ra_deg = excluded.ra_deg, dec_deg = excluded.dec_deg, scale_arcsec_px = excluded.scale_arcsec_px,
    rotation_deg = excluded.rotation_deg, mirrored = excluded.mirrored, matched = excluded.matched,
    rms_px = excluded.rms_px, false_alarm = excluded.false_alarm, off_target_arcmin = excluded.off_target_arcmin,
    airmass = excluded.airmass, zero_point_error_mag = excluded.zero_point_error_mag, unsolved = excluded.unsolved, telescope = excluded.telescope,
    in_header = 0
WHERE excluded.datetime > facts.datetime AND (excluded.reason IS NULL OR facts.reason IS NOT NULL)
";

/// Writes one thing of a telescope; returns how many rows were new.
pub(super) fn write(
    transaction: &Transaction<'_>,
    telescope: &str,
    memory: &mut Memory,
    write: &Write,
) -> rusqlite::Result<usize> {
    match write {
        Write::Reading { device, property, value, at } => {
            memory.telemetry.write(transaction, (device, property), value, *at)
        }
        Write::Received { key, origin: (boot_id, seq), at } => {
            memory.streams.store(transaction, (key, boot_id, *seq), *at).map(|()| 0)
        }
        Write::Lost(gap) => memory.streams.lose(transaction, gap),
        Write::ForgetOld { days } => memory.telemetry.forget_old(transaction, *days).map(|()| 0),
        Write::Log { telescope, node, target, level, message, at, origin: (boot_id, seq) } => {
            let level = match level {
                Level::Error => "error",
                Level::Warn => "warning",
                Level::Info => "info",
            };
            transaction
                .prepare_cached("INSERT INTO log VALUES (?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING")?
                .execute(params![stamp(*at), level, message, node, target, telescope, boot_id.as_str(), *seq as i64])
        }
        Write::Writing { frame, file } => transaction
            .prepare_cached("INSERT OR REPLACE INTO writing VALUES (?,?)")?
            .execute(params![frame.0, file])
            .map(|_| 0),
        Write::Announced(frame) => {
            let (frame, json) = without_url(frame)?;
            transaction
                .prepare_cached("UPDATE images SET frame = ? WHERE frame_id = ?")?
                .execute(params![json, frame.id.0])
        }
        Write::Stored(image, path) => {
            let (frame, json) = without_url(&image.frame)?;
            transaction.prepare_cached("DELETE FROM writing WHERE frame_id = ?")?.execute([&frame.id.0])?;
            transaction
                .prepare_cached("INSERT INTO images VALUES (?,?,0,?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING")?
                .execute(params![
                    path.to_string_lossy(),
                    frame.camera,
                    stamp(frame.started_utc),
                    frame.id.0,
                    image.file,
                    frame.sha256,
                    image.bytes as i64,
                    stamp(image.stored),
                    json,
                    telescope,
                ])
        }
        Write::Audit(record) => transaction
            .prepare_cached("INSERT INTO audit VALUES (?,?,?,?,?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING")?
            .execute(params![
                record.node,
                record.chain,
                record.number,
                record.at.map(stamp),
                record.from,
                record.device,
                record.verb,
                record.token,
                record.outcome,
                record.line,
                record.sha256,
                record.fault,
            ]),
        Write::Correction(stored) => super::guiding::write(transaction, stored),
        Write::Facts(stored) => {
            let StoredFacts { facts, at, origin: (boot_id, seq) } = &**stored;
            let json =
                serde_json::to_string(facts).map_err(|e| rusqlite::Error::ToSqlConversionFailure(Box::new(e)))?;
            transaction.prepare_cached(PUT_FACTS)?.execute(params![
                facts.frame.0,
                facts.camera,
                facts.filter,
                facts.image_type,
                facts.started_utc.map(stamp),
                facts.stars,
                facts.fwhm_px,
                facts.fwhm_error_px,
                facts.ellipticity,
                facts.elongation_deg,
                facts.trailed,
                facts.sky_adu,
                facts.noise_adu,
                facts.saturated_fraction,
                facts.defect_fraction,
                facts.zero_point_mag,
                facts.transparency,
                facts.reason,
                json,
                stamp(*at),
                boot_id.as_str(),
                *seq as i64,
                facts.ra_deg,
                facts.dec_deg,
                facts.scale_arcsec_px,
                facts.rotation_deg,
                facts.mirrored,
                facts.matched,
                facts.rms_px,
                facts.false_alarm,
                facts.off_target_arcmin,
                facts.airmass,
                facts.zero_point_error_mag,
                facts.unsolved.as_ref().map(|unsolved| word(&unsolved.class)).transpose()?,
                telescope,
            ])
        }
        Write::Focus(stored) => write_run(transaction, telescope, stored),
        Write::State(stored) => happenings::write_state(transaction, telescope, stored),
        Write::Row(stored) => happenings::write_row(transaction, telescope, stored),
        Write::Alerts(stored) => happenings::write_alerts(transaction, telescope, stored),
        Write::Fluxes(stored) => happenings::write_fluxes(transaction, stored),
        Write::FactsTaken { frame, origin: (boot_id, seq), in_header } => transaction
            .prepare_cached("UPDATE facts SET in_header = ? WHERE frame_id = ? AND boot_id = ? AND seq = ?")?
            .execute(params![if *in_header { 1 } else { 2 }, frame.0, boot_id.as_str(), *seq as i64])
            .map(|_| 0),
        Write::Recomplete(frame) => transaction
            .prepare_cached("UPDATE images SET complete_hdr = 0 WHERE frame_id = ?")?
            .execute([&frame.0])
            .map(|_| 0),
        Write::Complete(frame) => transaction
            .prepare_cached("UPDATE images SET complete_hdr = 1 WHERE frame_id = ?")?
            .execute([&frame.0])
            .map(|_| 0),
    }
}

fn write_run(transaction: &Transaction<'_>, telescope: &str, stored: &StoredRun) -> rusqlite::Result<usize> {
    let StoredRun { run, plot, at, origin: (boot_id, seq) } = stored;
    let new = transaction
        .prepare_cached(
            "INSERT INTO focus_runs VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING",
        )?
        .execute(params![
            run.id.0,
            run.camera,
            run.focuser,
            run.filter,
            stamp(run.started_utc),
            run.ended_utc.map(stamp),
            word(&run.outcome)?,
            run.reason,
            run.start_position,
            run.best_position,
            run.best_position_error,
            run.stored_position,
            run.critical_zone,
            run.verified,
            run.operator,
            run.temperature_c,
            run.altitude_deg,
            plot,
            json(run)?,
            stamp(*at),
            boot_id.as_str(),
            *seq as i64,
            telescope,
        ])?;
    if new == 0 {
        return Ok(0);
    }
    let mut put =
        transaction.prepare_cached("INSERT INTO focus_points VALUES (?,?,?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING")?;
    for (number, point) in run.points.iter().enumerate() {
        put.execute(params![
            run.id.0,
            number as i64,
            point.position,
            word(&point.pass)?,
            point.value,
            point.error,
            point.stars,
            point.reason,
            point.temperature_c,
            point.used,
        ])?;
    }
    Ok(new + run.points.len())
}

/// A frame as the database stores it: the token in its URL opens the frame in the spool, so the URL is left out.
fn without_url(frame: &Frame) -> Result<(Frame, String), rusqlite::Error> {
    let frame = Frame { url: String::new(), ..frame.clone() };
    let text = json(&frame)?;
    Ok((frame, text))
}
