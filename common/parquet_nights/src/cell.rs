//! One value of a row, between SQLite and Parquet.

use std::cmp::Ordering;

use parquet::data_type::ByteArray;
use rusqlite::types::{ToSqlOutput, Value, ValueRef};
use units::Utc;

use crate::table::{Column, Kind};

/// Microseconds of a minute.
const MINUTE_US: i64 = 60_000_000;
/// Times in the database that are text: sorted as text they are sorted in time.
const STAMP: &str = "%Y-%m-%d %H:%M:%S.%6f";

/// A time as the database's text.
pub(crate) fn stamp(at: Utc) -> String {
    at.strftime(STAMP)
}

/// A value as a file holds it; times are microseconds since 1970 UTC.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// No value.
    Null,
    /// Text; rows with the same text may share it.
    Text(ByteArray),
    /// An integer or a time.
    Int(i64),
    /// A number.
    Real(f64),
    /// True or false.
    Bool(bool),
}

impl Cell {
    /// A text.
    pub fn text(text: &str) -> Self {
        Self::Text(ByteArray::from(text.as_bytes().to_vec()))
    }

    /// Reads a value of SQLite; the cell of the row before gives its text where both have the same. `None` where the
    /// value is not of the column's kind.
    pub(crate) fn read(value: ValueRef<'_>, column: &Column, before: Option<&Self>) -> Option<Self> {
        Some(match (value, column.kind) {
            (ValueRef::Null, _) if !column.required => Self::Null,
            (ValueRef::Text(text), Kind::Text) => match before {
                Some(Self::Text(same)) if same.data() == text => Self::Text(same.clone()),
                _ => Self::text(std::str::from_utf8(text).ok()?),
            },
            (ValueRef::Text(text), Kind::Stamp) => {
                let text = std::str::from_utf8(text).ok()?;
                let at: Utc = text.parse().ok()?;
                Self::Int(at.micros())
            }
            (ValueRef::Integer(value), Kind::Int | Kind::Micros) => Self::Int(value),
            (ValueRef::Integer(minute), Kind::Minute) => Self::Int(minute.checked_mul(MINUTE_US)?),
            (ValueRef::Integer(value @ (0 | 1)), Kind::Bool) => Self::Bool(value == 1),
            (ValueRef::Real(value), Kind::Real) => Self::Real(value),
            _ => return None,
        })
    }

    /// The value for SQLite; `None` for a text that is not UTF-8.
    pub(crate) fn to_sql(&self, kind: Kind) -> Option<ToSqlOutput<'_>> {
        Some(match (self, kind) {
            (Self::Null, _) => ToSqlOutput::Owned(Value::Null),
            (Self::Text(text), _) => ToSqlOutput::Borrowed(ValueRef::Text(text.as_utf8().ok()?.as_bytes())),
            (Self::Int(at_us), Kind::Stamp) => ToSqlOutput::Owned(Value::Text(stamp(Utc::from_micros(*at_us)))),
            (Self::Int(at_us), Kind::Minute) => ToSqlOutput::Owned(Value::Integer(at_us.div_euclid(MINUTE_US))),
            (Self::Int(value), _) => ToSqlOutput::Owned(Value::Integer(*value)),
            (Self::Real(value), _) => ToSqlOutput::Owned(Value::Real(*value)),
            (Self::Bool(value), _) => ToSqlOutput::Owned(Value::Integer((*value).into())),
        })
    }

    /// The order of keys, which is SQLite's: no value first, texts by their bytes.
    pub(crate) fn order(&self, other: &Self) -> Ordering {
        match (self, other) {
            (Self::Int(one), Self::Int(two)) => one.cmp(two),
            (Self::Text(one), Self::Text(two)) => one.data().cmp(two.data()),
            (Self::Bool(one), Self::Bool(two)) => one.cmp(two),
            (Self::Real(one), Self::Real(two)) => one.total_cmp(two),
            (one, two) => (*one != Self::Null).cmp(&(*two != Self::Null)),
        }
    }
}
