//! Documents that show what the code declares; `UPDATE_DOCS=1 cargo test -p contract --test documents` writes them again.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod shown;
mod whole;

use std::path::Path;

use shown::{shows, text};

#[test]
fn the_page_about_alerts_is_what_the_code_declares() {
    shows("docs/operator/alerts.md", &contract::observatory::markdown());
}

#[test]
fn the_page_about_the_bus_is_what_the_code_declares() {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("golden/v1");
    let sample = |name: &str| text(&golden.join(format!("{name}.json")));
    shows("docs/bus.md", &contract::bus_page::markdown(sample));
}

#[test]
fn the_asyncapi_document_is_what_the_code_declares() {
    let document = contract::async_api::document("v1");
    whole::is("docs/api/asyncapi.json", &(serde_json::to_string_pretty(&document).unwrap() + "\n"));
}
