//! How a focus run searches: over which positions, with how many frames, and what it measures on them.

use std::collections::BTreeMap;

use imaging::focus::{OPERATORS, Operator, SMOOTHERS, Smoother};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::Value;

use crate::action::parameters::yes;
use crate::focus_meter::{HFD, Meter};
use crate::wrong::Wrong;

/// The search.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Search {
    /// Lowest and highest position, or with `search_range_is_relative` so far below and above the best focus; one number,
    /// relative, is both. Absent: four critical zones to either side, as far as they are known.
    #[schemars(extend("unit" = "steps", "minimum" = -1_000_000_000, "maximum" = 1_000_000_000))]
    search_range: Option<Range>,
    /// `search_range` counts from the best focus.
    #[serde(default)]
    search_range_is_relative: bool,
    /// Positions of the first look and of the closer one; 9 and 7 where absent.
    #[schemars(extend("unit" = "positions", "minimum" = 5, "maximum" = 50))]
    n_steps: Option<Counts>,
    /// Frames at each position, for both looks or for each; 1 where absent.
    #[schemars(extend("unit" = "frames", "minimum" = 1, "maximum" = 100))]
    n_exposures: Option<Counts>,
    /// The closer look covers less than the first one; false: the same range once more.
    #[serde(default = "yes")]
    decrease_search_range: bool,
    /// How much of the first range the closer look covers, about the focus that the first one shows; absent: three
    /// critical zones to either side.
    #[schemars(range(min = 1, max = 100), extend("unit" = "%"))]
    percent_to_cut: Option<f64>,
    /// Least signal-to-noise of a star that is measured.
    #[serde(default = "ten")]
    #[schemars(range(min = 1, max = 1_000_000), extend("unit" = "sigma"))]
    star_find_threshold: f64,
    /// What is measured; `hfd` is the half-flux diameter, the others are the predecessor's. The sky is taken off first.
    #[serde(default = "hfd")]
    #[schemars(extend("enum" = operators()))]
    focus_measure_operator: String,
    /// Curve through contrasts; sizes of stars get a hyperbola.
    #[serde(default = "lowess")]
    #[schemars(extend("enum" = estimators()))]
    extremum_estimator: String,
    /// Taken from other schedules, without effect: the curves have fixed settings.
    #[serde(default, rename = "extremum_estimator_kwargs")]
    #[schemars(extend("deprecated" = true))]
    _extremum_estimator_kwargs: BTreeMap<String, Value>,
    /// Other operators that are computed and stored with it.
    #[serde(default)]
    #[schemars(extend("items" = {"type": "string", "enum": names()}))]
    secondary_focus_measure_operators: Vec<String>,
}

/// One number, or two.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
#[serde(untagged)]
enum Range {
    Both(f64),
    Each([f64; 2]),
}

/// One number for both looks, or one for each; more are the predecessor's further passes.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(untagged)]
enum Counts {
    Both(u32),
    Each(Vec<u32>),
}

impl Counts {
    fn of_look(&self, second: bool) -> Option<u32> {
        match self {
            Self::Both(count) => Some(*count),
            Self::Each(counts) => counts.get(usize::from(second)).or(counts.last()).copied(),
        }
    }
}

fn ten() -> f64 {
    10.0
}

fn hfd() -> String {
    HFD.to_owned()
}

fn lowess() -> String {
    "lowess".to_owned()
}

fn names() -> Vec<&'static str> {
    OPERATORS.iter().map(|operator| operator.name).collect()
}

fn operators() -> Vec<&'static str> {
    std::iter::once(HFD).chain(names()).collect()
}

/// What the predecessor's documents call the running median.
const MEDIAN: &str = "medianfilter";

fn estimators() -> Vec<&'static str> {
    SMOOTHERS.iter().map(|smoother| smoother.name).chain([MEDIAN]).collect()
}

/// A row that names no range looks this far, and a range is as wide as this at least, steps.
const LEAST_HALF_RANGE: f64 = 2.0;

impl Search {
    /// Refuses what the schema cannot: a lone number that is not relative, and numbers within lists.
    pub fn check(&self) -> Result<(), Wrong> {
        self.meter(false)?;
        self.smoother()?;
        if matches!(self.search_range, Some(Range::Both(_))) && !self.search_range_is_relative {
            let what = "one number needs search_range_is_relative; else give [lowest, highest]";
            return Err(Wrong::of("search_range", what));
        }
        for (name, counts, low, high) in [("n_steps", &self.n_steps, 5, 50), ("n_exposures", &self.n_exposures, 1, 100)]
        {
            let looks = counts.iter().flat_map(|counts| [counts.of_look(false), counts.of_look(true)]);
            for count in looks {
                match count {
                    Some(count) if (low..=high).contains(&count) => {}
                    Some(count) => return Err(Wrong::of(name, format!("expected {low} to {high}, found {count}"))),
                    None => return Err(Wrong::of(name, "expected at least one number")),
                }
            }
        }
        Ok(())
    }

    fn operator(&self) -> Result<Option<&'static Operator>, Wrong> {
        if self.focus_measure_operator.trim().eq_ignore_ascii_case(HFD) {
            return Ok(None);
        }
        let named = Operator::named(&self.focus_measure_operator);
        named.map(Some).map_err(|error| Wrong::of("focus_measure_operator", format!("{error}, {HFD}")))
    }

    /// The curve through contrasts.
    ///
    /// # Errors
    /// No such estimator.
    pub fn smoother(&self) -> Result<&'static Smoother, Wrong> {
        let name = self.extremum_estimator.trim().to_lowercase().replace(['_', ' ', '-'], "");
        let name = if name == MEDIAN { "median" } else { &name };
        Smoother::named(name).map_err(|error| Wrong::of("extremum_estimator", error.to_string()))
    }

    /// How frames are measured.
    pub fn meter(&self, looks_for_saturation: bool) -> Result<Meter, Wrong> {
        let other = |name: &String| {
            Operator::named(name).map_err(|error| Wrong::of("secondary_focus_measure_operators", error.to_string()))
        };
        let others = self.secondary_focus_measure_operators.iter().map(other);
        Ok(Meter {
            operator: self.operator()?,
            least_snr: self.star_find_threshold,
            others: others.collect::<Result<_, _>>()?,
            looks_for_saturation,
        })
    }

    /// Positions of the first and of the closer look.
    pub fn positions(&self) -> (usize, usize) {
        let of_look = |second, usual| {
            let count = self.n_steps.as_ref().and_then(|counts| counts.of_look(second));
            count.map_or(usual, |count| count as usize)
        };
        (of_look(false, 9), of_look(true, 7))
    }

    /// Frames at each position of the first and of the closer look.
    pub fn frames(&self) -> (u32, u32) {
        let of_look = |second| self.n_exposures.as_ref().and_then(|counts| counts.of_look(second)).unwrap_or(1);
        (of_look(false), of_look(true))
    }

    /// How much of the first range the closer look covers, where the row says so.
    pub fn closer_percent(&self) -> Option<u32> {
        match self.percent_to_cut {
            _ if !self.decrease_search_range => Some(100),
            // `as` saturates
            Some(percent) => Some((percent.round() as u32).clamp(1, 100)),
            None => None,
        }
    }

    /// Middle and half width of the range, steps; `centre` is the best focus, `usual` the half width where the row
    /// names none.
    pub fn range(&self, centre: i64, usual: i64, max_step: i64) -> (i64, i64) {
        let (low, high) = match self.search_range {
            None => return (centre, usual),
            Some(Range::Both(reach)) => (centre as f64 - reach.abs(), centre as f64 + reach.abs()),
            Some(Range::Each([below, above])) if self.search_range_is_relative => {
                (centre as f64 - below.abs(), centre as f64 + above.abs())
            }
            Some(Range::Each([a, b])) => (a.min(b), a.max(b)),
        };
        let (low, high) = (low.clamp(0.0, max_step as f64), high.clamp(0.0, max_step as f64));
        // `as` saturates
        let half = (0.5 * (high - low)).max(LEAST_HALF_RANGE);
        ((0.5 * (low + high)).round() as i64, half.round() as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Autofocus;
    use super::*;
    use crate::action::read_text;

    fn read(text: &str) -> Search {
        read_text::<Autofocus>(text).unwrap().search
    }

    #[test]
    fn the_predecessors_words_are_known() {
        let plain = read("{}");
        assert_eq!((plain.positions(), plain.frames(), plain.closer_percent()), ((9, 7), (1, 1), None));
        assert!(plain.operator().unwrap().is_none());
        let all = read(
            r#"{"n_steps": [30, 20], "n_exposures": 2, "focus_measure_operator": "HFR", "extremum_estimator": "LOWESS",
            "secondary_focus_measure_operators": ["fft", "Normalized Variance", "tenengrad"]}"#,
        );
        assert_eq!((all.positions(), all.frames()), ((30, 20), (2, 2)));
        assert_eq!(all.operator().unwrap().unwrap().name, "hfr");
        assert_eq!(all.meter(true).unwrap().others.len(), 3);
        assert_eq!(read(r#"{"extremum_estimator": "median_filter"}"#).smoother().unwrap().name, "median");
        assert_eq!(read(r#"{"n_steps": [12]}"#).positions(), (12, 12));
    }

    #[test]
    fn the_closer_look_covers_what_the_row_asks_for() {
        let percent = |text: &str| read(text).closer_percent();
        assert_eq!(percent(r#"{"percent_to_cut": 60}"#), Some(60));
        assert_eq!(percent(r#"{"percent_to_cut": 60, "decrease_search_range": false}"#), Some(100));
        assert_eq!(percent(r#"{"decrease_search_range": true}"#), None);
    }

    #[test]
    fn ranges_are_absolute_or_about_the_best_focus_and_end_with_the_travel() {
        let range = |text: &str| read(text).range(1000, 77, 50_000);
        assert_eq!(range("{}"), (1000, 77));
        assert_eq!(range(r#"{"search_range": 300, "search_range_is_relative": true}"#), (1000, 300));
        assert_eq!(range(r#"{"search_range": [-100, 500], "search_range_is_relative": true}"#), (1200, 300));
        assert_eq!(range(r#"{"search_range": [9000, 8000]}"#), (8500, 500));
        assert_eq!(range(r#"{"search_range": 5000, "search_range_is_relative": true}"#), (3000, 3000));
        assert_eq!(range(r#"{"search_range": [70000, 80000]}"#), (50_000, 2));
    }
}
