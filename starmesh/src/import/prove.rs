//! Finds the valid parts of a device: each key is proven by itself, so that an invalid one costs no other.

use super::block::{Block, TableLines, quoted};
use super::devices::DWELL_MIN;
use super::entry::Notes;

/// Enough of a file for the reader of configurations.
const FRAME: &str =
    "[observatory]\nsite = \"site\"\ntelescope = \"telescope\"\nlatitude_deg = 0\nlongitude_deg = 0\nelevation_m = 0\n";

/// Removes what would make the new file invalid, and notes it. Returns the devices that remain.
pub fn prune(blocks: Vec<Block>, notes: &mut Notes) -> Vec<Block> {
    let mut taken: Vec<Block> = Vec::new();
    for mut block in blocks {
        let place = block.place();
        if taken.iter().any(|known| known.kind == block.kind && known.old_name == block.old_name) {
            notes.add(block.line, format!("{place}: a second one of this name; THE DEVICE IS LEFT OUT"));
            continue;
        }
        // Names that differed only in characters that are not allowed here.
        let wanted = block.name.clone();
        let is_free = |name: &str| !taken.iter().any(|known| known.kind == block.kind && known.name == name);
        let names = std::iter::once(wanted.clone()).chain((2..1000).map(|n| format!("{wanted:.59}-{n}")));
        block.name = names.into_iter().find(|name| is_free(name)).unwrap_or(wanted);
        if let Some(why) = fault(&block.head()) {
            notes.add(block.line, format!("{place}: {why}; THE DEVICE IS LEFT OUT"));
            continue;
        }
        let head = block.head();
        block.lines = valid(&place, &head, std::mem::take(&mut block.lines), notes);
        for (table, lines) in &mut block.tables {
            *lines = valid(&place, &format!("[{table}]\n"), std::mem::take(lines), notes);
        }
        let is_limit_valid = |(line, limit): &(usize, String)| match fault(&format!("{head}limit = [{limit}]\n")) {
            Some(why) => {
                notes.add(*line, format!("{place}: {why}: THIS LIMIT DOES NOT CLOSE THE DOME; not carried over"));
                false
            }
            None => true,
        };
        block.limits.retain(is_limit_valid);
        if let Some(why) = block.dwell_min.and_then(|dwell_min| fault(&format!("{head}dwell_min = {dwell_min}\n"))) {
            notes.add(block.line, format!("{place}: max_safe_duration: {why}; Astra's {DWELL_MIN} min are taken"));
            block.dwell_min = Some(DWELL_MIN);
        }
        taken.push(block);
    }
    taken
}

/// The lines that are valid behind `head`, each with those before it.
fn valid(place: &str, head: &str, lines: TableLines, notes: &mut Notes) -> TableLines {
    let mut proven = TableLines::default();
    for (old, line) in lines.all {
        let is_comment = line.starts_with('#');
        match fault(&format!("{head}{}{line}\n", proven.text())).filter(|_| !is_comment) {
            Some(why) => {
                let key = line.split("  #").next().unwrap_or_default();
                notes.add(old, format!("{place}: {key}: {why}; not carried over"));
            }
            None => proven.all.push((old, line)),
        }
    }
    proven
}

/// File-name templates that can be used.
pub fn templates(templates: Vec<(usize, String, String)>, notes: &mut Notes) -> Vec<(String, String)> {
    let key = |action: &str, template: &str| format!("[archive.filename]\n{} = {}\n", quoted(action), quoted(template));
    let mut own = std::collections::BTreeMap::new();
    let mut valid = Vec::new();
    for (line, action, template) in templates {
        let text = format!("{FRAME}{}", key(&action, &template));
        let (_, faults) = config::examine(&text, std::path::Path::new("."));
        let of_key = faults.into_iter().find(|fault| fault.what.starts_with("archive.filename"));
        match fault(&key(&action, &template)).or(of_key.map(|fault| fault.what)) {
            Some(why) => notes.add(line, format!("filename_templates: {action}: {why}; not carried over")),
            None => {
                own.insert(action.clone(), template.clone());
                valid.push((line, action, template));
            }
        }
    }
    // One of them decides how all are read.
    let (_, faults) = node_archive::name::Namer::with_faults(&own, config::FileProfile::Astra, 0.0);
    for fault in faults {
        if let Some(at) = valid.iter().position(|(_, action, _)| *action == fault.action) {
            let (line, action, _) = valid.remove(at);
            notes.add(line, format!("filename_templates: {action}: {fault}; the usual name is taken"));
        }
    }
    valid.into_iter().map(|(_, action, template)| (action, template)).collect()
}

/// Why a piece of a file is not valid, in one line.
fn fault(piece: &str) -> Option<String> {
    let error = config::parse(&format!("{FRAME}{piece}"), std::path::Path::new(".")).err()?.to_string();
    // A TOML error begins with a picture of the place; its last line names what is wrong.
    let text = error.lines().map(str::trim).rfind(|line| !line.is_empty()).unwrap_or_default();
    let after_line = text.strip_prefix("line ").and_then(|rest| rest.split_once(": ")).map_or(text, |(_, what)| what);
    Some(after_line.to_owned())
}
