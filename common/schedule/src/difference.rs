//! What changes where one schedule takes the place of another: rows that are new, gone or changed, in the order of the new
//! text.
//!
//! Rows are compared as the observatory node recognises them: by their content, whatever the order of the fields and the
//! blanks. A row that is the same stays as it is, wherever it stands.

use std::collections::HashMap;

use serde_json::{Map, Value};

use crate::parse::objects;
use crate::row::RowId;

/// A row of a text, as it is written.
#[derive(Debug, Clone, PartialEq)]
pub struct WrittenRow {
    /// Line on which it begins, from 1.
    pub line: u32,
    /// Its fields.
    pub row: Map<String, Value>,
}

/// What becomes of a row.
#[derive(Debug, Clone, PartialEq)]
pub enum RowChange {
    /// It is new.
    Added(WrittenRow),
    /// It is gone.
    Removed(WrittenRow),
    /// A row of the same camera, action and object had other fields.
    Changed {
        /// As it was.
        before: WrittenRow,
        /// As it is.
        after: WrittenRow,
        /// What differs, as JSON pointers.
        fields: Vec<FieldChange>,
    },
}

/// A field that differs.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldChange {
    /// JSON pointer within the row, such as `/action_value/exptime`.
    pub pointer: String,
    /// Absent where it had none.
    pub before: Option<Value>,
    /// Absent where it has none.
    pub after: Option<Value>,
}

/// The difference of two schedules.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// In the order of the new text; a row that is gone stands where it was, before the next row that it preceded.
    pub changes: Vec<RowChange>,
    /// Rows that both have.
    pub same: usize,
}

/// Compares two texts by their rows; a place that is no JSON is no row.
pub fn difference(before: &str, after: &str) -> Difference {
    let (old, new) = (rows(before), rows(after));
    let mut by_id: HashMap<RowId, usize> = old.iter().enumerate().map(|(place, (id, _))| (id.clone(), place)).collect();
    // For each new row, the place of the old one that it is.
    let same: Vec<Option<usize>> = new.iter().map(|(id, _)| by_id.remove(id)).collect();
    let mut gone: Vec<usize> = by_id.into_values().collect();
    gone.sort_unstable();
    let mut by_kind: HashMap<String, std::collections::VecDeque<usize>> = HashMap::new();
    for place in gone {
        if let Some((_, row)) = old.get(place) {
            by_kind.entry(kind(&row.row)).or_default().push_back(place);
        }
    }
    let was: Vec<Option<usize>> = new
        .iter()
        .zip(&same)
        .map(|((_, row), same)| same.is_none().then(|| by_kind.get_mut(&kind(&row.row))?.pop_front()).flatten())
        .collect();
    let mut removed: Vec<usize> = by_kind.into_values().flatten().collect();
    removed.sort_unstable();
    let mut removed = removed.into_iter().peekable();
    let mut changes = Vec::new();
    let row_of = |place: usize| old.get(place).map(|(_, row)| row.clone());
    for (((_, row), same), was) in new.iter().zip(&same).zip(&was) {
        if let Some(reached) = same.or(*was) {
            while let Some(place) = removed.next_if(|place| *place < reached) {
                changes.extend(row_of(place).map(RowChange::Removed));
            }
        }
        match (same, was.and_then(row_of)) {
            (Some(_), _) => {}
            (None, Some(before)) => {
                let mut fields = Vec::new();
                compare("", &before.row, &row.row, &mut fields);
                changes.push(RowChange::Changed { before, after: row.clone(), fields });
            }
            (None, None) => changes.push(RowChange::Added(row.clone())),
        }
    }
    changes.extend(removed.filter_map(row_of).map(RowChange::Removed));
    Difference { changes, same: same.iter().flatten().count() }
}

fn rows(text: &str) -> Vec<(RowId, WrittenRow)> {
    let mut twins: HashMap<RowId, usize> = HashMap::new();
    let all = objects(text).into_iter().map(|(line, row)| {
        let value = Value::Object(row);
        let twin = twins.entry(RowId::of(&value, 0)).and_modify(|count| *count += 1).or_insert(0);
        let id = RowId::of(&value, *twin);
        let Value::Object(row) = value else { return (id, WrittenRow { line, row: Map::new() }) };
        (id, WrittenRow { line, row })
    });
    all.collect()
}

/// Rows of one kind are taken for one that was changed.
fn kind(row: &Map<String, Value>) -> String {
    let field = |name: &str| row.get(name).map(Value::to_string).unwrap_or_default();
    let object =
        row.get("action_value").and_then(|value| value.get("object")).map(Value::to_string).unwrap_or_default();
    [field("device_name"), field("action_type"), object].join("\n")
}

fn compare(pointer: &str, before: &Map<String, Value>, after: &Map<String, Value>, changes: &mut Vec<FieldChange>) {
    let names = before.keys().chain(after.keys().filter(|name| !before.contains_key(*name)));
    for name in names {
        let pointer = format!("{pointer}/{}", name.replace('~', "~0").replace('/', "~1"));
        match (before.get(name), after.get(name)) {
            (Some(one), Some(other)) if one == other => {}
            (Some(Value::Object(one)), Some(Value::Object(other))) => compare(&pointer, one, other, changes),
            (before, after) => {
                changes.push(FieldChange { pointer, before: before.cloned(), after: after.cloned() });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn row(object: &str, exptime: f64, start: &str) -> String {
        format!(
            "{{\"device_name\": \"cam\", \"action_type\": \"object\", \"action_value\": {{\"object\": \"{object}\", \"exptime\": \
             {exptime:?}}}, \"start_time\": \"{start}\", \"end_time\": \"2026-11-21 09:00:00\"}}\n"
        )
    }

    fn words(difference: &Difference) -> Vec<String> {
        let object = |row: &WrittenRow| format!("{} {}", row.line, row.row["action_value"]["object"].as_str().unwrap());
        let word = |change: &RowChange| match change {
            RowChange::Added(row) => format!("+{}", object(row)),
            RowChange::Removed(row) => format!("-{}", object(row)),
            RowChange::Changed { before, after, fields } => {
                let fields: Vec<&str> = fields.iter().map(|field| field.pointer.as_str()).collect();
                format!("{}>{} {}", object(before), object(after), fields.join(","))
            }
        };
        difference.changes.iter().map(word).collect()
    }

    #[test]
    fn rows_are_added_removed_and_changed_in_the_order_of_the_new_text() {
        let before = [row("a", 10.0, "1"), row("b", 10.0, "2"), row("c", 10.0, "3"), row("d", 10.0, "4")].concat();
        let after = format!(
            "// another night\n{}{}{}{}",
            row("e", 5.0, "0"),
            row("a", 10.0, "1"),
            row("c", 20.0, "3"),
            row("d", 10.0, "4")
        );
        let found = difference(&before, &after);
        assert_eq!(words(&found), ["+2 e", "-2 b", "3 c>4 c /action_value/exptime"]);
        assert_eq!(found.same, 2);
        let RowChange::Changed { fields, .. } = &found.changes[2] else { panic!("{found:?}") };
        assert_eq!((fields[0].before.clone(), fields[0].after.clone()), (Some(json!(10.0)), Some(json!(20.0))));
    }

    #[test]
    fn blanks_comments_and_the_order_of_fields_change_nothing_and_a_row_that_stands_twice_counts_twice() {
        let one = row("a", 10.0, "1");
        let turned = "// the same\n {\"end_time\": \"2026-11-21 09:00:00\", \"start_time\": \"1\", \"action_value\": {\"exptime\": \
                      10.0, \"object\": \"a\"}, \"action_type\": \"object\", \"device_name\": \"cam\"}";
        assert_eq!(difference(&one, turned), Difference { changes: vec![], same: 1 });
        assert_eq!(words(&difference(&one.repeat(3), &one)), ["-2 a", "-3 a"]);
        assert_eq!(words(&difference(&one, &one.repeat(2))), ["+2 a"]);
        assert_eq!(words(&difference("", &one)), ["+1 a"]);
        assert_eq!(words(&difference(&one, "")), ["-1 a"]);
    }

    #[test]
    fn what_is_no_row_is_passed_over() {
        let text = format!("[1]\n{{\"a\": \n{}no\n", row("a", 10.0, "1"));
        assert_eq!(words(&difference("", &text)), ["+3 a"]);
    }
}
