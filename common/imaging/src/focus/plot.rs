//! A focus run as a picture: an SVG that a phone shows well.

use std::fmt::Write as _;

use super::sweep::{FocusFit, FocusMeasurement, Pass};

/// What the picture shows.
#[derive(Debug, Clone, Copy)]
pub struct Plot<'a> {
    /// Written above, such as telescope, filter and time.
    pub title: &'a str,
    /// What was measured, and its unit, such as `HFD, px`.
    pub value_label: &'a str,
    /// All that was measured.
    pub points: &'a [FocusMeasurement],
    /// The curve, if there is one.
    pub fit: Option<&'a FocusFit>,
    /// The position that was chosen, if one was, steps.
    pub chosen: Option<i32>,
}

/// The picture is 4 : 3, in its own units; a phone of 390 px shows letters of 18 units 11 px high.
const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 480.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 54.0;
const BOTTOM: f64 = 64.0;
/// Straight pieces of a curve.
const PIECES: usize = 120;

impl Plot<'_> {
    /// The picture. Points without a value are marked on the lower edge; points that the curve did not use are hollow.
    pub fn svg(&self) -> String {
        let valid: Vec<(f64, f64)> = self
            .points
            .iter()
            .filter_map(|p| p.value.map(|v| (f64::from(p.position), v.value)))
            .filter(|(_, value)| value.is_finite())
            .collect();
        let along =
            PlotAxis::around(self.points.iter().map(|p| f64::from(p.position)).chain(self.chosen.map(f64::from)));
        let up = PlotAxis::around(valid.iter().map(|(_, value)| *value).chain(self.fit.map(FocusFit::best_value)));
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" \
             font-size=\"18\" role=\"img\">\n<rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"#fff\"/>\n"
        );
        // writing to a String cannot fail
        let _ = writeln!(svg, "<text x=\"{LEFT}\" y=\"30\" font-weight=\"bold\">{}</text>", escaped(self.title));
        self.axes(&mut svg, &along, &up);
        self.curve(&mut svg, &along, &up);
        self.marks(&mut svg, &along, &up);
        svg.push_str("</svg>\n");
        svg
    }

    fn axes(&self, svg: &mut String, along: &PlotAxis, up: &PlotAxis) {
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        for tick in along.ticks() {
            let (x, text) = (along.x(tick), along.written(tick));
            let _ = writeln!(svg, "<path d=\"M{x:.1} {TOP}V{bottom}\" stroke=\"#ddd\"/>");
            let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{text}</text>", bottom + 24.0);
        }
        for tick in up.ticks() {
            let (y, text) = (up.y(tick), up.written(tick));
            let _ = writeln!(svg, "<path d=\"M{LEFT} {y:.1}H{right}\" stroke=\"#ddd\"/>");
            let _ =
                writeln!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{text}</text>", LEFT - 8.0, y + 6.0);
        }
        let _ = writeln!(
            svg,
            "<path d=\"M{LEFT} {TOP}V{bottom}H{right}\" fill=\"none\" stroke=\"#333\" stroke-width=\"2\"/>"
        );
        let middle = 0.5 * (LEFT + right);
        let _ =
            writeln!(svg, "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">position, steps</text>", HEIGHT - 12.0);
        let _ =
            writeln!(svg, "<text x=\"{LEFT}\" y=\"{}\" fill=\"#555\">{}</text>", TOP - 6.0, escaped(self.value_label));
    }

    fn curve(&self, svg: &mut String, along: &PlotAxis, up: &PlotAxis) {
        let line: Vec<(f64, f64)> = match self.fit {
            Some(FocusFit::Hyperbola(curve)) => {
                let at = |n: usize| along.low + (along.high - along.low) * n as f64 / PIECES as f64;
                (0..=PIECES).map(at).map(|position| (position, curve.size_at(position))).collect()
            }
            Some(FocusFit::Smoothed { curve, .. }) => curve.clone(),
            None => return,
        };
        let inside = line.iter().filter(|(_, value)| (up.low..=up.high).contains(value));
        let places: Vec<String> = inside.map(|(x, y)| format!("{:.1},{:.1}", along.x(*x), up.y(*y))).collect();
        let places = places.join(" ");
        let _ = writeln!(
            svg,
            "<polyline class=\"fit\" points=\"{places}\" fill=\"none\" stroke=\"#1f77b4\" stroke-width=\"2.5\"/>"
        );
    }

    fn marks(&self, svg: &mut String, along: &PlotAxis, up: &PlotAxis) {
        let bottom = HEIGHT - BOTTOM;
        if let Some(chosen) = self.chosen {
            let x = along.x(f64::from(chosen));
            let error =
                self.fit.and_then(FocusFit::best_position_error).map_or(String::new(), |e| format!(" ± {e:.1}"));
            // the text keeps to the side where there is room
            let (anchor, label_x) = if x > 0.6 * WIDTH { ("end", x - 6.0) } else { ("start", x + 6.0) };
            let _ = writeln!(
                svg,
                "<path class=\"chosen\" d=\"M{x:.1} {TOP}V{bottom}\" stroke=\"#d62728\" stroke-width=\"2\" stroke-dasharray=\"6 4\"/>"
            );
            let _ = writeln!(
                svg,
                "<text x=\"{label_x:.1}\" y=\"{}\" text-anchor=\"{anchor}\" fill=\"#d62728\">{chosen}{error}</text>",
                TOP + 18.0
            );
        }
        let mut number = 0;
        for point in self.points {
            let is_used = match self.fit {
                Some(FocusFit::Hyperbola(curve)) if point.pass != Pass::Verification => {
                    number += 1;
                    curve.used.get(number - 1).copied().unwrap_or(true)
                }
                _ => true,
            };
            let x = along.x(f64::from(point.position));
            let Some(value) = point.value.filter(|value| value.value.is_finite()) else {
                let _ = writeln!(
                    svg,
                    "<text class=\"none\" x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\" fill=\"#888\">×</text>",
                    bottom - 4.0
                );
                continue;
            };
            let (y, error) = (up.y(value.value), if value.error.is_finite() { value.error.abs() } else { 0.0 });
            let (top, foot) = (up.y((value.value + error).min(up.high)), up.y((value.value - error).max(up.low)));
            let (class, colour) = match point.pass {
                Pass::Coarse => ("coarse", "#555"),
                Pass::Fine => ("fine", "#1f77b4"),
                Pass::Verification => ("verification", "#d62728"),
            };
            let fill = if is_used { colour } else { "#fff" };
            let _ = writeln!(svg, "<path d=\"M{x:.1} {top:.1}V{foot:.1}\" stroke=\"{colour}\" stroke-width=\"2\"/>");
            let _ = writeln!(
                svg,
                "<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"6\" fill=\"{fill}\" stroke=\"{colour}\" stroke-width=\"2\"/>"
            );
        }
    }
}

/// From values to places.
struct PlotAxis {
    low: f64,
    high: f64,
}

impl PlotAxis {
    /// With a twentieth of room at either end; something to draw even for no values or one.
    fn around(values: impl Iterator<Item = f64>) -> Self {
        let finite = values.filter(|value| value.is_finite());
        let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), value| (l.min(value), h.max(value)));
        if low > high {
            return Self { low: 0.0, high: 1.0 };
        }
        let room = 0.05 * (0.5 * high - 0.5 * low) * 2.0;
        let room = if room > 0.0 && room.is_finite() { room } else { 0.05 * low.abs().max(1.0) };
        Self { low: low - room, high: high + room }
    }

    fn share(&self, value: f64) -> f64 {
        ((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0)
    }

    fn x(&self, value: f64) -> f64 {
        LEFT + (WIDTH - LEFT - RIGHT) * self.share(value)
    }

    fn y(&self, value: f64) -> f64 {
        HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * self.share(value)
    }

    /// Distance of the ticks: 1, 2 or 5 times a power of ten, so that there are four to nine.
    fn step(&self) -> f64 {
        let raw = (self.high - self.low) / 4.5;
        let power = 10_f64.powf(raw.log10().floor());
        let factor = [5.0, 2.0].into_iter().find(|factor| factor * power <= raw).unwrap_or(1.0);
        factor * power
    }

    fn ticks(&self) -> Vec<f64> {
        let step = self.step();
        let first = (self.low / step).ceil();
        (0..12).map(|n| (first + f64::from(n)) * step).take_while(|tick| *tick <= self.high).collect()
    }

    fn written(&self, tick: f64) -> String {
        if tick.abs() >= 1e6 {
            return format!("{tick:.1e}");
        }
        let digits = (-self.step().log10().floor()).clamp(0.0, 6.0) as usize;
        format!("{tick:.digits$}")
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::focus::hyperbola::{Hyperbola, Size};
    use crate::quality::Estimate;

    fn points() -> Vec<FocusMeasurement> {
        let point = |n: i32| {
            let position = 9_600 + 100 * n;
            let size = 2.5_f64.hypot(0.025 * f64::from(position - 10_050));
            let size = if n == 1 { 30.0 } else { size };
            let value = (n != 8).then_some(Estimate { value: size, error: 0.1 });
            FocusMeasurement { position, pass: if n < 5 { Pass::Coarse } else { Pass::Fine }, value }
        };
        let verified = FocusMeasurement {
            position: 10_050,
            pass: Pass::Verification,
            value: Some(Estimate { value: 2.5, error: 0.1 }),
        };
        (0..9).map(point).chain([verified]).collect()
    }

    #[test]
    fn the_picture_shows_points_curve_choice_and_units() {
        let points = points();
        let sizes: Vec<Size> = points[..9]
            .iter()
            .map(|p| (f64::from(p.position), p.value))
            .map(|(position, v)| Size { position, size: v.map_or(f64::NAN, |v| v.value), error: 0.1 })
            .collect();
        let fit = FocusFit::Hyperbola(Hyperbola::fit(&sizes).unwrap());
        let plot =
            Plot { title: "A & <B>", value_label: "HFD, px", points: &points, fit: Some(&fit), chosen: Some(10_050) };
        let svg = plot.svg();
        let count = |what: &str| svg.matches(what).count();
        assert_eq!((count("<circle"), count("class=\"none\""), count("class=\"verification\"")), (9, 1, 1), "{svg}");
        assert_eq!(
            (count("class=\"fit\""), count("class=\"chosen\""), count("fill=\"#fff\" stroke")),
            (1, 1, 1),
            "{svg}"
        );
        for text in [">A &amp; &lt;B&gt;<", ">HFD, px<", ">position, steps<", ">10050 ± ", ">9600<", ">10000<", ">10<"]
        {
            assert!(svg.contains(text), "{text} is missing in {svg}");
        }
        // the line of the chosen position stands above that position: 9600 to 10400 with a twentieth of room
        let x = LEFT + (WIDTH - LEFT - RIGHT) * (10_050.0 - 9_560.0) / 880.0;
        assert!(svg.contains(&format!("class=\"chosen\" d=\"M{x:.1} ")), "{x} {svg}");
        assert_eq!((count("<svg "), count("</svg>"), count("NaN"), count("inf")), (1, 1, 0, 0));
    }

    #[test]
    fn strange_runs_have_a_picture_too() {
        let huge = FocusMeasurement {
            position: i32::MAX,
            pass: Pass::Fine,
            value: Some(Estimate { value: 1e300, error: f64::NAN }),
        };
        let none = FocusMeasurement { position: i32::MIN, pass: Pass::Fine, value: None };
        for points in [vec![], vec![none.clone()], vec![huge.clone()], vec![huge.clone(), huge, none]] {
            let svg = Plot { title: "", value_label: "", points: &points, fit: None, chosen: None }.svg();
            assert!(!svg.contains("NaN") && !svg.contains("inf") && svg.ends_with("</svg>\n"), "{svg}");
        }
    }
}
