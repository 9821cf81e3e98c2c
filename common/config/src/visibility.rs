//! `[schedule.check]` and the horizon of a telescope: what a schedule is held against before anything moves.
//!
//! All of it is reported, and refuses no schedule (docs/decisions/0027): what protects the mount are its own `limits`.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use crate::pair::Pair;

/// What rows are held against.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScheduleCheck {
    /// Targets should stand this high over their whole window, degrees; the mount's `limits` count as well.
    pub altitude_min_deg: f64,
    /// And not higher than this, degrees: near the zenith some mounts and domes cannot follow.
    pub altitude_max_deg: f64,
    /// And so far from the Moon while it is up, degrees; 0: never mind.
    pub moon_distance_min_deg: f64,
    /// What a row takes in addition to its exposures: slew, filter, focus, settling; s.
    pub row_overhead_s: f64,
    /// What a frame takes in addition to its exposure, s.
    pub frame_overhead_s: f64,
}

impl Default for ScheduleCheck {
    /// 30 deg from the Moon is what ESO asks of visitors at the least; 60 s and 3 s are what common mounts and cameras need.
    fn default() -> Self {
        Self {
            altitude_min_deg: 0.0,
            altitude_max_deg: 90.0,
            moon_distance_min_deg: 30.0,
            row_overhead_s: 60.0,
            frame_overhead_s: 3.0,
        }
    }
}

impl ScheduleCheck {
    /// What does not hold, in words.
    pub(crate) fn faults(&self) -> Vec<String> {
        [
            ("altitude_min_deg", self.altitude_min_deg, -5.0, 89.0),
            ("altitude_max_deg", self.altitude_max_deg, 1.0, 90.0),
            ("moon_distance_min_deg", self.moon_distance_min_deg, 0.0, 180.0),
            ("row_overhead_s", self.row_overhead_s, 0.0, 3600.0),
            ("frame_overhead_s", self.frame_overhead_s, 0.0, 600.0),
        ]
        .into_iter()
        .filter(|(_, value, low, high)| !(low..=high).contains(&value))
        .map(|(key, value, low, high)| format!("schedule.check.{key} = {value}: expected {low} to {high}"))
        .chain((self.altitude_min_deg >= self.altitude_max_deg).then(|| {
            let (low, high) = (self.altitude_min_deg, self.altitude_max_deg);
            format!("schedule.check.altitude_min_deg = {low}: expected less than altitude_max_deg = {high}")
        }))
        .collect()
    }
}

/// A telescope's horizon as the configuration gives it.
#[derive(Debug, Clone, PartialEq)]
pub enum HorizonSource {
    /// Pairs of azimuth (from north through east) and altitude, degrees.
    Points(Vec<[f64; 2]>),
    /// A text file with one pair per line, separated by white space or a comma; `#` begins a comment.
    File(PathBuf),
}

impl<'de> Deserialize<'de> for HorizonSource {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(EitherSource)
    }
}

struct EitherSource;

impl<'de> Visitor<'de> for EitherSource {
    type Value = HorizonSource;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("pairs such as [[0, 10], [180, 25]], or a file of such pairs in quotes")
    }

    fn visit_str<E: de::Error>(self, file: &str) -> Result<HorizonSource, E> {
        Ok(HorizonSource::File(file.into()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<HorizonSource, A::Error> {
        let mut points = Vec::new();
        while let Some(Pair(point)) = list.next_element()? {
            points.push(point);
        }
        Ok(HorizonSource::Points(points))
    }
}

/// What walls, trees and hills leave of the sky: altitude over azimuth, straight lines between the points.
#[derive(Debug, Clone, PartialEq)]
pub struct Horizon {
    /// Azimuth in [0, 360) and altitude, degrees, by azimuth.
    points: Vec<[f64; 2]>,
}

/// Points of a horizon that is measured by hand or by a camera; more are a slip.
const MOST_POINTS: usize = 3600;

impl Horizon {
    /// From pairs of azimuth (from north through east) and altitude, degrees, in any order; one point is the same all
    /// around.
    ///
    /// # Errors
    /// In words: no points, too many, two of one azimuth, an azimuth outside -360 to 360, an altitude outside -10 to 90.
    pub fn new(points: &[[f64; 2]]) -> Result<Self, String> {
        if points.is_empty() || points.len() > MOST_POINTS {
            return Err(format!("{} points; expected 1 to {MOST_POINTS}", points.len()));
        }
        for [azimuth_deg, altitude_deg] in points {
            if !(-360.0..=360.0).contains(azimuth_deg) {
                return Err(format!("azimuth {azimuth_deg}: expected -360 to 360 deg, from north through east"));
            }
            if !(-10.0..=90.0).contains(altitude_deg) {
                return Err(format!("altitude {altitude_deg}: expected -10 to 90 deg"));
            }
        }
        // the end of a whole turn may repeat its begin, as some programs write it
        let closes = points.len() > 1 && points.first().map(|p| [p[0] + 360.0, p[1]]) == points.last().copied();
        let once = if closes { points.split_last().map_or(points, |(_, rest)| rest) } else { points };
        let mut points: Vec<[f64; 2]> = once.iter().map(|[az, alt]| [az.rem_euclid(360.0), *alt]).collect();
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        if let Some(pair) = points.windows(2).find(|pair| pair[0][0] == pair[1][0]) {
            return Err(format!("azimuth {} stands twice; give each once", pair[0][0]));
        }
        Ok(Self { points })
    }

    /// Altitude of the horizon in a direction, degrees.
    pub fn altitude_deg(&self, azimuth_deg: f64) -> f64 {
        let azimuth_deg = azimuth_deg.rem_euclid(360.0);
        let after = self.points.partition_point(|point| point[0] <= azimuth_deg);
        let (Some(first), Some(last)) = (self.points.first(), self.points.last()) else { return -90.0 };
        let before = match after.checked_sub(1).and_then(|index| self.points.get(index)) {
            Some(point) => *point,
            None => [last[0] - 360.0, last[1]],
        };
        let next = self.points.get(after).copied().unwrap_or([first[0] + 360.0, first[1]]);
        let share = (azimuth_deg - before[0]) / (next[0] - before[0]);
        before[1] + share * (next[1] - before[1])
    }

    /// Its highest altitude, degrees: no need to ask for the azimuth above it.
    pub fn highest_deg(&self) -> f64 {
        self.points.iter().map(|point| point[1]).fold(f64::NEG_INFINITY, f64::max)
    }
}

impl FromStr for Horizon {
    type Err = String;

    /// One pair of azimuth and altitude per line; blank lines and what follows a `#` are skipped.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut points = Vec::new();
        for (line, number) in text.trim_start_matches('\u{feff}').lines().zip(1..) {
            let line = line.split('#').next().unwrap_or_default();
            let mut words = line.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty());
            let pair = (words.next(), words.next(), words.next());
            points.push(match pair {
                (None, ..) => continue,
                (Some(azimuth), Some(altitude), None) => {
                    let parsed = azimuth.parse().ok().zip(altitude.parse().ok());
                    let wrong = || format!("line {number}: {line:?} is no pair of numbers, such as 120 25.5");
                    let (azimuth_deg, altitude_deg) = parsed.ok_or_else(wrong)?;
                    [azimuth_deg, altitude_deg]
                }
                _ => return Err(format!("line {number}: expected azimuth and altitude in degrees, found {line:?}")),
            });
            if points.len() > MOST_POINTS {
                return Err(format!("line {number}: more than {MOST_POINTS} points"));
            }
        }
        Self::new(&points)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_its_points_the_horizon_is_a_straight_line_also_through_north() {
        let horizon = Horizon::new(&[[90.0, 30.0], [350.0, 10.0], [180.0, 20.0]]).unwrap();
        for (azimuth_deg, expected) in [(90.0, 30.0), (135.0, 25.0), (350.0, 10.0), (0.0, 12.0), (360.0, 12.0)] {
            let altitude_deg = horizon.altitude_deg(azimuth_deg);
            assert!((altitude_deg - expected).abs() < 1e-9, "{azimuth_deg}: {altitude_deg}");
        }
        assert_eq!(horizon.highest_deg(), 30.0);
        let flat = Horizon::new(&[[77.0, 15.0]]).unwrap();
        for azimuth_deg in [0.0, 76.9, 77.0, 200.0, -10.0] {
            assert_eq!(flat.altitude_deg(azimuth_deg), 15.0);
        }
    }

    #[test]
    fn a_file_of_pairs_is_read_with_comments_and_commas() {
        let read: Horizon = "# wall\n0 10\n90, 30\n\n180\t20 # hill\n360 10\n".parse().unwrap();
        assert_eq!(read, Horizon::new(&[[0.0, 10.0], [90.0, 30.0], [180.0, 20.0]]).unwrap());
    }

    #[test]
    fn a_horizon_that_makes_no_sense_is_refused_with_its_place() {
        for (text, words) in [
            ("", "0 points"),
            ("0 10\n90\n", "line 2: expected azimuth and altitude"),
            ("0 ten\n", "line 1: \"0 ten\" is no pair of numbers"),
            ("0 10\n400 10\n", "azimuth 400"),
            ("0 95\n", "altitude 95"),
            ("0 nan\n", "altitude NaN"),
            ("10 5\n370 6\n", "azimuth 370"),
            ("10 5\n-350 6\n", "azimuth 10 stands twice"),
        ] {
            let error = text.parse::<Horizon>().unwrap_err();
            assert!(error.contains(words), "{text:?}: {error}");
        }
    }

    #[test]
    fn numbers_out_of_range_are_reported_by_their_key() {
        assert!(ScheduleCheck::default().faults().is_empty());
        let odd = ScheduleCheck {
            altitude_min_deg: 80.0,
            altitude_max_deg: 70.0,
            row_overhead_s: f64::NAN,
            ..Default::default()
        };
        let faults = odd.faults().join("\n");
        assert!(
            faults.contains("row_overhead_s = NaN") && faults.contains("less than altitude_max_deg = 70"),
            "{faults}"
        );
    }
}
