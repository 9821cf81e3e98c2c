//! Writes the rows of one file, a row group at a time.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::basic::Compression;
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::Result as Written;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::parser::parse_message_type;

use crate::ParquetError;
use crate::cell::Cell;
use crate::table::{Kind, Table};

/// Rows of a row group, at most: what is in memory while a file is written or read.
pub const ROWS_OF_A_GROUP: usize = 65_536;
/// Row groups that are smaller than this do not end where a device's rows end.
const FEWEST_OF_A_GROUP: usize = 4096;

enum Values {
    Text(Vec<ByteArray>),
    Int(Vec<i64>),
    Real(Vec<f64>),
    Bool(Vec<bool>),
}

struct Buffer {
    values: Values,
    /// For each row whether it has a value, as Parquet counts levels.
    present: Vec<i16>,
}

impl Buffer {
    fn new(kind: Kind) -> Self {
        let values = match kind {
            Kind::Text => Values::Text(Vec::new()),
            Kind::Real => Values::Real(Vec::new()),
            Kind::Bool => Values::Bool(Vec::new()),
            Kind::Int | Kind::Stamp | Kind::Micros | Kind::Minute => Values::Int(Vec::new()),
        };
        Self { values, present: Vec::new() }
    }

    fn push(&mut self, cell: Cell) {
        match (&mut self.values, cell) {
            (Values::Text(values), Cell::Text(value)) => values.push(value),
            (Values::Int(values), Cell::Int(value)) => values.push(value),
            (Values::Real(values), Cell::Real(value)) => values.push(value),
            (Values::Bool(values), Cell::Bool(value)) => values.push(value),
            _ => return self.present.push(0),
        }
        self.present.push(1);
    }

    fn write(&mut self, column: &mut SerializedColumnWriter<'_>, required: bool) -> Written<()> {
        let levels = (!required).then_some(self.present.as_slice());
        match &mut self.values {
            Values::Text(values) => {
                column.typed::<ByteArrayType>().write_batch(values, levels, None)?;
                values.clear();
            }
            Values::Int(values) => {
                column.typed::<Int64Type>().write_batch(values, levels, None)?;
                values.clear();
            }
            Values::Real(values) => {
                column.typed::<DoubleType>().write_batch(values, levels, None)?;
                values.clear();
            }
            Values::Bool(values) => {
                column.typed::<BoolType>().write_batch(values, levels, None)?;
                values.clear();
            }
        }
        self.present.clear();
        Ok(())
    }
}

/// A file that is being written under a temporary name of the caller's.
pub struct PartWriter {
    table: &'static Table,
    path: PathBuf,
    writer: SerializedFileWriter<File>,
    buffers: Vec<Buffer>,
    /// The first columns of the newest row.
    group: Vec<Cell>,
    waiting: usize,
    rows: usize,
}

impl PartWriter {
    /// Begins a file, which must not exist yet. `about` is stored in the file: site, telescope, night.
    ///
    /// # Errors
    /// The file cannot be made.
    pub fn create(path: &Path, table: &'static Table, about: &[(&str, &str)]) -> Result<Self, ParquetError> {
        let file = File::create_new(path).map_err(ParquetError::io("make the file", path))?;
        let begin = || {
            let schema = Arc::new(parse_message_type(&table.schema())?);
            let about =
                about.iter().map(|(name, value)| KeyValue::new(format!("starmesh.{name}"), (*value).to_owned()));
            // Statistics of pages would lengthen what an engine reads before it knows that it needs nothing of a file.
            let properties = WriterProperties::builder()
                .set_compression(Compression::SNAPPY)
                .set_statistics_enabled(EnabledStatistics::Chunk)
                .set_offset_index_disabled(true)
                .set_created_by(concat!("starmesh ", env!("CARGO_PKG_VERSION")).to_owned())
                .set_key_value_metadata(Some(about.collect()));
            SerializedFileWriter::new(file, schema, Arc::new(properties.build()))
        };
        let writer = begin().map_err(ParquetError::file("begin", path))?;
        let buffers = table.columns.iter().map(|column| Buffer::new(column.kind)).collect();
        Ok(Self { table, path: path.to_owned(), writer, buffers, group: Vec::new(), waiting: 0, rows: 0 })
    }

    /// Adds a row. Rows come in the order of the table's key, with a cell for each column, of its kind.
    ///
    /// # Errors
    /// The disk refuses a row group.
    pub fn push(&mut self, row: Vec<Cell>) -> Result<(), ParquetError> {
        let is_full = self.waiting >= ROWS_OF_A_GROUP;
        let group = row.get(..self.table.group).unwrap_or_default();
        if is_full || (self.waiting >= FEWEST_OF_A_GROUP && self.group != group) {
            self.flush()?;
        }
        if self.waiting == 0 || self.group != group {
            self.group = group.to_vec();
        }
        for (buffer, cell) in self.buffers.iter_mut().zip(row) {
            buffer.push(cell);
        }
        self.waiting += 1;
        self.rows += 1;
        Ok(())
    }

    fn flush(&mut self) -> Result<(), ParquetError> {
        let mut write = || {
            let mut group = self.writer.next_row_group()?;
            let mut columns = self.table.columns.iter().zip(&mut self.buffers);
            while let Some(mut writer) = group.next_column()? {
                if let Some((column, buffer)) = columns.next() {
                    buffer.write(&mut writer, column.required)?;
                }
                writer.close()?;
            }
            group.close().map(drop)
        };
        if self.waiting > 0 {
            write().map_err(ParquetError::file("write", &self.path))?;
        }
        self.waiting = 0;
        Ok(())
    }

    /// Ends the file and syncs it; returns how many rows it has.
    ///
    /// # Errors
    /// The disk refuses the end of the file.
    pub fn finish(mut self) -> Result<usize, ParquetError> {
        self.flush()?;
        let file = self.writer.into_inner().map_err(ParquetError::file("end", &self.path))?;
        file.sync_all().map_err(ParquetError::io("sync", &self.path))?;
        Ok(self.rows)
    }
}
