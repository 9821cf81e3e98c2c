//! For any schedule: forecasts end, no camera and no mount works at two rows at once, nothing needs the sky by day, and
//! no row lasts longer than its action allows in the observatory node.

use contract::observatory::RowStatus;
use proptest::prelude::*;
use schedule::action::ACTIONS;
use schedule::plan::{PlannedRow, forecast};
use units::Utc;

const OBJECT: &str = r#"{"object": "x", "exptime": EXPTIME, "ra": RA, "dec": -30, "execute_parallel": PARALLEL}"#;
const COUNTED: &str =
    r#"{"object": "y", "exptime": EXPTIME, "ra": RA, "dec": -60, "n": 7, "filter": "V", "pointing": true}"#;
const STARING: &str =
    r#"{"object": "z", "exptime": EXPTIME, "disable_telescope_movement": true, "execute_parallel": PARALLEL}"#;
const BIASES: &str = r#"{"exptime": [0, EXPTIME], "n": [3, 4], "execute_parallel": PARALLEL}"#;
/// After the last exposure of a row its frame is read, and the frames of the row are written to disk; a cover opens
/// again.
const AFTER_S: f64 = 2.0 + 2.0 + 10.0;

/// An opening, a slew, also that of a meridian flip, and an acquisition that begin within the window may end after it.
const SLEW_S: f64 = 90.0;

/// A row: sort, second camera, parallel, begin in minutes after 20:00, length in minutes, exposure, right ascension.
type Drawn = (usize, bool, bool, u32, u32, f64, f64);

fn sorts() -> Vec<(&'static str, &'static str)> {
    let mut sorts: Vec<_> = ACTIONS.iter().map(|entry| (entry.name, entry.example)).collect();
    sorts.extend([("object", OBJECT), ("object", COUNTED), ("object", STARING), ("calibration", BIASES)]);
    sorts
}

fn text(drawn: &[Drawn]) -> String {
    let evening: Utc = "2026-11-20T20:00:00Z".parse().unwrap();
    let sorts = sorts();
    let row = |(sort, second, parallel, from_min, length_min, exptime, ra): &Drawn| {
        let (action, value) = sorts[sort % sorts.len()];
        let value =
            value.replace("PARALLEL", &parallel.to_string()).replace("EXPTIME", &format!("{:.2}", exptime.max(0.01)));
        let value = value.replace("RA", &format!("{ra:.3}")).replace('\n', " ");
        // The second camera has no wheel.
        let has_filter = value.contains("filter");
        let camera = if *second && !has_filter { "second" } else { "main" };
        let start = evening.plus_seconds(60.0 * f64::from(*from_min));
        let end = start.plus_seconds(60.0 * f64::from(*length_min));
        format!(
            "{{\"device_name\": \"{camera}\", \"action_type\": \"{action}\", \"action_value\": {value}, \
             \"start_time\": \"{start}\", \"end_time\": \"{end}\"}}\n"
        )
    };
    drawn.iter().map(row).collect()
}

/// Runs of two rows that are under way at one time.
fn overlap(a: &PlannedRow, b: &PlannedRow) -> bool {
    let meet = |(one, other): (&(Utc, Utc), &(Utc, Utc))| one.0 < other.1 && other.0 < one.1;
    a.runs.iter().any(|one| b.runs.iter().any(|other| meet((one, other))))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn rows_never_share_a_camera_or_the_mount_and_keep_to_their_windows_and_to_the_night(
        drawn in prop::collection::vec(
            (0..64_usize, any::<bool>(), any::<bool>(), 0..900_u32, 1..300_u32, 0.0..400.0_f64, 0.01..120.0_f64), 1..9),
        storm in (0..900_u32, 1..120_u32),
    ) {
        let evening: Utc = "2026-11-20T20:00:00Z".parse().unwrap();
        let mut site = super::site();
        let from = evening.plus_seconds(60.0 * f64::from(storm.0));
        let storm = (from, from.plus_seconds(60.0 * f64::from(storm.1)));
        site.unsafe_spans = vec![storm];
        let night = forecast(super::rows(&text(&drawn)), &mut site).unwrap();
        let rows = &night.rows;
        for (n, row) in rows.iter().enumerate() {
            let has_ended = matches!(row.status, RowStatus::Finished | RowStatus::Failed | RowStatus::Skipped);
            prop_assert!(has_ended, "{row:?}");
            prop_assert!(row.is_whole() || !row.note.is_empty(), "nothing is reported about {row:?}");
            prop_assert!(row.frames_wanted.is_none_or(|wanted| row.frames <= wanted), "{row:?}");
            for (start, end) in &row.runs {
                prop_assert!(start <= end && row.window.0 <= *start && *start <= row.window.1, "{row:?}");
                if row.needs_safe {
                    prop_assert!(site_sun(*start) <= 0.05 && site_sun(*end) <= 0.05, "under the Sun: {row:?}");
                    prop_assert!(!(*start < storm.1 && storm.0 < *end), "in the storm: {row:?}");
                }
                if row.frames > 0 {
                    let most_s = if row.has_mount { AFTER_S + SLEW_S } else { AFTER_S };
                    prop_assert!(end.seconds_since(row.window.1) <= most_s, "it does not end: {row:?}");
                }
            }
            for other in &rows[n + 1..] {
                let shares = row.camera == other.camera || (row.has_mount && other.has_mount);
                prop_assert!(!(shares && overlap(row, other)), "{row:?}\n{other:?}");
            }
        }
    }
}

/// The Sun's altitude, deg.
fn site_sun(at: Utc) -> f64 {
    let config = config::parse(super::SITE, std::path::Path::new(".")).unwrap();
    schedule::plan::sky::Sky::of(&config.place).unwrap().sun_deg(at).unwrap()
}
