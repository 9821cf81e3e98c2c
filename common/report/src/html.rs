//! The report as one page of HTML: no script, nothing from elsewhere, light and dark by the reader's choice.

use std::fmt::Write as _;

use units::Utc;

use crate::curve::Curve;
use crate::markup::escape;
use crate::summary::hours;
use crate::svg::{self, Panel};
use crate::{Report, summary};

/// Tables show at most so many rows; JSON has all of them.
const MOST_ROWS: usize = 500;

const STYLE: &str = "
:root{color-scheme:light dark;--back:#fff;--text:#1b1f24;--soft:#5a6470;--line:#d5dae0;--open_shutter:#2f7d4f;--daytime:#e3d9b8;
--weather:#3f78b5;--fault:#c0392b;--overhead:#d9942b;--idle:#9aa3ad;--unexplained:#b03fb0}
@media (prefers-color-scheme:dark){:root{--back:#14171b;--text:#e4e7ea;--soft:#98a2ad;--line:#333a42;--open_shutter:#4caf78;
--daytime:#5d563c;--weather:#5b98d8;--fault:#e25b4c;--overhead:#e0a548;--idle:#5d6670;--unexplained:#cf62cf}}
body{background:var(--back);color:var(--text);font:15px/1.45 system-ui,sans-serif;max-width:1060px;margin:24px auto;padding:0 16px}
h1{font-size:24px;margin:0}h2{font-size:18px;margin:32px 0 8px}p{margin:6px 0}.soft{color:var(--soft)}
table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:4px 10px 4px 0;border-bottom:1px solid var(--line);vertical-align:top;
overflow-wrap:anywhere}th{color:var(--soft);font-weight:500}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}td.k{white-space:nowrap}
svg{width:100%;height:auto;display:block}svg text{fill:var(--soft);font-size:12px}svg text.label{fill:var(--text)}
.grid{stroke:var(--line)}.frame{fill:none;stroke:var(--line)}.error{stroke:var(--soft)}.point{fill:var(--weather)}
.key{display:inline-block;width:12px;height:12px;border-radius:2px;margin-right:6px;vertical-align:-1px}
rect.open_shutter{fill:var(--open_shutter)}rect.daytime{fill:var(--daytime)}rect.weather{fill:var(--weather)}rect.fault{fill:var(--fault)}
rect.overhead{fill:var(--overhead)}rect.idle{fill:var(--idle)}rect.unexplained{fill:var(--unexplained)}
@media print{body{max-width:none}}
";

/// The page.
pub fn page(report: &Report) -> String {
    let mut page = String::new();
    let title = format!("Night of {}, {} {}", report.night, report.site, report.telescope);
    let title = escape(&title);
    let _ = write!(
        page,
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">\
         <title>{title}</title><style>{STYLE}</style></head><body>\n<h1>{title}</h1>\n"
    );
    let _ = writeln!(
        page,
        "<p class=\"soft\">{} to {} UTC, {}. Made {} UTC{}.</p>",
        minute(report.from_utc),
        minute(report.to_utc),
        hours(report.span_s),
        minute(report.made_utc),
        if report.is_running { "; the night is not over" } else { "" }
    );
    if let Some(why) = &report.nothing_tried {
        let _ = writeln!(page, "<p><b>Nothing was tried.</b> {}</p>", escape(why));
    }
    time(&mut page, report);
    targets(&mut page, report);
    for curve in &report.curves {
        light_curve(&mut page, curve);
    }
    alerts_and_orders(&mut page, report);
    instruments(&mut page, report);
    rows(&mut page, report);
    refused(&mut page, report);
    let disk = &report.disk;
    let free = disk.free_bytes.map_or_else(String::new, |free| format!(", {} free", gigabytes(free)));
    let _ = writeln!(
        page,
        "<h2>Disk</h2><p>{} frames, {}{free}. {} headers are not complete; of {} frames not all could be measured.</p>",
        disk.frames,
        gigabytes(disk.bytes),
        disk.headers_incomplete,
        disk.frames_unmeasured
    );
    if !report.unreadable.is_empty() {
        table(
            &mut page,
            "Left out",
            ["what is stored and cannot be read"],
            report.unreadable.iter().map(|what| [what.clone()]),
        );
    }
    page.push_str("</body></html>\n");
    page
}

fn time(page: &mut String, report: &Report) {
    page.push_str("<h2>Time</h2>\n");
    page.push_str(&svg::bar(report));
    page.push_str(
        "<table><tr><th>class</th><th class=\"n\">time</th><th class=\"n\">share</th><th>of which</th></tr>\n",
    );
    for time in &report.times {
        let mut kinds: Vec<String> =
            time.kinds.iter().take(8).map(|k| format!("{} {}", k.kind, hours(k.time_s))).collect();
        if time.kinds.len() > kinds.len() {
            kinds.push(format!("{} more", time.kinds.len() - kinds.len()));
        }
        let _ = writeln!(
            page,
            "<tr><td class=\"k\"><span class=\"key\" style=\"background:var(--{})\"></span>{}</td><td class=\"n\">{}</td>\
             <td class=\"n\">{:.1} %</td><td>{}</td></tr>",
            time.group.name(),
            time.group.words(),
            hours(time.time_s),
            100.0 * time.share,
            escape(&kinds.join(", "))
        );
    }
    page.push_str("</table>\n");
}

fn targets(page: &mut String, report: &Report) {
    page.push_str("<h2>Targets</h2>\n");
    if report.targets.is_empty() {
        page.push_str("<p>No target was asked for, and no frame of one was taken.</p>\n");
        return;
    }
    page.push_str(
        "<table><tr><th>object</th><th class=\"n\">asked</th><th class=\"n\">taken</th><th class=\"n\">counted</th>\
         <th class=\"n\">light</th><th>filter</th><th>camera</th><th class=\"n\">FWHM</th><th class=\"n\">sky</th>\
         <th class=\"n\">ellipticity</th><th class=\"n\">transparency</th><th class=\"n\">off target</th></tr>\n",
    );
    for target in report.targets.iter().take(MOST_ROWS) {
        let asked = target.frames_asked.map_or_else(|| "-".to_owned(), |asked| asked.to_string());
        let mut first = format!(
            "<td>{}</td><td class=\"n\">{asked}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td>",
            escape(&target.object),
            target.frames_taken,
            target.frames_counted,
            hours(target.exposure_s)
        );
        if target.quality.is_empty() {
            let _ = writeln!(page, "<tr>{first}{}</tr>", "<td></td>".repeat(7));
        }
        for quality in &target.quality {
            let _ = writeln!(
                page,
                "<tr>{first}<td>{}</td><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td>\
                 <td class=\"n\">{}</td><td class=\"n\">{}</td></tr>",
                escape(quality.filter.as_deref().unwrap_or("-")),
                escape(&format!("{}, bin {}, {} s", quality.camera, quality.bin, quality.exposure_s)),
                value(quality.fwhm_arcsec, 2, "″"),
                value(quality.sky_adu, 0, " ADU"),
                value(quality.ellipticity, 2, ""),
                value(quality.transparency, 2, ""),
                value(quality.off_target_arcmin, 2, "′"),
            );
            first = "<td></td>".repeat(5);
        }
    }
    page.push_str("</table>\n");
    more(page, report.targets.len().saturating_sub(MOST_ROWS));
}

fn light_curve(page: &mut String, curve: &Curve) {
    let title = format!("Light curve of {}, {}", curve.object, curve.filter.as_deref().unwrap_or("no filter"));
    let _ = writeln!(
        page,
        "<h2>{}</h2><p class=\"soft\">{}: {} frames against {} comparison stars; {} frames left out.</p>",
        escape(&title),
        escape(&curve.camera),
        curve.points.len(),
        curve.comparison_stars,
        curve.frames_left_out
    );
    for warning in &curve.warnings {
        let _ = writeln!(page, "<p><b>Warning:</b> {}</p>", escape(warning));
    }
    let points = |value: fn(&crate::curve::CurvePoint) -> Option<f64>| -> Vec<(Utc, f64, f64)> {
        curve.points.iter().filter_map(|point| Some((point.mid_utc, value(point)?, 0.0))).collect()
    };
    let flux = curve.points.iter().map(|point| (point.mid_utc, point.flux, point.flux_error)).collect();
    let mut panels = vec![Panel { label: "relative flux", points: flux, height: 200.0 }];
    let others = [
        ("airmass", points(|point| point.airmass)),
        ("FWHM, arcsec", points(|point| point.fwhm_arcsec)),
        ("sky, ADU", points(|point| point.sky_adu)),
        ("drift x, px", points(|point| Some(point.dx_px))),
        ("drift y, px", points(|point| Some(point.dy_px))),
    ];
    let some = others.into_iter().filter(|(_, points)| !points.is_empty());
    panels.extend(some.map(|(label, points)| Panel { label, points, height: 70.0 }));
    page.push_str(&svg::panels(&title, &panels));
}

fn alerts_and_orders(page: &mut String, report: &Report) {
    let alerts = report.alerts.iter().map(|alert| {
        let cleared = alert.cleared_utc.map_or_else(|| "active".to_owned(), second);
        let by = alert.acknowledged_by.clone().unwrap_or_default();
        [second(alert.raised_utc), cleared, alert.priority.clone(), alert.id.clone(), alert.cause.clone(), by]
    });
    table(page, "Alerts", ["raised", "cleared", "priority", "alert", "cause", "acknowledged by"], alerts);
    let mut orders: Vec<_> = report.orders.iter().collect();
    orders.sort_by(|a, b| (&a.from, a.at_utc).cmp(&(&b.from, b.at_utc)));
    let orders = orders
        .into_iter()
        .map(|order| [order.from.clone(), second(order.at_utc), order.verb.clone(), order.outcome.clone()]);
    table(page, "Orders by person", ["person", "at", "order", "outcome"], orders);
}

fn instruments(page: &mut String, report: &Report) {
    let runs = report.focus_runs.iter().map(|run| {
        let best = match (run.best_position, run.best_position_error) {
            (Some(best), Some(error)) => format!("{best:.0} ± {error:.1}"),
            (Some(best), None) => format!("{best:.0}"),
            (None, _) => "-".to_owned(),
        };
        let outcome = run.reason.as_ref().map_or_else(|| run.outcome.clone(), |why| format!("{}: {why}", run.outcome));
        [second(run.started_utc), run.camera.clone(), run.filter.clone().unwrap_or_default(), best, outcome]
    });
    table(page, "Focus runs", ["began", "camera", "filter", "best position", "outcome"], runs);
    let guiding = report.guiding.iter().map(|guiding| {
        let bin = guiding.bin.map_or_else(|| "-".to_owned(), |bin| bin.to_string());
        let rms = format!("{:.2} px", guiding.rms_px);
        [guiding.object.clone().unwrap_or_default(), guiding.camera.clone(), bin, guiding.frames.to_string(), rms]
    });
    table(page, "Guiding", ["object", "guided by", "bin", "frames", "rms"], guiding);
}

fn rows(page: &mut String, report: &Report) {
    let rows = report.rows.iter().map(|row| {
        let wanted = row.frames_wanted.map_or_else(String::new, |wanted| format!(" of {wanted}"));
        let what = row.object.as_ref().map_or_else(|| row.action.clone(), |object| format!("{} {object}", row.action));
        [
            row.row.to_string(),
            what,
            format!("{} to {}", second(row.start_utc), second(row.end_utc)),
            summary::status_word(row.status).to_owned(),
            format!("{}{wanted}", row.frames),
            row.detail.clone(),
        ]
    });
    table(page, "Schedule", ["row", "action", "window", "status", "frames", "detail"], rows);
}

fn refused(page: &mut String, report: &Report) {
    let frames = report.refused_frames.iter().map(|frame| {
        let object = frame.object.clone().unwrap_or_default();
        [second(frame.started_utc), object, frame.file.clone(), frame.why.clone()]
    });
    table(page, "Frames that do not count", ["began", "object", "file", "why"], frames);
}

/// A table of texts, each of which is escaped; nothing where it has no rows.
fn table<const N: usize>(page: &mut String, title: &str, head: [&str; N], rows: impl Iterator<Item = [String; N]>) {
    let mut rows = rows.peekable();
    let _ = writeln!(page, "<h2>{}</h2>", escape(title));
    if rows.peek().is_none() {
        page.push_str("<p class=\"soft\">None.</p>\n");
        return;
    }
    let cells = |cells: &[String], tag: &str| -> String {
        cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escape(cell))).collect()
    };
    let _ = writeln!(page, "<table><tr>{}</tr>", cells(&head.map(str::to_owned), "th"));
    for row in rows.by_ref().take(MOST_ROWS) {
        let _ = writeln!(page, "<tr>{}</tr>", cells(&row, "td"));
    }
    page.push_str("</table>\n");
    more(page, rows.count());
}

/// What a table does not show is not hidden.
fn more(page: &mut String, count: usize) {
    if count > 0 {
        let _ = writeln!(page, "<p class=\"soft\">{count} more are in the JSON.</p>");
    }
}

fn second(at: Utc) -> String {
    at.strftime("%H:%M:%S")
}

fn minute(at: Utc) -> String {
    at.strftime("%Y-%m-%d %H:%M")
}

fn gigabytes(bytes: u64) -> String {
    format!("{:.2} GB", bytes as f64 / 1e9)
}

fn value(value: Option<f64>, digits: usize, unit: &str) -> String {
    value.filter(|value| value.is_finite()).map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}{unit}"))
}
