//! The text of `observatory.toml`, block by block.

use std::collections::BTreeMap;

use contract::Kind;

/// A table of the file, as lines.
#[derive(Debug, Clone, Default)]
pub struct TableLines {
    /// Each line, and the line of the old file that it was made of; 0 for none.
    pub all: Vec<(usize, String)>,
    old: usize,
}

impl TableLines {
    /// The next lines are made of this line of the old file.
    pub fn of(&mut self, old: usize) -> &mut Self {
        self.old = old;
        self
    }

    /// `key = value`, with a comment where there is one.
    pub fn key(&mut self, key: &str, value: impl std::fmt::Display, comment: &str) {
        let comment = if comment.is_empty() { String::new() } else { format!("  # {comment}") };
        self.all.push((self.old, format!("{key} = {value}{comment}")));
    }

    /// The same, where there is a value.
    pub fn maybe(&mut self, key: &str, value: Option<impl std::fmt::Display>, comment: &str) {
        if let Some(value) = value {
            self.key(key, value, comment);
        }
    }

    /// A comment of its own.
    pub fn comment(&mut self, text: &str) {
        self.all.push((self.old, format!("# {text}")));
    }

    /// The head of a table.
    pub fn table(&mut self, name: &str) {
        self.all.push((0, format!("\n[{name}]")));
    }

    /// Lines that are ready.
    pub fn text_of(&mut self, text: &str) {
        self.all.push((self.old, String::new()));
        self.all.extend(text.lines().map(|line| (self.old, line.to_owned())));
    }

    /// Takes out the line of a key.
    pub fn without(&mut self, key: &str) {
        let of_key = |line: &str| line.split_once('=').is_some_and(|(known, _)| known.trim() == key);
        self.all.retain(|(_, line)| !of_key(line));
    }

    /// The value of a key, as it is written.
    pub fn value(&self, key: &str) -> Option<&str> {
        let value = |line: &'_ str| -> bool { line.split_once('=').is_some_and(|(known, _)| known.trim() == key) };
        let (_, line) = self.all.iter().find(|(_, line)| value(line))?;
        let (_, value) = line.split_once('=')?;
        Some(value.split("  #").next()?.trim())
    }

    /// Whether there is no line.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// All of it.
    pub fn text(&self) -> String {
        self.all.iter().map(|(_, line)| format!("{line}\n")).collect()
    }
}

/// A text as TOML writes it.
pub fn quoted(text: &str) -> String {
    // JSON's escapes are among TOML's.
    serde_json::Value::from(text).to_string()
}

/// A list of texts.
pub fn list<'a>(texts: impl IntoIterator<Item = &'a String>) -> String {
    let texts: Vec<String> = texts.into_iter().map(|text| quoted(text)).collect();
    format!("[{}]", texts.join(", "))
}

/// A device of the predecessor's file, during its conversion.
#[derive(Debug, Clone)]
pub struct Block {
    /// Its kind.
    pub kind: Kind,
    /// Its name there, which may be no name here.
    pub old_name: String,
    /// Its name here.
    pub name: String,
    /// Line of the old file.
    pub line: usize,
    /// Alpaca server, `host:port`.
    pub server: String,
    /// Device number there.
    pub number: i64,
    /// The keys of its block.
    pub lines: TableLines,
    /// Lists of tables within its block (`limit`), as inline tables, each with its line of the old file.
    pub limits: Vec<(usize, String)>,
    /// Of a safety monitor: min.
    pub dwell_min: Option<f64>,
    /// Of a camera: old names of the devices that work with it, by kind.
    pub pairs: BTreeMap<Kind, String>,
    /// Of a dome: old names of the telescopes under it.
    pub telescopes: Vec<String>,
    /// Its keys for tables of the whole telescope, by their name.
    pub tables: BTreeMap<&'static str, TableLines>,
    /// Of a mount: the effect of its pulses on the stars of its camera.
    pub guide_start: Option<GuideStart>,
    /// Of a focuser: the focus in the old file, steps.
    pub focus_position: Option<i64>,
    /// Of a camera: defaults of its actions, by action.
    pub defaults: BTreeMap<String, serde_json::Map<String, serde_json::Value>>,
}

/// The effect of a mount's pulses, before it is written into the block of a camera.
#[derive(Debug, Clone)]
pub struct GuideStart {
    /// Line of the old file.
    pub line: usize,
    /// The inline table `guide_calibration`.
    pub text: String,
}

impl Block {
    /// The block without any key but those that every block has.
    pub fn head(&self) -> String {
        let (kind, name, server) = (self.kind.ascom().to_lowercase(), quoted(&self.name), quoted(&self.server));
        format!("\n[[{kind}]]\nname = {name}\nserver = {server}\nnumber = {}\n", self.number)
    }

    /// The block's text in a telescope's file, where `pairs` are the names to write for a camera.
    pub fn text(&self, pairs: &[(Kind, String)]) -> String {
        let mut lines = self.lines.clone();
        for (kind, name) in pairs {
            lines.key(&kind.ascom().to_lowercase(), quoted(name), "");
        }
        lines.maybe("dwell_min", self.dwell_min, "safe again only after so long without an unsafe reading");
        let limits = limits(self.limits.iter().map(|(_, limit)| limit));
        format!("{}{}{limits}", self.head(), lines.text())
    }

    /// Of a camera: its set point, degrees Celsius.
    pub fn temperature_c(&self) -> Option<f64> {
        self.lines.value("temperature_c")?.parse().ok()
    }

    /// The name of the device, for messages.
    pub fn place(&self) -> String {
        format!("{} {}", self.kind.ascom(), self.old_name)
    }
}

/// The key `limit`, where there is one.
pub fn limits<'a>(limits: impl Iterator<Item = &'a String>) -> String {
    let limits: Vec<&str> = limits.map(String::as_str).collect();
    if limits.is_empty() { String::new() } else { format!("limit = [\n    {},\n]\n", limits.join(",\n    ")) }
}

/// A name that devices may have here: letters, digits, `_`, `-` and `.`.
pub fn name(old: &str) -> String {
    let safe = |c: char| if c.is_ascii_alphanumeric() || "_-.".contains(c) { c } else { '_' };
    let name: String = old.trim().chars().map(safe).take(63).collect();
    if name.starts_with(|c: char| c.is_ascii_alphanumeric()) {
        name
    } else {
        format!("d{name}").chars().take(63).collect()
    }
}

/// A name that sites and telescopes may have here: small letters, digits and `-`.
pub fn chunk(old: &str) -> String {
    let safe = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    let chunk: String = old.trim().chars().map(safe).take(63).collect();
    let chunk = chunk.trim_matches('-');
    if chunk.is_empty() { "telescope".to_owned() } else { chunk.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_such_as_are_allowed() {
        assert_eq!(name("Cam 1 (north)"), "Cam_1__north_");
        assert_eq!(name("_x").parse::<contract::Name>().map(|name| name.to_string()), Ok("d_x".to_owned()));
        assert_eq!(chunk("SPECULOOS_South"), "speculoos-south");
        assert!(chunk("__").parse::<contract::Chunk>().is_ok() && name("").parse::<contract::Name>().is_ok());
    }
}
