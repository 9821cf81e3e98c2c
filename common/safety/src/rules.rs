//! The configured safety inputs and their limits.

use std::collections::BTreeMap;
use std::time::Duration;

use config::{Limit, Observatory, Response, WindSector};
use contract::{Device, Kind};
use units::seconds;

use super::measure::Measure;

/// No record of the time before reaches farther back, sky time.
const LONGEST: Duration = Duration::from_secs(86_400);

/// A safety monitor whose state counts.
#[derive(Debug, Clone, PartialEq)]
pub struct MonitorRule {
    /// As reasons name it: `safetymonitor/monitor`.
    pub input: String,
    /// Which device.
    pub device: Device,
    /// Safe only after so long without any other value, sky time.
    pub dwell: Duration,
    /// A reading older than this is unsafe, machine time.
    pub max_age: Duration,
    /// Nobody set that age: a device that is asked less often may be older, as its node publishes (`History::allowed`).
    pub by_period: bool,
}

/// A limit on one parameter of one weather station.
#[derive(Debug, Clone, PartialEq)]
pub struct LimitRule {
    /// As reasons name it: `wx/Humidity`.
    pub input: String,
    /// Which station.
    pub device: Device,
    /// ASCOM property, or a derived parameter.
    pub parameter: String,
    /// What of it is limited.
    pub measure: Measure,
    /// Bad above and below.
    pub bad: Bounds,
    /// A value that was bad is good again only within these.
    pub reopen: Bounds,
    /// Safe only after so long without a violation, sky time.
    pub dwell: Duration,
    /// A reading older than this is a missing value, machine time.
    pub max_age: Duration,
    /// Nobody set that age: a device that is asked less often may be older, as its node publishes (`History::allowed`).
    pub by_period: bool,
    /// A missing value is unsafe.
    pub required: bool,
    /// What a violation leads to.
    pub response: Response,
    /// Limits of this name vote.
    pub vote: Option<String>,
}

/// The ends of a range; an absent one is open.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bounds {
    /// The largest value within.
    pub upper: Option<f64>,
    /// The smallest value within.
    pub lower: Option<f64>,
}

impl Bounds {
    /// Is this value within? NaN is within nothing.
    pub fn contain(&self, value: f64) -> bool {
        value.is_finite()
            && self.upper.is_none_or(|upper| value <= upper)
            && self.lower.is_none_or(|lower| value >= lower)
    }
}

/// Everything that the verdict rests on.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rules {
    /// Safety monitors.
    pub monitors: Vec<MonitorRule>,
    /// Weather limits, several tiers per parameter where configured.
    pub limits: Vec<LimitRule>,
    /// Unsafe while the Sun is higher, degrees.
    pub sun_altitude_max_deg: Option<f64>,
    /// A station whose values have been the same for so long is frozen, machine time; zero: never.
    pub frozen_after: Duration,
    /// Nothing is exposed while a node's clock is off by more, s.
    pub clock_offset_max_s: f64,
    /// Nothing is exposed while a node's data folder has less room, GB.
    pub disk_free_min_gb: f64,
    /// Where not to point in a wind.
    pub wind_sector: Option<WindSector>,
    /// Limits that are not applied, with the reason.
    pub disabled: Vec<(String, String)>,
    /// A person wants it closed, in words.
    pub stay_closed: Option<String>,
}

impl Rules {
    /// The rules of a configuration: own devices with their own dwell and limits, shared ones with those of `[shared]`.
    pub fn of(config: &Observatory) -> Self {
        let (mut monitors, mut limits, mut disabled) = (Vec::new(), Vec::new(), Vec::new());
        for device in config.used_safety_monitors() {
            let own = config
                .safetymonitor
                .iter()
                .find(|own| device.address == config.address() && own.common.name == device.name);
            let (dwell_min, max_age_s) = match own {
                // Five polls, so that one lost answer is no alarm.
                Some(own) => (own.dwell_min, own.max_age_s),
                None => (config.shared.dwell_min, config.shared.max_age_s),
            };
            let period_s = own.map_or(1.0, |own| own.common.period_s);
            let by_period = max_age_s.is_none();
            let max_age_s = max_age_s.unwrap_or((5.0 * period_s).max(5.0));
            let input = format!("safetymonitor/{}", device.name);
            match own.and_then(|own| own.disabled.clone()) {
                None => {
                    let (dwell, max_age) = (dwell(dwell_min), seconds(max_age_s));
                    monitors.push(MonitorRule { input, dwell, max_age, by_period, device });
                }
                Some(why) => disabled.push((input, why)),
            }
        }
        let mut limited: Vec<(Device, &Limit)> = Vec::new();
        for device in config.used_weather() {
            let own = config
                .observingconditions
                .iter()
                .find(|own| device.address == config.address() && own.common.name == device.name);
            let of_station = own.map_or(&config.shared.limit, |own| &own.limit);
            limited.extend(of_station.iter().map(|limit| (device.clone(), limit)));
        }
        for switch in &config.switch {
            let device = config.device(Kind::Switch, &switch.common.name);
            limited.extend(switch.limit.iter().map(|limit| (device.clone(), limit)));
        }
        for (device, limit) in limited {
            let rule = LimitRule::of(limit, &device);
            match &limit.disabled {
                None => limits.push(rule),
                Some(why) => disabled.push((rule.input, why.clone())),
            }
        }
        let safety = &config.safety;
        Self {
            monitors,
            limits,
            sun_altitude_max_deg: Some(safety.sun_altitude_max_deg),
            frozen_after: seconds(safety.frozen_after_min * 60.0),
            clock_offset_max_s: safety.clock_offset_max_s,
            disk_free_min_gb: safety.disk_free_min_gb,
            wind_sector: safety.wind_sector,
            disabled,
            stay_closed: None,
        }
    }

    /// How far back the rules look at each device, sky time: the dwell, before it the window of a measure, and a state
    /// more, by which the window began.
    pub fn look_back(&self, speed: f64) -> BTreeMap<Device, Duration> {
        let monitors = self.monitors.iter().map(|rule| (&rule.device, rule.dwell, Duration::ZERO, rule.max_age));
        let limits = self.limits.iter().map(|rule| (&rule.device, rule.dwell, rule.measure.over(), rule.max_age));
        let mut longest = BTreeMap::new();
        for (device, dwell, over, max_age) in monitors.chain(limits) {
            let window = over.min(LONGEST) + max_age.min(LONGEST).mul_f64(speed);
            let looks = dwell.min(LONGEST) + window;
            let back: &mut Duration = longest.entry(device.clone()).or_default();
            *back = (*back).max(looks.min(LONGEST));
        }
        longest
    }
}

/// A dwell that is no number never ends.
fn dwell(minutes: f64) -> Duration {
    Duration::try_from_secs_f64(minutes * 60.0).unwrap_or(Duration::MAX)
}

impl LimitRule {
    /// A missing value is unsafe by itself.
    pub fn needs_each(&self) -> bool {
        self.required && self.vote.is_none()
    }

    fn of(limit: &Limit, device: &Device) -> Self {
        let swift = matches!(limit.parameter.as_str(), "RainRate" | "WindSpeed" | "WindGust");
        let over = seconds(limit.over_min.unwrap_or_default() * 60.0);
        let (measure, words) = match limit.of {
            config::Measure::Value => (Measure::Value, ""),
            config::Measure::Max => (Measure::Max(over), " max"),
            config::Measure::Rate => (Measure::Rate(over), " rate"),
        };
        Self {
            input: format!("{}/{}{words}", device.name, limit.parameter),
            device: device.clone(),
            parameter: limit.parameter.clone(),
            measure,
            bad: Bounds { upper: limit.upper, lower: limit.lower },
            reopen: Bounds { upper: limit.reopen_upper.or(limit.upper), lower: limit.reopen_lower.or(limit.lower) },
            dwell: dwell(limit.dwell_min),
            max_age: seconds(limit.max_age_s.unwrap_or(if swift { 15.0 } else { 60.0 })),
            by_period: limit.max_age_s.is_none(),
            required: limit.required,
            response: limit.response,
            vote: limit.vote.clone(),
        }
    }
}
