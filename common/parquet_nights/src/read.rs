//! Reads the rows of one file, a row group at a time.

use std::fs::File;
use std::path::{Path, PathBuf};

use parquet::column::reader::ColumnReader;
use parquet::file::reader::{FileReader as _, RowGroupReader, SerializedFileReader};
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::Type;

use crate::ParquetError;
use crate::cell::Cell;
use crate::table::Table;

/// A file that is being read.
pub struct PartReader {
    table: &'static Table,
    path: PathBuf,
    reader: SerializedFileReader<File>,
    columns_of_file: usize,
    next_group: usize,
    group: Vec<std::vec::IntoIter<Cell>>,
    left: usize,
}

impl PartReader {
    /// Opens a file and checks that it has the table's columns; those that were added since it was written may be
    /// missing. What the file itself says of site, telescope and night has to be `about`.
    ///
    /// # Errors
    /// The file is damaged, or not one of this table, telescope and night.
    pub fn open(path: &Path, table: &'static Table, about: &[(&str, &str)]) -> Result<Self, ParquetError> {
        let file = File::open(path).map_err(ParquetError::io("open", path))?;
        let read = ParquetError::file("read", path);
        let reader = SerializedFileReader::new(file).map_err(read)?;
        let foreign = |why| ParquetError::Foreign { path: path.to_owned(), table: table.name, why };
        let expected = parse_message_type(&table.schema()).map_err(ParquetError::file("read", path))?;
        let metadata = reader.metadata().file_metadata();
        let found = metadata.schema_descr().root_schema().get_fields();
        if found.len() > table.columns.len() {
            return Err(foreign(format!("it has {} columns, and {} are known", found.len(), table.columns.len())));
        }
        for (found, expected) in found.iter().zip(expected.get_fields()) {
            if !is_same(found, expected) {
                return Err(foreign(format!("its column {found:?} should be {expected:?}")));
            }
        }
        if let Some(column) = table.columns.iter().skip(found.len()).find(|column| column.required) {
            return Err(foreign(format!("it has no column {}", column.name)));
        }
        let stored = metadata.key_value_metadata().map_or(&[][..], Vec::as_slice);
        for (name, expected) in about {
            let key = format!("starmesh.{name}");
            let value = stored.iter().find(|pair| pair.key == key).and_then(|pair| pair.value.as_deref());
            if value.is_some_and(|value| value != *expected) {
                let value = value.unwrap_or_default();
                return Err(foreign(format!(
                    "it was written for {name} {value}, and its folder is that of {expected}"
                )));
            }
        }
        let columns_of_file = found.len();
        let (path, group) = (path.to_owned(), Vec::new());
        Ok(Self { table, path, reader, columns_of_file, next_group: 0, group, left: 0 })
    }

    /// How many rows the file has.
    pub fn rows(&self) -> i64 {
        self.reader.metadata().file_metadata().num_rows()
    }

    /// The next row; `None` at the end.
    ///
    /// # Errors
    /// The file is damaged.
    pub fn next_row(&mut self) -> Result<Option<Vec<Cell>>, ParquetError> {
        while self.left == 0 {
            if self.next_group == self.reader.num_row_groups() {
                return Ok(None);
            }
            self.read_group().map_err(ParquetError::file("read", &self.path))?;
        }
        self.left -= 1;
        let row = self.group.iter_mut().map(|column| column.next().unwrap_or(Cell::Null));
        let missing = self.table.columns.len() - self.columns_of_file;
        Ok(Some(row.chain(std::iter::repeat_n(Cell::Null, missing)).collect()))
    }

    fn read_group(&mut self) -> parquet::errors::Result<()> {
        let group = self.reader.get_row_group(self.next_group)?;
        self.next_group += 1;
        self.left = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
        self.group.clear();
        for index in 0..self.columns_of_file {
            let required = self.table.columns.get(index).is_some_and(|column| column.required);
            let cells = read_column(group.as_ref(), index, required, self.left)?;
            if cells.len() != self.left {
                let why = format!("column {index} has {} of {} rows", cells.len(), self.left);
                return Err(parquet::errors::ParquetError::General(why));
            }
            self.group.push(cells.into_iter());
        }
        Ok(())
    }
}

fn is_same(found: &Type, expected: &Type) -> bool {
    let (one, two) = (found.get_basic_info(), expected.get_basic_info());
    found.is_primitive()
        && one.name() == two.name()
        && one.repetition() == two.repetition()
        && found.get_physical_type() == expected.get_physical_type()
        && one.logical_type_ref() == two.logical_type_ref()
}

fn read_column(
    group: &dyn RowGroupReader,
    index: usize,
    required: bool,
    rows: usize,
) -> parquet::errors::Result<Vec<Cell>> {
    let mut levels = Vec::new();
    macro_rules! cells {
        ($reader:expr, $cell:expr) => {{
            let (mut values, mut read) = (Vec::new(), 0);
            while read < rows {
                let levels = (!required).then_some(&mut levels);
                let (more, _, _) = $reader.read_records(rows - read, levels, None, &mut values)?;
                if more == 0 {
                    break;
                }
                read += more;
            }
            with_gaps(values.into_iter().map($cell), (!required).then_some(levels))
        }};
    }
    Ok(match group.get_column_reader(index)? {
        ColumnReader::BoolColumnReader(mut reader) => cells!(reader, Cell::Bool),
        ColumnReader::Int64ColumnReader(mut reader) => cells!(reader, Cell::Int),
        ColumnReader::DoubleColumnReader(mut reader) => cells!(reader, Cell::Real),
        ColumnReader::ByteArrayColumnReader(mut reader) => cells!(reader, Cell::Text),
        _ => return Err(parquet::errors::ParquetError::General(format!("column {index} has an unknown type"))),
    })
}

/// Values where there are some, and none where the level says so.
fn with_gaps(mut values: impl Iterator<Item = Cell>, levels: Option<Vec<i16>>) -> Vec<Cell> {
    match levels {
        None => values.collect(),
        Some(levels) => {
            let cell = |level| if level == 0 { Some(Cell::Null) } else { values.next() };
            levels.into_iter().map_while(cell).collect()
        }
    }
}
