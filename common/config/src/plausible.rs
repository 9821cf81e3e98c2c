//! Which numbers can be meant: ranges, and the units that are most often mistaken.

use contract::Address;
use contract::device::observing_conditions::{PhysicalRange, physical_range};

use crate::device::{Device, Limit, Measure, blocks};
use crate::findings::Findings;
use crate::host::{host_name, host_port};
use crate::observatory::Observatory;

/// A temperature from here on is in kelvin.
const KELVIN_FROM: f64 = 150.0;
/// How old a reading of a safety monitor may be, s.
const AGE_S: (f64, f64) = (0.1, 3600.0);
/// No value with a limit may be older than this unless the limit itself says so, s; as in `common/safety`.
const LIMIT_AGE_S: f64 = 60.0;
/// States that are held in memory, min: at least some, at most a day.
const HOLD_MIN: (f64, f64) = (0.05, 1440.0);
/// Steps of a focuser: positions are whole numbers from 0 on, as in schedules.
const STEPS: (f64, f64) = (0.0, 1e9);

fn is_within(value: f64, (low, high): (f64, f64)) -> bool {
    (low..=high).contains(&value)
}

/// Values of single keys.
pub(crate) fn prove(observatory: &Observatory, findings: &mut Findings<'_>) {
    place(observatory, findings);
    sections(observatory, findings);
    devices(observatory, findings);
}

fn place(observatory: &Observatory, findings: &mut Findings<'_>) {
    let place = &observatory.place;
    let mut number = |key: &str, value: f64, range: (f64, f64), unit: &str, hint: Option<String>| {
        if !is_within(value, range) {
            let hint = hint.map(|hint| format!("; {hint}")).unwrap_or_default();
            let (low, high) = range;
            let what = format!("observatory.{key} = {value}: expected a number from {low} to {high}, {unit}{hint}");
            findings.error(&format!("observatory.{key}"), what);
        }
    };
    let latitude = "degrees, north positive";
    number("latitude_deg", place.latitude_deg, (-90.0, 90.0), latitude, None);
    number("longitude_deg", place.longitude_deg, (-180.0, 360.0), "degrees, east positive", None);
    let metres = place.elevation_m;
    let looks = (metres >= 100_000.0).then(|| format!("are these millimetres? {metres} mm are {} m", metres / 1000.0));
    number("elevation_m", metres, (-500.0, 9000.0), "metres above the sea", looks);
    number("dut1_s", place.dut1_s, (-1.0, 1.0), "seconds", None);
    number("polar_x_arcsec", place.polar_x_arcsec, (-2.0, 2.0), "arcsec", None);
    number("polar_y_arcsec", place.polar_y_arcsec, (-2.0, 2.0), "arcsec", None);
}

fn sections(observatory: &Observatory, findings: &mut Findings<'_>) {
    let safety = &observatory.safety;
    let sector = safety.wind_sector;
    for (key, value, low, high, unit) in [
        ("sun_altitude_max_deg", safety.sun_altitude_max_deg, -90.0, 90.0, "degrees"),
        ("frozen_after_min", safety.frozen_after_min, 0.0, 10_080.0, "min"),
        ("clock_offset_max_s", safety.clock_offset_max_s, 0.01, 3600.0, "s"),
        ("disk_free_min_gb", safety.disk_free_min_gb, 0.0, 1e6, "GB"),
        ("wind_sector.above_mps", sector.map_or(0.0, |sector| sector.above_mps), 0.0, 100.0, "m/s"),
        ("wind_sector.half_width_deg", sector.map_or(0.0, |sector| sector.half_width_deg), 0.0, 180.0, "degrees"),
    ] {
        if !is_within(value, (low, high)) {
            let what = format!("safety.{key} = {value}: expected a number from {low} to {high} {unit}");
            findings.error(&format!("safety.{key}"), what);
        }
    }
    let raw_days = observatory.archive.raw_days;
    if raw_days < 2 {
        let what = format!(
            "archive.raw_days = {raw_days}: expected 2 or more: the headers of the last night are completed from the values"
        );
        findings.error("archive.raw_days", what);
    }
    let archive = &observatory.archive;
    if !is_within(archive.disk_warn_gb, (0.0, 1e6)) {
        let what = format!("archive.disk_warn_gb = {}: expected a number from 0 to 1000000 GB", archive.disk_warn_gb);
        findings.error("archive.disk_warn_gb", what);
    }
    if archive.remove_delivered_after_days == Some(0) {
        let what = "archive.remove_delivered_after_days = 0: expected 1 or more days after the night";
        findings.error("archive.remove_delivered_after_days", what.to_owned());
    }
    if !is_within(observatory.shared.dwell_min, (0.0, 1440.0)) {
        let what = format!("shared.dwell_min = {}: expected 0 to 1440 min", observatory.shared.dwell_min);
        findings.error("shared.dwell_min", what);
    }
    if let Some(age) = observatory.shared.max_age_s.filter(|age| !is_within(*age, AGE_S)) {
        let what = format!("shared.max_age_s = {age}: expected {} to {} s", AGE_S.0, AGE_S.1);
        findings.error("shared.max_age_s", what);
    }
    let hold_min = observatory.spool.hold_min;
    if !is_within(hold_min, HOLD_MIN) {
        let what = format!("spool.hold_min = {hold_min}: expected {} to {} min", HOLD_MIN.0, HOLD_MIN.1);
        findings.error("spool.hold_min", what);
    }
    for (endpoint, fault) in observatory.bus.faults() {
        findings.quoted(&endpoint, fault);
    }
    if let Some(url) = &observatory.clock.simulator {
        let host = url.strip_prefix("http://").map(|rest| rest.trim_end_matches('/'));
        if host.is_none_or(|host| host_port(host).is_err()) {
            let what = format!(
                "clock.simulator = \"{url}\": expected the simulator as http://host:port, such as http://127.0.0.1:11111"
            );
            findings.error("clock.simulator", what);
        }
    }
    if let Some(host) = &observatory.spool.advertise
        && host_port(host).is_err()
        && let Err(why) = host_name(host)
    {
        let what = format!(
            "spool.advertise = \"{host}\": expected the name or address of this host, such as \"10.0.0.5\"; {why}"
        );
        findings.error("spool.advertise", what);
    }
}

fn devices(observatory: &Observatory, findings: &mut Findings<'_>) {
    let mut all = Vec::new();
    let mut number = |path: &str, shown: &str, key: &str, value: Option<f64>, low: f64, high: f64, unit: &str| {
        if let Some(value) = value.filter(|value| !is_within(*value, (low, high))) {
            let fault = format!("{key} = {value}: expected {low} to {high} {unit}");
            all.push((path.to_owned(), shown.to_owned(), fault.trim_end().to_owned()));
        }
    };
    let mut counts = std::collections::BTreeMap::<String, usize>::new();
    for (kind, common) in observatory.devices() {
        let index = counts.entry(kind.to_string()).or_default();
        let path = format!("{kind}[{index}]");
        *index += 1;
        number(&path, &format!("{kind} \"{}\": ", common.name), "period_s", Some(common.period_s), 0.1, 3600.0, "s");
    }
    for (path, shown, mount) in blocks(&observatory.telescope) {
        let limits = &mount.limits;
        number(&path, &shown, "slew_timeout_s", Some(mount.slew_timeout_s), 1.0, 7200.0, "s");
        number(&path, &shown, "settle_s", Some(mount.settle_s), 0.0, 600.0, "s");
        number(&path, &shown, "arrival_tolerance_deg", Some(mount.arrival_tolerance_deg), 0.001, 10.0, "degrees");
        number(&path, &shown, "settle_factor", Some(mount.settle_factor), 0.0, 10.0, "exposure times");
        number(&path, &shown, "meridian_flip_min", Some(mount.meridian_flip_min), 0.0, 120.0, "min");
        number(&path, &shown, "limits.altitude_min_deg", Some(limits.altitude_min_deg), -90.0, 90.0, "");
        number(&path, &shown, "limits.hour_angle_max_h", limits.hour_angle_max_h, -12.0, 12.0, "");
        number(&path, &shown, "limits.meridian_past_min", limits.meridian_past_min, -360.0, 360.0, "");
    }
    for (path, shown, camera) in blocks(&observatory.camera) {
        number(&path, &shown, "temperature_tolerance_c", Some(camera.temperature_tolerance_c), 0.01, 50.0, "K");
        number(&path, &shown, "cooling_timeout_min", Some(camera.cooling_timeout_min), 0.05, 1440.0, "min");
        number(&path, &shown, "electrons_per_adu", camera.electrons_per_adu, 1e-4, 1000.0, "electrons");
        number(&path, &shown, "read_noise_e", camera.read_noise_e, 0.0, 1000.0, "electrons");
        number(&path, &shown, "saturation_adu", camera.saturation_adu, 1.0, 4_294_967_295.0, "ADU");
        if camera.temperature_c.is_none_or(|set| set < KELVIN_FROM) {
            number(&path, &shown, "temperature_c", camera.temperature_c, -200.0, 60.0, "degrees Celsius");
        }
    }
    for (path, shown, focuser) in blocks(&observatory.focuser) {
        let best = focuser.best_position.map(|steps| steps as f64);
        number(&path, &shown, "best_position", best, STEPS.0, STEPS.1, "steps");
        number(&path, &shown, "settle_s", Some(focuser.settle_s), 0.0, 600.0, "s");
        number(&path, &shown, "tolerance_steps", Some(focuser.tolerance_steps as f64), 0.0, 1e6, "steps");
    }
    for (path, shown, dome) in blocks(&observatory.dome) {
        number(&path, &shown, "permit_valid_s", Some(dome.permit_valid_s), 3.0, 30.0, "s");
        number(&path, &shown, "watchdog_s", dome.watchdog_s, 4.0, 3600.0, "s");
        number(&path, &shown, "parked_within_s", Some(dome.parked_within_s), 1.0, 7200.0, "s");
        number(&path, &shown, "travel_timeout_s", Some(dome.travel_timeout_s), 1.0, 7200.0, "s");
    }
    for (path, shown, rotator) in blocks(&observatory.rotator) {
        number(&path, &shown, "tolerance_deg", Some(rotator.tolerance_deg), 0.001, 10.0, "degrees");
    }
    for (path, shown, monitor) in blocks(&observatory.safetymonitor) {
        number(&path, &shown, "dwell_min", Some(monitor.dwell_min), 0.0, 1440.0, "min");
        number(&path, &shown, "max_age_s", monitor.max_age_s, AGE_S.0, AGE_S.1, "s");
    }
    for (path, shown, fault) in all {
        findings.block(&path, &shown, &fault);
    }
    for (path, shown, monitor) in blocks(&observatory.safetymonitor) {
        let period = monitor.common.period_s;
        if let Some(age) = monitor.max_age_s.filter(|age| is_within(*age, AGE_S) && *age < period) {
            let why = "between two readings it would be unsafe each time";
            findings.block(&path, &shown, &format!("max_age_s = {age}: expected at least period_s = {period}: {why}"));
        }
    }
    // In the file of the shared devices no limit has an effect.
    if observatory.place.telescope.as_str() != Address::SHARED {
        fresh(&observatory.observingconditions, |station| station.limit.as_slice(), findings);
        fresh(&observatory.switch, |switch| switch.limit.as_slice(), findings);
    }
    for (path, shown, camera) in blocks(&observatory.camera) {
        if let Some(kelvin) = camera.temperature_c.filter(|set| *set >= KELVIN_FROM) {
            let fault = format!("temperature_c = {kelvin}: expected degrees Celsius; {}", from_kelvin(kelvin));
            findings.block(&path, &shown, &fault);
        }
    }
}

/// A limit whose values are too old before the next ones are read would never be good.
fn fresh<D: Device>(list: &[D], limits: impl Fn(&D) -> &[Limit], findings: &mut Findings<'_>) {
    let why = "between two readings a limit would be without a value each time";
    for (path, shown, device) in blocks(list) {
        let period = device.common().period_s;
        for (index, limit) in limits(device).iter().enumerate().filter(|(_, limit)| limit.disabled.is_none()) {
            match limit.max_age_s {
                Some(age) if age > 0.0 && age < period => findings.error(
                    &format!("{path}.limit[{index}].max_age_s"),
                    format!(
                        "limit on \"{}\": max_age_s = {age}: expected at least period_s = {period}: {why}",
                        limit.parameter
                    ),
                ),
                None if period > LIMIT_AGE_S => {
                    let fault = format!(
                        "period_s = {period}: expected at most {LIMIT_AGE_S} s, or a max_age_s of at least {period} \
                         in each limit: {why}"
                    );
                    findings.block(&path, &shown, &fault);
                }
                _ => {}
            }
        }
    }
}

fn from_kelvin(kelvin: f64) -> String {
    format!("are these kelvin? {kelvin} K are {:.2} degrees Celsius", kelvin - 273.15)
}

/// Limits on the weather, in the units of ASCOM.
pub(crate) fn weather(limit: &Limit, path: &str, findings: &mut Findings<'_>) {
    let name = limit.parameter.as_str();
    let Some(PhysicalRange { low, high, unit }) = physical_range(name) else { return };
    let ends = [
        ("upper", limit.upper),
        ("lower", limit.lower),
        ("reopen_upper", limit.reopen_upper),
        ("reopen_lower", limit.reopen_lower),
    ];
    for (key, value) in ends.into_iter().filter_map(|(key, end)| Some((key, end.filter(|end| end.is_finite())?))) {
        let mut fault = |why: String| {
            findings.error(&format!("{path}.{key}"), format!("limit on \"{name}\": {key} = {value}: {why}"));
        };
        if limit.of == Measure::Rate {
            let most = high - low;
            if value.abs() > most {
                fault(format!("expected -{most} to {most} per minute, in {unit}"));
            }
        } else if unit == "percent" && value > 0.0 && value <= 1.0 && (name == "Humidity" || value < 1.0) {
            fault(format!(
                "expected {unit}, 0 to 100; write a fraction of {value} as {}",
                (value * 1e4).round() / 100.0
            ));
        } else if unit == "degrees Celsius" && value >= KELVIN_FROM {
            fault(format!("expected {unit}; {}", from_kelvin(value)));
        } else if name == "Pressure" && (30_000.0..=110_000.0).contains(&value) {
            fault(format!("expected {unit}; are these Pa? {value} Pa are {} hPa", value / 100.0));
        } else if !is_within(value, (low, high)) {
            fault(format!("expected {low} to {high} {unit}"));
        }
    }
    if limit.of == Measure::Rate {
        return;
    }
    // a clear sky is cold: what is far below the air is good
    let is_bad_above = matches!(
        name,
        "Humidity"
            | "CloudCover"
            | "RainRate"
            | "WindSpeed"
            | "WindGust"
            | "SkyTemperature"
            | "RelativeSkyTemp"
            | "SkyBrightness"
            | "StarFWHM"
    );
    let is_bad_below = matches!(name, "SkyQuality" | "DewPointMargin");
    let (key, what) = match (limit.upper, limit.lower) {
        (None, Some(_)) if is_bad_above => {
            ("lower", "only a lower end: any value above it counts as good; is upper meant?")
        }
        (Some(_), None) if is_bad_below => {
            ("upper", "only an upper end: any value below it counts as good; is lower meant?")
        }
        (Some(upper), _) if unit == "percent" && upper >= 100.0 => {
            ("upper", "no value is above 100 percent, so that this end closes nothing; expected less")
        }
        (Some(upper), None) if upper >= high => ("upper", "no value that is believed is above it; expected less"),
        (None, Some(lower)) if lower <= low => ("lower", "no value that is believed is below it; expected more"),
        _ => return,
    };
    findings.warning(&format!("{path}.{key}"), format!("limit on \"{name}\": {what}"));
}
