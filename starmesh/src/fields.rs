//! Targets of the demo and of the schedule that `init` writes: places of catalogues, to 0.1 arcsec.
//!
//! Stars are hosts of transiting planets, with their places at epoch 2000.0 by the catalogue that is shipped (Gaia DR3 and
//! Tycho-2), so that each is on the frame, where a light curve finds it. All others are places of OpenNGC.

/// A target.
#[derive(Debug, Clone, Copy)]
pub struct NamedField {
    /// Its name.
    pub name: &'static str,
    /// Right ascension, ICRS, degrees.
    pub ra_deg: f64,
    /// Declination, ICRS, degrees.
    pub dec_deg: f64,
    /// Stars stand close together: a field for looking at, and a bad first one to point at.
    pub is_crowded: bool,
    /// The longest exposure that does not saturate a bright target, s: by the simulated camera's full well and 350 mm aperture.
    pub exptime_s: f64,
}

/// Where nothing bright is meant, s.
const USUAL_S: f64 = 120.0;

const fn sparse(name: &'static str, ra_deg: f64, dec_deg: f64) -> NamedField {
    NamedField { name, ra_deg, dec_deg, is_crowded: false, exptime_s: USUAL_S }
}

/// A star that is the target itself.
const fn star(name: &'static str, ra_deg: f64, dec_deg: f64, exptime_s: f64) -> NamedField {
    NamedField { name, ra_deg, dec_deg, is_crowded: false, exptime_s }
}

const fn crowded(name: &'static str, ra_deg: f64, dec_deg: f64) -> NamedField {
    NamedField { name, ra_deg, dec_deg, is_crowded: true, exptime_s: USUAL_S }
}

/// Where nothing is known of a place.
pub const M_78: NamedField = sparse("M 78", 86.690917, 0.079306);

/// All of them.
pub const FIELDS: [NamedField; 24] = [
    crowded("47 Tuc", 6.022333, -72.081444),
    sparse("M 31", 10.684792, 41.269056),
    sparse("NGC 253", 11.888, -25.288222),
    star("WASP-18", 24.354298, -45.677874, 5.0),
    star("WASP-33", 36.712744, 37.550484, 2.0),
    star("WASP-79", 66.370903, -30.600439, 10.0),
    sparse("NGC 1647", 71.481542, 19.095111),
    M_78,
    star("WASP-121", 107.600243, -39.097374, 15.0),
    crowded("NGC 2360", 109.429667, -15.641306),
    crowded("NGC 2516", 119.529417, -60.753472),
    crowded("NGC 2506", 120.007417, -10.769639),
    star("WASP-166", 144.875351, -20.982468, 5.0),
    crowded("Eta Carinae", 161.285542, -59.866694),
    sparse("M 104", 189.997625, -11.623056),
    crowded("Omega Cen", 201.691208, -47.476861),
    sparse("NGC 5460", 211.865875, -48.342528),
    crowded("M 4", 245.8975, -26.525528),
    crowded("M 7", 268.46325, -34.792833),
    crowded("M 22", 279.100833, -23.903417),
    star("HAT-P-11", 297.709356, 48.080868, 5.0),
    crowded("M 2", 323.362583, -0.82325),
    star("HD 209458", 330.794892, 18.884323, 1.0),
    sparse("NGC 7293", 337.410583, -20.837111),
];

#[cfg(test)]
mod tests {
    use units::Angle;

    use super::*;

    /// A star beside its place is out of the aperture, or out of the frame.
    #[test]
    fn each_star_is_where_the_shipped_catalogue_has_it() {
        let mut count = 0;
        for field in
            FIELDS.iter().filter(|field| ["WASP", "HAT-P", "HD "].iter().any(|word| field.name.starts_with(word)))
        {
            let [ra, dec, radius] = [field.ra_deg, field.dec_deg, 0.1 / 3600.0].map(Angle::from_degrees);
            let near = catalogue::shipped().cone(ra, dec, radius, 12.0, 2000.0);
            assert_eq!(near.len(), 1, "{}", field.name);
            count += 1;
        }
        assert_eq!(count, 7);
    }

    /// `target-saturated` would be told of a field that is an example to copy.
    #[test]
    fn no_star_where_a_field_points_saturates_in_its_exposure() {
        let mut too_long = Vec::new();
        for field in FIELDS {
            let [ra, dec, radius] = [field.ra_deg, field.dec_deg, 40.0 / 3600.0].map(Angle::from_degrees);
            for star in catalogue::shipped().cone(ra, dec, radius, 14.0, 2026.9) {
                // A star of 10.5 mag saturates in some 20 s.
                if field.exptime_s > 20.0 * 10.0_f64.powf(0.4 * (star.mag - 10.5)) {
                    too_long.push((field.name, field.exptime_s, star.mag));
                }
            }
        }
        assert!(too_long.is_empty(), "{too_long:?}");
    }
}
