//! Flats: how long to expose as the light changes, which filter comes next, and where the Sun must stand. Decision
//! 0028.

pub mod exposure;
pub mod filter;
pub mod order;
pub mod twilight;
