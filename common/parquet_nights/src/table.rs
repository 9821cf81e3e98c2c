//! What a table is: its columns in the files, and its rows in the database.

use std::fmt::Write as _;

/// How a column's values are stored, in the file and in the database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Text.
    Text,
    /// An integer of 64 bits.
    Int,
    /// A number of double precision.
    Real,
    /// True or false.
    Bool,
    /// A time; text in the database.
    Stamp,
    /// A time; microseconds in the database.
    Micros,
    /// The time at which a minute begins; minutes in the database.
    Minute,
}

impl Kind {
    /// The type in the language of Parquet's schemas.
    fn parquet(self) -> (&'static str, &'static str) {
        match self {
            Self::Text => ("BYTE_ARRAY", " (STRING)"),
            Self::Int => ("INT64", ""),
            Self::Real => ("DOUBLE", ""),
            Self::Bool => ("BOOLEAN", ""),
            Self::Stamp | Self::Micros | Self::Minute => ("INT64", " (TIMESTAMP(MICROS,true))"),
        }
    }

    /// The type as DuckDB names it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Text => "VARCHAR",
            Self::Int => "BIGINT",
            Self::Real => "DOUBLE",
            Self::Bool => "BOOLEAN",
            Self::Stamp | Self::Micros | Self::Minute => "TIMESTAMP WITH TIME ZONE",
        }
    }
}

/// A column.
#[derive(Debug, Clone, Copy)]
pub struct Column {
    /// Its name in the files.
    pub name: &'static str,
    /// Its name in the table of the database, or the expression that reads it.
    pub sql: &'static str,
    /// Its type.
    pub kind: Kind,
    /// Every row has a value.
    pub required: bool,
    /// It repeats a part of another column, for readers, and is not put back.
    pub derived: bool,
    /// What it is, for the document.
    pub about: &'static str,
}

/// A table of the files. Columns are only added, at the end, so that files of before are still read.
#[derive(Debug)]
pub struct Table {
    /// Its name: the first folder of a file's path.
    pub name: &'static str,
    /// One row for what, for the document.
    pub about: &'static str,
    /// The columns; the first [`Table::key`] of them are the key of a row, and rows are sorted by them.
    pub columns: &'static [Column],
    /// How many columns are the key.
    pub key: usize,
    /// A row group ends where one of so many first columns changes, so that engines skip what they do not need.
    pub group: usize,
    /// Of two rows with one key, the one counts that is larger here; where absent, the database's.
    pub prefer: Option<&'static str>,
    /// What is read: tables, joins and conditions, after `FROM`.
    pub from: &'static str,
    /// Asks for the time of the first row at or after `:from` or `:from_us`; absent where another table has the answer.
    pub next: Option<&'static str>,
    /// How a row is put back: the statement, with `?1` for the first column; generated where absent.
    pub insert: Option<&'static str>,
    /// The table of the database, for the generated statement.
    pub into: &'static str,
    /// The column of the database that names the telescope itself; it is in the path of the file, not in the file.
    pub owner: Option<&'static str>,
    /// What is done before a row whose first four columns differ from those of the row before.
    pub before: Option<&'static str>,
}

impl Table {
    /// The schema in the language of Parquet.
    pub fn schema(&self) -> String {
        let mut text = format!("message {} {{\n", self.name);
        for column in self.columns {
            let (physical, logical) = column.kind.parquet();
            let repetition = if column.required { "REQUIRED" } else { "OPTIONAL" };
            let _ = writeln!(text, "  {repetition} {physical} {}{logical};", column.name);
        }
        text + "}\n"
    }

    /// The place of the column that decides between two rows with one key.
    pub(crate) fn preferred(&self) -> Option<usize> {
        self.columns.iter().position(|column| Some(column.name) == self.prefer)
    }

    /// The question for the rows of a night, in the order of the key.
    pub(crate) fn select(&self) -> String {
        let columns: Vec<&str> = self.columns.iter().map(|column| column.sql).collect();
        let key: Vec<&str> = columns.iter().take(self.key).copied().collect();
        format!("SELECT {} FROM {} ORDER BY {}", columns.join(", "), self.from, key.join(", "))
    }

    /// The columns that are put back, with their places.
    pub(crate) fn stored(&self) -> impl Iterator<Item = (usize, &'static Column)> {
        self.columns.iter().enumerate().filter(|(_, column)| !column.derived)
    }

    /// The statement that puts a row back.
    pub(crate) fn put(&self) -> String {
        let generated = || {
            let mut columns: Vec<&str> = self.stored().map(|(_, column)| column.sql).collect();
            let mut places: Vec<String> = (1..=columns.len()).map(|place| format!("?{place}")).collect();
            if let Some(owner) = self.owner {
                columns.push(owner);
                places.push(":telescope".to_owned());
            }
            let (columns, places) = (columns.join(", "), places.join(", "));
            let put = format!("INSERT OR REPLACE INTO {} ({columns}) SELECT {places}", self.into);
            let Some(prefer) = self.prefer else { return put };
            // A row may have come into the files of two nights: facts that learn late when their frame began.
            let place = self.stored().position(|(_, column)| column.name == prefer).unwrap_or_default() + 1;
            let mut newer = vec![format!("{prefer} > ?{place}")];
            let key = self.stored().take(self.key).zip(1..);
            newer.extend(key.map(|((_, column), place)| format!("{} = ?{place}", column.sql)));
            format!("{put} WHERE NOT EXISTS (SELECT 1 FROM {} WHERE {})", self.into, newer.join(" AND "))
        };
        self.insert.map_or_else(generated, str::to_owned)
    }
}
