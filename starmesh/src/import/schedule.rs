//! The predecessor's schedule: rows go to the telescope of their camera, comments with the row that they stand before.

use contract::Name;
use node_observatory::action::ACTIONS;
use serde_json::Value;

use super::entry::Notes;

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

/// Takes a schedule apart; the last text is what follows the last row.
///
/// # Errors
/// [`BadSchedule`] at the first value that is no JSON, and for a text that is larger than any schedule.
pub fn pieces(text: &str) -> Result<(Vec<Piece>, String), BadSchedule> {
    if text.len() > MOST_BYTES {
        let what = format!("{} bytes; a schedule has at most {MOST_BYTES}", text.len());
        return Err(BadSchedule { line: 1, what });
    }
    let masked = without_comments(text);
    let mut values = serde_json::Deserializer::from_str(&masked).into_iter::<Value>();
    let mut pieces = Vec::new();
    loop {
        let from = values.byte_offset();
        let rest = masked.get(from..).unwrap_or_default();
        let begins = from + (rest.len() - rest.trim_start().len());
        let line = masked.get(..begins).unwrap_or_default().matches('\n').count() + 1;
        let value = match values.next() {
            None => return Ok((pieces, text.get(from..).unwrap_or_default().to_owned())),
            Some(value) => {
                value.map_err(|error| BadSchedule { line: error.line().max(line), what: error.to_string() })?
            }
        };
        if pieces.len() >= MOST_ROWS {
            return Err(BadSchedule { line, what: format!("more than {MOST_ROWS} rows") });
        }
        let camera = value.get("device_name").and_then(Value::as_str).map(str::to_owned);
        let cut = |from: usize, to: usize| text.get(from..to).unwrap_or_default().to_owned();
        pieces.push(Piece { line, camera, before: cut(from, begins), row: cut(begins, values.byte_offset()) });
    }
}

/// Comment lines as blanks, so that every other byte stays where it is.
fn without_comments(text: &str) -> String {
    let blank = |line: &str| -> String { line.bytes().map(|byte| if byte == b'\n' { '\n' } else { ' ' }).collect() };
    let line = |line: &str| if line.trim_start().starts_with("//") { blank(line) } else { line.to_owned() };
    text.split_inclusive('\n').map(line).collect()
}

/// The schedule of one telescope: the rows of its cameras (old name and new). A row that is not taken here stands in it
/// as comment, with the reason, and is noted.
pub fn of_telescope(pieces: &[Piece], cameras: &[(String, Name)], notes: &mut Notes) -> String {
    let names: Vec<Name> = cameras.iter().map(|(_, name)| name.clone()).collect();
    let mut text = String::new();
    for piece in pieces {
        let Some((old, new)) = cameras.iter().find(|(old, _)| Some(old) == piece.camera.as_ref()) else { continue };
        text += piece.before.trim_start_matches(['\n', '\r', ' ']);
        let row = match old == new.as_str() {
            true => piece.row.clone(),
            false => renamed(&piece.row, old, new),
        };
        let row = match as_it_was_heeded(&row) {
            Some((heeded, dropped)) => {
                let what = format!("without {}, which Astra passed over too", dropped.join(", "));
                notes.add(piece.line, format!("row for {old}: {what}"));
                text += &format!("// {what}; as it was:\n{}\n", commented(&row));
                heeded
            }
            None => row,
        };
        match node_observatory::schedule::parse(&row, &names) {
            Ok(_) => text += &row,
            Err(fault) => {
                notes.add(piece.line, format!("row for {old}: {}", fault.words()));
                text += &format!("// not taken over: {}\n", fault.words().replace('\n', " "));
                text += &commented(&row);
            }
        }
        text.push('\n');
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

/// The row as the predecessor took it, where that is less than what is written, and what it passed over: fields that it
/// does not know, and a number of frames below 0, which is one without end. Here both would refuse the row.
fn as_it_was_heeded(row: &str) -> Option<(String, Vec<String>)> {
    let Ok(Value::Object(mut fields)) = serde_json::from_str::<Value>(&without_comments(row)) else { return None };
    let action = fields.get("action_type").and_then(Value::as_str)?.to_owned();
    let entry = ACTIONS.iter().find(|entry| entry.name == action)?;
    let known: Vec<String> = entry.parameters().into_iter().map(|parameter| parameter.name).collect();
    let mut dropped: Vec<String> = fields
        .keys()
        .filter(|key| !FIELDS.contains(&key.as_str()) && !PASSED_OVER.contains(&key.as_str()))
        .cloned()
        .collect();
    dropped.iter().for_each(|key| drop(fields.remove(key)));
    if let Some(Value::Object(values)) = fields.get_mut("action_value") {
        let endless = |value: &Value| action == "object" && value.as_f64().is_some_and(|count| count < 0.0);
        let is_dropped = |key: &String, value: &Value| !known.contains(key) || (key == "n" && endless(value));
        let strangers: Vec<String> =
            values.iter().filter(|(key, value)| is_dropped(key, value)).map(|(key, _)| key.clone()).collect();
        strangers.iter().for_each(|key| drop(values.remove(key)));
        dropped.extend(strangers);
    }
    let quoted = dropped.iter().map(|key| Value::from(key.as_str()).to_string()).collect();
    (!dropped.is_empty()).then(|| (Value::Object(fields).to_string(), quoted))
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
        let a = of_telescope(&pieces, &[("a cam".to_owned(), "a_cam".parse().unwrap())], &mut notes);
        assert!(a.starts_with("// night of a\n{\"device_name\": \"a_cam\",\n// inside\n"), "{a}");
        assert!(notes.lines.is_empty(), "{notes:?}");
        let b = of_telescope(&pieces, &[("b".to_owned(), "b".parse().unwrap())], &mut notes);
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
        let cameras: [(String, Name); 1] = [("c".to_owned(), "c".parse().unwrap())];
        let mut notes = Notes::default();
        let new = of_telescope(&pieces(&text).unwrap().0, &cameras, &mut notes);
        let rows = node_observatory::schedule::parse(&new, &[cameras[0].1.clone()]).unwrap();
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
    fn what_is_no_json_is_told_with_its_line() {
        let error = pieces("// c\n{\"a\": 1}\n{\"b\": }\n").unwrap_err();
        assert_eq!(error.line, 3);
    }
}
