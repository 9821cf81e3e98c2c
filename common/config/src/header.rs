//! The site's FITS-header table (CSV), which also decides what device nodes poll.

use std::collections::HashSet;
use std::str::FromStr;

use contract::Kind;

use crate::check::MOST_BYTES;

/// The rows that a site without a table of its own uses.
pub const DEFAULT_CSV: &str = include_str!("default_fits_header.csv");

/// The table, in file order.
#[derive(Debug, Clone, PartialEq)]
pub struct HeaderTable {
    /// Its rows, the first one of each keyword.
    pub rows: Vec<HeaderRow>,
    /// Keywords of further rows, which are left out.
    pub repeated: Vec<String>,
}

/// One keyword.
#[derive(Debug, Clone, PartialEq)]
pub struct HeaderRow {
    /// FITS keyword.
    pub keyword: String,
    /// Type of `static` and `action_metadata` values.
    pub dtype: Dtype,
    /// True: written when the file is made; false: filled in when the header is completed.
    pub fixed: bool,
    /// Where the value comes from.
    pub source: Source,
    /// FITS comment.
    pub comment: String,
}

/// Type of a value in the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dtype {
    /// Text.
    Str,
    /// Whole number.
    Int,
    /// Number.
    Float,
    /// Logical.
    Bool,
}

/// Where the value of a keyword comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    /// Left to the FITS library (`astropy_default`).
    Library,
    /// Literal text, converted by the row's type.
    Static(String),
    /// Computed by Starmesh from the keyword's own meaning (`astra`).
    Computed,
    /// A property of the camera's paired device of this kind.
    Property(Kind, String),
    /// A value of the action's `metadata`.
    Metadata(String),
}

/// Why a table is not taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("FITS-header table, line {line}: {fault}")]
pub struct HeaderError {
    /// Line of the table, from 1; 0 where that is not known.
    pub line: u64,
    /// What is wrong with it.
    pub fault: String,
}

const COLUMNS: [&str; 6] = ["header", "dtype", "fixed", "device_type", "device_command", "comment"];

impl Default for HeaderTable {
    fn default() -> Self {
        // the default rows are part of this crate and proven by a test
        DEFAULT_CSV.parse().unwrap_or(Self { rows: Vec::new(), repeated: Vec::new() })
    }
}

impl FromStr for HeaderTable {
    type Err = HeaderError;

    fn from_str(text: &str) -> Result<Self, HeaderError> {
        if text.len() > MOST_BYTES {
            let fault = format!("{} bytes; a table has at most {MOST_BYTES}", text.len());
            return Err(HeaderError { line: 1, fault });
        }
        let mut reader = csv::ReaderBuilder::new()
            .flexible(true)
            .trim(csv::Trim::All)
            .from_reader(text.trim_start_matches('\u{feff}').as_bytes());
        let at = |line: u64, fault: String| HeaderError { line, fault };
        let names = reader.headers().map_err(|error| at(1, error.to_string()))?.clone();
        let mut columns = [0; 6];
        for (column, name) in columns.iter_mut().zip(COLUMNS) {
            let found = names.iter().position(|have| have.eq_ignore_ascii_case(name));
            *column = found.ok_or_else(|| at(1, format!("no column {name:?}; expected {}", COLUMNS.join(","))))?;
        }
        let (mut rows, mut repeated, mut seen) = (Vec::new(), Vec::new(), HashSet::new());
        for record in reader.records() {
            let record =
                record.map_err(|error| at(error.position().map_or(0, csv::Position::line), error.to_string()))?;
            let line = record.position().map_or(0, csv::Position::line);
            let cell = |index: usize| record.get(columns[index]).unwrap_or_default();
            if record.iter().all(str::is_empty) {
                continue;
            }
            let row = row(cell).map_err(|fault| at(line, fault))?;
            if seen.insert(row.keyword.clone()) {
                rows.push(row);
            } else {
                repeated.push(row.keyword);
            }
        }
        Ok(Self { rows, repeated })
    }
}

fn row<'a>(cell: impl Fn(usize) -> &'a str) -> Result<HeaderRow, String> {
    let keyword = cell(0).to_ascii_uppercase();
    if keyword.is_empty()
        || keyword.len() > 8
        || !keyword.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
    {
        return Err(format!("{:?} is no FITS keyword: expected 1 to 8 of A-Z, 0-9, '-', '_'", cell(0)));
    }
    let dtype = match cell(1).to_ascii_lowercase().as_str() {
        "str" => Dtype::Str,
        "int" => Dtype::Int,
        "float" => Dtype::Float,
        "bool" => Dtype::Bool,
        other => return Err(format!("{keyword}: dtype {other:?}: expected str, int, float or bool")),
    };
    let fixed = match cell(2).to_ascii_lowercase().as_str() {
        "true" | "1" => true,
        "false" | "0" => false,
        other => return Err(format!("{keyword}: fixed {other:?}: expected true or false")),
    };
    let command = cell(4).to_owned();
    let source = match cell(3) {
        "astropy_default" => Source::Library,
        "static" => Source::Static(command),
        "astra" => Source::Computed,
        "action_metadata" => Source::Metadata(command),
        kind => match kind.parse::<Kind>() {
            Ok(_) if command.is_empty() => {
                return Err(format!("{keyword}: device_command is empty: expected an ASCOM property"));
            }
            Ok(kind) => Source::Property(kind, command),
            Err(_) => {
                return Err(format!(
                    "{keyword}: device_type {kind:?}: expected an ASCOM device type, static, astra, astropy_default or action_metadata"
                ));
            }
        },
    };
    Ok(HeaderRow { keyword, dtype, fixed, source, comment: cell(5).to_owned() })
}

impl HeaderTable {
    /// Properties of a kind that device nodes poll (`fixed` false) or read on connecting (`fixed` true).
    pub fn properties(&self, kind: Kind, fixed: bool) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for row in self.rows.iter().filter(|row| row.fixed == fixed) {
            if let Source::Property(k, property) = &row.source
                && *k == kind
                && !names.contains(property)
            {
                names.push(property.clone());
            }
        }
        names
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_table_is_taken_whole() {
        let table: HeaderTable = DEFAULT_CSV.parse().unwrap();
        assert_eq!(table.rows.len(), DEFAULT_CSV.lines().filter(|line| !line.is_empty()).count() - 1);
        assert_eq!(table.properties(Kind::Camera, false), ["CCDTemperature", "CameraState"]);
        assert!(table.properties(Kind::Telescope, true).contains(&"SiteLatitude".to_owned()));
    }

    #[test]
    fn the_first_row_of_a_keyword_counts() {
        let text = "header,dtype,fixed,device_type,device_command,comment\nA,str,true,static,x,\nB,int,true,static,1,\na,int,false,Dome,Azimuth,\n";
        let table: HeaderTable = text.parse().unwrap();
        assert_eq!(table.rows.iter().map(|row| row.keyword.as_str()).collect::<Vec<_>>(), ["A", "B"]);
        assert_eq!(
            (table.rows[0].source.clone(), table.repeated),
            (Source::Static("x".to_owned()), vec!["A".to_owned()])
        );
    }

    #[test]
    fn a_bad_row_is_named_with_its_line() {
        let text = "header,dtype,fixed,device_type,device_command,comment\nA,str,true,static,x,\n,,,,,\nB,text,true,static,x,\n";
        let error = text.parse::<HeaderTable>().unwrap_err().to_string();
        assert_eq!(error, "FITS-header table, line 4: B: dtype \"text\": expected str, int, float or bool");
    }
}
