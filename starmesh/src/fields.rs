//! Targets of the demo and of the schedule that `init` writes: places of catalogues, to 0.1 arcsec.
//!
//! Stars are hosts of transiting planets, with place, epoch and proper motion of the catalogue of which the shipped one is made
//! (Gaia DR3; Tycho-2 at epoch 2000.0 where that has none), so that each is on the frame, where a light curve finds it. All others
//! are places of OpenNGC.

use imaging::catalogue::Entry;
use units::{Angle, Utc};

/// A target.
#[derive(Debug, Clone, Copy)]
pub struct NamedField {
    /// Its name.
    pub name: &'static str,
    /// Right ascension at its epoch, ICRS, degrees.
    ra_deg: f64,
    /// Declination at its epoch, ICRS, degrees.
    dec_deg: f64,
    /// Epoch of its place, Julian year.
    epoch_year: f64,
    /// Proper motion in right ascension times cos(dec), and in declination, mas per year; 0 where the catalogue has none.
    motion_mas: [f64; 2],
    /// Stars stand close together: a field for looking at, and a bad first one to point at.
    pub is_crowded: bool,
    /// The longest exposure that does not saturate a bright target, s: by the simulated camera's full well and 350 mm aperture.
    pub exptime_s: f64,
}

impl NamedField {
    /// Where it is at a time: right ascension and declination, ICRS, degrees, to 4 mas.
    pub fn place(&self, at: Utc) -> [f64; 2] {
        let [ra, dec] = [self.ra_deg, self.dec_deg].map(Angle::from_degrees);
        let [pm_ra_mas, pm_dec_mas] = self.motion_mas;
        let there = Entry { ra, dec, pm_ra_mas, pm_dec_mas, mag: 0.0 }.after(julian_year(at) - self.epoch_year);
        // Rows of a schedule are read by people.
        [there.ra, there.dec].map(|angle| (angle.degrees() * 1e6).round() / 1e6)
    }
}

fn julian_year(at: Utc) -> f64 {
    2000.0 + (at.jd() - 2_451_545.0) / 365.25
}

/// Where nothing bright is meant, s.
const USUAL_S: f64 = 120.0;

const fn sparse(name: &'static str, ra_deg: f64, dec_deg: f64) -> NamedField {
    let (epoch_year, motion_mas) = (2000.0, [0.0, 0.0]);
    NamedField { name, ra_deg, dec_deg, epoch_year, motion_mas, is_crowded: false, exptime_s: USUAL_S }
}

/// A star that is the target itself, with its place at epoch 2016.0.
const fn star(name: &'static str, ra_deg: f64, dec_deg: f64, motion_mas: [f64; 2], exptime_s: f64) -> NamedField {
    NamedField { name, ra_deg, dec_deg, epoch_year: 2016.0, motion_mas, is_crowded: false, exptime_s }
}

const fn crowded(name: &'static str, ra_deg: f64, dec_deg: f64) -> NamedField {
    NamedField { is_crowded: true, ..sparse(name, ra_deg, dec_deg) }
}

/// Where nothing is known of a place.
pub const M_78: NamedField = sparse("M 78", 86.690917, 0.079306);

/// All of them.
pub const FIELDS: [NamedField; 24] = [
    crowded("47 Tuc", 6.022333, -72.081444),
    sparse("M 31", 10.684792, 41.269056),
    sparse("NGC 253", 11.888, -25.288222),
    star("WASP-18", 24.3544669, -45.6777908, [26.52, 18.79], 5.0),
    star("WASP-33", 36.7127373, 37.5504428, [-1.26, -9.22], 2.0),
    star("WASP-79", 66.3709016, -30.6004358, [-0.27, 0.74], 10.0),
    sparse("NGC 1647", 71.481542, 19.095111),
    M_78,
    NamedField { epoch_year: 2000.0, ..star("WASP-121", 107.6002426, -39.097374, [0.0, 0.0], 15.0) },
    crowded("NGC 2360", 109.429667, -15.641306),
    crowded("NGC 2516", 119.529417, -60.753472),
    crowded("NGC 2506", 120.007417, -10.769639),
    star("WASP-166", 144.8750965, -20.9824175, [-53.45, 11.3], 5.0),
    // The nebula; the star Eta Carinae is 11 arcmin from there.
    crowded("NGC 3372", 161.285542, -59.866694),
    sparse("M 104", 189.997625, -11.623056),
    crowded("Omega Cen", 201.691208, -47.476861),
    sparse("NGC 5460", 211.865875, -48.342528),
    crowded("M 4", 245.8975, -26.525528),
    crowded("M 7", 268.46325, -34.792833),
    crowded("M 22", 279.100833, -23.903417),
    star("HAT-P-11", 297.7102026, 48.0818958, [127.2, 231.23], 5.0),
    crowded("M 2", 323.362542, -0.823306),
    star("HD 209458", 330.7950263, 18.8842394, [28.55, -18.81], 1.0),
    sparse("NGC 7293", 337.410708, -20.837333),
];

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A star beside its place is out of the aperture, or out of the frame.
    pub fn is_star_of_catalogue([ra_deg, dec_deg]: [f64; 2], at: Utc) -> bool {
        let [ra, dec, radius] = [ra_deg, dec_deg, 0.1 / 3600.0].map(Angle::from_degrees);
        catalogue::shipped().cone(ra, dec, radius, 12.0, julian_year(at)).len() == 1
    }

    pub fn is_star(name: &str) -> bool {
        ["WASP", "HAT-P", "HD "].iter().any(|word| name.starts_with(word))
    }

    #[test]
    fn each_star_is_where_the_shipped_catalogue_has_it_at_any_time() {
        for year in [2000, 2016, 2026, 2040] {
            let at: Utc = format!("{year}-11-27T03:00:00Z").parse().unwrap();
            let stars: Vec<_> = FIELDS.iter().filter(|field| is_star(field.name)).collect();
            let elsewhere = stars.iter().filter(|star| !is_star_of_catalogue(star.place(at), at));
            let elsewhere: Vec<&str> = elsewhere.map(|star| star.name).collect();
            assert!(stars.len() == 7 && elsewhere.is_empty(), "{year}: {elsewhere:?}");
        }
    }

    /// Half an arcsecond since Gaia's epoch, 0.9 since 2000.0.
    #[test]
    fn a_star_is_where_its_proper_motion_has_brought_it() {
        let field = FIELDS.iter().find(|field| field.name == "WASP-18").unwrap();
        let place = |time: &str| field.place(time.parse().unwrap());
        assert_eq!(place("2000-01-01T12:00:00Z"), [24.354298, -45.677874]);
        assert_eq!(place("2016-01-01T12:00:00Z"), [24.354467, -45.677791]);
        assert_eq!(place("2026-11-27T03:00:00Z"), [24.354582, -45.677734]);
    }

    /// `target-saturated` would be told of a field that is an example to copy.
    #[test]
    fn no_star_where_a_field_points_saturates_in_its_exposure() {
        let at = "2026-11-27T03:00:00Z".parse().unwrap();
        let mut too_long = Vec::new();
        for field in FIELDS {
            let [ra_deg, dec_deg] = field.place(at);
            let [ra, dec, radius] = [ra_deg, dec_deg, 40.0 / 3600.0].map(Angle::from_degrees);
            for star in catalogue::shipped().cone(ra, dec, radius, 14.0, julian_year(at)) {
                // A star of 10.5 mag saturates in some 20 s.
                if field.exptime_s > 20.0 * 10.0_f64.powf(0.4 * (star.mag - 10.5)) {
                    too_long.push((field.name, field.exptime_s, star.mag));
                }
            }
        }
        assert!(too_long.is_empty(), "{too_long:?}");
    }
}
