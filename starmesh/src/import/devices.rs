//! Each kind of device: what the predecessor's keys are here.

use contract::Kind;

use super::block::{Block, Lines, list, name, quoted};
use super::entry::{Entry, Notes};
use super::guider::guider;

/// Why a device cannot be taken at all.
#[derive(Debug, thiserror::Error)]
#[error("line {line}: {place}: {what}")]
pub struct BadDevice {
    line: usize,
    place: String,
    what: String,
}

/// Key of a dome: who turns it.
pub const FOLLOW: &str = "follow";
const NOT_HERE: &str = "there is no such key here; not carried over";

/// Reads one device.
///
/// # Errors
/// [`BadDevice`] when it has no name or no server: then nothing can be done with it.
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
    let number = entry.whole("device_number", notes).unwrap_or(0);
    let name = name(&old_name);
    if name != old_name {
        notes.add(entry.line, format!("{}: is named {name:?} here: letters, digits, '_', '-', '.'", entry.place));
    }
    let mut lines = Lines::default();
    lines.maybe("period_s", entry.number("polling_interval", notes), "poll period");
    if entry.flag("connectable", notes) == Some(false) {
        lines.key("connect", false, "the site connects it");
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
    };
    match kind {
        Kind::Telescope => telescope(&mut block, &mut entry, notes),
        Kind::Camera => camera(&mut block, &mut entry, notes),
        Kind::Focuser => focuser(&mut block, &mut entry, notes),
        Kind::Dome => dome(&mut block, &mut entry, notes),
        Kind::SafetyMonitor => {
            // what the predecessor takes where the file says nothing
            block.dwell_min = Some(entry.number("max_safe_duration", notes).unwrap_or(30.0));
        }
        Kind::ObservingConditions => weather(&mut block, &mut entry, notes),
        Kind::FilterWheel | Kind::CoverCalibrator | Kind::Switch | Kind::Rotator => {}
    }
    entry.rest(NOT_HERE, notes);
    Ok(block)
}

fn telescope(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    let pointing = block.tables.entry("pointing").or_default();
    match entry.number("pointing_threshold", notes) {
        Some(arcmin) if (0.005..=60.0).contains(&arcmin) => {
            pointing.key("threshold_arcmin", arcmin, "on target when so near");
            // ours asks each frame to be nearer than this, which is 1 unless it is said
            if arcmin > 1.0 {
                pointing.key("tolerance_arcmin", arcmin, "a frame that is further off does not count");
            }
        }
        Some(arcmin) => notes.add(
            entry.line,
            format!("{}: pointing_threshold = {arcmin}: expected 0.005 to 60 arcmin; not carried over", entry.place),
        ),
        None => {}
    }
    if let Some(mut map) = entry.entry("guider", notes) {
        guider(block, &mut map, notes);
        map.rest(NOT_HERE, notes);
    }
    // a wait of exposure times factor after a correction: 0 waits for nothing
    if let Some(factor) = entry.number("settle_factor", notes).filter(|factor| *factor != 0.0) {
        let what = "waits by the exposure do not exist here; telescope.settle_s is one for every slew";
        notes.add(entry.line, format!("{}: settle_factor = {factor}: {what}; not carried over", entry.place));
    }
    flip(block, entry, notes);
    if let Some(system) = entry.text("equatorial_system", notes) {
        match system.to_ascii_lowercase().as_str() {
            "auto" => {}
            "j2000" | "icrs" | "equj2000" | "other" => block.lines.key("equatorial_system", quoted("j2000"), &system),
            "jnow" | "topocentric" | "equtopocentric" | "equlocaltopocentric" => {
                let what = format!("{system}: true equator and equinox of date");
                block.lines.key("equatorial_system", quoted("topocentric"), &what);
            }
            _ => notes.add(
                entry.line,
                format!("{}: equatorial_system {system:?} is not supported: auto, J2000 or JNow", entry.place),
            ),
        }
    }
}

/// When a German mount turns over; ours has the same rule.
fn flip(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    if entry.flag("meridian_flip", notes) == Some(true) {
        block.lines.key("meridian_flip", true, "between two frames");
    }
    match entry.number("meridian_flip_min", notes) {
        Some(past_min) if (0.0..=120.0).contains(&past_min) => {
            block.lines.key("meridian_flip_min", past_min, "past the meridian at the end of the next frame");
        }
        Some(past_min) => notes.add(
            entry.line,
            format!("{}: meridian_flip_min = {past_min}: expected 0 to 120 min; not carried over", entry.place),
        ),
        None => {}
    }
}

fn camera(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    block.lines.maybe("temperature_c", entry.number("temperature", notes), "cooler set point");
    block.lines.maybe("temperature_tolerance_c", entry.number("temperature_tolerance", notes), "K");
    block.lines.maybe("cooling_timeout_min", entry.number("cooling_timeout", notes), "");
    if let Some(mut flats) = entry.entry("flats", notes) {
        let keys = [
            ("target_adu", "target_adu"),
            ("target_adu_tolerance", "tolerance_adu"),
            ("bias_offset", "bias_adu"),
            ("lower_exptime_limit", "exposure_min_s"),
            ("upper_exptime_limit", "exposure_max_s"),
        ];
        let each = keys.iter().filter_map(|(old, new)| Some(format!("{new} = {:?}", flats.number(old, notes)?)));
        let table = each.collect::<Vec<_>>().join(", ");
        flats.rest(NOT_HERE, notes);
        block.lines.key("flats", format!("{{ {table} }}"), "what a good flat is; levels with their bias");
    }
    if let Some(mut pairs) = entry.entry("paired_devices", notes) {
        camera_pairs(block, &mut pairs, notes);
        pairs.rest("expected an ASCOM device type; not carried over", notes);
    }
    for key in entry.keys().iter().filter(|key| NEVER_APPLIED.contains(&key.as_str())) {
        let line = entry.take(key).map_or(entry.line, |node| node.line);
        let what = "defaults of an action had no effect in Astra either; write them into the rows";
        notes.add(line, format!("{}: {key}: {what}; not carried over", entry.place));
    }
}

/// Sub-maps of a camera that look like defaults of an action; the predecessor looks them up by a key that no device has.
const NEVER_APPLIED: [&str; 10] = [
    "openaction",
    "closeaction",
    "coolcameraaction",
    "completeheadersaction",
    "objectaction",
    "calibrationaction",
    "flatsaction",
    "calibrateguidingaction",
    "pointingmodelaction",
    "autofocus",
];

fn camera_pairs(block: &mut Block, pairs: &mut Entry<'_>, notes: &mut Notes) {
    for key in pairs.keys() {
        let Ok(kind) = key.parse::<Kind>() else { continue };
        if let Some(old_name) = pairs.text(&key, notes) {
            block.pairs.insert(kind, old_name);
        }
    }
}

fn focuser(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    block.lines.maybe("best_position", entry.whole("focus_position", notes), "steps, until a better one is learnt");
    block.lines.maybe("tolerance_steps", entry.whole("focus_tolerance", notes), "");
    block.lines.maybe("settle_s", entry.number("settle_time", notes), "");
}

fn dome(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    match entry.flag("close_dome_on_telescope_error", notes) {
        Some(true) => block.lines.key("close_with_mount", quoted("beside"), "close_dome_on_telescope_error: true"),
        said => {
            let why = match said {
                Some(_) => "close_dome_on_telescope_error: false",
                None => "close_dome_on_telescope_error is not said, which means false",
            };
            block
                .lines
                .comment("The old flag kept the dome open over a mount in fault. Here it waits for the park and");
            block.lines.comment("then closes all the same. \"parked_only\": a roof that would hit the telescope;");
            block.lines.comment("\"beside\": a dome that never touches it.");
            block.lines.key("close_with_mount", quoted("parked_within_s"), why);
            let place = &entry.place;
            notes.add(
                entry.line,
                format!(
                    "{place}: {why}: taken for close_with_mount = \"parked_within_s\"; a roof that would hit the telescope needs \
                     \"parked_only\", a dome that never touches it \"beside\": please decide"
                ),
            );
        }
    }
    block.telescopes = entry.texts("telescopes", notes);
    block.lines.comment(
        "Astra turned no dome. \"auto\" turns it here, or waits for one that is slaved: only where nothing else does.",
    );
    block.lines.key(FOLLOW, quoted("off"), "the site turns it, as before");
    notes.add(
        entry.line,
        format!("{}: {FOLLOW} = \"off\", as Astra turned no dome; \"auto\" where nothing else turns it", entry.place),
    );
}

fn weather(block: &mut Block, entry: &mut Entry<'_>, notes: &mut Notes) {
    let Some(mut parameters) = entry.entry("closing_limits", notes) else { return };
    for parameter in parameters.keys() {
        for mut limit in parameters.entries(&parameter, notes) {
            let (upper, lower) = (limit.number("upper", notes), limit.number("lower", notes));
            if upper.is_none() && lower.is_none() {
                notes.add(limit.line, format!("{}: neither upper nor lower; not carried over", limit.place));
                continue;
            }
            let dwell_min = limit.number("max_safe_duration", notes);
            if dwell_min.is_none() {
                let what = "without max_safe_duration this limit did nothing; it counts now, with a dwell of 15 min";
                notes.add(limit.line, format!("{}: {what}", limit.place));
            }
            let mut words = vec![format!("parameter = {}", quoted(&parameter))];
            for (key, value) in [("upper", upper), ("lower", lower), ("dwell_min", dwell_min)] {
                words.extend(value.map(|value| format!("{key} = {value}")));
            }
            block.limits.push(format!("{{ {} }}", words.join(", ")));
            limit.rest(NOT_HERE, notes);
        }
    }
}

/// `telescopes = [...]` of a dome over several of them.
pub fn telescopes_under(chunks: &[String]) -> String {
    format!("telescopes = {}\n", list(chunks))
}
