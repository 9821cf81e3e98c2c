//! A site on a simulator: it gets the place of the site, the night of its schedule, under a sky that is fair for the
//! site's limits, with its filters and its focus.

use std::collections::BTreeSet;
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use contract::Kind;
use schedule::times;
use serde_json::{Map, Value, json};
use units::Utc;

use super::block::Block;
use super::devices::{BEST_POSITION, FOLLOW};
use super::differences::dwell_min;
use super::fair::fair;
use super::schedule::Piece;
use super::site::Location;

/// An answer of the simulator takes no longer than this.
const LIMIT: Duration = Duration::from_secs(5);
/// Between the end of the longest dwell and the first row, s.
const SPARE_S: f64 = 900.0;

/// The default for a value that the site's file does not contain: how near to a target is on it, arcmin.
const THRESHOLD_ARCMIN: f64 = 0.1;
/// Scatter of the simulator's own mount, arcsec.
const SCATTER_ARCSEC: f64 = 4.0;

/// The wanted properties of a simulator.
#[derive(Debug, Default)]
pub struct Wanted {
    location: Option<Location>,
    start: Option<Utc>,
    first_row: Option<Utc>,
    focus_position: Option<i64>,
    coldest_c: Option<f64>,
    scatter_arcsec: Option<f64>,
    filters: BTreeSet<String>,
    weather: Map<String, Value>,
}

/// A simulator with these properties.
#[derive(Debug)]
pub struct Ready {
    /// Its place.
    pub location: Location,
    lines: Vec<String>,
}

impl Wanted {
    /// The properties that a site's files describe.
    pub fn of(blocks: &[Block], pieces: &[Piece], location: Option<Location>) -> Self {
        let values: Vec<Value> = pieces.iter().filter_map(Piece::value).collect();
        let time = |value: &Value| times::read(value["start_time"].as_str()?).map(|read| read.utc);
        let first_row = values.iter().filter_map(time).min();
        let limits: Vec<&str> =
            blocks.iter().flat_map(|block| &block.limits).map(|(_, limit)| limit.as_str()).collect();
        let dwells =
            limits.iter().filter_map(|limit| dwell_min(limit)).chain(blocks.iter().filter_map(|block| block.dwell_min));
        let longest_min = dwells.fold(15.0, f64::max);
        let names = |value: &Value| match value {
            Value::String(name) => vec![name.clone()],
            Value::Array(list) => list.iter().filter_map(Value::as_str).map(str::to_owned).collect(),
            _ => Vec::new(),
        };
        let filters = values.iter().flat_map(|value| names(&value["action_value"]["filter"])).collect();
        let thresholds =
            blocks.iter().filter_map(|block| block.tables.get("pointing")?.value("threshold_arcmin")?.parse().ok());
        let threshold_arcmin: Option<f64> = thresholds.reduce(f64::min);
        let set_points = blocks.iter().filter_map(Block::temperature_c);
        Self {
            location,
            start: first_row.map(|first| first.plus_seconds(-60.0 * longest_min - SPARE_S)),
            first_row,
            focus_position: blocks.iter().find_map(|block| block.focus_position),
            coldest_c: set_points.reduce(f64::min),
            // A mount that comes within the threshold in one or two corrections.
            scatter_arcsec: Some((threshold_arcmin.unwrap_or(THRESHOLD_ARCMIN) * 60.0 / 4.0).min(SCATTER_ARCSEC)),
            filters,
            weather: fair(&limits),
        }
    }
}

/// Makes the simulator at `server` what is wanted; its clock starts when a node first asks for it.
///
/// # Errors
/// When no simulator answers there, or it does not take what it is sent.
pub async fn prepare(server: &str, wanted: &Wanted) -> anyhow::Result<Ready> {
    let client = local_http::client_builder().timeout(LIMIT).build()?;
    let world = format!("http://{server}/simulator/v1/world");
    let mut site = Map::new();
    if let Some(Location { latitude_deg, longitude_deg, elevation_m }) = wanted.location {
        for (key, value) in
            [("latitude_deg", latitude_deg), ("longitude_deg", longitude_deg), ("elevation_m", elevation_m)]
        {
            site.insert(key.to_owned(), json!(value));
        }
    }
    if let Some(start) = wanted.start {
        site.insert("start".to_owned(), json!(start));
    }
    if let Some(position) = wanted.focus_position {
        site.insert("best_focus".to_owned(), json!(position));
    }
    for (key, value) in [("coldest_c", wanted.coldest_c), ("scatter_arcsec", wanted.scatter_arcsec)] {
        if let Some(value) = value {
            site.insert(key.to_owned(), json!(value));
        }
    }
    site.insert("filters".to_owned(), json!(wanted.filters));
    site.insert("small_frames".to_owned(), true.into());
    let answer = put(&client, &format!("{world}/site"), &site).await;
    let answer = answer.with_context(|| {
        format!("the simulator at {server} cannot be made ready; is it running? Start it first: starmesh simulator --speed 300 &")
    })?;
    if !wanted.weather.is_empty() {
        put(&client, &format!("{world}/weather"), &wanted.weather).await.context("the simulator's weather")?;
    }
    let number =
        |key: &str| answer["site"][key].as_f64().with_context(|| format!("the simulator does not report its {key}"));
    let location = Location {
        latitude_deg: number("latitude_deg")?,
        longitude_deg: number("longitude_deg")?,
        elevation_m: number("elevation_m")?,
    };
    let mut lines = Vec::new();
    let (latitude, longitude) = (location.latitude_deg, location.longitude_deg);
    lines.push(match wanted.location {
        Some(_) => format!("the simulator stands where the site does: {latitude:.4}, {longitude:.4}"),
        None => format!(
            "no mount reported the position of the site, so it is where the simulator stands: {latitude:.4}, {longitude:.4}; \
             --latitude-deg, --longitude-deg and --elevation-m say it"
        ),
    });
    if let (Some(start), Some(first_row)) = (wanted.start, wanted.first_row) {
        lines.push(format!(
            "its clock stands at {start} until the nodes start: the longest dwell before the first row at {first_row}"
        ));
    }
    if !wanted.weather.is_empty() {
        let weather: Vec<String> = wanted.weather.iter().map(|(name, value)| format!("{name} {value}")).collect();
        lines.push(format!("its weather is fair for the site's limits: {}", weather.join(", ")));
    }
    if let Some(frame_px) = answer["site"]["frame_px"].as_u64() {
        lines.push(format!(
            "its frames are {frame_px} pixels wide; at a high --speed they are small, or the night would wait for them"
        ));
    }
    if let Some(position) = wanted.focus_position {
        lines.push(format!("its focus is at the site's focus_position, {position}"));
    }
    lines.push(
        "a simulator that is started anew has forgotten all this: import once more, with another --out".to_owned(),
    );
    Ok(Ready { location, lines })
}

async fn put(client: &reqwest::Client, address: &str, values: &Map<String, Value>) -> anyhow::Result<Value> {
    let answer = client.put(address).body(Value::Object(values.clone()).to_string()).send().await?;
    let (status, text) = (answer.status(), answer.text().await?);
    ensure!(status.is_success(), "{address} answers {status}: {text}");
    Ok(serde_json::from_str(&text)?)
}

/// Puts a simulator in the place of every device, and removes what is true of the real ones alone. Returns the
/// sentences to be printed.
///
/// # Errors
/// For a site of several telescopes: a simulator is one.
pub fn replace(blocks: &mut Vec<Block>, server: &str, ready: Option<&Ready>) -> anyhow::Result<Vec<String>> {
    let mut kinds = BTreeSet::new();
    let mut lines: Vec<String> = ready.map(|ready| ready.lines.clone()).unwrap_or_default();
    let mut retained = Vec::new();
    for mut block in std::mem::take(blocks) {
        if !kinds.insert(block.kind) {
            let place = format!("line {}: {}", block.line, block.place());
            if block.kind == Kind::Telescope {
                bail!(
                    "{place} is a second one, and a simulator is one telescope: import without --simulator and give each \
                     telescope's devices the address of a simulator of its own"
                );
            }
            lines.push(format!("{place} is a second one, and a simulator has one: it is left out here"));
            continue;
        }
        (block.server, block.number, block.guide_start) = (server.to_owned(), 0, None);
        // Nobody else turns or connects simulated devices, and how the real ones answer and move is not how these do.
        for key in [FOLLOW, "connect", "period_s", "equatorial_system"] {
            block.lines.without(key);
        }
        if let Some(guiding) = block.tables.get_mut("guiding") {
            guiding.without("dec_reversed_after_flip");
        }
        if ready.is_none() {
            block.lines.without(BEST_POSITION);
        }
        retained.push(block);
    }
    *blocks = retained;
    Ok(lines)
}
