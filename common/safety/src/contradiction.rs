//! Values of one weather station that cannot be true together: at least one of its sensors is dead, and nobody knows
//! which.
//!
//! A value that is impossible by itself is no value (`contract`'s table of physical ranges). What is here are values
//! that are each possible. Each rule leaves room for the errors of two good sensors.

use std::fmt;

use contract::device::observing_conditions::{Fields, made_of, physical_range};

/// The two kinds of wind speed, averaged over different times, may differ by this, m/s, or by this part of the wind.
const WIND_MPS: f64 = 2.0;
const WIND_PART: f64 = 0.3;
/// Rain of this much, mm/h, makes the air near the ground damper than this, percent.
const RAIN_MM_PER_H: f64 = 0.5;
const RAINY_PERCENT: f64 = 40.0;
/// The driest air that was ever measured, and the least that sensors are specified for, percent.
const DRIEST_PERCENT: f64 = 1.0;
/// The humidity by temperature and dew point, and that of the sensor, may differ by so much, percent.
const HUMIDITY_PERCENT: f64 = 30.0;
/// From here on it is day, lux, and a sky of this many magnitudes per square arcsec is dark.
const DAY_LUX: f64 = 1000.0;
const DARK_MAG: f64 = 15.0;
/// Properties of the air that are not all exactly zero at one time.
const NEVER_ALL_ZERO: [&str; 5] = ["Temperature", "Humidity", "DewPoint", "Pressure", "SkyTemperature"];

/// Two values, by their ASCOM names, that exclude each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contradiction {
    one: (&'static str, f64),
    other: (&'static str, f64),
    why: &'static str,
}

impl fmt::Display for Contradiction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { one, other, why } = self;
        let value = |value: f64| (value * 1000.0).round() / 1000.0;
        write!(
            f,
            "the station contradicts itself: {} is {} and {} is {}; {why}",
            one.0,
            value(one.1),
            other.0,
            value(other.1)
        )
    }
}

/// The first contradiction among the values of a station.
pub fn contradiction(fields: &Fields) -> Option<Contradiction> {
    let any = [zeros, no_air, difference, humidity, gust, rain, daylight].into_iter();
    any.filter_map(|rule| rule(fields)).next()
}

/// A value that is possible by itself, by its ASCOM name.
fn value(fields: &Fields, name: &'static str) -> Option<(&'static str, f64)> {
    Some((name, fields.measured(name).ok()?))
}

/// A station that has lost its sensors reports zero for everything.
fn zeros(fields: &Fields) -> Option<Contradiction> {
    let known = NEVER_ALL_ZERO.into_iter().filter_map(|name| Some((name, *fields.by_ascom_name(name)?.known()?)));
    let known: Vec<_> = known.collect();
    match known.as_slice() {
        [one, other, ..] if known.iter().all(|(_, value)| *value == 0.0) => {
            Some(Contradiction { one: *one, other: *other, why: "all that it measures of the air is exactly 0" })
        }
        _ => None,
    }
}

/// Dry air is not that dry; a fraction of 1 looks like it, too.
fn no_air(fields: &Fields) -> Option<Contradiction> {
    let one = value(fields, "Humidity").filter(|(_, percent)| *percent < DRIEST_PERCENT)?;
    Some(Contradiction { one, other: ("the driest air", DRIEST_PERCENT), why: "no air is drier than 1 percent" })
}

/// A difference outside of its own range: the dew point above the temperature, the sky far colder or warmer than the
/// air.
fn difference(fields: &Fields) -> Option<Contradiction> {
    contract::device::observing_conditions::differences().find_map(|name| {
        let [one, other] = made_of(name).try_into().ok()?;
        let (one, other) = (value(fields, one)?, value(fields, other)?);
        let is_possible = physical_range(name).is_some_and(|range| range.contains(one.1 - other.1));
        (!is_possible).then_some(Contradiction { one, other, why: "this difference is not possible" })
    })
}

/// Humidity, temperature and dew point are two values and one that follows from them.
fn humidity(fields: &Fields) -> Option<Contradiction> {
    let (air, dew) = (value(fields, "Temperature")?.1, value(fields, "DewPoint")?);
    let one = value(fields, "Humidity")?;
    // Magnus' formula with the numbers of the WMO's guide. Frost differs from it by some percent, which the room covers.
    let vapour = |celsius: f64| (17.62 * celsius / (243.12 + celsius)).exp();
    let by_dew = 100.0 * vapour(dew.1) / vapour(air);
    let differs = (by_dew.min(100.0) - one.1.min(100.0)).abs() > HUMIDITY_PERCENT;
    differs.then_some(Contradiction { one, other: dew, why: "by the temperature, both cannot be" })
}

/// A gust is the largest wind of some minutes.
fn gust(fields: &Fields) -> Option<Contradiction> {
    let (one, other) = (value(fields, "WindGust")?, value(fields, "WindSpeed")?);
    let room = WIND_MPS.max(WIND_PART * other.1);
    (one.1 < other.1 - room).then_some(Contradiction { one, other, why: "a gust is no less than the wind" })
}

/// Rain is damp.
fn rain(fields: &Fields) -> Option<Contradiction> {
    let one = value(fields, "RainRate").filter(|(_, rate)| *rate >= RAIN_MM_PER_H)?;
    let other = value(fields, "Humidity").filter(|(_, percent)| *percent < RAINY_PERCENT)?;
    Some(Contradiction { one, other, why: "rain makes the air damper than that" })
}

/// A sky is not dark by day.
fn daylight(fields: &Fields) -> Option<Contradiction> {
    let one = value(fields, "SkyQuality").filter(|(_, mag)| *mag > DARK_MAG)?;
    let other = value(fields, "SkyBrightness").filter(|(_, lux)| *lux > DAY_LUX)?;
    Some(Contradiction { one, other, why: "no sky is dark in daylight" })
}

#[cfg(test)]
mod tests {
    use contract::Datum;

    use super::*;

    /// A station with these values, by ASCOM names.
    fn station(values: &[(&str, f64)]) -> Fields {
        let mut fields = Fields::default();
        for (name, value) in values {
            let field = match *name {
                "DewPoint" => &mut fields.dew_point_c,
                "Humidity" => &mut fields.humidity_percent,
                "Pressure" => &mut fields.pressure_hpa,
                "RainRate" => &mut fields.rain_mm_per_h,
                "SkyBrightness" => &mut fields.sky_lux,
                "SkyQuality" => &mut fields.sky_mag_per_arcsec2,
                "SkyTemperature" => &mut fields.sky_c,
                "Temperature" => &mut fields.air_c,
                "WindGust" => &mut fields.gust_mps,
                "WindSpeed" => &mut fields.wind_mps,
                other => panic!("{other}"),
            };
            *field = Datum::Known(*value);
        }
        fields
    }

    #[test]
    fn values_that_exclude_each_other_are_named_with_the_reason() {
        for (values, words) in [
            (&[("Temperature", 3.0), ("DewPoint", 9.0)][..], "Temperature is 3 and DewPoint is 9"),
            (&[("Temperature", 20.0), ("SkyTemperature", -69.0)], "SkyTemperature is -69"),
            (&[("Temperature", -30.0), ("SkyTemperature", 20.0)], "SkyTemperature is 20"),
            (&[("Humidity", 0.0), ("WindSpeed", 3.0)], "no air is drier"),
            (&[("Humidity", 0.41), ("WindSpeed", 3.0)], "no air is drier"),
            (&[("Temperature", 0.0), ("DewPoint", 0.0), ("WindSpeed", 0.0)], "exactly 0"),
            (&[("Temperature", 0.0), ("Humidity", -0.0), ("Pressure", 0.0)], "exactly 0"),
            (&[("Temperature", 10.0), ("DewPoint", 9.5), ("Humidity", 20.0)], "Humidity is 20 and DewPoint is 9.5"),
            (&[("Temperature", 10.0), ("DewPoint", -20.0), ("Humidity", 95.0)], "Humidity is 95"),
            (&[("WindGust", 0.0), ("WindSpeed", 8.0)], "a gust is no less"),
            (&[("WindGust", 5.0), ("WindSpeed", 8.0)], "a gust is no less"),
            (&[("RainRate", 4.0), ("Humidity", 25.0)], "rain makes the air damper"),
            (&[("SkyQuality", 21.5), ("SkyBrightness", 20_000.0)], "no sky is dark in daylight"),
        ] {
            let found = contradiction(&station(values)).map(|found| found.to_string()).unwrap_or_default();
            assert!(found.contains(words), "{values:?}: {found}");
        }
    }

    #[test]
    fn what_real_stations_report_is_no_contradiction() {
        for values in [
            // A calm and dry night, one in fog, one below zero, one that crosses zero, and a gust that is over.
            &[("Temperature", 9.0), ("DewPoint", -3.0), ("Humidity", 41.0), ("WindSpeed", 0.0), ("WindGust", 0.0)][..],
            &[("Temperature", 9.0), ("DewPoint", 9.4), ("Humidity", 103.0), ("SkyTemperature", 8.0)],
            &[("Temperature", -15.0), ("DewPoint", -21.0), ("Humidity", 68.0), ("SkyTemperature", -58.0)],
            &[("Temperature", 0.0), ("DewPoint", -8.1), ("Humidity", 54.0), ("WindSpeed", 0.0), ("RainRate", 0.0)],
            &[("WindSpeed", 10.0), ("WindGust", 8.5), ("Humidity", 2.0), ("Temperature", 14.0), ("DewPoint", -36.0)],
            &[("RainRate", 0.2), ("Humidity", 35.0)],
            &[("RainRate", 3.0), ("Humidity", 80.0)],
            &[("SkyQuality", 21.5), ("SkyBrightness", 0.0)],
            &[("SkyQuality", 5.0), ("SkyBrightness", 90_000.0)],
            &[("Temperature", 0.0), ("WindSpeed", 0.0), ("WindGust", 0.0)],
            &[],
        ] {
            assert_eq!(contradiction(&station(values)), None, "{values:?}");
        }
    }

    #[test]
    fn a_value_that_is_impossible_by_itself_contradicts_nothing() {
        assert_eq!(contradiction(&station(&[("Temperature", -273.15), ("DewPoint", 9.0)])), None);
        assert_eq!(contradiction(&station(&[("WindGust", -1.0), ("WindSpeed", 8.0)])), None);
    }
}
