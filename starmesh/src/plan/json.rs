//! A plan for programs: one JSON object a line.

use contract::observatory::RowStatus;
use schedule::plan::{PlannedNight, PlannedRow, Site};
use serde_json::{Map, Value, json};
use units::Utc;

use super::Planned;

/// The overheads, then of each file its rows and its night.
pub fn lines(planned: &[Planned], site: &Site) -> Vec<String> {
    let mut lines = vec![overheads(planned, site)];
    for Planned { file, night } in planned {
        let file = file.display().to_string();
        lines.extend(night.rows.iter().map(|planned| row(&file, planned)));
        lines.push(totals(&file, night));
    }
    lines.iter().map(Value::to_string).collect()
}

/// Each figure with its origin.
fn overheads(planned: &[Planned], site: &Site) -> Value {
    let told = site.overheads.told().into_iter().map(|(name, figure, unit)| {
        json!({ "name": name, "value": to_ms(figure.value), "unit": unit, "measured": figure.measured })
    });
    let rows = planned.iter().flat_map(|planned| &planned.night.rows);
    let cameras: Map<String, Value> = rows
        .map(|row| {
            let sensor = site.overheads.sensor(row.camera.as_str());
            let [width_px, height_px] = sensor.size_px;
            let about = json!({
                "width_px": width_px, "height_px": height_px, "bytes_per_px": to_ms(sensor.bytes_per_px),
                "measured": sensor.measured,
            });
            (row.camera.to_string(), about)
        })
        .collect();
    json!({ "overheads": told.collect::<Vec<_>>(), "cameras": cameras })
}

fn row(file: &str, row: &PlannedRow) -> Value {
    let time = |at: Utc| at.to_string();
    let runs: Vec<Value> = row.runs.iter().map(|(start, end)| json!([time(*start), time(*end)])).collect();
    let heights = row.heights.as_ref();
    let curve = heights.map(|heights| {
        heights.curve.iter().map(|(at, deg)| json!([time(*at), (100.0 * deg).round() / 100.0])).collect::<Vec<_>>()
    });
    json!({
        "file": file, "row": row.index, "line": row.line, "action": row.action, "object": row.object,
        "camera": row.camera.as_str(),
        "window_utc": [time(row.window.0), time(row.window.1)],
        "start_utc": row.span().map(|(start, _)| time(start)),
        "end_utc": row.span().map(|(_, end)| time(end)),
        "runs_utc": runs, "status": status(row.status), "whole": row.is_whole(),
        "frames": row.frames, "frames_wanted": row.frames_wanted,
        "exposed_s": to_ms(row.exposed_s), "gigabytes": to_ms(row.bytes / 1e6) / 1e3,
        "altitude_min_deg": heights.map(|heights| to_ms(heights.min_deg)),
        "altitude_max_deg": heights.map(|heights| to_ms(heights.max_deg)),
        "airmass_at_mid": heights.and_then(|heights| heights.airmass_at_mid).map(to_ms),
        "altitude_curve": curve, "note": row.note,
    })
}

fn totals(file: &str, night: &PlannedNight) -> Value {
    json!({
        "file": file, "rows": night.rows.len(), "rows_at_risk": night.at_risk().count(), "frames": night.frames(),
        "gigabytes": to_ms(night.bytes() / 1e9), "open_s": to_ms(night.open_s),
        "closed_utc": night.closed.map(|closed| closed.to_string()),
        "dark_s": to_ms(night.dark_s), "dark_exposed_s": to_ms(night.dark_exposed_s),
    })
}

/// Three digits are enough for a forecast.
fn to_ms(value: f64) -> f64 {
    (1000.0 * value).round() / 1000.0
}

/// The word of the status on the bus.
fn status(status: RowStatus) -> Value {
    serde_json::to_value(status).unwrap_or_default()
}
