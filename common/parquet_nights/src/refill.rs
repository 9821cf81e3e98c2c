//! Fills the empty tables of a new database from the files of a telescope.

use std::path::Path;

use rusqlite::{Connection, Statement};
use units::Utc;

use crate::ParquetError;
use crate::cell::Cell;
use crate::partition::Partition;
use crate::read::PartReader;
use crate::table::Table;
use crate::tables::{GATHER_AUDIT, NIGHTS, ORDER_AUDIT, TABLES};

/// How much came back.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refilled {
    /// Nights that had a file.
    pub nights: usize,
    /// Rows of each table.
    pub rows: Vec<(&'static str, usize)>,
}

/// The columns that name a series.
const SERIES_COLUMNS: usize = 4;

/// Days with values, found again; then those beyond the newest so many, which the archive would have forgotten.
const DAYS: &str = "INSERT OR IGNORE INTO days SELECT DISTINCT at_us / 86400000000 FROM samples";
const OLDEST: &str = "SELECT day FROM days ORDER BY day DESC LIMIT 1 OFFSET ?";

/// Fills a database that has all tables and no rows; of polled values those of the newest `raw_days` days with values.
///
/// # Errors
/// A file is damaged or of another kind, or the disk is full. The database is then half filled, and of no use.
pub fn refill(connection: &Connection, partition: &Partition, raw_days: u32) -> Result<Refilled, ParquetError> {
    let sqlite = |source| ParquetError::Sqlite { what: "fill", table: "telemetry", source };
    let transaction = connection.unchecked_transaction().map_err(sqlite)?;
    transaction.execute_batch(GATHER_AUDIT).map_err(sqlite)?;
    let (mut all, mut rows) = (std::collections::BTreeSet::new(), Vec::new());
    for night in partition.nights(&NIGHTS)? {
        check_night(partition, &night)?;
        all.insert(night);
    }
    for table in &TABLES {
        let nights = partition.nights(table)?;
        all.extend(nights.iter().cloned());
        let skipped = match table.name {
            // A day touches two nights, which it has for itself where the days before and after have no values.
            "telemetry" => nights.len().saturating_sub((raw_days.max(1) as usize).saturating_mul(2)),
            _ => 0,
        };
        let mut count = 0;
        for night in nights.iter().skip(skipped) {
            count += read_part(&transaction, partition, table, night)?;
        }
        rows.push((table.name, count));
    }
    if all.is_empty() {
        return Err(ParquetError::Nothing {
            folder: partition.root.clone(),
            site: partition.site.clone(),
            telescope: partition.telescope.clone(),
            others: partition.others(&TABLES)?,
        });
    }
    transaction.execute_batch(ORDER_AUDIT).map_err(ParquetError::sqlite("fill", "audit"))?;
    forget_old(&transaction, raw_days).map_err(sqlite)?;
    transaction.commit().map_err(sqlite)?;
    Ok(Refilled { nights: all.len(), rows })
}

/// Has every file of a night the rows that it had when the night was written? Files only gain rows.
fn check_night(partition: &Partition, night: &str) -> Result<(), ParquetError> {
    let mut parts = PartReader::open(&partition.part(&NIGHTS, night), &NIGHTS, &partition.about(night))?;
    while let Some(row) = parts.next_row()? {
        let [Cell::Text(name), Cell::Int(expected), ..] = row.as_slice() else { continue };
        let Some(table) = TABLES.iter().find(|table| table.name.as_bytes() == name.data()) else { continue };
        let path = partition.part(table, night);
        let rows = if path.exists() { PartReader::open(&path, table, &partition.about(night))?.rows() } else { 0 };
        if rows < *expected {
            return Err(ParquetError::Lost { path, rows, expected: *expected });
        }
    }
    Ok(())
}

fn read_part(
    connection: &Connection,
    partition: &Partition,
    table: &'static Table,
    night: &str,
) -> Result<usize, ParquetError> {
    let path = partition.part(table, night);
    let mut reader = PartReader::open(&path, table, &partition.about(night))?;
    let failed = |source| ParquetError::Sqlite { what: "fill", table: table.name, source };
    let mut put = connection.prepare_cached(&table.put()).map_err(failed)?;
    let mut before = table.before.map(|sql| connection.prepare_cached(sql)).transpose().map_err(failed)?;
    let (mut series, mut count): (Vec<Cell>, _) = (Vec::new(), 0);
    crate::night::bind(&mut put, &partition.telescope, (Utc::EPOCH, Utc::EPOCH)).map_err(failed)?;
    while let Some(row) = reader.next_row()? {
        let name = row.get(..SERIES_COLUMNS).unwrap_or(&row);
        if let Some(before) = before.as_mut().filter(|_| series != name) {
            bind_row(before, table, name, &path)?.raw_execute().map_err(failed)?;
            series = name.to_vec();
        }
        bind_row(&mut put, table, &row, &path)?.raw_execute().map_err(failed)?;
        count += 1;
    }
    Ok(count)
}

fn bind_row<'a, 'c>(
    statement: &'a mut Statement<'c>,
    table: &'static Table,
    row: &[Cell],
    path: &Path,
) -> Result<&'a mut Statement<'c>, ParquetError> {
    for (place, (index, column)) in table.stored().enumerate() {
        // Only the first columns name a series.
        let Some(cell) = row.get(index) else { break };
        let value = cell.to_sql(column.kind).ok_or_else(|| ParquetError::Foreign {
            path: path.to_owned(),
            table: table.name,
            why: format!("a text of the column {} is not UTF-8", column.name),
        })?;
        let bound = statement.raw_bind_parameter(place + 1, value);
        bound.map_err(|source| ParquetError::Sqlite { what: "fill", table: table.name, source })?;
    }
    Ok(statement)
}

fn forget_old(connection: &Connection, raw_days: u32) -> rusqlite::Result<()> {
    use rusqlite::OptionalExtension as _;
    connection.execute(DAYS, [])?;
    let oldest = connection.query_row(OLDEST, [i64::from(raw_days.max(1)) - 1], |row| row.get::<_, i64>(0));
    if let Some(oldest) = oldest.optional()? {
        connection.execute("DELETE FROM samples WHERE at_us < ? * 86400000000", [oldest])?;
        connection.execute("DELETE FROM days WHERE day < ?", [oldest])?;
    }
    Ok(())
}
