//! The document that shows the tables; `UPDATE_DOCS=1 cargo test -p parquet_nights` writes it again.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

#[path = "../../contract/tests/shown/mod.rs"]
mod shown;

#[test]
fn the_document_shows_the_tables() {
    shown::shows("docs/parquet.md", &parquet_nights::document());
}
