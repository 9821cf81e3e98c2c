//! The catalogue that is part of the program, so that one binary is enough.

use std::sync::LazyLock;

use imaging::catalogue as packed;

use crate::Catalogue;

static BYTES: &[u8] = include_bytes!("../../../catalogue/default.smcat");

static SHIPPED: LazyLock<packed::Catalogue<&'static [u8]>> = LazyLock::new(|| {
    #[allow(clippy::expect_used, reason = "the embedded file is part of the source, and a test opens it")]
    packed::Catalogue::from_bytes(BYTES).expect("the embedded catalogue is sound")
});

/// The catalogue that Starmesh ships (`catalogue/default.smcat`): the whole sky, to about magnitude 11 to 12.5.
pub fn shipped() -> &'static packed::Catalogue<&'static [u8]> {
    &SHIPPED
}

impl Catalogue {
    /// The catalogue that Starmesh ships.
    pub fn of_program() -> Self {
        Self::Embedded(shipped().clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_catalogue_opens_and_knows_the_whole_sky() {
        let catalogue = Catalogue::of_program();
        assert!(catalogue.stars().is_some_and(|stars| stars > 1_000_000), "{:?}", catalogue.stars());
        for (ra, dec) in [(0.0, 89.0), (78.6, -8.2), (266.4, -29.0), (150.0, -70.0)] {
            let angle = units::Angle::from_degrees;
            let near = catalogue.cone(angle(ra), angle(dec), angle(0.5), 12.5, 2026.9).unwrap();
            assert!(near.len() > 5, "{} stars at {ra} {dec}", near.len());
        }
    }
}
