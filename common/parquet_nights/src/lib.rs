//! The network's archive: the tables of a site's database as one Parquet file for each table and night, and a database
//! filled again from such files.
//!
//! [`TABLES`] declares each table once: its columns for readers ([`document`]), how they are read from SQLite
//! ([`write_night`]) and put back ([`refill`]). A file is at
//! `TABLE/site=SITE/telescope=TELESCOPE/night=YYYYMMDD/part-0.parquet` ([`Partition`]), so that engines find a night
//! without opening files.
//!
//! # Invariants
//!
//! - A file appears under its name only when it is whole and on disk: `a_disk_that_takes_nothing_leaves_the_file_of_before`.
//! - A file never loses rows: those that the database has no more stay in it:
//!   `what_the_database_has_forgotten_stays_in_the_file`; nor is one replaced that cannot be looked at now:
//!   `a_file_that_lies_on_a_disk_that_is_away_is_not_replaced`.
//! - What comes back is what was there: `a_database_that_is_filled_again_is_the_one_of_before`
//!   (`node-archive/src/parquet/tests.rs`).
//! - Memory is bounded by a row group, whatever the night: [`ROWS_OF_A_GROUP`].

mod cell;
mod document;
mod error;
mod night;
mod partition;
mod read;
mod refill;
mod table;
mod tables;
mod write;

pub use cell::Cell;
pub use document::document;
pub use error::ParquetError;
pub use night::{NightSpan, Outcome, PartReport, nights_with_data, write_night};
pub use partition::Partition;
pub use read::PartReader;
pub use refill::{Refilled, refill};
pub use table::{Column, Kind, Table};
pub use tables::{NIGHTS, TABLES};
pub use write::{PartWriter, ROWS_OF_A_GROUP};
