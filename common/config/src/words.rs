//! What the reader of TOML complains of, in the words of the field.

use toml::de::{DeString, DeValue};

use crate::document::Step;

/// A complaint of the reader, understood.
#[derive(Debug, PartialEq, Eq)]
pub enum Complaint<'a> {
    /// A table has a key that it cannot have.
    UnknownKey {
        /// The key.
        key: &'a str,
        /// Those that it can have.
        known: Vec<&'a str>,
    },
    /// A table lacks a key.
    MissingKey(&'a str),
    /// A table stands where a list of them was expected, or a value where a list was.
    List,
    /// A list stands where one table was expected.
    OneTable,
    /// A value is not what was expected.
    Value(Expected<'a>),
}

/// What a value should have been.
#[derive(Debug, PartialEq, Eq)]
pub enum Expected<'a> {
    /// Something else: a sort of value, in the reader's words.
    Sort(&'a str),
    /// One of these texts.
    OneOf(Vec<&'a str>),
    /// So many numbers, not others.
    Length,
    /// In words that are ready.
    Stated(&'a str),
}

/// How a message about a line that is no TOML begins.
pub const TORN: &str = "this line cannot be read";

/// A fault of the notation.
pub fn syntax(message: &str, line: &str) -> String {
    let line: String = line.chars().take(60).collect();
    let key_alone = line.split_once('=').is_some_and(|(_, value)| value.trim().is_empty());
    let help = if message.contains("carriage return") {
        let first = line.split('\r').next().unwrap_or_default();
        return format!(
            "{TORN}: {first:?}: lines end in CR alone here, which many programs cannot read; save the file with LF"
        );
    } else if key_alone {
        "give the key a value after the \"=\"".to_owned()
    } else if let Some(kind) = one_bracket(&line).filter(|_| message.contains("duplicate key")) {
        return format!(
            "{TORN}: {line:?}: [{kind}] is written [[{kind}]], with two brackets, since there may be several"
        );
    } else if message.contains("duplicate key") {
        return format!("{TORN}: {line:?} stands in this block for the second time; keep one of the two");
    } else if line.contains('\u{201c}') || line.contains('\u{201d}') || line.contains('\u{2019}') {
        "use straight quotes: \"...\"".to_owned()
    } else if !line.contains('=') && !line.starts_with('[') {
        "expected key = value, such as latitude_deg = -24.6, or a block such as [[camera]]".to_owned()
    } else if line.starts_with('[') && !line.contains('=') && line.matches('[').count() != line.matches(']').count() {
        "expected a block such as [observatory] or [[camera]]: as many brackets before as after its name".to_owned()
    } else if line.matches('"').count() % 2 == 1 {
        "a text begins and ends with \": one of the two is missing".to_owned()
    } else if line.split_once('=').is_some_and(|(_, value)| value.contains(',') && !value.contains(['[', '{', '"'])) {
        "write decimals with a point, and lists in square brackets".to_owned()
    } else if line.split_once('=').is_some_and(|(_, value)| {
        !value.trim().starts_with(['"', '[', '{', '\'']) && value.contains(|c: char| c.is_alphabetic())
    }) {
        "texts stand in quotes: key = \"text\"".to_owned()
    } else {
        format!("{}; expected key = value, with texts in quotes", plain(message))
    };
    format!("{TORN}: {line:?}: {help}")
}

/// The kind of device whose block stands in one pair of brackets.
fn one_bracket(line: &str) -> Option<&str> {
    let kind = line.strip_prefix('[')?.strip_suffix(']')?.trim();
    is_list_of_blocks(kind).then_some(kind)
}

/// The parser's own words, without code.
fn plain(message: &str) -> String {
    if message.contains("recurse") {
        return "brackets stand in one another too often here".to_owned();
    }
    message.replace('`', "\"").replace("\"\"\"", "\"")
}

/// Understands a message.
pub fn complaint(message: &str) -> Complaint<'_> {
    if let Some(rest) = message.strip_prefix("unknown field ") {
        let mut names = ticked(rest);
        let key = if names.is_empty() { "" } else { names.remove(0) };
        return Complaint::UnknownKey { key, known: names };
    }
    if let Some(rest) = message.strip_prefix("missing field ") {
        return Complaint::MissingKey(ticked(rest).first().copied().unwrap_or_default());
    }
    if let Some(rest) = message.strip_prefix("unknown variant ") {
        let mut names = ticked(rest);
        if !names.is_empty() {
            names.remove(0);
        }
        return Complaint::Value(Expected::OneOf(names));
    }
    if message.starts_with("invalid length") {
        return Complaint::Value(Expected::Length);
    }
    let kind = message.strip_prefix("invalid type: ").or_else(|| message.strip_prefix("invalid value: "));
    if let Some((found, expected)) = kind.and_then(|rest| rest.rsplit_once(", expected ")) {
        return match (found, expected) {
            (_, "a sequence") => Complaint::List,
            ("sequence", expected) if expected.starts_with("struct") => Complaint::OneTable,
            _ => Complaint::Value(Expected::Sort(expected)),
        };
    }
    Complaint::Value(Expected::Stated(message))
}

/// The names in back ticks.
fn ticked(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

/// What a value should have been, and how to mend it.
pub fn expected(expected: &Expected<'_>, steps: &[Step], quoted: &str) -> String {
    let key = steps.iter().rev().find_map(|step| if let Step::Key(key) = step { Some(key.as_str()) } else { None });
    let bare = quoted.trim_matches(['"', '\'']);
    let is_quoted = bare.len() < quoted.len();
    match expected {
        Expected::OneOf(words) => {
            let list: Vec<String> = words.iter().map(|word| format!("\"{word}\"")).collect();
            let near = crate::nearest::nearest(bare, words.iter().copied());
            let near = near.filter(|_| list.len() > 2).map(|near| format!("; did you mean \"{near}\"?"));
            format!("expected {}{}", list.join(" or "), near.unwrap_or_default())
        }
        Expected::Length => "expected two numbers in square brackets, such as [120, 25.5]".to_owned(),
        Expected::Sort(sort) => {
            let what = sort_in_words(sort);
            let is_number = matches!(what, Sort::Number | Sort::Whole(..));
            let mut text = format!("expected {}", what.in_words());
            if let Some(about) = hint(steps) {
                text.push_str(&format!(": {about}"));
            }
            if is_quoted && is_number && bare.trim().parse::<f64>().is_ok() {
                text.push_str(&format!("; leave the quotes away: {}", bare.trim()));
            } else if is_quoted && is_number && bare.replace(',', ".").parse::<f64>().is_ok() {
                text.push_str("; write decimals with a point, and without quotes");
            } else if is_quoted && is_number && sexagesimal(bare).is_some() {
                let degrees = sexagesimal(bare).unwrap_or_default();
                let is_hours = bare.contains('h') && key.is_some_and(|key| key.ends_with("_deg"));
                let degrees = if is_hours { 15.0 * degrees } else { degrees };
                text.push_str(&format!("; as a decimal number that is {degrees:.5}"));
            } else if is_quoted && is_number {
                text.push_str("; only the number, without its unit");
            } else if is_quoted && what == Sort::Truth && matches!(bare, "true" | "false") {
                text.push_str(&format!("; leave the quotes away: {bare}"));
            } else if what == Sort::Text && !quoted.is_empty() && !quoted.starts_with(['[', '{']) {
                text.push_str(&format!("; put it in quotes: \"{bare}\""));
            }
            text
        }
        Expected::Stated(message) => with_key(message, key.unwrap_or_default()),
    }
}

/// Messages of our own types are ready; those of foreign ones are not.
fn with_key(message: &str, key: &str) -> String {
    if message.contains("socket address") {
        return format!(
            "expected an address and a port from 0 to 65535, such as {}",
            if key == "listen" { "\"127.0.0.1:8080\"; an address is needed, not a name" } else { "\"10.0.0.5:11111\"" }
        );
    }
    if message.contains("overflow") {
        return "expected a number that is not as large as this".to_owned();
    }
    if message.contains("wanted string or table") {
        return "expected one of its words, in quotes".to_owned();
    }
    if message.contains("wanted exactly 1 element") {
        return "expected a word in quotes, not a table".to_owned();
    }
    // "x" is no name: expected ...
    match message.split_once(": expected ") {
        Some((_, expected)) => format!("expected {expected}"),
        None => plain(message),
    }
}

/// A sort of value.
#[derive(Debug, PartialEq, Eq)]
enum Sort {
    Number,
    Whole(u64, bool),
    Truth,
    Text,
    Pair,
    Table,
    List,
    Other(String),
}

impl Sort {
    fn in_words(&self) -> String {
        match self {
            Self::Number => "a number".to_owned(),
            Self::Whole(most, negative) => match (most, negative) {
                (0, true) => "a whole number".to_owned(),
                (0, false) => "a whole number of 0 or more".to_owned(),
                (most, _) => format!("a whole number from 0 to {most}"),
            },
            Self::Truth => "true or false".to_owned(),
            Self::Text => "a text in quotes".to_owned(),
            Self::Pair => "two numbers in square brackets, such as [120, 25.5]".to_owned(),
            Self::Table => "keys of its own, such as { key = value }".to_owned(),
            Self::List => "a list in square brackets".to_owned(),
            Self::Other(words) => words.clone(),
        }
    }
}

fn sort_in_words(sort: &str) -> Sort {
    match sort {
        "f64" | "f32" => Sort::Number,
        "u8" => Sort::Whole(u8::MAX.into(), false),
        "u16" => Sort::Whole(u16::MAX.into(), false),
        "u32" | "u64" | "usize" => Sort::Whole(0, false),
        "i64" | "i32" => Sort::Whole(0, true),
        "a boolean" | "bool" => Sort::Truth,
        "a string" | "string" | "path string" | "a borrowed string" | "socket address" | "an IP address" => Sort::Text,
        "a map" => Sort::Table,
        "a sequence" => Sort::List,
        words if words.starts_with("an array of length 2") => Sort::Pair,
        words if words.starts_with("struct") || words.starts_with("a table") => Sort::Table,
        words if words.starts_with("enum") || words.contains("variant") => Sort::Text,
        words => Sort::Other(words.to_owned()),
    }
}

/// `-24:37:38.6` or `-24 37 38.6`, degrees.
pub fn sexagesimal(text: &str) -> Option<f64> {
    let plain = text.trim().replace(['d', 'h', 'm', 's', '\u{b0}', '\'', '"', ':'], " ");
    let parts: Vec<f64> = plain.split_whitespace().map(str::parse).collect::<Result<_, _>>().ok()?;
    let ([degrees, minutes] | [degrees, minutes, _]) = parts[..] else { return None };
    let seconds = parts.get(2).copied().unwrap_or(0.0);
    let fits = [minutes, seconds].iter().all(|part| (0.0..60.0).contains(part));
    let size = degrees.abs() + minutes / 60.0 + seconds / 3600.0;
    fits.then_some(if plain.trim_start().starts_with('-') { -size } else { size })
}

/// What a key holds, with an example; for keys that a file cannot do without.
fn hint(steps: &[Step]) -> Option<&'static str> {
    let key = steps.iter().rev().find_map(|step| if let Step::Key(key) = step { Some(key.as_str()) } else { None })?;
    // a camera names its devices by the kind
    if is_list_of_blocks(key) && matches!(steps, [Step::Key(camera), ..] if camera == "camera") {
        return Some("the name of its block in this file");
    }
    Some(match key {
        "site" => "the site's id, such as \"paranal\"",
        "telescope" => "the telescope's id, such as \"callisto\"",
        "latitude_deg" => "degrees, north positive, such as -24.6157",
        "longitude_deg" => "degrees, east positive, such as -70.3976",
        "elevation_m" => "metres above the sea, such as 2518",
        "name" => "a name that no other device of this kind has, such as \"main\"",
        "server" => "the Alpaca server as host:port, such as \"10.0.0.5:11111\"",
        "number" => "the device number on its Alpaca server, such as 0",
        "parameter" => "what is limited, such as \"Humidity\"",
        "upper" | "lower" => "in the unit of the parameter, such as 80 for a humidity in percent",
        "url" => "an address such as \"https://example.org/hook\"",
        "from" => "the sender, such as \"callisto@example.org\"",
        "to" => "addresses, such as [\"astronomer@example.org\"]",
        "port" => "the port of the server, such as 587",
        "above_mps" => "m/s, such as 10",
        "half_width_deg" => "degrees, such as 60",
        "east_px_per_s" | "north_px_per_s" => "px/s in x and y, such as [14.0, 0.5]",
        _ => return None,
    })
}

/// What belongs at a path.
pub fn about(steps: &[Step]) -> String {
    let key = steps.iter().rev().find_map(|step| if let Step::Key(key) = step { Some(key.as_str()) } else { None });
    match (key, steps) {
        (Some("observatory"), [_]) => {
            "a block [observatory] with site, telescope, latitude_deg, longitude_deg and elevation_m".to_owned()
        }
        (Some("server"), [Step::Key(alerts), ..]) if alerts == "alerts" => {
            "the mail server's name, such as \"mail.example.org\"".to_owned()
        }
        (Some("name"), [Step::Key(alerts), ..]) if alerts == "alerts" => {
            "how the receiver is called in messages, such as \"chat\"".to_owned()
        }
        (Some("p" | "i" | "d"), _) => "a number: all three of p, i and d".to_owned(),
        (Some(_), _) => hint(steps).map_or_else(|| "a value".to_owned(), str::to_owned),
        (None, _) => "a value".to_owned(),
    }
}

/// Is this a key for blocks in double brackets?
pub fn is_list_of_blocks(key: &str) -> bool {
    key == "delivery" || contract::Kind::ALL.iter().any(|kind| kind.to_string() == key)
}

/// Is this a key of one table, such as `limits` or `[safety]`?
pub fn is_one_table(steps: &[Step]) -> bool {
    const TABLES: [&str; 12] = [
        "limits",
        "slit",
        "flats",
        "guide_calibration",
        "wind_sector",
        "check",
        "smtp",
        "ping",
        "pid_ra",
        "pid_dec",
        "policy",
        "filename",
    ];
    const SECTIONS: [&str; 18] = [
        "observatory",
        "folders",
        "bus",
        "clock",
        "safety",
        "faults",
        "guiding",
        "imaging",
        "names",
        "pointing",
        "focusing",
        "hooks",
        "schedule",
        "spool",
        "archive",
        "alerts",
        "web",
        "shared",
    ];
    match steps {
        [Step::Key(key)] => SECTIONS.contains(&key.as_str()),
        [.., Step::Key(key)] => TABLES.contains(&key.as_str()),
        _ => false,
    }
}

/// Is this an element of a list of tables?
pub fn is_list_of_tables(steps: &[Step]) -> bool {
    match steps {
        [Step::Key(key), Step::Index(_)] => is_list_of_blocks(key),
        [.., Step::Key(key), Step::Index(_)] => matches!(key.as_str(), "limit" | "webhook" | "email" | "webcam"),
        _ => false,
    }
}

/// A value that lets the reading go on where one is missing.
pub fn stand_in(key: &str, number: usize) -> Option<DeValue<'static>> {
    let text = |text: String| Some(DeValue::String(DeString::Owned(text)));
    match key {
        "site" | "telescope" => text("stand-in".to_owned()),
        "name" => text(format!("stand-in-{number}")),
        "server" => text(format!("stand-in-{number}:1")),
        "parameter" => text("Humidity".to_owned()),
        "url" => text("http://stand-in".to_owned()),
        "from" => text("stand-in@localhost".to_owned()),
        "latitude_deg" | "longitude_deg" | "elevation_m" | "above_mps" | "half_width_deg" => {
            Some(DeValue::Integer(Default::default()))
        }
        "observatory" => Some(DeValue::Table(Default::default())),
        _ => None,
    }
}

/// Keys that people look for in the wrong block.
pub fn belongs_to(key: &str, table: &[Step]) -> Option<String> {
    let here = match table {
        [Step::Key(block), ..] => block.as_str(),
        _ => "",
    };
    let (right, example): (&str, &str) = match key {
        "site" | "latitude_deg" | "longitude_deg" | "elevation_m" => ("observatory", "[observatory]"),
        "temperature_c" | "scale_arcsec_px" | "guide_calibration" | "flats" | "read_noise_e" | "electrons_per_adu"
        | "saturation_adu" => ("camera", "[[camera]]"),
        "permit_valid_s" | "close_with_mount" | "watchdog_s" | "follow" | "slit" => ("dome", "[[dome]]"),
        "limits" | "horizon" | "meridian_flip" | "equatorial_system" | "slew_timeout_s" => {
            ("telescope", "[[telescope]]")
        }
        "backlash_steps" | "best_position" | "search_steps" => ("focuser", "[[focuser]]"),
        "filters" => ("filterwheel", "[[filterwheel]]"),
        "sun_altitude_max_deg" | "wind_sector" => ("safety", "[safety]"),
        "fits_header" | "database" | "filename" | "raw_days" | "backups" | "parquet" => ("archive", "[archive]"),
        "remove_delivered_after_days" | "disk_warn_gb" | "compress" | "profile" => ("archive", "[archive]"),
        "robotic" => ("schedule", "[schedule]"),
        "multicast" => ("bus", "[bus]"),
        _ => return None,
    };
    (here != right).then(|| format!("it belongs to {example}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_reader_writes_is_understood() {
        assert_eq!(
            complaint("unknown field `perod`, expected one of `name`, `period_s`"),
            Complaint::UnknownKey { key: "perod", known: vec!["name", "period_s"] }
        );
        assert_eq!(complaint("missing field `site`"), Complaint::MissingKey("site"));
        let number = complaint("invalid type: string \"a, expected b\", expected f64");
        assert_eq!(number, Complaint::Value(Expected::Sort("f64")));
        assert_eq!(complaint("invalid type: map, expected a sequence"), Complaint::List);
        assert_eq!(complaint("invalid type: sequence, expected struct Place"), Complaint::OneTable);
    }

    #[test]
    fn angles_of_three_parts_are_read() {
        assert!((sexagesimal("-24:37:38.6").unwrap() + 24.627_388).abs() < 1e-5);
        assert_eq!(sexagesimal("-0 30"), Some(-0.5));
        assert_eq!(sexagesimal("24.6"), None);
        assert_eq!(sexagesimal("24:61:00"), None);
    }
}
