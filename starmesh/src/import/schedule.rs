//! The predecessor's schedule: rows go to the telescope of their camera, comments with the row that they stand before.

use contract::{Kind, Name};
use schedule::action::ACTIONS;
use schedule::times;
use serde_json::{Map, Value};

use super::block::Block;
use super::entry::Notes;
use super::telescopes::File;

/// A row of the file, with the comments before it, as they were written.
#[derive(Debug, Clone, PartialEq)]
pub struct Piece {
    /// Line of its first character that is no comment.
    pub line: usize,
    /// `device_name`.
    pub camera: Option<String>,
    /// Comments and blank lines before it.
    pub before: String,
    /// The row itself.
    pub row: String,
    /// Why it is no JSON.
    pub broken: Option<String>,
}

impl Piece {
    /// The row, where it is JSON.
    pub fn value(&self) -> Option<Value> {
        serde_json::from_str(&without_comments(&self.row)).ok()
    }
}

/// A camera of a new file.
#[derive(Debug, Clone)]
pub struct Camera {
    /// Its name in the old rows.
    pub old: String,
    /// Its name here.
    pub new: Name,
    /// A filter wheel was paired with it.
    pub has_wheel: bool,
}

/// The cameras of a file.
pub fn cameras(file: &File) -> anyhow::Result<Vec<Camera>> {
    let wheels: Vec<&String> =
        file.blocks.iter().filter(|block| block.kind == Kind::FilterWheel).map(|block| &block.old_name).collect();
    let named: Vec<&String> = file.cameras().filter_map(|block| block.pairs.get(&Kind::FilterWheel)).collect();
    // The only wheel works with each camera of its telescope; where another camera names it, it is that one's.
    let is_anyones = matches!(wheels[..], [only] if !named.contains(&only));
    let camera = |block: &Block| {
        let own = block.pairs.get(&Kind::FilterWheel);
        let has_wheel = is_anyones || own.is_some_and(|wheel| wheels.contains(&wheel));
        Ok(Camera { old: block.old_name.clone(), new: block.name.parse()?, has_wheel })
    };
    file.cameras().map(camera).collect()
}

/// Why a schedule cannot be taken apart.
#[derive(Debug, thiserror::Error)]
#[error("line {line}: {what}")]
pub struct BadSchedule {
    line: usize,
    what: String,
}

/// As for a schedule of our own: more is none.
const MOST_BYTES: usize = 5_000_000;
const MOST_ROWS: usize = 10_000;

/// Takes a schedule apart; the last text is the text after the last row. Text that is no JSON costs only its own row.
///
/// # Errors
/// [`BadSchedule`] for a text that is larger than any schedule.
pub fn pieces(text: &str) -> Result<(Vec<Piece>, String), BadSchedule> {
    if text.len() > MOST_BYTES {
        let what = format!("{} bytes; a schedule has at most {MOST_BYTES}", text.len());
        return Err(BadSchedule { line: 1, what });
    }
    let masked = without_comments(text);
    let mut pieces: Vec<Piece> = Vec::new();
    let (mut from, mut lines) = (0, LineCounter { text: &masked, at: 0, line: 1 });
    // Each turn begins behind a row.
    loop {
        let rest = masked.get(from..).unwrap_or_default();
        let begins = from + (rest.len() - rest.trim_start().len());
        let line = lines.of(begins);
        let mut values = serde_json::Deserializer::from_str(rest).into_iter::<Value>();
        let (camera, to, broken) = match values.next() {
            None => return Ok((pieces, text.get(from..).unwrap_or_default().to_owned())),
            Some(Ok(value)) => {
                let camera = value.get("device_name").and_then(Value::as_str).map(str::to_owned);
                (camera, from + values.byte_offset(), None)
            }
            Some(Err(error)) => {
                let to = next_row(&masked, begins);
                let message = error.to_string();
                let message = message.split(" at line ").next().unwrap_or(&message);
                let at = lines.of(begins) + error.line().saturating_sub(1 + rest_lines(rest));
                let what = format!("no JSON: {message}, in line {at}");
                (camera_of(masked.get(begins..to).unwrap_or_default()), to, Some(what))
            }
        };
        if pieces.len() >= MOST_ROWS {
            return Err(BadSchedule { line, what: format!("more than {MOST_ROWS} rows") });
        }
        let cut = |from: usize, to: usize| text.get(from..to).unwrap_or_default().to_owned();
        pieces.push(Piece { line, camera, before: cut(from, begins), row: cut(begins, to), broken });
        from = to;
    }
}

/// Counts lines on its way through a text.
struct LineCounter<'a> {
    text: &'a str,
    at: usize,
    line: usize,
}

impl LineCounter<'_> {
    /// The line of a byte behind those that were asked for before, from 1.
    fn of(&mut self, at: usize) -> usize {
        self.line += self.text.get(self.at..at).unwrap_or_default().matches('\n').count();
        self.at = self.at.max(at);
        self.line
    }
}

/// Lines that end before the first character of a text that is no blank.
fn rest_lines(rest: &str) -> usize {
    let blank = rest.len() - rest.trim_start().len();
    rest.get(..blank).unwrap_or_default().matches('\n').count()
}

/// The place where the next line begins with a brace: reading continues there after a row that is no JSON.
fn next_row(text: &str, offset: usize) -> usize {
    let mut at = offset;
    for line in text.get(offset..).unwrap_or_default().split_inclusive('\n') {
        if at > offset && line.trim_start().starts_with('{') {
            return at;
        }
        at += line.len();
    }
    text.len()
}

/// The camera of a row that is no JSON, if that can still be seen.
fn camera_of(row: &str) -> Option<String> {
    let (_, rest) = row.split_once("\"device_name\"")?;
    let rest = rest.trim_start().strip_prefix(':')?.trim_start().strip_prefix('"')?;
    rest.split_once('"').map(|(name, _)| name.to_owned())
}

/// Comment lines as blanks, so that every other byte stays where it is.
fn without_comments(text: &str) -> String {
    let blank = |line: &str| -> String { line.bytes().map(|byte| if byte == b'\n' { '\n' } else { ' ' }).collect() };
    let line = |line: &str| if line.trim_start().starts_with("//") { blank(line) } else { line.to_owned() };
    text.split_inclusive('\n').map(line).collect()
}

/// The schedule of one telescope: the rows of its cameras. A row that is not taken is a comment in it, with the
/// reason, and is noted.
pub fn of_telescope(pieces: &[Piece], cameras: &[Camera], notes: &mut Notes) -> String {
    let names: Vec<Name> = cameras.iter().map(|camera| camera.new.clone()).collect();
    let mut text = String::new();
    for piece in pieces {
        let Some(camera) = cameras.iter().find(|camera| Some(&camera.old) == piece.camera.as_ref()) else { continue };
        text += piece.before.trim_start_matches(['\n', '\r', ' ']);
        let old = &camera.old;
        if let Some(why) = &piece.broken {
            notes.add(piece.line, format!("row for {old}: {why}; left out"));
            text += &format!("// not taken over: {why}\n{}\n", commented(piece.row.trim_end()));
            continue;
        }
        let row = if *old == camera.new.as_str() { piece.row.clone() } else { renamed(&piece.row, old, &camera.new) };
        let row = match as_it_was_applied(&row, camera) {
            Some((applied, changes)) => {
                let what = changes.join("; ");
                notes.add(piece.line, format!("row for {old}: {what}"));
                text += &format!("// {what}; as it was:\n{}\n", commented(&row));
                applied
            }
            None => row,
        };
        match schedule::parse(&row, &names) {
            Ok(_) => text += &row,
            Err(fault) => {
                notes.add(piece.line, format!("row for {old}: {}; left out", fault.words()));
                text += &format!("// not taken over: {}\n", fault.words().replace('\n', " "));
                text += &commented(&row);
            }
        }
        text.push('\n');
    }
    text
}

/// Rows of no camera of the configuration, as comments; each is noted.
pub fn strays(pieces: &[Piece], known: &[String], notes: &mut Notes) -> String {
    let mut text = String::new();
    for piece in pieces.iter().filter(|piece| !piece.camera.as_ref().is_some_and(|camera| known.contains(camera))) {
        let why = match (&piece.broken, &piece.camera) {
            (Some(why), _) => why.clone(),
            (None, Some(camera)) => format!("a row for {camera}, which is no camera that was carried over"),
            (None, None) => "a row without device_name".to_owned(),
        };
        notes.add(piece.line, format!("{why}; left out"));
        text += &format!("// not taken over: {why}\n{}\n", commented(piece.row.trim_end()));
    }
    text
}

/// A row as comment lines.
fn commented(row: &str) -> String {
    row.lines().map(|line| format!("// {line}")).collect::<Vec<_>>().join("\n")
}

/// Top-level fields that the predecessor reads.
const FIELDS: [&str; 5] = ["device_name", "action_type", "action_value", "start_time", "end_time"];
/// Those of its own output, which are passed over here as there.
const PASSED_OVER: [&str; 2] = ["completed", "status"];

/// The row as the predecessor took it, where that differs from the text, and each change in words: what it passes over
/// (fields that it does not know, `null`, a number of frames below 0, which is one without end, the filter of a camera
/// without wheel), and times in the many ways that it reads. Here all of it would refuse the row.
fn as_it_was_applied(row: &str, camera: &Camera) -> Option<(String, Vec<String>)> {
    let Ok(Value::Object(mut fields)) = serde_json::from_str::<Value>(&without_comments(row)) else { return None };
    let action = fields.get("action_type").and_then(Value::as_str)?.to_owned();
    let entry = ACTIONS.iter().find(|entry| entry.name == action)?;
    let known: Vec<String> = entry.parameters().into_iter().map(|parameter| parameter.name).collect();
    let is_known = |key: &String| FIELDS.contains(&key.as_str()) || PASSED_OVER.contains(&key.as_str());
    let mut dropped = take(&mut fields, |key, _| !is_known(key));
    let mut changes = Vec::new();
    if let Some(Value::Object(values)) = fields.get_mut("action_value") {
        let endless = |value: &Value| action == "object" && value.as_f64().is_some_and(|count| count < 0.0);
        dropped.extend(take(values, |key, value| !known.contains(key) || (key == "n" && endless(value))));
        // A folder of the whole machine becomes one inside that of the images.
        if let Some(Value::String(dir)) = values.get("dir")
            && let Some(inside) = inside(dir)
        {
            changes.push(format!("dir {dir:?} is the folder {inside:?} inside that of the images"));
            values.insert("dir".to_owned(), inside.into());
        }
        let empty = take(values, |_, value| value.is_null());
        if !empty.is_empty() {
            changes.push(format!("{} = null is what it is without a word", empty.join(", ")));
        }
        if !camera.has_wheel && !take(values, |key, _| key == "filter").is_empty() {
            changes.push("without \"filter\", as its camera has no filter wheel".to_owned());
            // The frames of all filters are of one sort then.
            let all: Option<u64> = values
                .get("n")
                .and_then(Value::as_array)
                .filter(|_| action == "flats")
                .and_then(|n| n.iter().map(Value::as_u64).sum());
            if let Some(all) = all {
                values.insert("n".to_owned(), serde_json::json!([all]));
            }
        }
    }
    if !dropped.is_empty() {
        changes.insert(0, format!("without {}, which Astra passed over too", dropped.join(", ")));
    }
    for key in ["start_time", "end_time"] {
        let Some(Value::String(written)) = fields.get(key) else { continue };
        let Some(read) = times::read(written).filter(|_| written.parse::<units::Utc>().is_err()) else { continue };
        let order = if read.is_ambiguous { " (the month first, as Astra reads it: is that meant?)" } else { "" };
        changes.push(format!("{key} {written:?} is {}{order}", read.utc));
        fields.insert(key.to_owned(), read.utc.to_string().into());
    }
    (!changes.is_empty()).then(|| (Value::Object(fields).to_string(), changes))
}

/// An absolute folder, as one below another; `None` where it is not absolute.
fn inside(dir: &str) -> Option<String> {
    let drive = |dir: &str| dir.get(1..3).is_some_and(|rest| rest == ":/" || rest == ":\\");
    if !dir.starts_with(['/', '\\', '~']) && !drive(dir) {
        return None;
    }
    let parts: Vec<&str> =
        dir.split(['/', '\\']).filter(|part| !part.is_empty() && !matches!(*part, "." | "..")).collect();
    Some(parts.join("/").replace([':', '~'], "").trim_start_matches('/').to_owned())
}

/// Takes out what `is_out`; returns the names, in quotes.
fn take(map: &mut Map<String, Value>, is_out: impl Fn(&String, &Value) -> bool) -> Vec<String> {
    let names: Vec<String> = map.iter().filter(|(key, value)| is_out(key, value)).map(|(key, _)| key.clone()).collect();
    names.iter().for_each(|name| drop(map.remove(name)));
    names.iter().map(|name| Value::from(name.as_str()).to_string()).collect()
}

/// The row with its camera's new name.
fn renamed(row: &str, old: &str, new: &Name) -> String {
    let Some(key) = row.find("\"device_name\"") else { return row.to_owned() };
    let (head, tail) = row.split_at(key);
    let quoted = Value::from(old).to_string();
    format!("{head}{}", tail.replacen(&quoted, &Value::from(new.as_str()).to_string(), 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROW: &str =
        r#""action_type": "close", "start_time": "2026-01-01T05:00:00", "end_time": "2026-01-01T06:00:00""#;

    #[test]
    fn rows_go_with_their_comments_to_the_telescope_of_their_camera() {
        let text = format!(
            "// night of a\n{{\"device_name\": \"a cam\",\n// inside\n{ROW}, \"action_value\": {{}}}}\n// of b\n\
             {{\"device_name\": \"b\", \"action_type\": \"calibration\", \"action_value\": {{\"exptime\": 5}}}}\n// end\n"
        );
        let (pieces, rest) = pieces(&text).unwrap();
        assert_eq!((pieces.len(), pieces[1].line, rest.trim()), (2, 6, "// end"));
        let mut notes = Notes::default();
        let a = of_telescope(&pieces, &[camera("a cam", "a_cam")], &mut notes);
        assert!(a.starts_with("// night of a\n{\"device_name\": \"a_cam\",\n// inside\n"), "{a}");
        assert!(notes.lines.is_empty(), "{notes:?}");
        let b = of_telescope(&pieces, &[camera("b", "b")], &mut notes);
        assert!(b.starts_with("// of b\n// not taken over: ") && b.lines().all(|line| line.starts_with("//")), "{b}");
        assert_eq!(notes.lines[0].0, 6);
        assert!(notes.lines[0].1.contains("exptime"), "{notes:?}");
    }

    #[test]
    fn what_the_predecessor_passed_over_does_not_cost_the_row() {
        let window = r#""start_time": "2026-01-01 01:00:00.5", "end_time": "2026-01-01T06:00:00+01:00""#;
        let text = format!(
            "{{\"device_name\": \"c\", \"action_type\": \"object\", \"execute_parallel\": true, {window}, \"status\": \"pending\",\n\
             // why\n\"action_value\": {{\"object\": \"M 31\", \"ra\": 10.7, \"dec\": 41.3, \"exptime\": 30, \"n\": -1, \"guidng\": true}}}}\n"
        );
        let cameras = [camera("c", "c")];
        let mut notes = Notes::default();
        let new = of_telescope(&pieces(&text).unwrap().0, &cameras, &mut notes);
        let rows = ::schedule::parse(&new, &[cameras[0].new.clone()]).unwrap();
        assert_eq!((rows.len(), rows[0].action.name()), (1, "object"), "{new}");
        for key in ["\"execute_parallel\"", "\"n\"", "\"guidng\""] {
            assert!(
                notes.lines[0].1.contains(key) && new.lines().next().unwrap().contains(key),
                "{key}: {notes:?} {new}"
            );
        }
        assert!(new.contains("// // why"), "nothing that people wrote is lost: {new}");
        assert!(!new.lines().last().unwrap().contains("guidng"), "{new}");
    }

    #[test]
    fn a_row_that_is_no_json_costs_only_itself() {
        let good = format!("{{\"device_name\": \"c\", {ROW}, \"action_value\": {{}}}}\n");
        let bad = format!("{{\"device_name\": \"c\",\n {ROW} \"action_value\": {{}}}}\n");
        let text = format!("// c\n{good}// why\n{bad}{good}[{good}]\n{{\"device_name\": \"d\", {ROW}}}\n// end\n");
        let (pieces, rest) = pieces(&text).unwrap();
        assert_eq!(rest.trim(), "// end");
        let mut notes = Notes::default();
        let new = of_telescope(&pieces, &[camera("c", "c")], &mut notes);
        assert_eq!(schedule::parse(&new, &["c".parse().unwrap()]).unwrap().len(), 2, "{new}");
        assert_eq!(notes.lines.len(), 1, "{notes:?}");
        assert!(notes.lines[0].0 == 4 && notes.lines[0].1.contains("in line 5"), "{notes:?}");
        assert!(new.contains("// why\n// not taken over: no JSON"), "{new}");
        let mut stray_notes = Notes::default();
        let strays = strays(&pieces, &["c".to_owned()], &mut stray_notes);
        assert!(strays.lines().all(|line| line.starts_with("//")), "{strays}");
        let lines: Vec<usize> = stray_notes.lines.iter().map(|(line, _)| *line).collect();
        assert_eq!(lines, [7, 9], "{stray_notes:?}");
    }

    #[test]
    fn an_absolute_folder_becomes_one_inside_that_of_the_images() {
        for (old, new) in [
            ("/data/x", Some("data/x")),
            ("C:\\a\\..\\b", Some("C/a/b")),
            ("~/n", Some("n")),
            ("x/y", None),
            ("", None),
        ] {
            assert_eq!(inside(old).as_deref(), new, "{old}");
        }
    }

    #[test]
    fn what_the_predecessor_took_is_taken_in_the_way_it_took_it() {
        let text = "{\"device_name\": \"c\", \"action_type\": \"object\", \"start_time\": \"2026-11-23 01:00:00 UTC\", \"end_time\": \"23.11.2026 03:00\", \
                    \"action_value\": {\"object\": \"x\", \"exptime\": 5, \"ra\": 1, \"dec\": 2, \"guiding\": null, \"filter\": \"V\"}}\n";
        let (pieces, _) = pieces(text).unwrap();
        for has_wheel in [true, false] {
            let camera = Camera { has_wheel, ..camera("c", "c") };
            let mut notes = Notes::default();
            let new = of_telescope(&pieces, std::slice::from_ref(&camera), &mut notes);
            let rows = ::schedule::parse(&new, &[camera.new]).unwrap();
            assert_eq!(rows[0].end.seconds_since(rows[0].start), 7200.0, "{new}");
            assert_eq!(rows[0].action.filters().is_empty(), !has_wheel, "{new}");
            let note = &notes.lines[0].1;
            for word in ["\"guiding\" = null", "start_time", "23.11.2026 03:00"] {
                assert!(note.contains(word), "{word}: {note}");
            }
        }
    }

    fn camera(old: &str, new: &str) -> Camera {
        Camera { old: old.to_owned(), new: new.parse().unwrap(), has_wheel: true }
    }
}
