//! Which keywords become columns of the table, and a frame's row.

use std::collections::{HashMap, HashSet};

use super::CubeError;
use super::frame::FrameFile;
use crate::card::{self, Value};

/// Keywords about a file's own data; the cube has its own.
const STRUCTURE: [&str; 14] = [
    "SIMPLE", "BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "EXTEND", "BSCALE", "BZERO", "BLANK", "PCOUNT", "GCOUNT",
    "CHECKSUM", "DATASUM", "END",
];
/// A keyword of a world coordinate system begins so. A frame has its own: they are columns, also where all are the same,
/// since half of one in the cube's header would be none.
const WORLD: [&str; 16] = [
    "WCSAXES", "CTYPE", "CUNIT", "CRVAL", "CRPIX", "CDELT", "CROTA", "CD1_", "CD2_", "PC1_", "PC2_", "A_", "B_", "AP_",
    "BP_", "PV",
];
/// Columns that a table of FITS has at most.
pub(super) const MOST_COLUMNS: usize = 999;

/// The types of a column, each of which holds all values of those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum ColumnType {
    /// No value was found yet.
    Nothing,
    Logical,
    Whole,
    Number,
    Text,
}

/// A keyword over all frames.
#[derive(Debug, Clone)]
struct KeywordColumn {
    keyword: String,
    first: Value,
    column_type: ColumnType,
    /// Bytes of the longest text.
    width: usize,
    is_same: bool,
    /// Frames that have it.
    count: usize,
    /// Number of the last frame that has it, from 1.
    last: usize,
    unit: Option<String>,
}

/// The keywords that were found so far.
pub(super) struct Columns {
    columns: Vec<KeywordColumn>,
    places: HashMap<String, usize>,
    frames: usize,
}

/// The columns of the table.
pub(super) struct MetadataTable {
    columns: Vec<KeywordColumn>,
    /// Keywords that all frames have with one value.
    constant: Vec<String>,
}

impl Columns {
    pub fn of(frame: &FrameFile) -> Self {
        let mut this = Self { columns: Vec::new(), places: HashMap::new(), frames: 0 };
        this.add(frame);
        this
    }

    pub fn add(&mut self, frame: &FrameFile) {
        self.frames += 1;
        let mut units: Option<HashMap<String, String>> = None;
        for (keyword, value) in frame.header.cards() {
            if STRUCTURE.contains(&keyword) {
                continue;
            }
            let Some(place) = self.places.get(keyword) else {
                let unit = units.get_or_insert_with(|| units_of(&frame.cards)).get(keyword).cloned();
                self.places.insert(keyword.to_owned(), self.columns.len());
                let (column_type, width) = kind(value);
                let (keyword, first) = (keyword.to_owned(), value.clone());
                let (is_same, count, last) = (true, 1, self.frames);
                self.columns.push(KeywordColumn { keyword, first, column_type, width, is_same, count, last, unit });
                continue;
            };
            let column = &mut self.columns[*place];
            if column.last == self.frames {
                // A keyword that stands twice: the first one counts.
                continue;
            }
            column.last = self.frames;
            let (column_type, width) = kind(value);
            column.count += 1;
            column.is_same &= same(&column.first, value);
            column.column_type = column.column_type.joined(column_type);
            column.width = column.width.max(width);
        }
    }

    /// The columns; the error is how many there would be, where a table cannot have so many.
    pub fn finish(self) -> Result<MetadataTable, usize> {
        let frames = self.frames;
        let is_constant = |column: &KeywordColumn| {
            column.is_same && column.count == frames && !WORLD.iter().any(|begin| column.keyword.starts_with(begin))
        };
        let (constant, mut columns): (Vec<KeywordColumn>, Vec<KeywordColumn>) =
            self.columns.into_iter().partition(is_constant);
        columns.retain(|column| column.column_type != ColumnType::Nothing);
        if columns.len() > MOST_COLUMNS {
            return Err(columns.len());
        }
        Ok(MetadataTable { columns, constant: constant.into_iter().map(|column| column.keyword).collect() })
    }
}

impl ColumnType {
    /// The type that holds values of both.
    fn joined(self, other: Self) -> Self {
        match (self.min(other), self.max(other)) {
            // T and F are no numbers, so that both become text.
            (Self::Logical, Self::Whole | Self::Number) => Self::Text,
            (_, larger) => larger,
        }
    }
}

impl MetadataTable {
    pub fn count(&self) -> usize {
        self.columns.len()
    }

    /// Whether all frames have this keyword with one value.
    pub fn is_constant(&self, keyword: &str) -> bool {
        self.constant.iter().any(|constant| constant == keyword)
    }

    /// Bytes of a row.
    pub fn row_bytes(&self) -> usize {
        self.columns.iter().map(KeywordColumn::bytes).sum()
    }

    /// The names of the columns: the keywords, with `_` for `-`, which names of columns should not have (section 7.3.2).
    /// Where another column has that name, a number follows.
    fn names(&self) -> Vec<String> {
        let mut taken: HashSet<String> = self.columns.iter().map(|column| column.keyword.clone()).collect();
        let name = |column: &KeywordColumn| {
            let plain = column.keyword.replace('-', "_");
            if plain == column.keyword {
                return plain;
            }
            let numbered = (2..).map(|number| format!("{plain}_{number}"));
            let mut names = std::iter::once(plain.clone()).chain(numbered);
            // The numbers do not end.
            names.find(|name| taken.insert(name.clone())).unwrap_or_default()
        };
        self.columns.iter().map(name).collect()
    }

    /// The cards that describe the columns: (keyword, value, comment).
    pub fn cards(&self) -> Vec<(String, Value, String)> {
        let mut cards = Vec::new();
        for ((number, column), name) in (1..).zip(&self.columns).zip(self.names()) {
            let comment = if name == column.keyword { String::new() } else { format!("keyword {}", column.keyword) };
            cards.push((format!("TTYPE{number}"), Value::Text(name), comment));
            cards.push((format!("TFORM{number}"), Value::Text(column.form()), String::new()));
            if let Some(unit) = &column.unit {
                cards.push((format!("TUNIT{number}"), Value::Text(unit.clone()), String::new()));
            }
            if column.column_type == ColumnType::Whole {
                cards.push((
                    format!("TNULL{number}"),
                    Value::Whole(i64::MIN),
                    "the frame has no such keyword".to_owned(),
                ));
            }
        }
        cards
    }

    /// The row of a frame, most significant bytes first.
    pub fn row(&self, frame: &FrameFile) -> Result<Vec<u8>, CubeError> {
        let mut row = Vec::with_capacity(self.row_bytes());
        for column in &self.columns {
            let value = frame.header.value(&column.keyword);
            if !column.put(value, &mut row) {
                let why = format!("its keyword {} changed while the cube was written; try again", column.keyword);
                return Err(frame.failed(why));
            }
        }
        Ok(row)
    }
}

impl KeywordColumn {
    fn form(&self) -> String {
        match self.column_type {
            ColumnType::Logical => "1L".to_owned(),
            ColumnType::Whole => "1K".to_owned(),
            ColumnType::Number => "1D".to_owned(),
            ColumnType::Text | ColumnType::Nothing => format!("{}A", self.width.max(1)),
        }
    }

    fn bytes(&self) -> usize {
        match self.column_type {
            ColumnType::Logical => 1,
            ColumnType::Whole | ColumnType::Number => 8,
            ColumnType::Text | ColumnType::Nothing => self.width.max(1),
        }
    }

    /// Adds a value to a row; false if it does not fit the column.
    fn put(&self, value: Option<&Value>, row: &mut Vec<u8>) -> bool {
        let value = value.filter(|value| **value != Value::Undefined);
        match (self.column_type, value) {
            (ColumnType::Logical, None) => row.push(0),
            (ColumnType::Logical, Some(Value::Logical(value))) => row.push(if *value { b'T' } else { b'F' }),
            (ColumnType::Whole, None) => row.extend(i64::MIN.to_be_bytes()),
            (ColumnType::Whole, Some(Value::Whole(value))) => row.extend(value.to_be_bytes()),
            (ColumnType::Number, None) => row.extend(f64::NAN.to_be_bytes()),
            (ColumnType::Number, Some(Value::Whole(value))) => row.extend((*value as f64).to_be_bytes()),
            (ColumnType::Number, Some(Value::Number(value))) => row.extend(value.to_be_bytes()),
            (ColumnType::Text | ColumnType::Nothing, value) => {
                let text = value.map(text_of).unwrap_or_default();
                let room = self.bytes();
                row.extend(text.bytes());
                row.extend(std::iter::repeat_n(b' ', room.saturating_sub(text.len())));
                return text.len() <= room;
            }
            _ => return false,
        }
        true
    }
}

/// The type of a value, and the length of its text.
fn kind(value: &Value) -> (ColumnType, usize) {
    let column_type = match value {
        Value::Logical(_) => ColumnType::Logical,
        Value::Whole(_) => ColumnType::Whole,
        Value::Number(_) => ColumnType::Number,
        Value::Text(_) => ColumnType::Text,
        Value::Undefined => ColumnType::Nothing,
    };
    (column_type, text_of(value).len())
}

/// A value as text of ASCII, for a column with values of several types.
fn text_of(value: &Value) -> String {
    let text = match value {
        Value::Logical(value) => if *value { "T" } else { "F" }.to_owned(),
        Value::Whole(value) => value.to_string(),
        Value::Number(value) => format!("{value:?}"),
        Value::Text(text) => text.clone(),
        Value::Undefined => String::new(),
    };
    text.chars().map(|c| if c.is_ascii() && !c.is_ascii_control() { c } else { '?' }).collect()
}

fn same(one: &Value, other: &Value) -> bool {
    match (one, other) {
        (Value::Number(one), Value::Number(other)) => one.to_bits() == other.to_bits(),
        _ => one == other,
    }
}

/// The units that the comments of a header's cards begin with, such as `[deg] altitude`.
fn units_of(cards: &[[u8; card::LENGTH]]) -> HashMap<String, String> {
    let unit = |card: &[u8; card::LENGTH]| {
        let text = String::from_utf8_lossy(card).into_owned();
        let (_, comment) = text.rsplit_once(" / [")?;
        let (unit, _) = comment.split_once(']')?;
        let is_unit = !unit.is_empty() && unit.len() <= 20 && unit.is_ascii();
        is_unit.then(|| (text.get(..8).unwrap_or_default().trim_end().to_owned(), unit.to_owned()))
    };
    cards.iter().filter_map(unit).collect()
}
