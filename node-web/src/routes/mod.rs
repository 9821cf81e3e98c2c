//! One file per page or document.

pub mod health;
pub mod heartbeat;
pub mod network;
pub mod page;
pub mod preview;
