//! All tables of the files.

mod focus;
mod frames;
mod happenings;
mod records;
mod telemetry;

pub(crate) use records::{GATHER_AUDIT, ORDER_AUDIT};

use crate::table::{Column, Kind, Table};

/// Each table of the database that is handed over. What is left out: `writing` (names of files that are being written)
/// and `days`, which is found again from the values.
pub static TABLES: [Table; 14] = [
    telemetry::TELEMETRY,
    telemetry::MINUTES,
    frames::IMAGES,
    frames::FACTS,
    frames::GUIDING,
    focus::FOCUS_RUNS,
    focus::FOCUS_POINTS,
    records::LOG,
    records::AUDIT,
    happenings::STATES,
    happenings::SCHEDULE_ROWS,
    happenings::ALERTS,
    happenings::SERIES_STARS,
    happenings::FLUXES,
];

/// What was written of each night, as the last of its files: a night that has it is whole.
pub static NIGHTS: Table = Table {
    name: "nights",
    about: "each table that has rows of the night",
    columns: &[
        given("table_name", Kind::Text, "the table"),
        given("rows", Kind::Int, "its rows of this night"),
        given("night_from", Kind::Micros, "local mean noon at which the night begins"),
        given("night_to", Kind::Micros, "local mean noon at which it ends"),
    ],
    key: 1,
    group: 0,
    prefer: None,
    from: "",
    next: None,
    insert: None,
    into: "",
    owner: None,
    before: None,
};

/// A column that has a value in every row, and the same name in the database.
const fn given(name: &'static str, kind: Kind, about: &'static str) -> Column {
    Column { name, sql: name, kind, required: true, derived: false, about }
}

/// A column that may have no value.
const fn maybe(name: &'static str, kind: Kind, about: &'static str) -> Column {
    Column { name, sql: name, kind, required: false, derived: false, about }
}

impl Column {
    /// The same column under another name in the database, or read by an expression.
    const fn read_by(self, sql: &'static str) -> Self {
        Self { sql, ..self }
    }

    /// A column that repeats a part of another one.
    const fn derived_by(self, sql: &'static str) -> Self {
        Self { sql, derived: true, ..self }
    }
}
