//! An instant of civil time, to the microsecond.

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use jiff::tz::{Offset, TimeZone};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// An instant in UTC, to the microsecond; for stamps, ephemerides and schedules, never for judging an age.
///
/// Written as RFC 3339 with `Z`. Leap seconds follow POSIX: the 61st second repeats the 60th.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Utc {
    micros: i64,
}

/// A text that is no instant of time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadTime(String);

impl fmt::Display for BadTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?} is no time; expected UTC such as 2026-11-21T03:00:00Z or 2026-11-21 03:00:00.5", self.0)
    }
}

impl std::error::Error for BadTime {}

impl Utc {
    /// The Unix epoch, 1970-01-01T00:00:00Z.
    pub const EPOCH: Self = Self { micros: 0 };
    /// Julian day of the Unix epoch.
    const EPOCH_JD: f64 = 2_440_587.5;
    const DAY_US: f64 = 86_400e6;

    /// From microseconds since the Unix epoch.
    pub const fn from_micros(micros: i64) -> Self {
        Self { micros }
    }

    /// Microseconds since the Unix epoch.
    pub const fn micros(self) -> i64 {
        self.micros
    }

    /// From seconds since the Unix epoch.
    pub fn from_seconds(seconds: f64) -> Self {
        Self { micros: (seconds * 1e6).round() as i64 }
    }

    /// Seconds since the Unix epoch.
    pub fn seconds(self) -> f64 {
        self.micros as f64 / 1e6
    }

    /// Julian date on the UTC scale as two parts, whole days at midnight and the fraction, which loses nothing.
    pub fn julian_date(self) -> (f64, f64) {
        let day = self.micros.div_euclid(86_400_000_000);
        let fraction = self.micros.rem_euclid(86_400_000_000) as f64 / Self::DAY_US;
        (Self::EPOCH_JD + day as f64, fraction)
    }

    /// Julian date on the UTC scale in one number; good to about 40 us.
    pub fn jd(self) -> f64 {
        let (day, fraction) = self.julian_date();
        day + fraction
    }

    /// Modified Julian date on the UTC scale (JD - 2400000.5).
    pub fn mjd(self) -> f64 {
        let (day, fraction) = self.julian_date();
        (day - 2_400_000.5) + fraction
    }

    /// Seconds from `earlier` to this instant; negative when `earlier` is later.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (self.micros - earlier.micros) as f64 / 1e6
    }

    /// This instant moved by seconds, which may be negative.
    pub fn plus_seconds(self, seconds: f64) -> Self {
        Self { micros: self.micros.saturating_add((seconds * 1e6).round() as i64) }
    }

    /// This instant moved forward.
    pub fn plus(self, duration: Duration) -> Self {
        Self { micros: self.micros.saturating_add(i64::try_from(duration.as_micros()).unwrap_or(i64::MAX)) }
    }

    /// Written by a `strftime` pattern, such as `%Y%m%d_%H%M%S`.
    pub fn strftime(self, pattern: &str) -> String {
        self.timestamp().to_zoned(TimeZone::UTC).strftime(pattern).to_string()
    }

    /// Date and time for people, to the second: `2026-11-21 03:00:00 UTC`.
    pub fn to_second(self) -> String {
        self.strftime("%Y-%m-%d %H:%M:%S UTC")
    }

    /// Time of day for people, to the second: `03:00:00 UTC`.
    pub fn time_of_day(self) -> String {
        self.strftime("%H:%M:%S UTC")
    }

    /// FITS form: ISO 8601 with milliseconds and no zone, such as `2026-11-21T03:00:00.123`.
    pub fn fits(self) -> String {
        self.strftime("%Y-%m-%dT%H:%M:%S.%3f")
    }

    fn timestamp(self) -> jiff::Timestamp {
        jiff::Timestamp::from_microsecond(self.micros).unwrap_or(if self.micros < 0 {
            jiff::Timestamp::MIN
        } else {
            jiff::Timestamp::MAX
        })
    }
}

impl fmt::Display for Utc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.6}", self.timestamp())
    }
}

impl FromStr for Utc {
    type Err = BadTime;

    /// Reads RFC 3339 with any offset, and the same without a zone, which then means UTC.
    fn from_str(text: &str) -> Result<Self, BadTime> {
        let trimmed = text.trim();
        let instant = trimmed.parse::<jiff::Timestamp>().ok().or_else(|| {
            let civil: jiff::civil::DateTime = trimmed.parse().ok()?;
            Offset::UTC.to_timestamp(civil).ok()
        });
        instant.map(|t| Self { micros: t.as_microsecond() }).ok_or_else(|| BadTime(text.to_owned()))
    }
}

impl Serialize for Utc {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Utc {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(de::Error::custom)
    }
}

impl JsonSchema for Utc {
    fn schema_name() -> Cow<'static, str> {
        "Utc".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "string",
            "format": "date-time",
            "description": "A time in UTC, RFC 3339 with Z.",
            "examples": ["2026-11-21T03:00:00.123Z"],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn utc(text: &str) -> Utc {
        text.parse().unwrap()
    }

    #[test]
    fn reads_the_forms_that_schedules_use() {
        let expected = utc("2026-11-21T03:00:00Z");
        for text in
            ["2026-11-21 03:00:00", "2026-11-21T03:00:00.000", "2026-11-21T05:00:00+02:00", " 2026-11-21T03:00Z "]
        {
            assert_eq!(utc(text), expected, "{text}");
        }
        for bad in ["", "yesterday", "2026-13-01T00:00:00Z", "2026-11-21T25:00:00Z"] {
            assert!(bad.parse::<Utc>().is_err(), "{bad}");
        }
    }

    #[test]
    fn writes_rfc_3339_with_z() {
        assert_eq!(utc("2026-11-21T03:00:00.5Z").to_string(), "2026-11-21T03:00:00.500000Z");
        assert_eq!(utc("2026-11-21T03:00:00.1239Z").fits(), "2026-11-21T03:00:00.123");
    }

    #[test]
    fn julian_dates_agree_with_the_known_epoch() {
        // J2000.0 is JD 2451545.0 (TT); the same number on the UTC scale
        let noon = utc("2000-01-01T12:00:00Z");
        assert_eq!(noon.jd(), 2_451_545.0);
        assert_eq!(noon.mjd(), 51_544.5);
        assert_eq!(utc("1969-12-31T18:00:00Z").julian_date(), (2_440_586.5, 0.75));
    }
}
