//! Names of targets that are looked up online: stars and deep-sky objects by Sesame, small bodies by JPL's Horizons.
//!
//! Looked up as soon as a schedule names them, beside everything else ([`task`]), and kept on disk: a row asks what is known
//! ([`Known`]) and never the network. One whose name is not known yet rests and is tried again; all others go on.

mod horizons;
mod http;
mod sesame;
mod task;

pub use self::task::keep_looking_up;
