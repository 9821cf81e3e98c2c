//! The date of a night, for its files: from noon to noon of local mean time.

use std::fmt;
use std::str::FromStr;

use sofars::cal;
use units::{Angle, Utc};

use crate::SkyError;

const NOON_S: f64 = 43_200.0;
const DAY_S: f64 = 86_400.0;
/// Seconds that local mean time gains on UTC per degree east.
const SECONDS_PER_DEGREE: f64 = 240.0;
/// Julian day of 1970-01-01T00:00.
const EPOCH_JD: f64 = 2_440_587.5;

/// A calendar date, that of the evening on which the night began; written `20261121`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NightDate {
    /// Days since 1970-01-01.
    day: i64,
}

/// The night date of an instant: before 12:00 local mean time (UTC + longitude / 15) the previous day, from 12:00 on
/// that day.
pub fn night_date(longitude_east: Angle, at: Utc) -> NightDate {
    // A longitude of 289.6 deg is 70.4 deg west, and its clocks are behind.
    let local_s = SECONDS_PER_DEGREE * longitude_east.wrapped_signed().degrees();
    let since_noon = at.plus_seconds(local_s - NOON_S);
    NightDate { day: since_noon.micros().div_euclid(86_400_000_000) }
}

impl NightDate {
    /// From a calendar date; refused when there is no such day.
    pub fn new(year: i32, month: i32, day: i32) -> Result<Self, SkyError> {
        let (zero, mjd) =
            cal::cal2jd(year, month, day).map_err(|_| SkyError::Date(format!("{year:04}{month:02}{day:02}")))?;
        Ok(Self { day: (zero + mjd - EPOCH_JD) as i64 })
    }

    /// Year, month (1 to 12) and day of the month.
    pub fn ymd(self) -> (i64, u8, u8) {
        // Days counted from 0000-03-01 in cycles of 400 years; March first, so that the leap day ends a year.
        let days = self.day + 719_468;
        let (cycle, of_cycle) = (days.div_euclid(146_097), days.rem_euclid(146_097));
        let year = (of_cycle - of_cycle / 1460 + of_cycle / 36_524 - of_cycle / 146_096) / 365;
        let of_year = of_cycle - (365 * year + year / 4 - year / 100);
        let march_month = (5 * of_year + 2) / 153;
        let day = of_year - (153 * march_month + 2) / 5 + 1;
        let month = if march_month < 10 { march_month + 3 } else { march_month - 9 };
        (cycle * 400 + year + i64::from(month <= 2), month as u8, day as u8)
    }

    /// Local mean noon at which this night begins; the next night's noon ends it.
    pub fn noon(self, longitude_east: Angle) -> Utc {
        let local_s = SECONDS_PER_DEGREE * longitude_east.wrapped_signed().degrees();
        Utc::from_seconds(self.day as f64 * DAY_S).plus_seconds(NOON_S - local_s)
    }

    /// The night after this one.
    pub const fn next(self) -> Self {
        Self { day: self.day + 1 }
    }

    /// The night before this one.
    pub const fn previous(self) -> Self {
        Self { day: self.day - 1 }
    }
}

impl fmt::Display for NightDate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (year, month, day) = self.ymd();
        write!(f, "{year:04}{month:02}{day:02}")
    }
}

impl FromStr for NightDate {
    type Err = SkyError;

    /// Reads `20261121`.
    fn from_str(text: &str) -> Result<Self, SkyError> {
        let bad = || SkyError::Date(text.to_owned());
        if text.len() != 8 || !text.bytes().all(|byte| byte.is_ascii_digit()) {
            return Err(bad());
        }
        let number = |range| text.get(range).and_then(|part: &str| part.parse().ok()).ok_or_else(bad);
        Self::new(number(0..4)?, number(4..6)?, number(6..8)?).map_err(|_| bad())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn date(longitude_deg: f64, at: &str) -> String {
        night_date(Angle::from_degrees(longitude_deg), at.parse().unwrap()).to_string()
    }

    #[test]
    fn the_date_changes_at_local_mean_noon() {
        // Greenwich: noon is 12:00 UTC.
        assert_eq!(date(0.0, "2026-11-21T11:59:59.999999Z"), "20261120");
        assert_eq!(date(0.0, "2026-11-21T12:00:00Z"), "20261121");
        // Paranal, 70.4 deg west: noon is 16:41:36 UTC.
        assert_eq!(date(-70.4, "2026-11-21T16:41:35Z"), "20261120");
        assert_eq!(date(-70.4, "2026-11-21T16:41:36Z"), "20261121");
        // All night long, over midnight UTC and local.
        for at in ["2026-11-21T23:30:00Z", "2026-11-22T03:00:00Z", "2026-11-22T09:30:00Z"] {
            assert_eq!(date(-70.4, at), "20261121", "{at}");
            assert_eq!(date(289.6, at), "20261121", "{at} counted round the east");
        }
        // Siding Spring, 149 deg east: an evening of 10:00 UTC is already after noon.
        assert_eq!(date(149.0, "2026-11-21T02:03:59Z"), "20261120");
        assert_eq!(date(149.0, "2026-11-21T10:00:00Z"), "20261121");
        assert_eq!(date(149.0, "2026-11-21T18:00:00Z"), "20261121");
    }

    #[test]
    fn dates_run_over_months_years_and_leap_days() {
        assert_eq!(date(0.0, "2027-01-01T03:00:00Z"), "20261231");
        assert_eq!(date(0.0, "2028-03-01T03:00:00Z"), "20280229");
        assert_eq!(date(0.0, "2026-03-01T03:00:00Z"), "20260228");
        assert_eq!(date(0.0, "1969-12-31T03:00:00Z"), "19691230");
        for day in -200_000..200_000 {
            let date = NightDate { day };
            let (year, month, of_month) = date.ymd();
            assert_eq!(NightDate::new(year as i32, month.into(), of_month.into()), Ok(date));
        }
    }

    #[test]
    fn a_night_begins_at_its_noon() {
        let paranal = Angle::from_degrees(-70.4);
        let night: NightDate = "20261121".parse().unwrap();
        assert_eq!(night.noon(paranal), "2026-11-21T16:41:36Z".parse().unwrap());
        assert_eq!(night_date(paranal, night.noon(paranal)), night);
        assert_eq!(night_date(paranal, night.noon(paranal).plus_seconds(-1.0)), night.previous());
        assert_eq!(night.next().to_string(), "20261122");
    }

    #[test]
    fn what_is_no_date_is_refused() {
        for text in ["", "2026-11-21", "20261321", "20260230", "2026112", "+2261121", "２０２６"] {
            assert_eq!(text.parse::<NightDate>(), Err(SkyError::Date(text.to_owned())), "{text}");
        }
    }
}
