//! The weather station.

use alpaca::{Abilities, Alpaca, AlpacaError, value};
use contract::CommandId;
use contract::device::observing_conditions::{self, Capabilities, Command, Fields};
use interlock::Need;

use super::{Driver, Executed};
use crate::readings::{AGE, Readings, age_of};

/// Reads a weather station.
pub struct ObservingConditions;

impl Driver for ObservingConditions {
    type Kind = observing_conditions::ObservingConditions;

    fn polled(&self) -> Vec<String> {
        let ages = observing_conditions::ascom_names().map(age_of);
        observing_conditions::ascom_names().chain([AGE]).map(str::to_owned).chain(ages).collect()
    }

    async fn capabilities(&self, abilities: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        let mut measures = Vec::new();
        for sensor in observing_conditions::ascom_names() {
            if abilities.read(sensor, value::number).await?.is_ok() {
                measures.push(sensor.to_owned());
            }
        }
        Ok(Capabilities { measures })
    }

    fn fields(&self, readings: &Readings) -> Fields {
        Fields {
            cloud_percent: readings.number("CloudCover"),
            dew_point_c: readings.number("DewPoint"),
            humidity_percent: readings.number("Humidity"),
            pressure_hpa: readings.number("Pressure"),
            rain_mm_per_h: readings.number("RainRate"),
            sky_lux: readings.number("SkyBrightness"),
            sky_mag_per_arcsec2: readings.number("SkyQuality"),
            sky_c: readings.number("SkyTemperature"),
            star_fwhm_arcsec: readings.number("StarFWHM"),
            air_c: readings.number("Temperature"),
            wind_from_deg: readings.number("WindDirection"),
            gust_mps: readings.number("WindGust"),
            wind_mps: readings.number("WindSpeed"),
            sensor_age_s: readings.number(AGE),
            sensor_ages_s: observing_conditions::ascom_names()
                .filter_map(|sensor| Some((sensor.to_owned(), readings.answered_number(&age_of(sensor))?)))
                .collect(),
        }
    }

    fn moves(&self, command: &Command) -> bool {
        match command {
            // A measurement.
            Command::Refresh => false,
        }
    }

    fn need(&self, command: &Command) -> Need {
        match command {
            Command::Refresh => Need::Nothing,
        }
    }

    async fn execute(
        &self,
        alpaca: &Alpaca,
        _: &CommandId,
        command: &Command,
        _: &Fields,
    ) -> Result<Executed, AlpacaError> {
        match command {
            Command::Refresh => alpaca.put("refresh", &[]).await?,
        }
        Ok(Executed::Done)
    }
}
