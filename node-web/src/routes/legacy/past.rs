//! The past as Astra answered it from its database: polled numbers of one kind of device, and corrections of the guide loop.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Json;
use axum::extract::{Extension, Path, State};
use axum::response::{IntoResponse as _, Response};
use contract::archive::{ArchiveAnswer, ArchiveQuestion, ArchiveRow, Ask, MOST_PROPERTIES, SeriesName, SeriesPoint};
use contract::datum::ReadingOutcome;
use contract::observatory::{Interval, SafetyState, Verdict};
use contract::{Address, Key, Kind, NoData, Part, Reading};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sky::{Night, Observer};
use units::{Angle, Utc};
use users::Principal;

use super::{instead, the_telescope};
use crate::freshness::Quality;
use crate::json_body::AskedFor;
use crate::problem::Problem;
use crate::routes::heartbeat::legacy_time;
use crate::routes::history::asked;
use crate::server::Server;

const DAY_S: f64 = 86_400.0;
const MINUTE_US: i64 = 60_000_000;
/// So many days may be asked for.
const MOST_DAYS: f64 = 31.0;
/// The archive gives so many points in all; from two a minute on it gives each minute.
const MOST_POINTS: u32 = 30_000;
/// Corrections of one answer.
const MOST_CORRECTIONS: u32 = 100_000;
/// Astra kept so many days of twilight.
const TWILIGHT_DAYS: f64 = 3.0;
const SHUTTER: &str = "ShutterStatus";
const CLOSED: f64 = 1.0;

/// Which numbers.
#[derive(Debug, JsonSchema, Deserialize)]
pub struct PollingQuery {
    /// As its id or as `site/telescope`; needed where there are several.
    telescope: Option<String>,
    /// The last so many days; 1 where absent, at most 31.
    day: Option<f64>,
    /// From this sky time on, UTC where it names no zone; counts instead of `day`.
    since: Option<Utc>,
}

/// Which corrections.
#[derive(Debug, JsonSchema, Deserialize)]
pub struct GuidingQuery {
    /// As its id or as `site/telescope`; needed where there are several.
    telescope: Option<String>,
    /// The last so many days; 1 where absent, at most 31.
    day: Option<f64>,
    /// From this sky time on, UTC where it names no zone; counts instead of `day`.
    since: Option<Utc>,
}

type Numbers = BTreeMap<String, f64>;

/// Polled numbers; true counts as 1, false as 0.
#[derive(Debug, JsonSchema, Serialize)]
pub struct PolledDays {
    #[serde(skip_serializing_if = "Option::is_none")]
    status: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    message: Option<String>,
    data: Vec<PolledMinute>,
    /// The newest values, of devices that answer.
    latest: Numbers,
    #[serde(skip_serializing_if = "Option::is_none")]
    safety_limits: Option<BTreeMap<String, Bounds>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    twilight_periods: Option<Vec<Twilight>>,
}

/// Means of a minute; what was not read in it is absent.
#[derive(Debug, JsonSchema, Serialize)]
struct PolledMinute {
    datetime: String,
    #[serde(flatten)]
    values: Numbers,
}

/// The strictest bounds of a property.
#[derive(Debug, Default, JsonSchema, Serialize)]
struct Bounds {
    upper: Option<f64>,
    lower: Option<f64>,
}

/// A time of day by the Sun.
#[derive(Debug, JsonSchema, Serialize)]
struct Twilight {
    start: String,
    end: String,
    /// `day`, `civil`, `nautical`, `astronomical` or `night`.
    phase: &'static str,
}

/// Corrections of the guide loop.
#[derive(Debug, JsonSchema, Serialize)]
pub struct LegacyCorrections {
    status: &'static str,
    message: String,
    data: Vec<LegacyCorrection>,
}

/// A correction: how far it moves the field, along the axes of the frame.
#[derive(Debug, JsonSchema, Serialize)]
struct LegacyCorrection {
    datetime: String,
    telescope_name: String,
    /// px; `null` where no star was measured.
    post_pid_x: Option<f64>,
    /// px.
    post_pid_y: Option<f64>,
}

/// The time that is asked for.
fn time(day: Option<f64>, since: Option<Utc>, now: Utc) -> Result<(Utc, Utc), Problem> {
    let day = day.unwrap_or(1.0);
    if !(day > 0.0 && day <= MOST_DAYS) {
        return Err(Problem::malformed(format!(
            "day: expected a number of days, more than 0 and at most {MOST_DAYS}."
        )));
    }
    let oldest = now.plus_seconds(-MOST_DAYS * DAY_S);
    Ok((since.map_or_else(|| now.plus_seconds(-day * DAY_S), |since| since.clamp(oldest, now)), now))
}

/// Polled numbers of one kind of device, a row per minute.
pub async fn polling(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    Path(kind): Path<String>,
    AskedFor(query): AskedFor<PollingQuery>,
) -> Result<Response, Problem> {
    let kind: Kind =
        kind.parse().map_err(|error: contract::device::UnknownKind| Problem::not_found(format!("{error}.")))?;
    let address = the_telescope(&server, &caller, query.telescope.as_deref())?;
    let (from, to) = time(query.day, query.since, server.network.clock().utc())?;
    let is_weather = kind == Kind::ObservingConditions;
    let Polled { properties, mut latest, verdicts } = known(&server, &address, kind);
    if is_weather {
        add_difference(&mut latest);
    }
    let mut data = Vec::new();
    if !properties.is_empty() {
        let count = u32::try_from(properties.len()).unwrap_or(u32::MAX);
        let minutes = (to.seconds_since(from) / 60.0).ceil() as u32;
        let points = minutes.saturating_mul(2).clamp(1, MOST_POINTS / count);
        let ask = Ask::Series { properties, points };
        let question = ArchiveQuestion { ask, from_utc: Some(from), to_utc: Some(to), limit: None };
        data = rows(asked(&server, address.clone(), &question).await?, &verdicts, is_weather);
    }
    let is_empty = data.is_empty();
    let twilight_periods = if is_weather {
        Some(twilight(&server, &address, from.max(to.plus_seconds(-TWILIGHT_DAYS * DAY_S)), to).await)
    } else {
        None
    };
    let answer = PolledDays {
        status: is_empty.then_some("success"),
        message: is_empty.then(|| format!("No numbers of any {} were polled in this time.", kind.ascom())),
        data,
        latest,
        safety_limits: is_weather.then(|| limits(&server, &address)),
        twilight_periods,
    };
    Ok(instead("series", &address, Json(answer).into_response()))
}

/// What is known of a kind now.
struct Polled {
    properties: Vec<SeriesName>,
    latest: Numbers,
    verdicts: Vec<Interval>,
}

fn known(server: &Server, address: &Address, wanted: Kind) -> Polled {
    let now = server.network.clock().machine();
    let model = server.network.read();
    let mut polled = Polled { properties: Vec::new(), latest: Numbers::new(), verdicts: Vec::new() };
    let telescope = model.telescopes.get(address);
    for entry in
        [telescope, model.telescopes.get(&address.shared())].into_iter().flatten().flat_map(|one| one.states.values())
    {
        let Key::State(device) = &entry.key else { continue };
        let only = match (wanted, device.kind) {
            (wanted, kind) if wanted == kind => None,
            (Kind::ObservingConditions, Kind::SafetyMonitor) => Some("IsSafe"),
            (Kind::ObservingConditions, Kind::Dome) => Some(SHUTTER),
            _ => continue,
        };
        let is_fresh = entry.quality(now) == Quality::Fresh;
        for (property, reading) in entry.body["readings"].as_object().into_iter().flatten() {
            if only.is_some_and(|only| only != property) {
                continue;
            }
            let Ok(Reading { outcome, .. }) = Reading::deserialize(reading) else { continue };
            let number = match outcome {
                ReadingOutcome::Value { value, .. } => match value.number() {
                    Some(number) => Some(number),
                    None => continue,
                },
                ReadingOutcome::Missing { no_data } if no_data == NoData::not_implemented() => continue,
                ReadingOutcome::Missing { .. } => None,
            };
            if let Some(number) = number.filter(|_| is_fresh) {
                match (wanted, property.as_str()) {
                    (Kind::ObservingConditions, SHUTTER) => {
                        polled.latest.insert("DomeOpen".to_owned(), is_open(number, number))
                    }
                    _ => polled.latest.insert(property.clone(), number),
                };
            }
            if polled.properties.len() < MOST_PROPERTIES {
                let name =
                    SeriesName { kind: device.kind, device: device.name.to_string(), property: property.clone() };
                polled.properties.push(name);
            }
        }
    }
    let safety = telescope.and_then(|one| one.read::<SafetyState>(&Key::Observatory(address.clone(), Part::Safety)));
    if wanted == Kind::ObservingConditions
        && let Some((entry, safety)) = safety
    {
        if entry.quality(now) == Quality::Fresh {
            polled.latest.insert("WeatherSafe".to_owned(), is_safe(safety.verdict));
        }
        polled.verdicts = safety.intervals;
    }
    polled
}

fn is_safe(verdict: Verdict) -> f64 {
    match verdict {
        Verdict::Safe => 1.0,
        Verdict::Unsafe => 0.0,
    }
}

/// Only what was closed all the time was not open.
fn is_open(min: f64, max: f64) -> f64 {
    if min == CLOSED && max == CLOSED { 0.0 } else { 1.0 }
}

fn add_difference(values: &mut Numbers) {
    if let (Some(sky), Some(air)) = (values.get("SkyTemperature"), values.get("Temperature")) {
        values.insert("RelativeSkyTemp".to_owned(), sky - air);
    }
}

/// A row per minute: the mean of what all devices of the kind gave.
fn rows(answer: ArchiveAnswer, verdicts: &[Interval], is_weather: bool) -> Vec<PolledMinute> {
    let mut minutes: BTreeMap<i64, BTreeMap<String, (f64, f64)>> = BTreeMap::new();
    for row in answer.rows {
        let ArchiveRow::Series(series) = row else { continue };
        let is_shutter = is_weather && series.property.property == SHUTTER;
        let name = if is_shutter { "DomeOpen".to_owned() } else { series.property.property };
        for SeriesPoint { at_utc, count, min, mean, max, .. } in series.points {
            let value = match (is_shutter, min.zip(max)) {
                (true, Some((min, max))) => Some(is_open(min, max)),
                (true, None) => None,
                (false, _) => mean,
            };
            let Some(value) = value.filter(|value| value.is_finite()) else { continue };
            let minute = minutes.entry(at_utc.micros().div_euclid(MINUTE_US)).or_default();
            let (sum, weight) = minute.entry(name.clone()).or_default();
            *sum += value * count as f64;
            *weight += count as f64;
        }
    }
    let row = |(minute, values): (i64, BTreeMap<String, (f64, f64)>)| {
        let at = Utc::from_micros(minute.saturating_mul(MINUTE_US));
        let weighed = values.into_iter().filter(|(_, (_, weight))| *weight > 0.0);
        let mut values: Numbers = weighed.map(|(name, (sum, weight))| (name, sum / weight)).collect();
        if is_weather {
            add_difference(&mut values);
            let holds = |one: &&Interval| one.from_utc <= at && one.until_utc.is_none_or(|until| at < until);
            if let Some(interval) = verdicts.iter().find(holds) {
                values.insert("WeatherSafe".to_owned(), is_safe(interval.verdict));
            }
        }
        PolledMinute { datetime: at.strftime("%Y-%m-%dT%H:%M:%S"), values }
    };
    minutes.into_iter().map(row).collect()
}

/// The strictest bounds of this server's own telescope; those of others stand in files that it does not have.
fn limits(server: &Server, address: &Address) -> BTreeMap<String, Bounds> {
    let config = &server.config;
    let mut bounds: BTreeMap<String, Bounds> = BTreeMap::new();
    if config.address() != *address {
        return bounds;
    }
    let own = config.observingconditions.iter().flat_map(|station| &station.limit);
    for limit in own.chain(&config.shared.limit).filter(|limit| limit.of == config::Measure::Value) {
        let known = bounds.entry(limit.parameter.clone()).or_default();
        known.upper = [known.upper, limit.upper].into_iter().flatten().reduce(f64::min);
        known.lower = [known.lower, limit.lower].into_iter().flatten().reduce(f64::max);
    }
    bounds
}

/// Day, twilight and night over a time; none where the place is not known.
async fn twilight(server: &Server, address: &Address, from: Utc, to: Utc) -> Vec<Twilight> {
    let Some((place, orientation)) = server.network.read().place(address) else { return Vec::new() };
    let worked_out = tokio::task::spawn_blocking(move || -> Result<Vec<Twilight>, sky::SkyError> {
        let mut changes = vec![from, to];
        let mut noon = from.plus_seconds(-DAY_S);
        while noon <= to.plus_seconds(DAY_S) {
            let night = sky::night(&place, &orientation, noon)?;
            let times = [
                night.sunset,
                night.civil_dusk,
                night.nautical_dusk,
                night.astronomical_dusk,
                night.astronomical_dawn,
                night.nautical_dawn,
                night.civil_dawn,
                night.sunrise,
            ];
            changes.extend(times.into_iter().flatten().filter(|at| *at > from && *at < to));
            noon = noon.plus_seconds(DAY_S);
        }
        changes.sort();
        changes.dedup();
        let mut periods = Vec::new();
        for pair in changes.windows(2) {
            let [start, end] = pair else { continue };
            let middle = start.plus_seconds(end.seconds_since(*start) / 2.0);
            let altitude = Observer::new(&place, &orientation, middle)?.sun().altitude;
            let iso = |at: &Utc| at.strftime("%Y-%m-%dT%H:%M:%S+00:00");
            periods.push(Twilight { start: iso(start), end: iso(end), phase: phase(altitude) });
        }
        Ok(periods)
    });
    worked_out.await.ok().and_then(Result::ok).unwrap_or_default()
}

fn phase(sun: Angle) -> &'static str {
    let phases = [
        (Night::SUNSET, "day"),
        (Night::CIVIL, "civil"),
        (Night::NAUTICAL, "nautical"),
        (Night::ASTRONOMICAL, "astronomical"),
    ];
    let found = phases.into_iter().find(|(least, _)| sun.degrees() >= least.degrees());
    found.map_or("night", |(_, phase)| phase)
}

/// Corrections of the guide loop, the oldest first.
pub async fn guiding(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    AskedFor(query): AskedFor<GuidingQuery>,
) -> Result<Response, Problem> {
    let address = the_telescope(&server, &caller, query.telescope.as_deref())?;
    let (from, to) = time(query.day, query.since, server.network.clock().utc())?;
    let question = ArchiveQuestion {
        ask: Ask::Corrections,
        from_utc: Some(from),
        to_utc: Some(to),
        limit: Some(MOST_CORRECTIONS),
    };
    let answer = asked(&server, address.clone(), &question).await?;
    let correction = |row| match row {
        ArchiveRow::Correction(correction) => Some(LegacyCorrection {
            datetime: legacy_time(correction.mid_utc),
            telescope_name: address.telescope.to_string(),
            post_pid_x: correction.dx_px.filter(|px| px.is_finite()).map(|px| -px),
            post_pid_y: correction.dy_px.filter(|px| px.is_finite()).map(|px| -px),
        }),
        _ => None,
    };
    let corrections = LegacyCorrections {
        status: "success",
        message: if answer.truncated { "older corrections are left out".to_owned() } else { String::new() },
        data: answer.rows.into_iter().filter_map(correction).collect(),
    };
    Ok(instead("guiding", &address, Json(corrections).into_response()))
}
