//! The polled readings: every property's newest answer under its ASCOM name, and what typed fields read from it.

use std::collections::BTreeMap;

use alpaca::value;
use bus::MachineTime;
use contract::datum::ReadingOutcome;
use contract::{Datum, Kind, NoData, Reading};
use serde_json::Value;
use units::Utc;

use crate::now::Now;

/// The newest answers of one device.
#[derive(Debug, Clone, Default)]
pub struct Readings {
    answers: BTreeMap<String, StoredAnswer>,
}

/// One answer.
#[derive(Debug, Clone)]
struct StoredAnswer {
    answer: Result<Value, NoData>,
    at_utc: Utc,
    /// When the device was asked; the answer is at least as new as that. `None` of what does not change.
    asked: Option<Now>,
}

impl Readings {
    /// Stores an answer whose age is of no interest.
    pub fn keep(&mut self, property: &str, answer: Result<Value, NoData>, at_utc: Utc) {
        self.answers.insert(property.to_owned(), StoredAnswer { answer, at_utc, asked: None });
    }

    /// Stores an answer to a question that was asked then.
    pub fn keep_asked(&mut self, property: &str, answer: Result<Value, NoData>, at_utc: Utc, asked: Now) {
        self.answers.insert(property.to_owned(), StoredAnswer { answer, at_utc, asked: Some(asked) });
    }

    /// Every property is missing now, for one reason.
    pub fn lose(&mut self, reason: &NoData, at_utc: Utc) {
        for stored in self.answers.values_mut() {
            *stored = StoredAnswer { answer: Err(reason.clone()), at_utc, asked: None };
        }
    }

    /// Every property that is polled is missing now, for one reason; what does not change stays, also that the device does not
    /// have a property: it is not asked again.
    pub fn drop_polled(&mut self, reason: &NoData, at_utc: Utc) {
        let absent = Err(NoData::not_implemented());
        for stored in self.answers.values_mut().filter(|stored| stored.asked.is_some() && stored.answer != absent) {
            *stored = StoredAnswer { answer: Err(reason.clone()), at_utc, asked: None };
        }
    }

    /// When the question of the present answer was asked.
    pub fn asked(&self, property: &str) -> Option<Now> {
        self.answers.get(property)?.asked
    }

    /// Why a property that the device has could not be read in the present answer.
    pub fn failure(&self, property: &str) -> Option<&NoData> {
        let reason = self.answers.get(property)?.answer.as_ref().err()?;
        Some(reason).filter(|reason| **reason != NoData::not_implemented())
    }

    fn read<T>(&self, property: &str, read: impl Fn(&Value) -> Result<T, NoData>) -> Datum<T> {
        match self.answers.get(property) {
            Some(StoredAnswer { answer: Ok(value), .. }) => read(value).into(),
            Some(StoredAnswer { answer: Err(reason), .. }) => Datum::missing(reason.clone()),
            None => Datum::default(),
        }
    }

    /// A finite number.
    pub fn number(&self, property: &str) -> Datum<f64> {
        self.read(property, value::number)
    }

    /// A finite number, or why the answer is none; `None` where there is no answer.
    pub fn answered_number(&self, property: &str) -> Option<Datum<f64>> {
        self.answers.get(property)?.answer.as_ref().ok()?;
        Some(self.number(property))
    }

    /// A whole number.
    pub fn whole(&self, property: &str) -> Datum<i64> {
        self.read(property, value::whole)
    }

    /// True or false.
    pub fn flag(&self, property: &str) -> Datum<bool> {
        self.read(property, value::flag)
    }

    /// JSON `true` or `false` only.
    pub fn strict_flag(&self, property: &str) -> Datum<bool> {
        self.read(property, value::strict_flag)
    }

    /// Text.
    pub fn text(&self, property: &str) -> Datum<String> {
        self.read(property, value::text)
    }

    /// An ASCOM enumeration; numbers outside it are missing.
    pub fn choice<T: Copy>(&self, property: &str, choices: &[(i64, T)]) -> Datum<T> {
        self.read(property, |answer| {
            let number = value::whole(answer)?;
            let choice = choices.iter().find(|(n, _)| *n == number);
            choice
                .map(|(_, choice)| *choice)
                .ok_or_else(|| NoData::new("wrong type", format!("{property} is {number}")))
        })
    }

    /// All of it as the contract shows it, in ASCOM's units, with its ages `now`.
    pub fn published(&self, kind: Kind, now: MachineTime) -> BTreeMap<String, Reading> {
        let published = self.answers.iter().map(|(property, StoredAnswer { answer, at_utc, asked })| {
            let unit = unit(kind, property).unwrap_or_default();
            // Whole milliseconds: more exact than any answer.
            let age_s = asked
                .filter(|_| answer.is_ok())
                .map(|asked| (now.since(asked.machine).as_secs_f64() * 1e3).round() / 1e3);
            (property.clone(), Reading { outcome: outcome(answer, unit), at_utc: *at_utc, age_s })
        });
        published.collect()
    }
}

fn outcome(answer: &Result<Value, NoData>, unit: &str) -> ReadingOutcome {
    let value = match answer {
        // If a number has a unit, text in its place is a sloppy server's number.
        Ok(answer @ Value::String(_)) if !unit.is_empty() => value::number(answer).map(contract::Scalar::Float),
        Ok(answer) => value::scalar(answer),
        Err(reason) => Err(reason.clone()),
    };
    match value {
        Ok(value) => ReadingOutcome::Value { value, unit: unit.to_owned() },
        Err(no_data) => ReadingOutcome::Missing { no_data },
    }
}

/// How old a weather station's own measurement is: of its newest sensor, or of the one in brackets behind it.
pub const AGE: &str = "TimeSinceLastUpdate";

/// The property that holds the age of one sensor.
pub fn age_of(sensor: &str) -> String {
    format!("{AGE}({sensor})")
}

/// The sensor whose age a property holds; empty for the newest of all.
pub fn aged_sensor(property: &str) -> Option<&str> {
    let rest = property.strip_prefix(AGE)?;
    if rest.is_empty() { Some(rest) } else { rest.strip_prefix('(')?.strip_suffix(')') }
}

/// The Alpaca member and parameters that a property is read by; some properties are methods with a parameter.
pub fn member(property: &str) -> (String, Vec<(&'static str, String)>) {
    if let Some(sensor) = aged_sensor(property) {
        return (AGE.to_ascii_lowercase(), vec![("SensorName", sensor.to_owned())]);
    }
    match property.strip_prefix("GetSwitchValue") {
        Some(number) if number.parse::<u32>().is_ok() => ("getswitchvalue".to_owned(), vec![("Id", number.to_owned())]),
        _ => (property.to_ascii_lowercase(), Vec::new()),
    }
}

/// Unit that ASCOM gives a property; `None` where it has none.
fn unit(kind: Kind, property: &str) -> Option<&'static str> {
    Some(match (kind, property) {
        (Kind::Telescope, "RightAscension" | "TargetRightAscension" | "SiderealTime") => "h",
        (Kind::Telescope, "Declination" | "TargetDeclination" | "Altitude" | "Azimuth") => "deg",
        (Kind::Telescope, "SiteLatitude" | "SiteLongitude") => "deg",
        (Kind::Telescope, "SiteElevation" | "ApertureDiameter" | "FocalLength") => "m",
        (Kind::Telescope, "ApertureArea") => "m2",
        (Kind::Telescope, "RightAscensionRate") => "s/s",
        (Kind::Telescope, "DeclinationRate") => "arcsec/s",
        (Kind::Telescope, "GuideRateRightAscension" | "GuideRateDeclination") => "deg/s",
        (Kind::Telescope, "SlewSettleTime") => "s",
        (Kind::Camera, "CCDTemperature" | "SetCCDTemperature" | "HeatSinkTemperature") => "C",
        (Kind::Camera, "CoolerPower" | "PercentCompleted") => "%",
        (Kind::Camera, "PixelSizeX" | "PixelSizeY") => "um",
        (Kind::Camera, "ElectronsPerADU") => "e/ADU",
        (Kind::Camera, "FullWellCapacity") => "e",
        (Kind::Camera, "MaxADU") => "ADU",
        (Kind::Camera, "LastExposureDuration" | "ExposureMin" | "ExposureMax") => "s",
        (Kind::Camera, "StartX" | "StartY" | "NumX" | "NumY" | "CameraXSize" | "CameraYSize") => "px",
        (Kind::Focuser, "Position" | "MaxStep" | "MaxIncrement") => "step",
        (Kind::Focuser, "StepSize") => "um",
        (Kind::Focuser, "Temperature") => "C",
        (Kind::Dome, "Azimuth" | "Altitude") => "deg",
        (Kind::Rotator, "Position" | "MechanicalPosition" | "TargetPosition" | "StepSize") => "deg",
        (Kind::ObservingConditions, "CloudCover" | "Humidity") => "%",
        (Kind::ObservingConditions, "DewPoint" | "SkyTemperature" | "Temperature") => "C",
        (Kind::ObservingConditions, "Pressure") => "hPa",
        (Kind::ObservingConditions, "RainRate") => "mm/h",
        (Kind::ObservingConditions, "SkyBrightness") => "lx",
        (Kind::ObservingConditions, "SkyQuality") => "mag/arcsec2",
        (Kind::ObservingConditions, "StarFWHM") => "arcsec",
        (Kind::ObservingConditions, "WindDirection") => "deg",
        (Kind::ObservingConditions, "WindGust" | "WindSpeed") => "m/s",
        (Kind::ObservingConditions, name) if aged_sensor(name).is_some() => "s",
        (Kind::ObservingConditions, "AveragePeriod") => "h",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use bus::SkyTime;
    use serde_json::json;

    use super::*;

    #[test]
    fn a_reading_that_is_published_again_is_older_and_what_was_never_asked_has_no_age() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let asked = Now { machine: at(100), sky: SkyTime::from_start(Duration::ZERO) };
        let mut readings = Readings::default();
        readings.keep_asked("IsSafe", Ok(json!(true)), Utc::EPOCH, asked);
        readings.keep("Name", Ok(json!("x")), Utc::EPOCH);
        readings.keep_asked("AtPark", Err(NoData::not_implemented()), Utc::EPOCH, asked);
        let age_s = |readings: &Readings, name: &str, now| readings.published(Kind::SafetyMonitor, at(now))[name].age_s;
        assert_eq!((age_s(&readings, "IsSafe", 100), age_s(&readings, "IsSafe", 112)), (Some(0.0), Some(12.0)));
        assert_eq!(age_s(&readings, "Name", 112), None);
        readings.drop_polled(&NoData::new("stale", "x"), Utc::EPOCH);
        assert_eq!((age_s(&readings, "IsSafe", 112), readings.flag("IsSafe").known()), (None, None));
        assert_eq!(readings.text("Name"), Datum::Known("x".to_owned()));
        assert_eq!(readings.flag("AtPark"), Datum::missing(NoData::not_implemented()), "nobody asks for it again");
    }

    #[test]
    fn numbers_keep_ascoms_unit_and_absence_its_reason() {
        let mut readings = Readings::default();
        readings.keep("RightAscension", Ok(json!("5.5")), Utc::EPOCH);
        readings.keep("Declination", Ok(json!("NaN")), Utc::EPOCH);
        readings.keep("Tracking", Err(NoData::not_implemented()), Utc::EPOCH);
        let published =
            serde_json::to_value(readings.published(Kind::Telescope, MachineTime::from_boot(Duration::ZERO))).unwrap();
        assert_eq!(published["RightAscension"], json!({"value": 5.5, "unit": "h", "at_utc": Utc::EPOCH}));
        assert_eq!(published["Declination"]["no_data"], "not a number");
        assert_eq!(published["Tracking"]["no_data"], "not implemented");
        assert_eq!(readings.number("RightAscension"), Datum::Known(5.5));
        assert_eq!(readings.number("Altitude"), Datum::missing(NoData::never_read()));
    }
}
