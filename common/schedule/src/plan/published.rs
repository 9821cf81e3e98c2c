//! A forecast as it is published: by the bus, the API and `starmesh plan --json`.

use std::collections::BTreeSet;

use contract::observatory::{AltitudePoint, NightPlan, OverheadFigure, RowPlan, SchedulePlan, SensorFigure};
use units::Utc;

use super::{PlannedNight, PlannedRow, Site};

/// Points of all altitude curves together: the bus carries no larger answer than 4 MiB.
const MOST_POINTS: usize = 20_000;

impl PlannedNight {
    /// With the figures that it is made of.
    pub fn published(&self, site: &Site) -> SchedulePlan {
        let mut rows: Vec<RowPlan> = self.rows.iter().map(PlannedRow::published).collect();
        let points: usize = rows.iter().filter_map(|row| Some(row.altitude_curve.as_ref()?.len())).sum();
        let problem = (points > MOST_POINTS).then(|| {
            rows.iter_mut().for_each(|row| row.altitude_curve = None);
            format!("the altitude curves are left out: {points} points, more than {MOST_POINTS}")
        });
        let (overheads, cameras) = site.figures(self);
        SchedulePlan { rows, night: Some(self.sums()), overheads, cameras, findings: Vec::new(), problem }
    }

    /// The sums.
    pub fn sums(&self) -> NightPlan {
        NightPlan {
            rows: count(self.rows.len()),
            rows_at_risk: count(self.at_risk().count()),
            frames: self.frames(),
            gigabytes: to_ms(self.bytes() / 1e9),
            open_s: to_ms(self.open_s),
            closed_utc: self.closed,
            dark_s: to_ms(self.dark_s),
            dark_exposed_s: to_ms(self.dark_exposed_s),
        }
    }
}

impl PlannedRow {
    /// As it is published.
    pub fn published(&self) -> RowPlan {
        let heights = self.heights.as_ref();
        let rounded = |deg: &f64| (100.0 * deg).round() / 100.0;
        let point = |(at, deg): &(Utc, f64)| AltitudePoint { at_utc: *at, altitude_deg: rounded(deg) };
        let curve = heights.map(|heights| heights.curve.iter().map(point).collect());
        RowPlan {
            row: count(self.index),
            line: count(self.line),
            action: self.action.to_owned(),
            object: self.object.clone(),
            camera: self.camera.to_string(),
            window_utc: [self.window.0, self.window.1],
            start_utc: self.span().map(|(start, _)| start),
            end_utc: self.span().map(|(_, end)| end),
            runs_utc: self.runs.iter().map(|(start, end)| [*start, *end]).collect(),
            status: self.status,
            whole: self.is_whole(),
            frames: self.frames,
            frames_wanted: self.frames_wanted,
            exposed_s: to_ms(self.exposed_s),
            gigabytes: to_ms(self.bytes / 1e6) / 1e3,
            altitude_min_deg: heights.map(|heights| to_ms(heights.min_deg)),
            altitude_max_deg: heights.map(|heights| to_ms(heights.max_deg)),
            airmass_at_mid: heights.and_then(|heights| heights.airmass_at_mid).map(to_ms),
            altitude_curve: curve,
            note: self.note.clone(),
        }
    }
}

impl Site {
    /// Each figure with its origin, and the pixels of the cameras of a forecast.
    pub fn figures(&self, night: &PlannedNight) -> (Vec<OverheadFigure>, Vec<SensorFigure>) {
        let overheads = self.overheads.figures().into_iter().map(|(name, figure, unit)| OverheadFigure {
            name,
            value: to_ms(figure.value),
            unit: unit.to_owned(),
            measured: count(figure.measured),
        });
        let names: BTreeSet<&str> = night.rows.iter().map(|row| row.camera.as_str()).collect();
        let cameras = names.into_iter().map(|camera| {
            let sensor = self.overheads.sensor(camera);
            let [width_px, height_px] = sensor.size_px;
            let (bytes_per_px, measured) = (to_ms(sensor.bytes_per_px), count(sensor.measured));
            SensorFigure { camera: camera.to_owned(), width_px, height_px, bytes_per_px, measured }
        });
        (overheads.collect(), cameras.collect())
    }
}

fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

/// Three digits are enough for a forecast.
fn to_ms(value: f64) -> f64 {
    (1000.0 * value).round() / 1000.0
}
