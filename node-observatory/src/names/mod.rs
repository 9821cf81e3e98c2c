//! Names of targets that are looked up online: stars and deep-sky objects by Sesame, small bodies by JPL's Horizons.
//!
//! A name is looked up as soon as a schedule has it, in parallel with everything else ([`task`]), and stored on disk: a
//! row asks what is known ([`schedule::names::KnownNames`](schedule::names::Known)) and never the network. A row whose name is not known
//! yet
//! rests and is tried again; all others go on.

mod horizons;
mod http;
mod sesame;
mod task;

pub use self::task::keep_looking_up;
