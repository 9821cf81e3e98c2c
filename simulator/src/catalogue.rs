//! The stars of the simulated sky: the shipped catalogue, which is part of the program.

use imaging::catalogue::Catalogue;

/// The catalogue that Starmesh ships (`catalogue/default.smcat`).
pub fn default() -> &'static Catalogue<&'static [u8]> {
    ::catalogue::shipped()
}
