//! The schema of the database as a page: each table and view with its columns, from a new database, and what they mean, from
//! `columns.txt`. For docs/operator/database.md.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use rusqlite::Connection;

use super::migrations;

/// Unit and meaning of each column, by table and column; a table itself has an empty column.
type Meanings = BTreeMap<(String, String), (String, String)>;

/// A table or view with name and type of its columns.
struct TableShape {
    name: String,
    columns: Vec<(String, String)>,
}

fn meanings() -> (Vec<String>, Meanings) {
    let (mut tables, mut meanings) = (Vec::new(), Meanings::new());
    for line in include_str!("columns.txt").lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        let cells: Vec<&str> = line.splitn(4, '|').map(str::trim).collect();
        let cell = |at: usize| cells.get(at).copied().unwrap_or_default().to_owned();
        if cell(1).is_empty() {
            tables.push(cell(0));
        }
        meanings.insert((cell(0), cell(1)), (cell(2), cell(3)));
    }
    (tables, meanings)
}

/// The tables and views of a new database.
fn shapes() -> rusqlite::Result<Vec<TableShape>> {
    let mut connection = Connection::open_in_memory()?;
    migrations::bring_up(&mut connection).map_err(|error| match error {
        rusqlite_migration::Error::RusqliteError { err, .. } => err,
        other => rusqlite::Error::ToSqlConversionFailure(Box::new(other)),
    })?;
    let sql = "SELECT name FROM sqlite_master WHERE type IN ('table', 'view') AND name NOT LIKE 'sqlite_%'";
    let names: Vec<String> =
        connection.prepare(sql)?.query_map([], |row| row.get(0))?.collect::<rusqlite::Result<_>>()?;
    let shape = |name: String| {
        let sql = "SELECT name, type FROM pragma_table_xinfo(?1)";
        let mut asked = connection.prepare(sql)?;
        let columns =
            asked.query_map([&name], |row| Ok((row.get(0)?, row.get(1)?)))?.collect::<rusqlite::Result<_>>()?;
        Ok(TableShape { name, columns })
    };
    names.into_iter().map(shape).collect()
}

/// The generated part of docs/operator/database.md.
///
/// # Errors
/// The tables cannot be made.
pub fn page() -> rusqlite::Result<String> {
    let (order, meanings) = meanings();
    let mut shapes = shapes()?;
    shapes.sort_by_key(|shape| order.iter().position(|name| *name == shape.name).unwrap_or(usize::MAX));
    let of =
        |table: &str, column: &str| meanings.get(&(table.to_owned(), column.to_owned())).cloned().unwrap_or_default();
    let mut page = String::new();
    for shape in shapes {
        // Writing to a String cannot fail.
        let _ = writeln!(
            page,
            "\n### `{}`: {}\n\n| column | type | unit | meaning |\n|---|---|---|---|",
            shape.name,
            of(&shape.name, "").1
        );
        for (column, affinity) in &shape.columns {
            let (unit, meaning) = of(&shape.name, column);
            let _ = writeln!(page, "| `{column}` | {} | {unit} | {meaning} |", affinity.to_lowercase());
        }
    }
    Ok(page)
}

#[cfg(test)]
#[path = "described_tests.rs"]
mod tests;
