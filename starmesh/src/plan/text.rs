//! A plan for people: rows, altitude curves, what will not run, totals, and where the figures come from.

use contract::observatory::RowStatus;
use schedule::plan::{Figure, Heights, PlannedNight, PlannedRow, Site};
use units::Utc;

use super::Planned;

/// Columns of an altitude curve; it covers the schedule from its first to its last row.
const WIDTH: u32 = 72;
/// Altitudes from 0 to 90 deg.
const BLOCKS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
const GB: f64 = 1e9;

/// All lines of the forecast.
pub fn lines(planned: &[Planned], site: &Site) -> Vec<String> {
    let mut lines = Vec::new();
    match planned {
        [only] => lines.extend(whole(only, site)),
        many => lines.extend(many.iter().flat_map(|one| brief(one, site))),
    }
    if planned.len() > 1 {
        lines.push(all(planned, site));
    }
    lines.push(String::new());
    lines.extend(origin(planned, site));
    lines
}

/// One night in full.
fn whole(planned: &Planned, site: &Site) -> Vec<String> {
    let night = &planned.night;
    let mut lines = vec![format!("plan of {} (UTC)", planned.file.display())];
    lines.extend(table(&night.rows));
    lines.extend(curves(&night.rows));
    lines.extend(at_risk(night));
    lines.push(totals(night, site));
    lines
}

/// One of many nights: its totals, and what will not run.
fn brief(planned: &Planned, site: &Site) -> Vec<String> {
    let mut lines = vec![format!("{}: {}", planned.file.display(), totals(&planned.night, site))];
    lines.extend(planned.night.at_risk().map(|row| format!("  {}", risk(row))));
    lines
}

fn table(rows: &[PlannedRow]) -> Vec<String> {
    let head = ["line", "action", "object", "camera", "start", "end", "frames", "GB", "altitude", "airmass", "note"];
    let mut cells: Vec<Vec<String>> = vec![head.map(str::to_owned).to_vec()];
    cells.extend(rows.iter().map(|row| {
        let (start, end) = match row.span() {
            Some((start, end)) if end.seconds_since(start) >= 86_400.0 => {
                (start.strftime("%m-%d %H:%M:%S"), end.strftime("%m-%d %H:%M:%S"))
            }
            Some((start, end)) => (start.strftime("%m-%d %H:%M:%S"), end.strftime("%H:%M:%S")),
            None => ("-".to_owned(), "-".to_owned()),
        };
        let wanted = row.frames_wanted.map(|wanted| format!("/{wanted}")).unwrap_or_default();
        let frames =
            if row.frames == 0 && row.frames_wanted.is_none() { String::new() } else { row.frames.to_string() };
        let altitude = row.heights.as_ref().map(|heights| format!("{:.0}..{:.0}", heights.min_deg, heights.max_deg));
        let airmass = row.heights.as_ref().and_then(|heights| heights.airmass_at_mid);
        vec![
            row.line.to_string(),
            row.action.to_owned(),
            row.object.clone().unwrap_or_default(),
            row.camera.to_string(),
            start,
            end,
            format!("{frames}{wanted}"),
            if row.bytes > 0.0 { format!("{:.2}", row.bytes / GB) } else { String::new() },
            altitude.unwrap_or_default(),
            airmass.map(|airmass| format!("{airmass:.2}")).unwrap_or_default(),
            row.note.clone(),
        ]
    }));
    let width = |column: usize| cells.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max();
    let widths: Vec<usize> = (0..head.len()).map(|column| width(column).unwrap_or(0)).collect();
    let line = |row: &Vec<String>| {
        let padded = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:width$}"));
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    cells.iter().map(line).collect()
}

/// How high each target stands while its row runs, over the hours.
fn curves(rows: &[PlannedRow]) -> Vec<String> {
    let shown: Vec<(&PlannedRow, &Heights)> =
        rows.iter().filter_map(|row| Some((row, row.heights.as_ref().filter(|_| row.span().is_some())?))).collect();
    let spans = || rows.iter().filter_map(PlannedRow::span);
    let (Some(from), Some(to)) = (spans().map(|(from, _)| from).min(), spans().map(|(_, to)| to).max()) else {
        return Vec::new();
    };
    let step_s = (to.seconds_since(from) / f64::from(WIDTH)).max(1.0);
    let name = |row: &PlannedRow| row.object.clone().unwrap_or_else(|| row.action.to_owned());
    let label = shown.iter().map(|(row, _)| name(row).chars().count()).max().unwrap_or(0);
    let mut lines = vec![String::new()];
    for (row, heights) in &shown {
        let column = |n: u32| block(heights, row, from.plus_seconds((f64::from(n) + 0.5) * step_s), 0.5 * step_s);
        let curve: String = (0..WIDTH).map(column).collect();
        let (min_deg, max_deg) = (heights.min_deg, heights.max_deg);
        lines.push(format!("{:label$}  {curve}  {min_deg:.0}..{max_deg:.0} deg", name(row)));
    }
    if !shown.is_empty() {
        lines.extend(axis(from, step_s).iter().map(|axis| format!("{:label$}  {axis}", "")));
    }
    lines
}

/// The altitude in a column, if the row runs in it.
fn block(heights: &Heights, row: &PlannedRow, at: Utc, half_s: f64) -> char {
    let runs =
        row.runs.iter().any(|(start, end)| *start <= at.plus_seconds(half_s) && at.plus_seconds(-half_s) <= *end);
    let nearest = heights.curve.iter().min_by(|(a, _), (b, _)| {
        let off = |point: &Utc| point.seconds_since(at).abs();
        off(a).total_cmp(&off(b))
    });
    match nearest {
        // `as` saturates.
        Some((_, deg)) if runs => BLOCKS[((deg / 90.0 * 8.0) as usize).min(BLOCKS.len() - 1)],
        _ => ' ',
    }
}

/// Hours between two ticks, the first that leaves room for its labels is taken.
const TICKS_H: [i64; 12] = [1, 2, 3, 6, 12, 24, 48, 96, 168, 336, 672, 2688];
const HOUR_US: i64 = 3_600_000_000;

/// The text under the columns: hours where there is room for them, each where it begins, and under them the days where
/// there is more than one.
fn axis(from: Utc, step_s: f64) -> Vec<String> {
    let every = |most_columns: f64| TICKS_H.into_iter().find(|hours| *hours as f64 * 3600.0 / step_s >= most_columns);
    let mut lines = Vec::new();
    if let Some(hours) = every(3.0).filter(|hours| *hours < 24) {
        lines.push(ticks(from, step_s, hours, "%H"));
    }
    let last = from.plus_seconds(f64::from(WIDTH) * step_s);
    let day = |at: Utc| at.micros().div_euclid(24 * HOUR_US);
    if day(last) > day(from) {
        // A label of five characters and a space.
        let hours = every(6.0).unwrap_or(2688).max(24);
        lines.push(ticks(from, step_s, hours, "%m-%d"));
    }
    lines.retain(|line| !line.is_empty());
    lines
}

/// A label in the column in which each multiple of so many hours begins.
fn ticks(from: Utc, step_s: f64, hours: i64, label: &str) -> String {
    let mut line = String::new();
    let tick = |at: Utc| at.micros().div_euclid(hours * HOUR_US);
    for n in 0..WIDTH {
        let (at, before) = (from.plus_seconds(f64::from(n + 1) * step_s), from.plus_seconds(f64::from(n) * step_s));
        let (column, length) = (n as usize, line.chars().count());
        let begins = Utc::from_micros(tick(at) * hours * HOUR_US);
        if tick(at) != tick(before) && (length < column || length == 0) {
            line.push_str(&format!("{:width$}{}", "", begins.strftime(label), width = column - length));
        }
    }
    line
}

/// Rows that will not run, or not whole.
fn at_risk(night: &PlannedNight) -> Vec<String> {
    let mut lines: Vec<String> = night.at_risk().map(|row| format!("  {}", risk(row))).collect();
    lines.insert(0, if lines.is_empty() { "every row runs whole".to_owned() } else { "not as asked for:".to_owned() });
    lines.insert(0, String::new());
    lines
}

fn risk(row: &PlannedRow) -> String {
    let what = row.object.as_deref().unwrap_or(row.action);
    let how = match row.status {
        RowStatus::Failed => "fails",
        RowStatus::Skipped if row.runs.is_empty() => "will not run",
        RowStatus::Skipped | RowStatus::Interrupted => "ends before its time",
        RowStatus::Finished => "is not whole",
        RowStatus::Pending | RowStatus::Running => "does not end",
    };
    let note = if row.note.is_empty() { String::new() } else { format!(": {}", row.note) };
    format!("line {}, {} {what} {how}{note}", row.line, row.action)
}

/// The size of all files, as far as it is known.
fn size<'a>(nights: impl Iterator<Item = &'a PlannedNight> + Clone, site: &Site) -> String {
    let is_unknown = |row: &PlannedRow| row.frames > 0 && site.overheads.sensor(row.camera.as_str()).measured == 0;
    match nights.clone().flat_map(|night| &night.rows).any(is_unknown) {
        true => "size not known yet".to_owned(),
        false => format!("{:.1} GB", nights.map(PlannedNight::bytes).sum::<f64>() / GB),
    }
}

fn totals(night: &PlannedNight, site: &Site) -> String {
    let closed = night.closed.map(|closed| format!(", closed at {}", closed.strftime("%H:%M:%S"))).unwrap_or_default();
    format!(
        "{} frames, {}; open for {:.1} h{closed}; {}",
        night.frames(),
        size(std::iter::once(night), site),
        night.open_s / 3600.0,
        dark(night.dark_s, night.dark_exposed_s),
    )
}

/// Nights of a high summer have none.
fn dark(dark_s: f64, exposed_s: f64) -> String {
    if dark_s <= 0.0 {
        return "never dark".to_owned();
    }
    format!("dark for {:.1} h, of which {:.0} % are exposed", dark_s / 3600.0, share(exposed_s, dark_s))
}

fn all(planned: &[Planned], site: &Site) -> String {
    let sum = |of: fn(&PlannedNight) -> f64| planned.iter().map(|planned| of(&planned.night)).sum::<f64>();
    let frames: u64 = planned.iter().map(|planned| planned.night.frames()).sum();
    format!(
        "{} schedules: {frames} frames, {}; open for {:.1} h; {}",
        planned.len(),
        size(planned.iter().map(|planned| &planned.night), site),
        sum(|night| night.open_s) / 3600.0,
        dark(sum(|night| night.dark_s), sum(|night| night.dark_exposed_s)),
    )
}

fn share(part: f64, of: f64) -> f64 {
    if of > 0.0 { 100.0 * part / of } else { 0.0 }
}

/// Which overheads were measured, and which are assumed.
fn origin(planned: &[Planned], site: &Site) -> Vec<String> {
    let status = site.overheads.figures();
    let one = |(name, figure, unit): &(String, Figure, &str)| format!("{name} {:.2} {unit}", figure.value);
    let measured: Vec<String> = status
        .iter()
        .filter(|(_, figure, _)| figure.measured > 0)
        .map(|figure| format!("{} (n = {})", one(figure), figure.1.measured))
        .collect();
    let assumed: Vec<String> = status.iter().filter(|(_, figure, _)| figure.measured == 0).map(one).collect();
    let mut cameras: Vec<&str> =
        planned.iter().flat_map(|planned| &planned.night.rows).map(|row| row.camera.as_str()).collect();
    cameras.sort_unstable();
    cameras.dedup();
    let cameras = cameras.into_iter().map(|name| {
        let sensor = site.overheads.sensor(name);
        let ([width, height], measured) = (sensor.size_px, sensor.measured);
        match measured {
            0 => format!("frames of {name}: none is archived, so that the size of their files is not known"),
            _ => format!(
                "frames of {name}: {width} x {height} px, {:.2} bytes each (n = {measured})",
                sensor.bytes_per_px
            ),
        }
    });
    let list = |what: &str, of: Vec<String>| {
        let none = || "none".to_owned();
        format!("{what}: {}", if of.is_empty() { none() } else { of.join(", ") })
    };
    [vec![list("measured, medians", measured), list("assumed", assumed)], cameras.collect()].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn under(from: &str, hours: f64) -> Vec<String> {
        axis(from.parse().unwrap(), hours * 3600.0 / f64::from(WIDTH))
    }

    #[test]
    fn a_night_has_hours_under_it_and_a_week_has_days() {
        let night = under("2026-11-21T22:30:00Z", 12.0);
        assert!(night[0].starts_with("  23    00    01    02"), "{night:?}");
        assert!(night[1].trim_start().starts_with("11-22") && night.len() == 2, "{night:?}");
        let three_days = under("2026-11-21T18:00:00Z", 72.0);
        assert!(three_days[0].starts_with("  21 00 03 06 09 12 15 18 21 00 03"), "{three_days:?}");
        assert_eq!(three_days[1].split_whitespace().collect::<Vec<_>>(), ["11-22", "11-23", "11-24"]);
        let month = under("2026-11-21T18:00:00Z", 720.0);
        assert_eq!(month.len(), 1, "{month:?}");
        let days: Vec<&str> = month[0].split_whitespace().collect();
        assert!(days.len() >= 5 && days.iter().all(|day| day.len() == 5), "{month:?}");
        // Two years: few labels, and none runs into another.
        let years = under("2026-11-21T18:00:00Z", 17_520.0);
        assert!(years[0].split_whitespace().all(|day| day.len() == 5), "{years:?}");
    }
}
