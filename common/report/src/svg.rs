//! Plots as SVG inside the page; colours come from its style sheet.

use std::fmt::Write as _;

use units::Utc;

use crate::markup::escape;
use crate::{Report, TimelinePiece};

const WIDTH: f64 = 1000.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 10.0;

/// A span of time along the width of a plot.
struct Axis {
    from: Utc,
    length_s: f64,
}

impl Axis {
    fn new(from: Utc, to: Utc) -> Self {
        Self { from, length_s: to.seconds_since(from).max(1.0) }
    }

    fn x(&self, at: Utc) -> f64 {
        LEFT + (WIDTH - LEFT - RIGHT) * (at.seconds_since(self.from) / self.length_s).clamp(0.0, 1.0)
    }

    /// Marks of time, about eight of them.
    fn marks(&self, svg: &mut String, top: f64, bottom: f64) {
        const STEPS_S: [i64; 12] = [1, 5, 10, 30, 60, 300, 600, 1800, 3600, 7200, 14_400, 28_800];
        let step = STEPS_S.into_iter().find(|step| self.length_s / *step as f64 <= 9.0).unwrap_or(86_400);
        let pattern = if step < 60 { "%H:%M:%S" } else { "%H:%M" };
        // `as` saturates.
        let mut second = (self.from.seconds() as i64).div_euclid(step) * step;
        for _ in 0..12 {
            let at = Utc::from_micros(second.saturating_mul(1_000_000));
            let into_s = at.seconds_since(self.from);
            if (0.0..=self.length_s).contains(&into_s) {
                let x = self.x(at);
                let _ = write!(
                    svg,
                    "<line class=\"grid\" x1=\"{x:.1}\" y1=\"{top}\" x2=\"{x:.1}\" y2=\"{bottom}\"/>\
                     <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                    bottom + 14.0,
                    at.strftime(pattern)
                );
            }
            second += step;
        }
    }
}

/// Pieces that are narrower, px, are drawn together until they are as wide as this.
const NARROW: f64 = 0.1;

/// A stretch of the bar.
struct Cell<'a> {
    left: f64,
    right: f64,
    /// Of the pieces in it the longest, and its width.
    longest: &'a TimelinePiece,
    width: f64,
}

/// Narrow pieces next to each other, as the longest of them: none may cover the rest of a night of short frames.
fn cells<'a>(axis: &Axis, timeline: &'a [TimelinePiece]) -> Vec<Cell<'a>> {
    let mut cells: Vec<Cell<'a>> = Vec::new();
    for piece in timeline {
        let (left, right) = (axis.x(piece.from_utc), axis.x(piece.to_utc));
        let width = right - left;
        match cells.last_mut() {
            Some(cell) if cell.right - cell.left < NARROW && width < NARROW => {
                cell.right = right;
                if width > cell.width {
                    (cell.longest, cell.width) = (piece, width);
                }
            }
            _ => cells.push(Cell { left, right, longest: piece, width }),
        }
    }
    cells
}

/// The night as a bar.
pub fn bar(report: &Report) -> String {
    let axis = Axis::new(report.from_utc, report.to_utc);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} 74\" role=\"img\" aria-label=\"The night from {} to {} UTC by class\">",
        report.from_utc.strftime("%H:%M"),
        report.to_utc.strftime("%H:%M")
    );
    axis.marks(&mut svg, 4.0, 56.0);
    let mut drawn: Option<(f64, f64, &TimelinePiece)> = None;
    let mut draw = |(left, right, piece): (f64, f64, &TimelinePiece)| {
        let title = escape(&format!(
            "{} {}: {}, {:.0} s",
            piece.from_utc.strftime("%H:%M:%S"),
            piece.group.words(),
            piece.kind,
            piece.to_utc.seconds_since(piece.from_utc)
        ));
        let _ = write!(
            svg,
            "<rect class=\"{}\" x=\"{left:.2}\" y=\"8\" width=\"{:.2}\" height=\"44\"><title>{title}</title></rect>",
            piece.group.name(),
            right - left
        );
    };
    for cell in cells(&axis, &report.timeline) {
        match &mut drawn {
            Some((_, until, first)) if first.group == cell.longest.group => *until = cell.right,
            _ => {
                if let Some(before) = drawn.take() {
                    draw(before);
                }
                drawn = Some((cell.left, cell.right, cell.longest));
            }
        }
    }
    if let Some(last) = drawn {
        draw(last);
    }
    svg.push_str("</svg>");
    svg
}

/// A series of values over time.
pub struct Panel<'a> {
    /// The quantity with its unit.
    pub label: &'a str,
    /// Time, value, and standard error.
    pub points: Vec<(Utc, f64, f64)>,
    /// Height, px.
    pub height: f64,
}

/// The panels below each other, with one axis of time.
pub fn panels(title: &str, panels: &[Panel<'_>]) -> String {
    const GAP: f64 = 10.0;
    let times = || panels.iter().flat_map(|panel| panel.points.iter().map(|point| point.0));
    let (Some(from), Some(to)) = (times().min(), times().max()) else { return String::new() };
    let axis = Axis::new(from, to);
    let height: f64 = panels.iter().map(|panel| panel.height + GAP).sum::<f64>() + 24.0;
    let mut svg = format!("<svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{}\">", escape(title));
    axis.marks(&mut svg, 4.0, height - 24.0);
    let mut top = 4.0;
    for panel in panels {
        draw(&mut svg, &axis, panel, top);
        top += panel.height + GAP;
    }
    svg.push_str("</svg>");
    svg
}

fn draw(svg: &mut String, axis: &Axis, panel: &Panel<'_>, top: f64) {
    let bottom = top + panel.height;
    let _ = write!(
        svg,
        "<rect class=\"frame\" x=\"{LEFT}\" y=\"{top}\" width=\"{}\" height=\"{}\"/>\
         <text class=\"label\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
        WIDTH - LEFT - RIGHT,
        panel.height,
        LEFT + 6.0,
        top + 14.0,
        escape(panel.label)
    );
    let finite = || panel.points.iter().filter(|(_, value, _)| value.is_finite());
    let low = finite().map(|(_, value, error)| value - positive(*error)).fold(f64::INFINITY, f64::min);
    let high = finite().map(|(_, value, error)| value + positive(*error)).fold(f64::NEG_INFINITY, f64::max);
    if low > high {
        return;
    }
    let margin = (0.08 * (high - low)).max(1e-9 * high.abs()).max(1e-12);
    let (low, high) = (low - margin, high + margin);
    let y = |value: f64| bottom - panel.height * (value - low) / (high - low);
    for (value, place) in [(high - margin, top + 12.0), (low + margin, bottom - 3.0)] {
        let digits = if (high - low) < 0.2 { 4 } else { 2 };
        let _ =
            write!(svg, "<text x=\"{:.1}\" y=\"{place:.1}\" text-anchor=\"end\">{value:.digits$}</text>", LEFT - 6.0);
    }
    for (at, value, error) in finite() {
        let (x, error) = (axis.x(*at), positive(*error));
        if error > 0.0 {
            let (above, below) = (y(value + error), y(value - error));
            let _ =
                write!(svg, "<line class=\"error\" x1=\"{x:.1}\" y1=\"{above:.1}\" x2=\"{x:.1}\" y2=\"{below:.1}\"/>");
        }
        let _ = write!(svg, "<circle class=\"point\" cx=\"{x:.1}\" cy=\"{:.1}\" r=\"2.2\"/>", y(*value));
    }
}

fn positive(error: f64) -> f64 {
    if error.is_finite() { error.max(0.0) } else { 0.0 }
}
