//! A weather station whose values no longer move: its sensors are dead and it does not know.
//!
//! Hazard S3 of the analysis: a frozen station looks like a calm night. Real air never repeats every digit.

use std::collections::BTreeMap;
use std::time::Duration;

use contract::Device;
use contract::device::observing_conditions::Fields;
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

/// The last value of each channel of a station, bit by bit, and when one of them moved.
#[derive(Debug, Clone)]
struct Still {
    values: BTreeMap<&'static str, u64>,
    since: MachineTime,
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
            // A calm is exactly zero for hours; a channel that falls silent does not move the others.
            let value = fields.by_ascom_name(name).and_then(|datum| datum.known()).filter(|value| **value != 0.0);
            if let Some(bits) = value.map(|value| value.to_bits()) {
                // A first value shows no movement: it may have been the same before this node listened.
                moved |= still.values.insert(name, bits).is_some_and(|before| before != bits);
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

    /// Forgets a station, to observe it anew from its record.
    pub fn forget(&mut self, station: &Device) {
        self.stations.remove(station);
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

    fn stands(values: &[(u64, f64, f64)], now: u64) -> Option<u64> {
        let station =
            Address::new("paranal", "shared").unwrap().device(Kind::ObservingConditions, &"wx".parse().unwrap());
        let mut freeze = Freeze::default();
        for (minute, air_c, humidity_percent) in values {
            let fields = Fields {
                air_c: Datum::Known(*air_c),
                humidity_percent: Datum::Known(*humidity_percent),
                wind_mps: Datum::Known(0.0),
                ..Fields::default()
            };
            freeze.observe(&station, &fields, at(*minute));
        }
        freeze.stand_still(at(now)).next().map(|(_, still)| still.as_secs() / 60)
    }

    #[test]
    fn a_station_is_frozen_while_no_channel_moves() {
        assert_eq!(stands(&[(0, 5.1, 40.0), (30, 5.1, 40.0)], 31), Some(31));
        assert_eq!(stands(&[(0, 5.1, 40.0), (30, 5.1, 40.1)], 31), Some(1));
        assert_eq!(stands(&[(0, 5.1, 40.0), (30, 5.1, 0.0)], 31), Some(31), "a lost channel shows no activity");
        assert_eq!(stands(&[(0, 5.1, 0.0), (30, 5.1, 0.0)], 31), None, "one channel alone may stand still");
    }
}
