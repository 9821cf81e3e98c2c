//! A weather station whose values no longer move: its sensors are dead and it does not know.
//!
//! Hazard S3 of the analysis: a frozen station looks like a calm night. Real air never repeats every digit.

use std::collections::BTreeMap;
use std::time::Duration;

use contract::Device;
use contract::device::observing_conditions::Fields;
use serde::{Deserialize, Serialize};
use units::MachineTime;

/// What moves with the air; the rest (rain, clouds, brightness) may stand still by nature.
const ANALOGUE: [&str; 7] =
    ["Temperature", "Humidity", "DewPoint", "Pressure", "SkyTemperature", "WindSpeed", "WindGust"];
/// Fewer channels than this may stand still together by chance.
const LEAST_CHANNELS: usize = 2;

/// Since when the values of each station stand still.
#[derive(Debug, Clone, Default)]
pub struct Freeze {
    stations: BTreeMap<Device, Still>,
}

/// The last possible value of each channel of a station, bit by bit, and when one of them moved. `None`: all that came
/// was the code of a dead sensor.
#[derive(Debug, Clone)]
struct Still {
    values: BTreeMap<&'static str, Option<u64>>,
    since: MachineTime,
}

/// What of it survives a restart of this node: the values, and how long they had been the same when it was written,
/// machine time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredStill {
    values: BTreeMap<String, Option<u64>>,
    still: Duration,
}

impl Still {
    fn is_enough(&self) -> bool {
        self.values.len() >= LEAST_CHANNELS
    }
}

impl Freeze {
    /// Takes in a station's state; machine time, because a fast simulation polls seldom. Returns true if a channel
    /// moved.
    pub fn observe(&mut self, station: &Device, fields: &Fields, now: MachineTime) -> bool {
        let fresh = Still { values: BTreeMap::new(), since: now };
        let still = self.stations.entry(station.clone()).or_insert(fresh);
        let mut moved = false;
        for name in ANALOGUE {
            if fields.by_ascom_name(name).is_none_or(|datum| datum.known().is_none()) {
                continue;
            }
            // Zeros count like any value: a station that has lost its sensors reports zero for everything. A channel
            // that becomes the code of a dead sensor, or one code after another, shows no movement.
            let before = still.values.entry(name).or_default();
            // Zero has two forms.
            if let Ok(bits) = fields.measured(name).map(|value| (value + 0.0).to_bits()) {
                // A first value shows no movement: it may have been the same before this node listened.
                moved |= before.replace(bits).is_some_and(|before| before != bits);
            }
        }
        if moved {
            still.since = now;
        }
        moved
    }

    /// Are enough channels of a station known to decide whether its values stand still?
    pub fn knows(&self, station: &Device) -> bool {
        self.stations.get(station).is_some_and(Still::is_enough)
    }

    /// Goes on with what another one knows of a station.
    pub fn take_over(&mut self, station: &Device, other: &Self) {
        match other.stations.get(station) {
            Some(still) => drop(self.stations.insert(station.clone(), still.clone())),
            None => self.forget(station),
        }
    }

    /// Forgets a station, to observe it anew from its record.
    pub fn forget(&mut self, station: &Device) {
        self.stations.remove(station);
    }

    /// What is to be written of a station.
    pub fn store(&self, station: &Device, now: MachineTime) -> Option<StoredStill> {
        let Still { values, since } = self.stations.get(station)?;
        let values = values.iter().map(|(name, bits)| ((*name).to_owned(), *bits)).collect();
        Some(StoredStill { values, still: now.since(*since) })
    }

    /// Goes on with what was written of a station `then`.
    pub fn restore(&mut self, station: &Device, stored: &StoredStill, then: MachineTime) {
        let values = ANALOGUE.iter().filter_map(|name| Some((*name, *stored.values.get(*name)?))).collect();
        self.stations.insert(station.clone(), Still { values, since: then.minus(stored.still) });
    }

    /// How long all values of each station have been the same.
    pub fn stand_still(&self, now: MachineTime) -> impl Iterator<Item = (&Device, Duration)> {
        let enough = self.stations.iter().filter(|(_, still)| still.is_enough());
        enough.map(move |(station, still)| (station, now.since(still.since)))
    }
}

#[cfg(test)]
mod tests {
    use contract::{Address, Datum, Kind};

    use super::*;

    fn at(minute: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(60 * minute))
    }

    fn station() -> Device {
        Address::new("paranal", "shared").unwrap().device(Kind::ObservingConditions, &"wx".parse().unwrap())
    }

    fn stands(values: &[(u64, f64, f64)], now: u64) -> Option<u64> {
        let mut freeze = Freeze::default();
        for (minute, air_c, humidity_percent) in values {
            let fields = Fields {
                air_c: Datum::Known(*air_c),
                humidity_percent: Datum::Known(*humidity_percent),
                ..Fields::default()
            };
            freeze.observe(&station(), &fields, at(*minute));
        }
        freeze.stand_still(at(now)).next().map(|(_, still)| still.as_secs() / 60)
    }

    #[test]
    fn a_station_is_frozen_while_no_channel_moves() {
        assert_eq!(stands(&[(0, 5.1, 40.0), (30, 5.1, 40.0)], 31), Some(31));
        assert_eq!(stands(&[(0, 5.1, 40.0), (30, 5.1, 40.1)], 31), Some(1));
        assert_eq!(stands(&[(0, 5.1, -1.0), (30, 5.1, -999.0), (40, 5.1, -1.0)], 41), Some(41), "codes do not move");
        assert_eq!(stands(&[(0, 5.1, 40.0), (30, 5.1, -1.0), (40, 5.1, 40.0)], 41), Some(41), "nor does coming back");
    }

    #[test]
    fn a_station_of_zeros_is_frozen_like_any_other() {
        assert_eq!(stands(&[(0, 0.0, 0.0), (30, 0.0, -0.0)], 31), Some(31));
        let calm = Fields { wind_mps: Datum::Known(0.0), gust_mps: Datum::Known(0.0), ..Fields::default() };
        let mut freeze = Freeze::default();
        for minute in [0, 10, 20] {
            freeze.observe(&station(), &calm, at(minute));
        }
        assert_eq!(freeze.stand_still(at(21)).count(), 1, "an anemometer that hangs looks like a calm");
    }

    #[test]
    fn one_channel_alone_may_stand_still() {
        let fields = Fields { air_c: Datum::Known(5.1), ..Fields::default() };
        let mut freeze = Freeze::default();
        freeze.observe(&station(), &fields, at(0));
        assert!(!freeze.knows(&station()) && freeze.stand_still(at(90)).next().is_none());
    }
}
