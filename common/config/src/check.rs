//! Reads `observatory.toml` and proves what holds between its parts.

use std::collections::HashSet;
use std::path::Path;

use contract::{Address, Kind, Name};

use crate::device::{Limit, Measure};
use crate::observatory::Observatory;
use crate::visibility::{Horizon, HorizonSource};

/// Why a configuration is not taken; each message says where, what was expected and what to do.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// The text is no TOML of the expected shape; the message carries line and column.
    #[error("{0}")]
    Toml(String),
    /// The text reads, but its parts do not fit together; one line per fault.
    #[error("{}", .0.join("\n"))]
    Faults(Vec<String>),
}

/// Parameters that a limit may name beside ASCOM's own ObservingConditions properties.
const DERIVED: [&str; 2] = ["RelativeSkyTemp", "DewPointMargin"];

/// Larger texts are neither configuration nor header table; what a text of this size becomes in memory is some ten times it.
pub const MOST_BYTES: usize = 1 << 20;

/// Reads and checks a configuration; relative paths in it start at `folder`.
pub fn parse(text: &str, folder: &Path) -> Result<Observatory, ConfigError> {
    if text.len() > MOST_BYTES {
        let bytes = text.len();
        return Err(ConfigError::Toml(format!("{bytes} bytes; a configuration has at most {MOST_BYTES}")));
    }
    let mut observatory: Observatory = toml::from_str(text).map_err(|error| ConfigError::Toml(error.to_string()))?;
    let folders = [&mut observatory.folders.data, &mut observatory.folders.images];
    for path in folders.into_iter().chain([&mut observatory.schedule.file, &mut observatory.archive.database]) {
        *path = folder.join(&path);
    }
    observatory.archive.fits_header = observatory.archive.fits_header.map(|path| folder.join(path));

    observatory.imaging.catalogue = observatory.imaging.catalogue.map(|path| folder.join(path));

    for mount in &mut observatory.telescope {
        if let Some(HorizonSource::File(path)) = &mut mount.horizon {
            *path = folder.join(&path);
        }
    }
    observatory.hooks.script = observatory.hooks.script.map(|path| folder.join(path));

    let alerts = &mut observatory.alerts;
    let secrets = alerts.webhook.iter_mut().map(|hook| &mut hook.token_file);
    let secrets = secrets.chain(alerts.smtp.iter_mut().map(|smtp| &mut smtp.password_file));
    for file in secrets.chain([&mut alerts.ca_file]).flatten() {
        *file = folder.join(&file);
    }

    let mut faults = Faults { text, found: Vec::new() };
    place(&observatory, &mut faults);
    names(&observatory, &mut faults);
    numbers(&observatory, &mut faults);
    pairings(&mut observatory, &mut faults);
    for (dome, message) in crate::slit::torn(&observatory) {
        faults.add(dome.as_str(), message);
    }
    for (quoted, message) in observatory.alerts.faults() {
        faults.add(&quoted, message);
    }
    if faults.found.is_empty() { Ok(observatory) } else { Err(ConfigError::Faults(faults.found)) }
}

struct Faults<'a> {
    text: &'a str,
    found: Vec<String>,
}

impl Faults<'_> {
    /// Adds a fault, with the line on which `quoted` first stands.
    fn add(&mut self, quoted: &str, message: String) {
        let line = self.text.lines().position(|line| line.contains(&format!("\"{quoted}\"")));
        self.found.push(match line {
            Some(index) => format!("line {}: {message}", index + 1),
            None => message,
        });
    }
}

fn place(observatory: &Observatory, faults: &mut Faults<'_>) {
    let place = &observatory.place;
    for (key, value, limit) in [
        ("latitude_deg", place.latitude_deg, 90.0),
        ("longitude_deg", place.longitude_deg, 360.0),
        ("dut1_s", place.dut1_s, 1.0),
    ] {
        if value.is_nan() || value.abs() > limit {
            faults.add("", format!("observatory.{key} = {value}: expected a number from -{limit} to {limit}"));
        }
    }
    let sun = observatory.safety.sun_altitude_max_deg;
    if !(-90.0..=90.0).contains(&sun) {
        faults.add("", format!("safety.sun_altitude_max_deg = {sun}: expected a number from -90 to 90"));
    }
    let safety = &observatory.safety;
    for (key, value) in [
        ("frozen_after_min", safety.frozen_after_min),
        ("clock_offset_max_s", safety.clock_offset_max_s),
        ("disk_free_min_gb", safety.disk_free_min_gb),
        ("wind_sector.above_mps", safety.wind_sector.map_or(0.0, |sector| sector.above_mps)),
        ("wind_sector.half_width_deg", safety.wind_sector.map_or(0.0, |sector| sector.half_width_deg)),
    ] {
        if !value.is_finite() || value < 0.0 {
            faults.add("", format!("safety.{key} = {value}: expected 0 or more"));
        }
    }
    for fault in observatory.names.faults().into_iter().chain(observatory.schedule.check.faults()) {
        faults.add("", fault);
    }
    for fault in observatory.pointing.faults() {
        faults.add("", fault);
    }
    for fault in observatory.faults.faults() {
        faults.add("", fault);
    }
    for fault in observatory.hooks.faults() {
        faults.add("", fault);
    }
    let cameras = observatory.camera.iter().map(|camera| &camera.common.name);
    for fault in observatory.guiding.faults(cameras) {
        faults.add("", fault);
    }
    for fault in observatory.focusing.faults(&observatory.focuser) {
        faults.add("", fault);
    }
    let shared = place.telescope.as_str() == Address::SHARED;
    for dome in observatory.dome.iter().filter(|dome| shared && dome.telescopes.is_empty()) {
        let name = &dome.common.name;
        faults.add(name.as_str(), format!("shared dome \"{name}\" lists no telescopes; add telescopes = [\"...\"]"));
    }
}

fn names(observatory: &Observatory, faults: &mut Faults<'_>) {
    let mut seen = HashSet::new();
    for (kind, common) in observatory.devices() {
        if !seen.insert((kind, common.name.clone())) {
            faults.add(
                common.name.as_str(),
                format!("two {kind} blocks are named \"{}\"; names must be unique", common.name),
            );
        }
        if !common.server.contains(':') || common.server.contains('/') {
            let (name, server) = (&common.name, &common.server);
            faults
                .add(server, format!("{kind} \"{name}\": server \"{server}\" is no host:port, such as 10.0.0.5:11111"));
        }
    }
}

fn numbers(observatory: &Observatory, faults: &mut Faults<'_>) {
    for (kind, common) in observatory.devices() {
        if !(0.1..=3600.0).contains(&common.period_s) {
            faults.add(
                common.name.as_str(),
                format!("{kind} \"{}\": period_s = {}: expected 0.1 to 3600 s", common.name, common.period_s),
            );
        }
    }
    for dome in &observatory.dome {
        if !(3.0..=30.0).contains(&dome.permit_valid_s) {
            let name = &dome.common.name;
            faults.add(
                name.as_str(),
                format!("dome \"{name}\": permit_valid_s = {}: expected 3 to 30 s", dome.permit_valid_s),
            );
        }
    }
    for dome in observatory.dome.iter().filter(|dome| dome.watchdog_s.is_some_and(|s| !(4.0..=3600.0).contains(&s))) {
        let (name, watchdog_s) = (&dome.common.name, dome.watchdog_s.unwrap_or_default());
        faults.add(name.as_str(), format!("dome \"{name}\": watchdog_s = {watchdog_s}: expected 4 to 3600 s"));
    }
    for dome in observatory.dome.iter().filter(|dome| dome.watchdog_action.is_some() && dome.watchdog_s.is_none()) {
        let name = &dome.common.name;
        faults.add(name.as_str(), format!("dome \"{name}\": watchdog_action needs watchdog_s, its time limit"));
    }
    let shared = observatory.place.telescope.as_str() == Address::SHARED;
    for dome in &observatory.dome {
        for fault in crate::slit::faults(dome, &observatory.telescope, shared) {
            let name = &dome.common.name;
            faults.add(name.as_str(), format!("dome \"{name}\": {fault}"));
        }
    }
    for camera in &observatory.camera {
        if let Some(fault) = crate::imaging::camera_fault(camera) {
            let name = &camera.common.name;
            faults.add(name.as_str(), format!("camera \"{name}\": {fault}"));
        }
    }
    for camera in &observatory.camera {
        let name = &camera.common.name;
        let pulses = camera.guide_calibration.iter().flat_map(crate::GuideStart::faults);
        for fault in camera.flats.faults().into_iter().chain(pulses) {
            faults.add(name.as_str(), format!("camera \"{name}\": {fault}"));
        }
    }
    for mount in &observatory.telescope {
        if let Some(HorizonSource::Points(points)) = &mount.horizon
            && let Err(fault) = Horizon::new(points)
        {
            let name = &mount.common.name;
            faults.add(name.as_str(), format!("telescope \"{name}\": horizon: {fault}"));
        }
        for fault in crate::slit::mount_faults(mount) {
            let name = &mount.common.name;
            faults.add(name.as_str(), format!("telescope \"{name}\": {fault}"));
        }
        let (name, limits) = (&mount.common.name, &mount.limits);
        let flip_min = mount.meridian_flip_min;
        if !(0.0..=120.0).contains(&flip_min) {
            let message = format!("telescope \"{name}\": meridian_flip_min = {flip_min}: expected 0 to 120");
            faults.add(name.as_str(), message);
        }
        if let Some(past_min) = limits.meridian_past_min.filter(|past_min| mount.meridian_flip && *past_min <= flip_min)
        {
            let message = format!(
                "telescope \"{name}\": meridian_flip_min = {flip_min}: the mount is stopped before, at \
                 limits.meridian_past_min = {past_min}; make that greater"
            );
            faults.add(name.as_str(), message);
        }
        for (key, value, low, high) in [
            ("altitude_min_deg", Some(limits.altitude_min_deg), -90.0, 90.0),
            ("hour_angle_max_h", limits.hour_angle_max_h, -12.0, 12.0),
            ("meridian_past_min", limits.meridian_past_min, -360.0, 360.0),
        ] {
            if let Some(value) = value.filter(|value| !(low..=high).contains(value)) {
                let message = format!("telescope \"{name}\": limits.{key} = {value}: expected {low} to {high}");
                faults.add(name.as_str(), message);
            }
        }
    }
    for monitor in &observatory.safetymonitor {
        if monitor.dwell_min.is_nan() || monitor.dwell_min < 0.0 {
            let name = &monitor.common.name;
            faults.add(
                name.as_str(),
                format!("safetymonitor \"{name}\": dwell_min = {}: expected 0 or more", monitor.dwell_min),
            );
        }
        if monitor.disabled.as_ref().is_some_and(|why| why.trim().is_empty()) {
            let name = &monitor.common.name;
            faults.add(name.as_str(), format!("safetymonitor \"{name}\": disabled needs words: say why"));
        }
    }
    let own = observatory.observingconditions.iter().flat_map(|station| &station.limit);
    for limit in own.chain(&observatory.shared.limit) {
        let known = contract::device::observing_conditions::Fields::default();
        if known.by_ascom_name(&limit.parameter).is_none() && !DERIVED.contains(&limit.parameter.as_str()) {
            let expected =
                "an ASCOM ObservingConditions property (Humidity, WindSpeed ...), RelativeSkyTemp or DewPointMargin";
            no_such_parameter(limit, expected, faults);
        }
        limit_holds(limit, faults);
    }
    for limit in observatory.switch.iter().flat_map(|switch| &switch.limit) {
        if contract::device::switch::number_of(&limit.parameter).is_none() {
            no_such_parameter(limit, "GetSwitchValue0, GetSwitchValue1 and so on", faults);
        }
        limit_holds(limit, faults);
    }
}

fn no_such_parameter(limit: &Limit, expected: &str, faults: &mut Faults<'_>) {
    let name = limit.parameter.as_str();
    faults.add(name, format!("limit on \"{name}\": no such parameter; expected {expected}"));
}

fn limit_holds(limit: &Limit, faults: &mut Faults<'_>) {
    let name = limit.parameter.as_str();
    let mut fault = |why: &str| faults.add(name, format!("limit on \"{name}\": {why}"));
    let own = [limit.upper, limit.lower, limit.reopen_upper, limit.reopen_lower];
    let others = [Some(limit.dwell_min), limit.max_age_s, limit.over_min];
    if own.iter().chain(&others).flatten().any(|n| !n.is_finite()) || limit.dwell_min < 0.0 {
        fault("all numbers must be finite, and dwell_min 0 or more");
    } else if limit.upper.is_none() && limit.lower.is_none() {
        fault("has neither upper nor lower; give one");
    } else if limit.reopen_upper.is_some_and(|reopen| limit.upper.is_none_or(|upper| reopen > upper)) {
        fault("reopen_upper needs an upper that is not smaller");
    } else if limit.reopen_lower.is_some_and(|reopen| limit.lower.is_none_or(|lower| reopen < lower)) {
        fault("reopen_lower needs a lower that is not larger");
    } else if (limit.of == Measure::Value) != limit.over_min.is_none() || limit.over_min.is_some_and(|min| min <= 0.0) {
        fault("over_min, more than 0, goes with of = \"max\" or \"rate\", and only with these");
    } else if [&limit.vote, &limit.disabled].into_iter().flatten().any(|words| words.trim().is_empty()) {
        fault("vote and disabled need words");
    }
}

/// Fills each camera's absent pairings with the only device of that kind, and refuses those that name nothing.
fn pairings(observatory: &mut Observatory, faults: &mut Faults<'_>) {
    let mut devices: Vec<(Kind, Name)> =
        observatory.devices().into_iter().map(|(kind, common)| (kind, common.name.clone())).collect();
    for (kind, shared) in [
        (Kind::SafetyMonitor, &observatory.shared.safetymonitor),
        (Kind::ObservingConditions, &observatory.shared.observingconditions),
        (Kind::Dome, &observatory.shared.dome),
    ] {
        devices.extend(shared.iter().map(|name| (kind, name.clone())));
    }
    for camera in &mut observatory.camera {
        let pairs = [
            (Kind::Telescope, &mut camera.telescope),
            (Kind::FilterWheel, &mut camera.filterwheel),
            (Kind::Focuser, &mut camera.focuser),
            (Kind::Dome, &mut camera.dome),
            (Kind::Rotator, &mut camera.rotator),
            (Kind::CoverCalibrator, &mut camera.covercalibrator),
            (Kind::SafetyMonitor, &mut camera.safetymonitor),
            (Kind::ObservingConditions, &mut camera.observingconditions),
            (Kind::Switch, &mut camera.switch),
        ];
        for (kind, pair) in pairs {
            let mut of_kind = devices.iter().filter(|(k, _)| *k == kind).map(|(_, name)| name);
            match pair {
                Some(name) if !of_kind.any(|other| other == name) => {
                    let message =
                        format!("camera \"{}\": {kind} = \"{name}\" names no {kind} of this file", camera.common.name);
                    faults.add(name.as_str(), message);
                }
                Some(_) => {}
                None => {
                    let first = of_kind.next().cloned();
                    *pair = if of_kind.next().is_none() { first } else { None };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MINIMAL: &str = r#"
[observatory]
site = "paranal"
telescope = "callisto"
latitude_deg = -24.6
longitude_deg = -70.4
elevation_m = 2500

[[telescope]]
name = "mount"
server = "10.0.0.5:11111"

[[camera]]
name = "cam"
server = "10.0.0.5:11111"
temperature_c = -30

[[dome]]
name = "dome"
server = "10.0.0.5:11111"
"#;

    fn faults(extra: &str) -> String {
        parse(&format!("{MINIMAL}{extra}"), Path::new("/site")).map(|_| ()).unwrap_err().to_string()
    }

    #[test]
    fn a_minimal_file_gets_its_defaults() {
        let observatory = parse(MINIMAL, Path::new("/site")).unwrap();
        assert_eq!(observatory.folders.images, Path::new("/site").join("images"));
        assert_eq!(observatory.dome[0].common.period_s, 1.0);
        assert_eq!(observatory.camera[0].common.period_s, 5.0);
        assert_eq!(observatory.camera[0].telescope.as_ref().unwrap().as_str(), "mount");
        assert_eq!(observatory.camera[0].focuser, None);
        assert_eq!(observatory.enclosures()[0].to_string(), "paranal/callisto/dome/dome");
    }

    #[test]
    fn an_unknown_key_is_refused_with_its_line() {
        let message = faults("[[focuser]]\nname = \"f\"\nserver = \"a:1\"\nperiod = 3\n");
        assert!(message.contains("line 24") && message.contains("`period`"), "{message}");
    }

    #[test]
    fn parts_that_do_not_fit_are_all_named_with_their_lines() {
        let message = faults(
            "[[observingconditions]]\nname = \"wx\"\nserver = \"10.0.0.6\"\nlimit = [{ parameter = \"Humidty\", upper = 80 }, { parameter = \"WindSpeed\" }]\n",
        );
        assert!(
            message.contains("line 23: observingconditions \"wx\": server \"10.0.0.6\" is no host:port"),
            "{message}"
        );
        assert!(message.contains("line 24: limit on \"Humidty\": no such parameter"), "{message}");
        assert!(message.contains("neither upper nor lower"), "{message}");
    }

    #[test]
    fn a_pairing_with_nothing_is_refused() {
        let message = faults("[[camera]]\nname = \"guide\"\nserver = \"a:1\"\nfocuser = \"f9\"\n");
        assert!(message.contains("camera \"guide\": focuser = \"f9\" names no focuser"), "{message}");
    }

    #[test]
    fn a_fault_policy_that_makes_no_sense_is_refused() {
        let message = faults("[faults.policy]\ncamera = \"without\"\nfocusser = \"skip\"\n");
        assert!(message.contains("faults.policy.camera = \"without\": no frame"), "{message}");
        assert!(message.contains("faults.policy.focusser: no such kind; expected one of telescope"), "{message}");
        let fine = parse(&format!("{MINIMAL}[faults.policy]\nfocuser = \"without\"\n"), Path::new("/site")).unwrap();
        assert_eq!(fine.faults.policy(Kind::Focuser), crate::FaultPolicy::Without);
        assert_eq!(fine.faults.policy(Kind::Camera), crate::FaultPolicy::Postpone);
    }

    #[test]
    fn not_a_number_is_no_limit() {
        let message = faults(
            "[[observingconditions]]\nname = \"wx\"\nserver = \"a:1\"\nlimit = [{ parameter = \"Humidity\", upper = nan }]\n",
        );
        assert!(message.contains("must be finite"), "{message}");
    }
}
