//! The lines of what the telescopes of a site share: what its safety monitors and weather stations show, the nodes
//! that serve them, and the alerts of those.

use std::collections::BTreeMap;
use std::time::Duration;

use bus::Bus;
use contract::device::{observing_conditions, safety_monitor};
use contract::observatory::{Alert, Alerts, Standing, merge};
use contract::{Address, Device, DeviceState, Key, Kind, Link, NodeTopic, Topic};
use overview::length;

use super::words::alert_lines;
use super::{Status, is_shared};

/// A device node publishes the state of a device that hangs each 15 s.
const SILENT_S: f64 = 20.0;

/// Asks for the shared safety monitors and weather stations of all sites; each in words.
pub(super) async fn sensors(bus: &Bus, timeout: Duration) -> BTreeMap<Device, String> {
    let states = |kind| Topic::State.everywhere().of_kind(kind);
    let (monitors, stations) = tokio::join!(
        bus.get_all::<DeviceState<safety_monitor::Fields>>(states(Kind::SafetyMonitor), timeout),
        bus.get_all::<DeviceState<observing_conditions::Fields>>(states(Kind::ObservingConditions), timeout),
    );
    let monitors = monitors.into_iter().map(|(key, sample)| (key, words(&sample.body, sample.held_s, safety)));
    let stations = stations.into_iter().map(|(key, sample)| (key, words(&sample.body, sample.held_s, weather)));
    let shared = monitors.chain(stations).filter_map(|(key, words)| match key {
        Key::State(device) if is_shared(&device.address) => Some((device, words)),
        _ => None,
    });
    shared.collect()
}

/// The line of a site's shared devices in the table, and those below it.
pub(super) fn lines(address: &Address, status: &Status, sensors: &BTreeMap<Device, String>) -> Vec<String> {
    let own = Alerts { alerts: status.own.clone(), ..Alerts::default() };
    let mut alerts = merge(std::iter::once(own)).alerts;
    Alert::sort_for_people(&mut alerts);
    let active = alerts.iter().filter(|alert| alert.standing() == Standing::Active).count();
    let of_site = sensors.iter().filter(|(device, _)| device.address == *address);
    let shown: Vec<String> = of_site.map(|(device, words)| format!("{} {words}", device.name)).collect();
    let now = match shown.is_empty() {
        true => "no shared safety monitor or weather station answers".to_owned(),
        false => shown.join("; "),
    };
    let mut lines = vec![
        format!("{:28} {:8} {:9} {:8} {:14} {active:>6}  {now}", address.to_string(), "-", "-", "-", "-"),
        format!("    nodes of the shared devices that answer: {}", status.node_names()),
    ];
    lines.extend(alert_lines(&alerts, Topic::Node(NodeTopic::Alerts).at(address)));
    lines
}

/// How a device is; its state is `held_s` old.
fn words<F>(state: &DeviceState<F>, held_s: Option<f64>, known: fn(&F) -> String) -> String {
    match (&state.link, held_s.unwrap_or(0.0)) {
        (_, held_s) if held_s > SILENT_S => {
            format!("is not known: its node has published nothing for {}", length(held_s))
        }
        (Link::Connected, _) => known(&state.fields),
        (Link::Connecting, _) => "is not connected yet".to_owned(),
        (Link::Lost { reason }, _) => format!("does not answer ({reason})"),
    }
}

fn safety(fields: &safety_monitor::Fields) -> String {
    match fields.is_safe.as_result() {
        Ok(true) => "is safe".to_owned(),
        Ok(false) => "is NOT safe".to_owned(),
        Err(reason) => format!("is not known ({reason})"),
    }
}

fn weather(fields: &observing_conditions::Fields) -> String {
    let values = [
        ("wind", &fields.wind_mps, "m/s"),
        ("humidity", &fields.humidity_percent, "%"),
        ("rain", &fields.rain_mm_per_h, "mm/h"),
    ];
    let known = values.iter().filter_map(|(name, value, unit)| Some(format!("{name} {:.1} {unit}", value.known()?)));
    let known: Vec<String> = known.collect();
    if known.is_empty() { "has no wind, humidity or rain".to_owned() } else { known.join(", ") }
}

#[cfg(test)]
mod tests {
    use contract::observatory::AlertKind;
    use contract::{Datum, NoData, Role};
    use units::Utc;

    use super::*;

    fn state<F>(link: Link, fields: F) -> DeviceState<F> {
        DeviceState {
            link,
            busy: false,
            period_s: 1.0,
            poll_s: None,
            last_command: None,
            fields,
            readings: BTreeMap::new(),
        }
    }

    #[test]
    fn what_a_site_shares_has_a_line_with_its_values_its_nodes_and_their_alerts() {
        let address = Address::new("paranal", "shared").unwrap();
        let other = Address::new("la-silla", "shared").unwrap();
        let monitor = safety_monitor::Fields { is_safe: Datum::Known(false), gapless_safe_s: 0.0 };
        let mut station = observing_conditions::Fields::default();
        (station.wind_mps, station.rain_mm_per_h) = (Datum::Known(3.2), Datum::Known(0.0));
        let monitor = words(&state(Link::Connected, monitor), Some(1.0), safety);
        let mast = words(&state(Link::Connected, station), None, weather);
        let all = [
            (&address, Kind::ObservingConditions, "mast", mast.as_str()),
            (&address, Kind::SafetyMonitor, "monitor", monitor.as_str()),
            (&other, Kind::SafetyMonitor, "away", "is safe"),
        ];
        let sensors = all.map(|(at, kind, name, words)| (at.device(kind, &name.parse().unwrap()), words.to_owned()));
        let sensors = BTreeMap::from(sensors);
        let status = Status {
            nodes: [(Role::Device, "main".to_owned())].into(),
            own: vec![AlertKind::DeviceLost.alert("focuser/f", Utc::from_seconds(1.0), "it hangs")],
            ..Status::default()
        };
        let shown = lines(&address, &status, &sensors);
        let columns: Vec<&str> = shown[0].split_whitespace().take(6).collect();
        assert_eq!(columns, ["paranal/shared", "-", "-", "-", "-", "1"], "{shown:#?}");
        assert!(shown[0].contains("mast wind 3.2 m/s, rain 0.0 mm/h") && !shown[0].contains("away"), "{shown:#?}");
        assert!(shown[0].contains("monitor is NOT safe"), "{shown:#?}");
        assert_eq!(shown[1], "    nodes of the shared devices that answer: device/main");
        assert!(shown[2].contains("device-lost/focuser/f: it hangs;") && shown.len() == 3, "{shown:#?}");
        let none = lines(&address, &Status::default(), &BTreeMap::new());
        assert!(
            none[0].ends_with("no shared safety monitor or weather station answers") && none[1].ends_with(": none"),
            "{none:#?}"
        );
    }

    #[test]
    fn a_shared_device_that_is_lost_or_whose_node_is_silent_shows_no_old_value() {
        let fields = || safety_monitor::Fields { is_safe: Datum::Known(true), gapless_safe_s: 60.0 };
        let silent = words(&state(Link::Connected, fields()), Some(30.0), safety);
        assert_eq!(silent, "is not known: its node has published nothing for 30 s");
        let reason = NoData::new("timeout", "no answer within 2 s");
        let lost = words(&state(Link::Lost { reason }, fields()), None, safety);
        assert_eq!(lost, "does not answer (timeout: no answer within 2 s)");
    }
}
