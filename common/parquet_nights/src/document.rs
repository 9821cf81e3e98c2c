//! The tables and columns as a document for readers.

use std::fmt::Write as _;

use crate::tables::{NIGHTS, TABLES};

/// The tables in Markdown.
pub fn document() -> String {
    let mut text = String::new();
    for table in TABLES.iter().chain([&NIGHTS]) {
        let _ = write!(text, "\n### `{}`\n\nA row for {}. ", table.name, table.about);
        let key: Vec<String> =
            table.columns.iter().take(table.key).map(|column| format!("`{}`", column.name)).collect();
        let _ = writeln!(text, "Sorted by {}, of which no two rows have the same.\n", key.join(", "));
        text.push_str("| column | type | meaning |\n|---|---|---|\n");
        for column in table.columns {
            let optional = if column.required { "" } else { ", or none" };
            let _ = writeln!(text, "| `{}` | {}{optional} | {} |", column.name, column.kind.name(), column.about);
        }
    }
    text + "\n"
}
