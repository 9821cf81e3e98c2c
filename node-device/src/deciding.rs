//! The properties of a device that verdicts need: they are read first, apart from the rest, and on deadlines of its
//! own.

use config::Observatory;
use contract::device::observing_conditions::made_of;
use contract::device::switch::number_of;
use contract::{Device, Kind};

use crate::readings::aged_sensor;

/// Sensors whose limits are passed within seconds come first.
const SWIFT: [&str; 3] = ["RainRate", "WindGust", "WindSpeed"];
/// The properties of a device that decide, the swiftest first; empty where the device is polled as a whole.
///
/// `polled` are all that the driver knows. Telescopes that share a station put limits on it that this node does not
/// know, so that all of its sensors decide. Ages of single sensors grow with the clock, so that they may be asked
/// later.
pub fn properties(config: &Observatory, device: &Device, polled: &[String]) -> Vec<String> {
    let limits = match device.kind {
        Kind::SafetyMonitor => return polled.to_vec(),
        Kind::ObservingConditions => {
            let own = config.observingconditions.iter().find(|station| station.common.name == device.name);
            own.map(|station| station.limit.as_slice()).unwrap_or_default()
        }
        Kind::Switch => {
            let own = config.switch.iter().find(|switch| switch.common.name == device.name);
            own.map(|switch| switch.limit.as_slice()).unwrap_or_default()
        }
        _ => return Vec::new(),
    };
    let limited: Vec<&str> = limits.iter().flat_map(|limit| made_of(&limit.parameter)).collect();
    let decides = |name: &&String| match device.kind {
        Kind::Switch => {
            limits.iter().any(|limit| limit.parameter == name.as_str() || same_switch(&limit.parameter, name))
        }
        _ => match aged_sensor(name) {
            Some(sensor) => sensor.is_empty(),
            None => limited.is_empty() || limited.contains(&name.as_str()),
        },
    };
    let mut deciding: Vec<String> = polled.iter().filter(decides).cloned().collect();
    deciding.sort_by_key(|name| SWIFT.iter().position(|swift| swift == name).unwrap_or(SWIFT.len()));
    deciding
}

fn same_switch(limit: &str, property: &str) -> bool {
    number_of(limit).is_some_and(|number| property == format!("GetSwitchValue{number}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readings::{AGE, age_of};

    fn deciding(telescope: &str, limits: &str) -> Vec<String> {
        let text = format!(
            "[observatory]\nsite = \"s\"\ntelescope = \"{telescope}\"\nlatitude_deg = 0\nlongitude_deg = 0\nelevation_m = 0\n\
             [[observingconditions]]\nname = \"wx\"\nserver = \"a:1\"\n{limits}\n"
        );
        let config = config::parse(&text, std::path::Path::new("/")).unwrap();
        let device = config.address().device(Kind::ObservingConditions, &"wx".parse().unwrap());
        let rain_age = age_of("RainRate");
        let polled = ["Humidity", "Pressure", "RainRate", "Temperature", "DewPoint", "WindSpeed", AGE, &rain_age];
        properties(&config, &device, &polled.map(str::to_owned))
    }

    #[test]
    fn what_has_a_limit_decides_and_rain_and_wind_come_first() {
        let limits =
            "limit = [{ parameter = \"DewPointMargin\", lower = 2.0 }, { parameter = \"RainRate\", upper = 0.1 }]";
        assert_eq!(deciding("t", limits), ["RainRate", "Temperature", "DewPoint", AGE]);
    }

    #[test]
    fn all_of_a_station_decides_where_its_limits_are_others() {
        let all = deciding("shared", "");
        assert_eq!((all.len(), all[0].as_str(), all[1].as_str()), (7, "RainRate", "WindSpeed"));
    }
}
