//! The weather over the site: a calm night that changes a little, and the values that a test orders instead.

use std::f64::consts::TAU;

use serde_json::{Map, Value};
use units::{Angle, Utc};

/// The quantities of an ASCOM weather station, in ASCOM's own units.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Percent of the sky.
    CloudCover,
    /// Deg C.
    DewPoint,
    /// Percent.
    Humidity,
    /// hPa at the site.
    Pressure,
    /// mm per hour.
    RainRate,
    /// Lux.
    SkyBrightness,
    /// Magnitudes per square arcsec.
    SkyQuality,
    /// Deg C.
    SkyTemperature,
    /// Arcsec at the zenith.
    StarFwhm,
    /// Deg C.
    Temperature,
    /// Deg from north through east; 0 when calm.
    WindDirection,
    /// m/s, peak of the last two minutes.
    WindGust,
    /// m/s.
    WindSpeed,
}

impl Quantity {
    /// All of them, in the order of their ASCOM names.
    pub const ALL: [Self; 13] = [
        Self::CloudCover,
        Self::DewPoint,
        Self::Humidity,
        Self::Pressure,
        Self::RainRate,
        Self::SkyBrightness,
        Self::SkyQuality,
        Self::SkyTemperature,
        Self::StarFwhm,
        Self::Temperature,
        Self::WindDirection,
        Self::WindGust,
        Self::WindSpeed,
    ];

    /// ASCOM's name.
    pub const fn ascom(self) -> &'static str {
        match self {
            Self::CloudCover => "CloudCover",
            Self::DewPoint => "DewPoint",
            Self::Humidity => "Humidity",
            Self::Pressure => "Pressure",
            Self::RainRate => "RainRate",
            Self::SkyBrightness => "SkyBrightness",
            Self::SkyQuality => "SkyQuality",
            Self::SkyTemperature => "SkyTemperature",
            Self::StarFwhm => "StarFWHM",
            Self::Temperature => "Temperature",
            Self::WindDirection => "WindDirection",
            Self::WindGust => "WindGust",
            Self::WindSpeed => "WindSpeed",
        }
    }

    /// The quantity of this name, in any case.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|quantity| quantity.ascom().eq_ignore_ascii_case(name))
    }
}

/// The weather at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conditions([f64; 13]);

impl Conditions {
    /// One quantity, in the unit of [`Quantity`].
    pub fn of(&self, quantity: Quantity) -> f64 {
        self.0[quantity as usize]
    }

    fn set(&mut self, quantity: Quantity, value: f64) {
        self.0[quantity as usize] = value;
    }

    /// All by their ASCOM names.
    pub fn state(&self) -> Map<String, Value> {
        Quantity::ALL.into_iter().map(|q| (q.ascom().to_owned(), Value::from(self.of(q)))).collect()
    }
}

/// The weather as it will be, and the values that were ordered instead.
#[derive(Debug, Clone)]
pub struct Weather {
    seed: u64,
    longitude: Angle,
    elevation_m: f64,
    ordered: [Option<f64>; 13],
    raining: bool,
}

impl Weather {
    /// Fair weather.
    pub fn fair(seed: u64, longitude: Angle, elevation_m: f64) -> Self {
        Self { seed, longitude, elevation_m, ordered: [None; 13], raining: false }
    }

    /// Orders a value; None returns to the natural value.
    pub fn order(&mut self, quantity: Quantity, value: Option<f64>) {
        self.ordered[quantity as usize] = value;
    }

    /// Starts or ends the rain, with its clouds and its damp.
    pub fn rain(&mut self, raining: bool) {
        self.raining = raining;
    }

    /// Returns all quantities to their natural values.
    pub fn clear(&mut self) {
        self.ordered = [None; 13];
        self.raining = false;
    }

    /// The weather now, under a sky of this brightness (magnitudes per square arcsec, clear).
    pub fn at(&self, now: Utc, clear_sky_mag: f64) -> Conditions {
        use Quantity::*;
        let mut conditions = Conditions([0.0; 13]);
        let local_h = (now.seconds() / 3600.0 + self.longitude.hours()).rem_euclid(24.0);
        let diurnal = ((local_h - 15.0) / 24.0 * TAU).cos();
        let wind = 3.0 + 1.5 * self.wander(1, 1700.0, now) + 0.5 * self.wander(2, 97.0, now);
        conditions.set(Temperature, 11.0 + 5.0 * diurnal + 0.7 * self.wander(3, 5400.0, now));
        conditions.set(Humidity, 35.0 - 12.0 * diurnal + 5.0 * self.wander(4, 7300.0, now));
        conditions.set(Pressure, pressure_at(self.elevation_m) + 2.0 * self.wander(5, 40_000.0, now));
        conditions.set(CloudCover, (4.0 + 4.0 * self.wander(6, 3600.0, now)).clamp(0.0, 100.0));
        conditions.set(WindSpeed, wind.max(0.0));
        conditions.set(WindDirection, (20.0 + 40.0 * self.wander(7, 8000.0, now)).rem_euclid(360.0));
        conditions.set(StarFwhm, (1.3 + 0.3 * self.wander(8, 2400.0, now)).max(0.6));
        if self.raining {
            for (quantity, value) in [(RainRate, 3.0), (CloudCover, 100.0), (Humidity, 97.0)] {
                conditions.set(quantity, value);
            }
        }
        self.apply(&mut conditions);

        // Quantities that follow from the others, unless they were ordered too.
        let (temperature, cloud) = (conditions.of(Temperature), conditions.of(CloudCover) / 100.0);
        conditions.set(DewPoint, dew_point(temperature, conditions.of(Humidity)));
        conditions.set(WindGust, conditions.of(WindSpeed) * (1.35 + 0.1 * self.wander(9, 310.0, now)));
        // A clear sky is some 30 K colder than the air, a cloud hardly.
        conditions.set(SkyTemperature, temperature - 32.0 * (1.0 - cloud) - 2.0);
        conditions.set(SkyQuality, clear_sky_mag - 0.3 * cloud);
        // 10.8e4 cd/m2 is magnitude 0 per square arcsec; a uniform sky of L cd/m2 gives pi L lux.
        conditions.set(SkyBrightness, 3.39e5 * 10.0_f64.powf(-0.4 * clear_sky_mag));
        self.apply(&mut conditions);
        conditions
    }

    fn apply(&self, conditions: &mut Conditions) {
        for (quantity, ordered) in Quantity::ALL.into_iter().zip(self.ordered) {
            if let Some(value) = ordered {
                conditions.set(quantity, value);
            }
        }
    }

    /// A smooth number between -1 and 1 that is back near itself after about `period_s`.
    fn wander(&self, which: u64, period_s: f64, now: Utc) -> f64 {
        let mixed = (self.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ which.wrapping_mul(0xD1B5_4A32_D192_ED03)) >> 40;
        let phase = mixed as f64 * 1e-3;
        let t = now.seconds() / period_s * TAU;
        0.6 * (t + phase).sin() + 0.4 * (t * 1.618 + 2.0 * phase).sin()
    }
}

/// Standard atmosphere, hPa.
fn pressure_at(elevation_m: f64) -> f64 {
    1013.25 * (1.0 - 2.255_77e-5 * elevation_m).powf(5.2559)
}

/// Magnus formula, deg C.
fn dew_point(temperature: f64, humidity: f64) -> f64 {
    let gamma = (humidity.max(0.1) / 100.0).ln() + 17.62 * temperature / (243.12 + temperature);
    243.12 * gamma / (17.62 - gamma)
}

/// Brightness of the clear sky at the zenith in V, magnitudes per square arcsec, by the Sun's altitude.
///
/// Twilight after Patat et al. 2006, A&A 455, 385 (V, zenith distances 95 to 105 deg); by day a bright blue sky.
pub fn clear_sky_mag(sun_altitude: Angle) -> f64 {
    const NIGHT: f64 = 21.8;
    let below_95 = 90.0 - sun_altitude.degrees() - 95.0;
    if below_95 < 0.0 {
        return (11.84 + 1.7 * below_95).max(3.5);
    }
    if below_95 > 13.0 {
        return NIGHT;
    }
    (11.84 + 1.518 * below_95 - 0.057 * below_95 * below_95).min(NIGHT)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fair() -> Weather {
        Weather::fair(1, Angle::from_degrees(-70.4), 2635.0)
    }

    fn now() -> Utc {
        "2026-11-21T03:00:00Z".parse().unwrap()
    }

    #[test]
    fn the_dew_point_is_the_temperature_of_saturation() {
        assert!((dew_point(20.0, 100.0) - 20.0).abs() < 1e-9);
        // WMO guide: 20 C at 50 % gives 9.3 C.
        assert!((dew_point(20.0, 50.0) - 9.3).abs() < 0.1);
    }

    #[test]
    fn rain_brings_clouds_and_a_warm_sky() {
        let mut weather = fair();
        let dry = weather.at(now(), 21.8);
        assert_eq!(dry.of(Quantity::RainRate), 0.0);
        weather.rain(true);
        let wet = weather.at(now(), 21.8);
        assert!(wet.of(Quantity::RainRate) > 0.0 && wet.of(Quantity::CloudCover) > 99.0);
        assert!(wet.of(Quantity::SkyTemperature) > dry.of(Quantity::SkyTemperature) + 20.0);
    }

    #[test]
    fn an_ordered_value_holds_and_what_follows_from_it_follows() {
        let mut weather = fair();
        weather.order(Quantity::Humidity, Some(100.0));
        let damp = weather.at(now(), 21.8);
        assert_eq!(damp.of(Quantity::Humidity), 100.0);
        assert!((damp.of(Quantity::DewPoint) - damp.of(Quantity::Temperature)).abs() < 1e-9);
        weather.order(Quantity::DewPoint, Some(-5.0));
        assert_eq!(weather.at(now(), 21.8).of(Quantity::DewPoint), -5.0);
    }

    #[test]
    fn the_sky_darkens_as_the_sun_sinks() {
        let brightness: Vec<f64> = (-25..=20).rev().map(|a| clear_sky_mag(Angle::from_degrees(f64::from(a)))).collect();
        assert!(brightness.is_sorted(), "{brightness:?}");
        assert!(brightness[0] < 5.0 && brightness[45] == 21.8);
    }
}
