//! Converts each kind of device: the predecessor's keys become ours.

use contract::Kind;
use contract::device::observing_conditions::made_of;

use super::block::{Block, TableLines, list, name, quoted};
use super::entry::{Entry, Notes};
use super::guider::guider;
use super::yaml::{Node, Value};

/// Why a device cannot be taken at all.
#[derive(Debug, thiserror::Error)]
#[error("{place}: {what}")]
pub struct BadDevice {
    /// Line of the old file.
    pub line: usize,
    place: String,
    what: String,
}

/// Key of a dome: which part turns it.
pub const FOLLOW: &str = "follow";
/// The value that the predecessor uses for a safety monitor where the file has none, min.
pub const DWELL_MIN: f64 = 30.0;
const NOT_HERE: &str = "there is no such key here; not carried over";

/// Reads one device.
///
/// # Errors
/// [`BadDevice`] when it has no name, no server or no number that can be read: then nothing may be sent to it.
pub fn device(kind: Kind, mut entry: Entry<'_>, notes: &mut Notes) -> Result<Block, BadDevice> {
    let bad = |entry: &Entry<'_>, what: &str| BadDevice {
        line: entry.line,
        place: entry.place.clone(),
        what: what.to_owned(),
    };
    let Some(old_name) = entry.text("device_name", notes) else {
        return Err(bad(&entry, "device_name is missing: expected the device's unique name"));
    };
    entry.place = format!("{} {old_name}", kind.ascom());
    let Some(server) = entry.text("ip", notes) else {
        return Err(bad(&entry, "ip is missing: expected host:port of its Alpaca server"));
    };
    let server = server.trim().trim_start_matches("http://").trim_end_matches('/').to_owned();
    let was_there = entry.has("device_number");
    let number = match entry.whole("device_number", notes) {
        Some(number) if u32::try_from(number).is_ok() => number,
        Some(number) => return Err(bad(&entry, &format!("device_number = {number}: expected 0 or more"))),
        None if was_there => {
            return Err(bad(&entry, "device_number cannot be read: another device would be commanded"));
        }
        None => {
            notes.add(entry.line, format!("{}: device_number is not set; 0 is taken: is that right?", entry.place));
            0
        }
    };
    let name = name(&old_name);
    if name != old_name {
        notes.add(entry.line, format!("{}: is named {name:?} here: letters, digits, '_', '-', '.'", entry.place));
    }
    let mut lines = TableLines::default();
    let period_s = entry.number("polling_interval", notes);
    lines.of(entry.last).maybe("period_s", period_s, "poll period");
    if entry.flag("connectable", notes) == Some(false) {
        lines.of(entry.last).key("connect", false, "the site connects it");
    }
    let line = entry.line;
    let mut block = Block {
        kind,
        old_name,
        name,
        line,
        server,
        number,
        lines,
        limits: Vec::new(),
        dwell_min: None,
        pairs: Default::default(),
        telescopes: Vec::new(),
        tables: Default::default(),
        guide_start: None,
        focus_position: None,
        defaults: Default::default(),
    };
    match kind {
        Kind::Telescope => telescope(&mut block, &mut entry, notes),
        Kind::Camera => camera(&mut block, &mut entry, notes),
        Kind::Focuser => focuser(&mut block, &mut entry, notes),
        Kind::Dome => dome(&mut block, &mut entry, notes),
        Kind::SafetyMonitor => {
            let minutes = entry.number("max_safe_duration", notes);
            if minutes.is_none() {
                let what = "max_safe_duration is not set; Astra's 30 min are taken for dwell_min";
                notes.add(entry.line, format!("{}: {what}", entry.place));
            }
            block.dwell_min = Some(minutes.unwrap_or(DWELL_MIN));
        }
        Kind::ObservingConditions => weather(&mut block, &mut entry, notes),
        Kind::FilterWheel | Kind::CoverCalibrator | Kind::Switch | Kind::Rotator => {}
    }
    entry.rest(NOT_HERE, notes);
    Ok(block)
}

fn telescope(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    if let Some(arcmin) = entry.number("pointing_threshold", notes) {
        let pointing = block.tables.entry("pointing").or_default().of(entry.last);
        pointing.key("threshold_arcmin", arcmin, "on target when so near");
        // Starmesh asks each frame to be nearer than this, which is 1 by default.
        if arcmin > 1.0 {
            pointing.key("tolerance_arcmin", arcmin, "a frame that is further off does not count");
        }
    }
    if let Some(mut map) = entry.entry("guider", notes) {
        guider(block, &mut map, notes);
        map.rest(NOT_HERE, notes);
    }
    // 0, as in the template, waits for nothing.
    if let Some(factor) = entry.number("settle_factor", notes).filter(|factor| *factor != 0.0) {
        let what = "times the exposure is waited for after a correction of the pointing";
        block.lines.of(entry.last).key("settle_factor", factor, what);
    }
    if entry.flag("meridian_flip", notes) == Some(true) {
        block.lines.of(entry.last).key("meridian_flip", true, "between two frames");
    }
    if let Some(past_min) = entry.number("meridian_flip_min", notes) {
        let what = "past the meridian at the end of the next frame";
        block.lines.of(entry.last).key("meridian_flip_min", past_min, what);
    }
    if let Some(system) = entry.text("equatorial_system", notes) {
        let line = entry.last;
        match system.to_ascii_lowercase().as_str() {
            "auto" => {}
            "j2000" | "icrs" | "equj2000" | "other" => {
                block.lines.of(line).key("equatorial_system", quoted("j2000"), &system);
            }
            "jnow" | "topocentric" | "equtopocentric" | "equlocaltopocentric" => {
                let what = format!("{system}: true equator and equinox of date");
                block.lines.of(line).key("equatorial_system", quoted("topocentric"), &what);
            }
            _ => notes.add(
                line,
                format!("{}: equatorial_system {system:?} is not supported: auto, J2000 or JNow", entry.place),
            ),
        }
    }
}

fn camera(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    for (old, new, comment) in [
        ("temperature", "temperature_c", "cooler set point"),
        ("temperature_tolerance", "temperature_tolerance_c", "K"),
        ("cooling_timeout", "cooling_timeout_min", ""),
    ] {
        let value = entry.number(old, notes);
        block.lines.of(entry.last).maybe(new, value, comment);
    }
    if let Some(mut flats) = entry.entry("flats", notes) {
        let line = flats.line;
        let keys = [
            ("target_adu", "target_adu"),
            ("target_adu_tolerance", "tolerance_adu"),
            ("bias_offset", "bias_adu"),
            ("lower_exptime_limit", "exposure_min_s"),
            ("upper_exptime_limit", "exposure_max_s"),
        ];
        for (old, new) in keys {
            let value = flats.number(old, notes);
            // Dotted keys, so that one that is not taken costs no other.
            block.lines.of(flats.last).maybe(&format!("flats.{new}"), value.map(|value| format!("{value:?}")), "");
        }
        block.lines.of(line);
        flats.rest(NOT_HERE, notes);
    }
    if let Some(mut pairs) = entry.entry("paired_devices", notes) {
        camera_pairs(block, &mut pairs, notes);
        pairs.rest("expected an ASCOM device type; not carried over", notes);
    }
    defaults_of_actions(block, entry, notes);
}

/// Sub-maps of a camera with defaults of an action, and the action.
const DEFAULTS: [(&str, &str); 11] = [
    ("openaction", "open"),
    ("closeaction", "close"),
    ("coolcameraaction", "cool_camera"),
    ("completeheadersaction", "complete_headers"),
    ("objectaction", "object"),
    ("calibrationaction", "calibration"),
    ("flatsaction", "flats"),
    ("calibrateguidingaction", "calibrate_guiding"),
    ("pointingmodelaction", "pointing_model"),
    ("autofocusaction", "autofocus"),
    ("autofocus", "autofocus"),
];

/// The predecessor documents them and never applies them, because it looks them up by a key that no device has. Rows
/// that were written for its nights would change here, so these defaults are carried over as comments that a person can
/// switch on.
fn defaults_of_actions(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    for (key, action) in DEFAULTS {
        let Some(node) = entry.take(key) else { continue };
        let place = format!("{}: {key}", entry.place);
        let Value::Map(map) = &node.value else {
            notes.add(node.line, format!("{place}: expected keys and values; not carried over"));
            continue;
        };
        let values = map.iter().filter_map(|(key, node)| Some((key.clone(), json(node)?)));
        block.defaults.entry(action.to_owned()).or_default().extend(values);
        let what = "defaults of an action had no effect in Astra; they are a comment in the new file (camera.defaults), \
                    and hold once you take the # away";
        notes.add(node.line, format!("{place}: {what}"));
    }
    for (action, values) in &block.defaults {
        let table = inline(&serde_json::Value::Object(values.clone()));
        block.lines.comment(&format!("defaults.{action} = {table}"));
    }
}

/// A value of the old file; `None` for one without content.
fn json(node: &Node) -> Option<serde_json::Value> {
    Some(match &node.value {
        Value::Null | Value::Unclear(_) => return None,
        Value::Bool(flag) => (*flag).into(),
        Value::Number(number) if number.fract() == 0.0 && number.abs() < 9e15 => (*number as i64).into(),
        Value::Number(number) => (*number).into(),
        Value::Text(text) => text.as_str().into(),
        Value::List(list) => list.iter().filter_map(json).collect(),
        Value::Map(map) => map.iter().filter_map(|(key, node)| Some((key.clone(), json(node)?))).collect(),
    })
}

/// A value as TOML writes it in one line.
fn inline(value: &serde_json::Value) -> String {
    match value {
        serde_json::Value::Array(list) => format!("[{}]", list.iter().map(inline).collect::<Vec<_>>().join(", ")),
        serde_json::Value::Object(map) => {
            let keys = map.iter().map(|(key, value)| format!("{} = {}", quoted(key), inline(value)));
            format!("{{ {} }}", keys.collect::<Vec<_>>().join(", "))
        }
        other => other.to_string(),
    }
}

fn camera_pairs(block: &mut Block, pairs: &mut Entry<'_>, notes: &mut Notes) {
    for key in pairs.keys() {
        let Ok(kind) = key.parse::<Kind>() else { continue };
        if let Some(old_name) = pairs.text(&key, notes) {
            block.pairs.insert(kind, old_name);
        }
    }
}

fn focuser(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    block.focus_position = entry.whole("focus_position", notes);
    block.lines.of(entry.last).maybe(BEST_POSITION, block.focus_position, "steps, until a better one is learned");
    let tolerance_steps = entry.whole("focus_tolerance", notes);
    block.lines.of(entry.last).maybe("tolerance_steps", tolerance_steps, "");
    let settle_s = entry.number("settle_time", notes);
    block.lines.of(entry.last).maybe("settle_s", settle_s, "");
}

/// Key of a dome: it is parked when it is closed.
pub const PARK_AT_CLOSE: &str = "park_at_close";
/// Key of a focuser: where the focus is.
pub const BEST_POSITION: &str = "best_position";

fn dome(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    let was_there = entry.has("close_dome_on_telescope_error");
    let closes = entry.flag("close_dome_on_telescope_error", notes);
    let line = if was_there { entry.last } else { entry.line };
    let lines = block.lines.of(line);
    match closes {
        Some(true) => lines.key("close_with_mount", quoted("alongside"), "close_dome_on_telescope_error: true"),
        closes => {
            let why = match closes {
                Some(_) => "close_dome_on_telescope_error: false",
                None if was_there => "close_dome_on_telescope_error cannot be read",
                None => "close_dome_on_telescope_error is not set, which means false",
            };
            lines.comment("The old flag kept the dome open over a mount in fault. Here it waits for the park and");
            lines.comment("then closes all the same. \"parked_only\": a roof that would hit the telescope;");
            lines.comment("\"alongside\": a dome that never touches it.");
            lines.key("close_with_mount", quoted("parked_within_s"), why);
            let place = &entry.place;
            notes.add(
                line,
                format!(
                    "{place}: {why}: taken for close_with_mount = \"parked_within_s\"; a roof that would hit the telescope needs \
                     \"parked_only\", a dome that never touches it \"alongside\": please decide"
                ),
            );
        }
    }
    block.telescopes = entry.texts("telescopes", notes);
    let lines = block.lines.of(entry.line);
    lines.key(
        "park_at_close",
        true,
        "as Astra did before it closed; the shutter waits for it a little, never for long",
    );
    lines.comment(
        "Astra turned no dome. \"auto\" turns it here, or waits for one that is slaved: only where nothing else does.",
    );
    lines.key(FOLLOW, quoted("off"), "the site turns it, as before");
    notes.add(
        entry.line,
        format!("{}: {FOLLOW} = \"off\", as Astra turned no dome; \"auto\" where nothing else turns it", entry.place),
    );
}

fn weather(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    let Some(mut parameters) = entry.entry("closing_limits", notes) else { return };
    for parameter in parameters.keys() {
        for mut limit in parameters.entries(&parameter, notes) {
            let mut is_torn = false;
            let mut number = |key: &str, limit: &mut Entry<'_>, notes: &mut Notes| {
                let was_there = limit.has(key);
                let value = limit.number(key, notes);
                is_torn |= was_there && value.is_none();
                value
            };
            let (upper, lower) = (number("upper", &mut limit, notes), number("lower", &mut limit, notes));
            let dwell_min = number("max_safe_duration", &mut limit, notes);
            if upper.is_none() && lower.is_none() {
                let what = "neither upper nor lower can be read: THIS LIMIT DOES NOT CLOSE THE DOME; not carried over";
                notes.add(limit.line, format!("{}: {what}", limit.place));
                continue;
            }
            if is_torn {
                notes.add(limit.line, format!("{}: holds only as far as it could be read; please look", limit.place));
            } else if dwell_min.is_none() && !made_of(&parameter).is_empty() {
                let what = "without max_safe_duration this limit did nothing; it counts now, with a dwell of 15 min";
                notes.add(limit.line, format!("{}: {what}", limit.place));
            }
            let mut words = vec![format!("parameter = {}", quoted(&parameter))];
            for (key, value) in [("upper", upper), ("lower", lower), ("dwell_min", dwell_min)] {
                words.extend(value.map(|value| format!("{key} = {value}")));
            }
            block.limits.push((limit.line, format!("{{ {} }}", words.join(", "))));
            limit.rest(NOT_HERE, notes);
        }
    }
}

/// `telescopes = [...]` of a dome over several of them.
pub fn telescopes_under(lines: &mut TableLines, chunks: &[String]) {
    lines.key("telescopes", list(chunks), "");
}
