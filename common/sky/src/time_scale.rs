//! One instant on the scales that astronomy counts in: TT, UT1 and TDB next to UTC.

use sofars::{cal, ts};
use units::Utc;

use crate::SkyError;

const DAY_S: f64 = 86_400.0;
/// TT - TAI.
const TT_MINUS_TAI_S: f64 = 32.184;

/// An instant on several scales, each as a Julian date in two parts: whole days (at midnight UTC) and the rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Scales {
    /// Coordinated universal time in days of 86400 s, the leap second repeated.
    pub utc: (f64, f64),
    /// The Earth's rotation.
    pub ut1: (f64, f64),
    /// Terrestrial time.
    pub tt: (f64, f64),
}

impl Scales {
    /// Fails outside 1972 to 2099.
    pub fn new(at: Utc, dut1_s: f64) -> Result<Self, SkyError> {
        let (day, fraction) = at.julian_date();
        let (year, month, date, _) = cal::jd2cal(day, 0.0).map_err(|_| SkyError::Time { at })?;
        if !(1972..2100).contains(&year) {
            return Err(SkyError::Time { at });
        }
        // Not sofars::ts::utctai: SOFA stretches a day with a leap second over 86401 s, a POSIX clock does not.
        let tai_minus_utc_s = ts::dat(year, month, date, 0.0).map_err(|_| SkyError::Time { at })?;
        Ok(Self {
            utc: (day, fraction),
            ut1: (day, fraction + dut1_s / DAY_S),
            tt: (day, fraction + (tai_minus_utc_s + TT_MINUS_TAI_S) / DAY_S),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tt_minus_utc_s(text: &str) -> f64 {
        let scales = Scales::new(text.parse().unwrap(), 0.0).unwrap();
        (scales.tt.1 - scales.utc.1) * DAY_S
    }

    #[test]
    fn the_leap_second_of_2016_comes_at_midnight_and_not_before() {
        assert!((tt_minus_utc_s("2016-12-31T23:59:59Z") - 68.184).abs() < 1e-6);
        assert!((tt_minus_utc_s("2017-01-01T00:00:00Z") - 69.184).abs() < 1e-6);
        assert!((tt_minus_utc_s("2026-11-21T03:00:00Z") - 69.184).abs() < 1e-6);
    }

    #[test]
    fn a_clock_that_was_never_set_is_refused() {
        for text in ["1970-01-01T00:00:10Z", "1971-12-31T23:59:59Z", "2100-01-01T00:00:00Z"] {
            let at: Utc = text.parse().unwrap();
            assert_eq!(Scales::new(at, 0.0), Err(SkyError::Time { at }), "{text}");
        }
        assert!(Scales::new(Utc::from_micros(i64::MAX), 0.0).is_err());
        assert!(Scales::new(Utc::from_micros(i64::MIN), 0.0).is_err());
        assert!(Scales::new("2099-12-31T23:59:59Z".parse().unwrap(), 0.0).is_ok());
    }
}
