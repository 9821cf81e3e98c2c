//! The stars of the simulated sky: the shipped catalogue, embedded, so that one binary is enough.

use std::sync::LazyLock;

use imaging::catalogue::Catalogue;

static BYTES: &[u8] = include_bytes!("../../catalogue/default.smcat");

static CATALOGUE: LazyLock<Catalogue<&'static [u8]>> = LazyLock::new(|| {
    #[allow(clippy::expect_used, reason = "the embedded file is part of the source, and a test opens it")]
    Catalogue::from_bytes(BYTES).expect("the embedded catalogue is sound")
});

/// The catalogue that Starmesh ships (`catalogue/default.smcat`).
pub fn default() -> &'static Catalogue<&'static [u8]> {
    &CATALOGUE
}
