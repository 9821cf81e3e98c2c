//! The document that shows the actions; `UPDATE_DOCS=1 cargo test -p schedule` writes it again.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

#[path = "../../contract/tests/shown/mod.rs"]
mod shown;

#[test]
fn the_page_about_the_schedule_is_what_the_actions_declare() {
    shown::shows("docs/operator/schedule.md", &schedule::action::page());
}
