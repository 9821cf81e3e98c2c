//! One file per page or document.

pub mod frames;
pub mod health;
pub mod heartbeat;
pub mod history;
pub mod legacy;
pub mod lite;
pub mod login;
pub mod metrics;
pub mod network;
pub mod page;
pub mod parts;
pub mod preview;
pub mod push;
pub mod records;
pub mod reports;
pub mod sessions;
pub mod sky;
pub mod test_messages;
pub mod tokens;
pub mod users;
