//! Writes one night of a database, and finds the nights that have something.

use std::cmp::Ordering;
use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{self, AtomicU64};
use std::time::{Duration, SystemTime};

use rusqlite::{Connection, Rows, Statement};
use units::Utc;

use crate::ParquetError;
use crate::cell::{Cell, stamp};
use crate::partition::Partition;
use crate::read::PartReader;
use crate::table::Table;
use crate::tables::{NIGHTS, TABLES};
use crate::write::PartWriter;

/// A night: its name, and its span of time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NightSpan {
    /// The date of its evening, such as `20261121`.
    pub date: String,
    /// Its beginning.
    pub from: Utc,
    /// Its end.
    pub to: Utc,
}

/// What became of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It is new.
    Written,
    /// It has other rows than before.
    Changed,
    /// It is as it was.
    Unchanged,
    /// There are no rows, and there is no file.
    Empty,
}

/// A file of a night, after it was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PartReport {
    /// The table.
    pub table: &'static str,
    /// Where the file is.
    pub path: PathBuf,
    /// How many rows it has.
    pub rows: usize,
    /// Its size.
    pub bytes: u64,
    /// What became of it.
    pub outcome: Outcome,
}

/// Temporary files of a writer that was killed are removed after so long.
const GIVEN_UP_AFTER: Duration = Duration::from_secs(3600);
/// How many files this process has begun.
static DRAFTS: AtomicU64 = AtomicU64::new(0);

/// Writes all files of a night from the database as it is now. A file that exists keeps the rows that the database has no
/// more; one that would be the same stays untouched.
///
/// # Errors
/// The database cannot be read, or the disk refuses a file; each file is then the one of before or the new one.
pub fn write_night(
    connection: &Connection,
    partition: &Partition,
    night: &NightSpan,
) -> Result<Vec<PartReport>, ParquetError> {
    let _snapshot = connection.unchecked_transaction().map_err(ParquetError::sqlite("begin to read", "telemetry"))?;
    let mut reports = Vec::new();
    for table in &TABLES {
        reports.push(write_part(connection, partition, night, table)?);
    }
    if reports.iter().any(|report| report.outcome != Outcome::Empty) {
        reports.push(write_nights(partition, night, &reports)?);
    }
    Ok(reports)
}

/// Writes which tables the night has, after all of them.
fn write_nights(partition: &Partition, night: &NightSpan, reports: &[PartReport]) -> Result<PartReport, ParquetError> {
    let mut rows: Vec<Vec<Cell>> = Vec::new();
    for report in reports.iter().filter(|report| report.outcome != Outcome::Empty) {
        let count = Cell::Int(i64::try_from(report.rows).unwrap_or(i64::MAX));
        rows.push(vec![Cell::text(report.table), count, Cell::Int(night.from.micros()), Cell::Int(night.to.micros())]);
    }
    rows.sort_by(|one, two| key_order(&NIGHTS, one, two));
    let mut draft = Draft::begin(partition, night, &NIGHTS)?;
    for row in rows {
        draft.writer.push(row)?;
    }
    draft.publish()
}

fn write_part(
    connection: &Connection,
    partition: &Partition,
    night: &NightSpan,
    table: &'static Table,
) -> Result<PartReport, ParquetError> {
    let path = partition.part(table, &night.date);
    let about = partition.about(&night.date);
    let mut stored = is_there(&path)?.then(|| PartReader::open(&path, table, &about)).transpose()?;
    let failed = |source| ParquetError::Sqlite { what: "read", table: table.name, source };
    let mut statement = connection.prepare_cached(&table.select()).map_err(failed)?;
    bind(&mut statement, &partition.telescope, (night.from, night.to)).map_err(failed)?;
    let mut found = Found { table, rows: statement.raw_query(), before: Vec::new() };
    let mut row = found.next_row()?;
    if row.is_none() && stored.is_none() {
        return Ok(PartReport { table: table.name, path, rows: 0, bytes: 0, outcome: Outcome::Empty });
    }

    let mut draft = Draft::begin(partition, night, table)?;
    let mut old = next_of(&mut stored)?;
    loop {
        let order = match (&row, &old) {
            (None, None) => break,
            (Some(_), None) => Ordering::Less,
            (None, Some(_)) => Ordering::Greater,
            (Some(row), Some(old)) => key_order(table, row, old),
        };
        let (mut from_database, mut from_file) = (None, None);
        if order != Ordering::Greater {
            from_database = std::mem::replace(&mut row, found.next_row()?);
        }
        if order != Ordering::Less {
            from_file = std::mem::replace(&mut old, next_of(&mut stored)?);
        }
        if let Some(row) = chosen(table, from_database, from_file) {
            draft.writer.push(row)?;
        }
    }
    drop(stored);
    draft.publish()
}

/// A file that is being written, and its place.
struct Draft {
    table: &'static Table,
    writer: PartWriter,
    temporary: Temporary,
    path: PathBuf,
    to_sync: Vec<PathBuf>,
}

impl Draft {
    fn begin(partition: &Partition, night: &NightSpan, table: &'static Table) -> Result<Self, ParquetError> {
        let path = partition.part(table, &night.date);
        let folder = path.parent().unwrap_or(Path::new(""));
        // Folders that are new, and in any case all of ours: those of before may not be on disk yet.
        let is_old = |folder: &&Path| folder.exists() && partition.root.starts_with(folder);
        let oldest = folder.ancestors().find(is_old).unwrap_or(folder);
        let to_sync = folder.ancestors().take_while(|folder| folder.starts_with(oldest)).map(Path::to_owned).collect();
        fs::create_dir_all(folder).map_err(ParquetError::io("make the folder", folder))?;
        remove_given_up(folder);
        // No other writer of this process has the number: a file of that name is of a killed process with the same id,
        // as the first process of a container has it each time.
        let number = DRAFTS.fetch_add(1, atomic::Ordering::Relaxed);
        let temporary = Temporary(with_ending(&path, &format!(".part-{}-{number}", std::process::id())));
        let _ = fs::remove_file(&temporary.0);
        let writer = PartWriter::create(&temporary.0, table, &partition.about(&night.date))?;
        Ok(Self { table, writer, temporary, path, to_sync })
    }

    /// Syncs the file and gives it its name, unless the file of before is the same.
    fn publish(self) -> Result<PartReport, ParquetError> {
        let Self { table, writer, temporary, path, to_sync } = self;
        let rows = writer.finish()?;
        let bytes = fs::metadata(&temporary.0).map_err(ParquetError::io("look at", &temporary.0))?.len();
        let is_new = !is_there(&path)?;
        let mut report = PartReport { table: table.name, path, rows, bytes, outcome: Outcome::Unchanged };
        let path = &report.path;
        if !is_new && is_same(&temporary.0, path).map_err(ParquetError::io("compare with the new rows", path))? {
            return Ok(report);
        }
        fs::rename(&temporary.0, path).map_err(ParquetError::io("give its name to", path))?;
        #[cfg(unix)]
        for folder in to_sync {
            let synced = File::open(&folder).and_then(|folder| folder.sync_all());
            synced.map_err(ParquetError::io("sync the folder", &folder))?;
        }
        report.outcome = if is_new { Outcome::Written } else { Outcome::Changed };
        Ok(report)
    }
}

/// A file that is removed where it was not given its name.
struct Temporary(PathBuf);

impl Drop for Temporary {
    fn drop(&mut self) {
        // It is gone where it was renamed; a file that cannot be removed now goes with those of writers that were killed.
        let _ = fs::remove_file(&self.0);
    }
}

/// The rows of the database, as cells.
struct Found<'a> {
    table: &'static Table,
    rows: Rows<'a>,
    before: Vec<Cell>,
}

impl Found<'_> {
    fn next_row(&mut self) -> Result<Option<Vec<Cell>>, ParquetError> {
        let failed = |source| ParquetError::Sqlite { what: "read", table: self.table.name, source };
        let Some(row) = self.rows.next().map_err(failed)? else { return Ok(None) };
        let mut cells = Vec::with_capacity(self.table.columns.len());
        for (index, column) in self.table.columns.iter().enumerate() {
            let value = row.get_ref(index).map_err(failed)?;
            let cell = Cell::read(value, column, self.before.get(index)).ok_or_else(|| ParquetError::Value {
                table: self.table.name,
                column: column.name,
                found: format!("{value:?}").chars().take(200).collect(),
                expected: column.kind.name(),
            })?;
            cells.push(cell);
        }
        self.before.clone_from(&cells);
        Ok(Some(cells))
    }
}

fn next_of(stored: &mut Option<PartReader>) -> Result<Option<Vec<Cell>>, ParquetError> {
    stored.as_mut().map_or(Ok(None), PartReader::next_row)
}

fn key_order(table: &Table, row: &[Cell], old: &[Cell]) -> Ordering {
    let keys = row.iter().zip(old).take(table.key);
    keys.map(|(row, old)| row.order(old)).find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
}

/// Of two rows with one key: the database's, unless the other one is preferred.
fn chosen(table: &Table, row: Option<Vec<Cell>>, old: Option<Vec<Cell>>) -> Option<Vec<Cell>> {
    let (Some(row), Some(old)) = (&row, &old) else { return row.or(old) };
    let is_older = table.preferred().is_some_and(|place| match (row.get(place), old.get(place)) {
        (Some(row), Some(old)) => row.order(old).is_lt(),
        _ => false,
    });
    Some(if is_older { old.clone() } else { row.clone() })
}

/// Gives a statement those of our parameters that it has.
pub(crate) fn bind(statement: &mut Statement<'_>, telescope: &str, (from, to): (Utc, Utc)) -> rusqlite::Result<()> {
    let texts = [(":telescope", telescope.to_owned()), (":from", stamp(from)), (":to", stamp(to))];
    for (name, text) in texts {
        if let Some(place) = statement.parameter_index(name)? {
            statement.raw_bind_parameter(place, text)?;
        }
    }
    for (name, at) in [(":from_us", from), (":to_us", to)] {
        if let Some(place) = statement.parameter_index(name)? {
            statement.raw_bind_parameter(place, at.micros())?;
        }
    }
    Ok(())
}

/// The nights from a time on that have rows in the database, the oldest first; `night_at` gives the night of a time.
///
/// # Errors
/// The database cannot be read.
pub fn nights_with_data(
    connection: &Connection,
    telescope: &str,
    from: Utc,
    night_at: impl Fn(Utc) -> NightSpan,
) -> Result<Vec<NightSpan>, ParquetError> {
    let (mut nights, mut from) = (Vec::new(), from);
    loop {
        let mut first: Option<Utc> = None;
        for table in &TABLES {
            let Some(sql) = table.next else { continue };
            let failed = |source| ParquetError::Sqlite { what: "find the nights of", table: table.name, source };
            let mut statement = connection.prepare_cached(sql).map_err(failed)?;
            bind(&mut statement, telescope, (from, from)).map_err(failed)?;
            let mut rows = statement.raw_query();
            let Some(row) = rows.next().map_err(failed)? else { continue };
            let at = match row.get_ref(0).map_err(failed)? {
                rusqlite::types::ValueRef::Integer(at_us) => Some(Utc::from_micros(at_us)),
                rusqlite::types::ValueRef::Text(text) => std::str::from_utf8(text).ok().and_then(|at| at.parse().ok()),
                _ => None,
            };
            first = [first, at].into_iter().flatten().min();
        }
        let Some(first) = first else { return Ok(nights) };
        let night = night_at(first);
        if night.to <= from {
            return Ok(nights);
        }
        from = night.to;
        nights.push(night);
    }
}

/// Whether a name is taken. A link into nowhere takes it, too: its file may lie on a disk that is away, and its rows
/// would be lost if it were replaced. So would those of a file that cannot be looked at now.
fn is_there(path: &Path) -> Result<bool, ParquetError> {
    match fs::symlink_metadata(path) {
        Ok(_) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(ParquetError::io("look at", path)(error)),
    }
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// Removes what a killed writer left, once no writer can be at it any more.
fn remove_given_up(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let is_temporary = entry.file_name().to_str().is_some_and(|name| name.contains(".parquet.part-"));
        // A file of the future is of a machine whose clock is wrong, or was.
        let age = |at: SystemTime| at.elapsed().unwrap_or_else(|ahead| ahead.duration());
        let age = entry.metadata().and_then(|file| file.modified()).ok().map(age);
        if is_temporary && age.is_some_and(|age| age > GIVEN_UP_AFTER) {
            let _ = fs::remove_file(entry.path());
        }
    }
}

fn is_same(one: &Path, two: &Path) -> io::Result<bool> {
    let (mut one, mut two) = (File::open(one)?, File::open(two)?);
    let mut left = one.metadata()?.len();
    if two.metadata()?.len() != left {
        return Ok(false);
    }
    let (mut first, mut second) = (vec![0; 1 << 16], vec![0; 1 << 16]);
    while left > 0 {
        let length = usize::try_from(left).unwrap_or(usize::MAX).min(first.len());
        let (Some(first), Some(second)) = (first.get_mut(..length), second.get_mut(..length)) else { return Ok(false) };
        one.read_exact(first)?;
        two.read_exact(second)?;
        if first != second {
            return Ok(false);
        }
        left -= length as u64;
    }
    Ok(true)
}

#[cfg(test)]
mod tests;
