//! Where not to point in a wind: within an angle of where it comes from, from a speed on.

use std::collections::BTreeMap;
use std::time::Duration;

use config::WindSector;
use contract::Device;
use contract::device::observing_conditions::Fields;
use contract::observatory::Sector;
use units::MachineTime;

/// A wind older than this is none, machine time.
const MOST_AGE: Duration = Duration::from_secs(60);

/// The newest wind of each station.
#[derive(Debug, Clone, Default)]
pub struct Winds {
    /// Speed m/s, direction degrees, when it was received.
    stations: BTreeMap<Device, (f64, f64, MachineTime)>,
}

impl Winds {
    /// Takes in a station's state; without speed or direction there is no wind to avoid.
    pub fn observe(&mut self, station: &Device, fields: &Fields, now: MachineTime) {
        let gust = fields.measured("WindGust").unwrap_or_default();
        let wind = fields.measured("WindSpeed").map(|wind| wind.max(gust));
        match (wind, fields.measured("WindDirection")) {
            (Ok(speed), Ok(from)) => {
                self.stations.insert(station.clone(), (speed, from.rem_euclid(360.0), now));
            }
            _ => drop(self.stations.remove(station)),
        }
    }

    /// The directions that no telescope is to point to now.
    pub fn sectors(&self, rule: &WindSector, now: MachineTime) -> Vec<Sector> {
        let strong = |(_, (speed, _, at)): &(&Device, &(f64, f64, MachineTime))| {
            *speed >= rule.above_mps && now.since(*at) <= MOST_AGE
        };
        let sector = |(station, (speed, from, _)): (&Device, &(f64, f64, MachineTime))| Sector {
            azimuth_deg: *from,
            half_width_deg: rule.half_width_deg,
            why: format!("{}: wind {speed:.1} m/s from {from:.0} deg", station.name),
        };
        self.stations.iter().filter(strong).map(sector).collect()
    }
}

#[cfg(test)]
mod tests {
    use contract::{Address, Datum, Kind};

    use super::*;

    #[test]
    fn a_strong_wind_closes_the_sector_that_it_blows_from() {
        let station = Address::new("s", "shared").unwrap().device(Kind::ObservingConditions, &"wx".parse().unwrap());
        let rule = WindSector { above_mps: 10.0, half_width_deg: 45.0 };
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let blows = |wind: f64, gust: f64, from: f64| Fields {
            wind_mps: Datum::Known(wind),
            gust_mps: Datum::Known(gust),
            wind_from_deg: Datum::Known(from),
            ..Fields::default()
        };
        let mut winds = Winds::default();
        winds.observe(&station, &blows(5.0, 9.0, 350.0), at(0));
        assert_eq!(winds.sectors(&rule, at(0)), []);
        winds.observe(&station, &blows(5.0, 12.0, 350.0), at(5));
        let [sector] = winds.sectors(&rule, at(6)).try_into().unwrap();
        assert!(sector.contains(20.0) && sector.contains(310.0) && !sector.contains(60.0) && !sector.contains(180.0));
        assert_eq!(winds.sectors(&rule, at(66)), [], "an old wind is none");
        winds.observe(&station, &Fields::default(), at(7));
        assert_eq!(winds.sectors(&rule, at(7)), []);
    }
}
