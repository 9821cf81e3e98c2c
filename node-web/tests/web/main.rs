//! Web nodes on a real bus, asked by HTTP clients.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test ends by panicking")]

mod api_document_is_true;
mod asks_who_it_is;
mod commands_are_given_once;
mod drafts_become_schedules;
mod errors_are_problems;
mod every_endpoint_asks_for_its_right;
mod follows_its_files;
mod frames_are_asked_of_the_archive;
mod heartbeat_answers_what_scripts_know;
mod history_is_asked_of_the_archive;
mod legacy_addresses_answer_as_astra_did;
mod limits_what_one_can_use;
mod parts_and_metrics_are_fresh_or_absent;
mod pushes_alerts_to_browsers;
mod sends_test_messages;
mod serves_page_image_and_socket;
mod stage;
mod users_are_changed_by_an_engineer;
mod withstands_strangers;
