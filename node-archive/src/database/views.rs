//! Views for people and their programs: typed columns, times that say their zone, angles on the sky in arcsec, and one meaning
//! per name of a column.

use super::guiding::holding;

/// The square root of a term, by sixteen of Newton's steps: many builds of SQLite have no `sqrt`. Exact for angles of 1 mas to 100
/// arcsec.
macro_rules! root {
    ($square:literal) => {
        concat!(
            "CAST(iif(",
            $square,
            " = 0, 0, (WITH RECURSIVE steps(step, root) AS (SELECT 0, (1 + ",
            $square,
            ") / 2
            UNION ALL SELECT step + 1, (root + ",
            $square,
            " / root) / 2 FROM steps WHERE step < 16)
            SELECT root FROM steps WHERE step = 16)) AS REAL)"
        )
    };
}

/// Replaces the views of another Starmesh. `frames` has a row for each stored frame, `weather` one for each minute of each
/// station, and `guiding_errors` one for each guided frame. A frame's scale is that of its solution, or
/// that of the newest solved frame of its camera and binning.
pub(super) const SCHEMA: &str = concat!(
    "
DROP VIEW IF EXISTS frames;
DROP VIEW IF EXISTS weather;
DROP VIEW IF EXISTS guiding_errors;
CREATE VIEW guiding_errors AS
    WITH scales AS (
        -- Beside max() SQLite gives the columns of the row that has it.
        SELECT facts.telescope, facts.camera_name, json_extract(images.frame, '$.bin') AS bin,
            facts.scale_arcsec_px AS newest_arcsec_px, max(facts.date_obs)
        FROM facts LEFT JOIN images USING (frame_id) WHERE facts.scale_arcsec_px IS NOT NULL
        GROUP BY facts.telescope, facts.camera_name, bin
    )
    SELECT guiding.frame_id, guiding.telescope, guiding.camera_name AS camera, guiding.object, guiding.filter,
        CAST(replace(guiding.datetime, ' ', 'T') || 'Z' AS TEXT) AS mid_utc, guiding.stage,
        CAST(guiding.east_error_px * ifnull(facts.scale_arcsec_px, newest_arcsec_px) AS REAL) AS ra_error_arcsec,
        CAST(guiding.north_error_px * ifnull(facts.scale_arcsec_px, newest_arcsec_px) AS REAL) AS dec_error_arcsec,
        guiding.east_given_ms AS ra_pulse_ms, guiding.north_given_ms AS dec_pulse_ms, guiding.stars
    FROM guiding LEFT JOIN facts ON facts.frame_id = guiding.frame_id
        LEFT JOIN images ON images.frame_id = guiding.frame_id
        LEFT JOIN scales ON scales.telescope = guiding.telescope AND scales.camera_name = guiding.camera_name
            AND scales.bin IS json_extract(images.frame, '$.bin');
CREATE VIEW frames AS
    WITH errors AS (
        SELECT held.frame_id, avg(ra_error_arcsec * ra_error_arcsec) AS ra2, avg(dec_error_arcsec * dec_error_arcsec) AS dec2
        FROM (",
    holding!(
        "(SELECT frame_id, telescope, camera_name, date_obs AS begins, strftime('%Y-%m-%d %H:%M:%f', date_obs,
            json_extract(frame, '$.exposure_s') || ' seconds') || '999' AS ends FROM images)"
    ),
    ") AS held JOIN guiding_errors ON guiding_errors.frame_id = held.guide_id
        GROUP BY held.frame_id
    )
    SELECT images.frame_id, images.telescope, images.camera_name AS camera, images.file, images.night, images.object,
        images.filter, images.image_type, CAST(json_extract(frame, '$.purpose.programme') AS TEXT) AS programme,
        CAST(json_extract(frame, '$.purpose.row') AS INTEGER) AS schedule_row,
        CAST(replace(images.date_obs, ' ', 'T') || 'Z' AS TEXT) AS start_utc,
        CAST(strftime('%Y-%m-%dT%H:%M:%f', images.date_obs, (json_extract(frame, '$.exposure_s') / 2) || ' seconds') || 'Z' AS TEXT) AS mid_utc,
        CAST(json_extract(frame, '$.exposure_s') AS REAL) AS exposure_s,
        facts.stars, facts.fwhm_px, CAST(facts.fwhm_px * facts.scale_arcsec_px AS REAL) AS fwhm_arcsec,
        facts.ellipticity, facts.sky_adu, facts.saturated_fraction, facts.ra_deg, facts.dec_deg, facts.scale_arcsec_px,
        facts.off_target_arcmin, CAST(json_extract(facts.facts, '$.target_saturated') AS INTEGER) AS target_saturated,
        facts.airmass AS airmass_mid, facts.transparency, facts.zero_point_mag,
        ",
    root!("ra2"),
    " AS guide_ra_rms_arcsec, ",
    root!("dec2"),
    " AS guide_dec_rms_arcsec, ",
    root!("(ra2 + dec2)"),
    " AS guide_rms_arcsec
    FROM images LEFT JOIN facts USING (frame_id) LEFT JOIN errors USING (frame_id);
CREATE VIEW weather AS
    SELECT series.telescope, series.device_name AS station,
        CAST(strftime('%Y-%m-%dT%H:%M:%SZ', minute * 60, 'unixepoch') AS TEXT) AS minute_utc,
        CAST(max(iif(device_command = 'Temperature', mean, NULL)) AS REAL) AS temperature_c,
        CAST(max(iif(device_command = 'DewPoint', mean, NULL)) AS REAL) AS dew_point_c,
        CAST(max(iif(device_command = 'Humidity', mean, NULL)) AS REAL) AS humidity_percent,
        CAST(max(iif(device_command = 'Pressure', mean, NULL)) AS REAL) AS pressure_hpa,
        CAST(max(iif(device_command = 'WindSpeed', mean, NULL)) AS REAL) AS wind_m_s,
        CAST(max(iif(device_command = 'WindGust', maximum, NULL)) AS REAL) AS gust_m_s,
        CAST(max(iif(device_command = 'RainRate', maximum, NULL)) AS REAL) AS rain_mm_h,
        CAST(max(iif(device_command = 'CloudCover', mean, NULL)) AS REAL) AS cloud_percent,
        CAST(max(iif(device_command = 'SkyTemperature', mean, NULL)) AS REAL) AS sky_temperature_c,
        CAST(max(iif(device_command = 'SkyQuality', mean, NULL)) AS REAL) AS sky_mag_arcsec2
    FROM minutes JOIN series ON series.id = minutes.series WHERE device_type = 'ObservingConditions'
    GROUP BY series.telescope, series.device_name, minute;
"
);
