//! The known word that a misspelt one was probably meant to be.

pub use config::{distance, meant, nearest};
