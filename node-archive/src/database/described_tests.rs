//! The page about the schema is what the schema is, and the views give what people read; `UPDATE_DOCS=1 cargo test -p
//! node-archive described` writes the page again.

use super::*;

use crate::document;

const VIEWS: [&str; 3] = ["frames", "weather", "guiding_errors"];

#[test]
fn the_page_about_the_database_is_what_the_schema_declares() {
    document::shows("docs/operator/database.md", &page().unwrap());
}

#[test]
fn every_column_has_a_meaning_and_every_meaning_a_column() {
    let (_, meanings) = meanings();
    let mut known = Vec::new();
    for shape in shapes().unwrap() {
        known.push((shape.name.clone(), String::new()));
        known.extend(shape.columns.into_iter().map(|(column, _)| (shape.name.clone(), column)));
    }
    let unknown: Vec<_> = meanings.keys().filter(|key| !known.contains(key)).collect();
    let silent: Vec<_> =
        known.iter().filter(|key| meanings.get(key).is_none_or(|(_, about)| about.is_empty())).collect();
    assert!(unknown.is_empty() && silent.is_empty(), "no such columns: {unknown:?}; without a meaning: {silent:?}");
}

#[test]
fn columns_of_the_views_have_a_type_and_a_name_has_one_meaning() {
    let (_, meanings) = meanings();
    let mut by_name: BTreeMap<String, (String, String)> = BTreeMap::new();
    for shape in shapes().unwrap().into_iter().filter(|shape| VIEWS.contains(&shape.name.as_str())) {
        for (column, affinity) in shape.columns {
            assert!(
                ["TEXT", "INT", "INTEGER", "REAL"].contains(&affinity.as_str()),
                "{}.{column}: {affinity:?}",
                shape.name
            );
            let (unit, mut meaning) = meanings[&(shape.name.clone(), column.clone())].clone();
            // Rows of shared devices are in one of the views.
            meaning = meaning.replace(", or `shared`", "");
            let first = by_name.entry(column.clone()).or_insert((unit.clone(), meaning.clone()));
            assert_eq!(*first, (unit, meaning), "{column}");
        }
    }
}

/// The texts of a row of a view, with their columns.
fn row(connection: &Connection, sql: &str) -> BTreeMap<String, rusqlite::types::Value> {
    let mut asked = connection.prepare(sql).unwrap();
    let names: Vec<String> = asked.column_names().into_iter().map(str::to_owned).collect();
    asked
        .query_row([], |row| {
            names.iter().enumerate().map(|(at, name)| Ok((name.clone(), row.get(at)?))).collect::<rusqlite::Result<_>>()
        })
        .unwrap()
}

/// A guided frame, with the errors that its stars showed, px.
fn guided(id: &str, at: &str, east: f64, north: f64) -> String {
    format!(
        "INSERT INTO guiding (frame_id, datetime, telescope, camera_name, reference, stage, shift_x, shift_y, stars, east_why, east_error_px,
            east_expected_px, east_drift_px_per_s, east_pulse_ms, east_given_ms, north_why, north_error_px, north_expected_px,
            north_drift_px_per_s, north_pulse_ms, north_given_ms, correction, boot_id, seq)
         VALUES ('{id}', '2026-11-21 03:{at}', 'callisto', 'guider', 'g', 'guide', {east}, {north}, 9, '', {east}, 0, 0, 0, 7, '', {north}, 0, 0, 0, -7, '', 'b', 1);"
    )
}

#[test]
fn a_guided_frame_without_a_solution_has_the_newest_scale_of_its_camera_and_binning_or_none() {
    let mut connection = Connection::open_in_memory().unwrap();
    migrations::bring_up(&mut connection).unwrap();
    // Binned in one night, and before and after other optics in others.
    let solved = [("a", 1, "2025-11-21", "1.0"), ("b", 2, "2025-12-21", "2.5"), ("c", 1, "2026-11-20", "1.25")];
    let unsolved = [("d", 1), ("e", 2), ("f", 3)].map(|(id, bin)| (id, bin, "2026-11-21", "NULL"));
    for (id, bin, date, scale) in solved.into_iter().chain(unsolved) {
        connection
            .execute_batch(&format!(
                "INSERT INTO images (filename, camera_name, complete_hdr, date_obs, frame_id, file, sha256, bytes, stored, frame, telescope)
                    VALUES ('', 'guider', 1, '{date} 03:00:00', '{id}', '{id}.fits', '', 1, '', '{{\"bin\": {bin}}}', 'callisto');
                 INSERT INTO facts (frame_id, camera_name, telescope, date_obs, scale_arcsec_px, facts, datetime, boot_id, seq, in_header)
                    VALUES ('{id}', 'guider', 'callisto', '{date} 03:00:00', {scale}, '{{}}', '', '', 1, 1);
                 {}",
                guided(id, "00:10.000000", 1.0, 2.0),
            ))
            .unwrap();
    }
    let mut asked =
        connection.prepare("SELECT ra_error_arcsec, dec_error_arcsec FROM guiding_errors ORDER BY frame_id").unwrap();
    let errors = asked.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    let errors: Vec<(Option<f64>, Option<f64>)> = errors.map(Result::unwrap).collect();
    let of_scale = |scale: f64| (Some(scale), Some(2.0 * scale));
    let expected = [of_scale(1.0), of_scale(2.5), of_scale(1.25), of_scale(1.25), of_scale(2.5), (None, None)];
    assert_eq!(errors, expected);
}

/// A frame of 60 s with two guided frames in it and one before, a scale, and a minute of weather.
#[test]
fn views_give_angles_on_the_sky_and_times_with_their_zone() {
    use rusqlite::types::Value::{Integer, Null, Real, Text};
    let mut connection = Connection::open_in_memory().unwrap();
    migrations::bring_up(&mut connection).unwrap();
    let frame = r#"{"exposure_s": 60.0, "purpose": {"night": "20261120", "object": "TRAPPIST-1", "filter": "r", "image_type": "Light Frame", "programme": "P.1", "row": 4}}"#;
    connection
        .execute_batch(&format!(
            "INSERT INTO images (filename, camera_name, complete_hdr, date_obs, frame_id, file, sha256, bytes, stored, frame, telescope)
                VALUES ('/data/a.fits', 'andor', 1, '2026-11-21 03:00:01.500000', 'f1', '20261120/a.fits', '', 1, '', '{frame}', 'callisto');
             INSERT INTO facts (frame_id, camera_name, telescope, stars, fwhm_px, scale_arcsec_px, airmass, facts, datetime, boot_id, seq, in_header)
                VALUES ('f1', 'andor', 'callisto', 30, 4.0, 0.5, 1.25, '{{\"target_saturated\": true}}', '', '', 1, 1),
                       ('g1', 'guider', 'callisto', 9, 2.0, 2.0, NULL, '{{}}', '', '', 1, 1);
             {}{}{}
             INSERT INTO series (id, telescope, device_type, device_name, device_command) VALUES
                (1, 'callisto', 'ObservingConditions', 'wx', 'Temperature'), (2, 'callisto', 'ObservingConditions', 'wx', 'WindGust'),
                (3, 'callisto', 'Telescope', 'mount', 'Altitude');
             INSERT INTO minutes VALUES (1, 29920500, 6, 0, 8.0, 9.0, 10.0, 0, 9.0), (2, 29920500, 6, 0, 3.0, 5.0, 12.5, 0, 4.0),
                (3, 29920500, 6, 0, 1.0, 2.0, 3.0, 0, 2.0);",
            guided("g0", "00:00.000000", 99.0, 99.0),
            guided("g1", "00:10.000000", 0.3, 0.0),
            guided("g2", "00:40.000000", 0.4, 1.0),
        ))
        .unwrap();
    let frame = row(&connection, "SELECT * FROM frames");
    let text = |text: &str| Text(text.to_owned());
    for (column, expected) in [
        ("telescope", text("callisto")),
        ("file", text("20261120/a.fits")),
        ("object", text("TRAPPIST-1")),
        ("filter", text("r")),
        ("programme", text("P.1")),
        ("target_saturated", Integer(1)),
        ("schedule_row", Integer(4)),
        ("start_utc", text("2026-11-21T03:00:01.500000Z")),
        ("mid_utc", text("2026-11-21T03:00:31.500Z")),
        ("exposure_s", Real(60.0)),
        ("fwhm_arcsec", Real(2.0)),
        ("airmass_mid", Real(1.25)),
    ] {
        assert_eq!(frame[column], expected, "{column}");
    }
    let real = |value: &rusqlite::types::Value| if let Real(value) = value { *value } else { panic!("{value:?}") };
    // 0.3 px and 0.4 px of 2 arcsec: the scale of the guide camera, also of the frame that was not solved.
    assert!((real(&frame["guide_ra_rms_arcsec"]) - 2.0 * (0.125_f64).sqrt()).abs() < 1e-9, "{frame:?}");
    assert!((real(&frame["guide_dec_rms_arcsec"]) - 2.0 * (0.5_f64).sqrt()).abs() < 1e-9, "{frame:?}");
    assert!((real(&frame["guide_rms_arcsec"]) - 2.0 * (0.625_f64).sqrt()).abs() < 1e-9, "{frame:?}");
    let weather = row(&connection, "SELECT *, count(*) OVER () AS rows FROM weather");
    assert_eq!((&weather["rows"], &weather["station"]), (&Integer(1), &text("wx")));
    assert_eq!(weather["minute_utc"], text("2026-11-21T03:00:00Z"));
    assert_eq!(
        (&weather["temperature_c"], &weather["gust_m_s"], &weather["wind_m_s"]),
        (&Real(9.0), &Real(12.5), &Null)
    );
    let guided = row(&connection, "SELECT * FROM guiding_errors WHERE frame_id = 'g2'");
    assert_eq!((&guided["mid_utc"], &guided["ra_pulse_ms"]), (&text("2026-11-21T03:00:40.000000Z"), &Integer(7)));
    assert_eq!((&guided["ra_error_arcsec"], &guided["dec_error_arcsec"]), (&Real(0.8), &Real(2.0)));
}
