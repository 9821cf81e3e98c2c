//! Faint stars beyond the catalogue: an invented sky, the same for the same seed, cell by cell.

use imaging::catalogue::{CatalogueStar, Entry, build};
use imaging::healpix::{self, FacePoint};
use sky::{Icrs, separation};
use units::Angle;

use crate::catalogue;
use crate::chance::Chance;

const ORDER: u8 = 8;
/// Where the real catalogue thins out, and where the invented sky ends.
const BRIGHTEST: f64 = 11.8;
const FAINTEST: f64 = 17.0;
/// Number counts grow as 10^(slope m); the catalogue has 46 stars per square degree to its limit.
const SLOPE: f64 = 0.35;
const PER_SQUARE_DEGREE: f64 = 2_600.0;
const SKY_SQUARE_DEGREES: f64 = 41_252.96;

/// The invented stars within a cone.
pub fn cone(seed: u64, center: Icrs, radius: Angle) -> Vec<CatalogueStar> {
    let cells = healpix::cells_in_cone(ORDER, center.ra, center.dec, radius);
    let all = cells.into_iter().flat_map(|cell| of_cell(seed, cell));
    all.filter(|star| separation(&center, &Icrs { ra: star.ra, dec: star.dec }) <= radius).collect()
}

fn of_cell(seed: u64, cell: u64) -> Vec<CatalogueStar> {
    let mut chance = Chance::new(seed, cell);
    let mean = PER_SQUARE_DEGREE * SKY_SQUARE_DEGREES / healpix::cells(ORDER) as f64;
    let count = (mean + mean.sqrt() * chance.normal()).max(0.0) as usize;
    let corner = healpix::corner(ORDER, cell);
    let side = 1.0 / f64::from(1_u32 << ORDER);
    let (low, high) = (10.0_f64.powf(SLOPE * BRIGHTEST), 10.0_f64.powf(SLOPE * FAINTEST));
    (0..count)
        .map(|_| {
            // The faces map to the sphere with equal areas, so even on the face is even on the sky.
            let (x, y) = (corner.x + side * chance.even(), corner.y + side * chance.even());
            let (ra, dec) = healpix::direction(FacePoint { face: corner.face, x, y });
            CatalogueStar { ra, dec, mag: (low + chance.even() * (high - low)).log10() / SLOPE }
        })
        .collect()
}

/// A catalogue file of a cone of this simulator's sky, real and invented stars together, at `epoch_year` (Julian).
pub fn written_out(seed: u64, center: Icrs, radius: Angle, epoch_year: f64) -> Vec<u8> {
    let real = catalogue::default().cone(center.ra, center.dec, radius, f64::INFINITY, epoch_year);
    let entries: Vec<Entry> = real
        .into_iter()
        .chain(cone(seed, center, radius))
        .map(|star| Entry { ra: star.ra, dec: star.dec, pm_ra_mas: 0.0, pm_dec_mas: 0.0, mag: star.mag })
        .collect();
    build(&entries, ORDER, epoch_year)
}

#[cfg(test)]
mod tests {
    use imaging::catalogue::Catalogue;

    use super::*;

    #[test]
    fn the_same_seed_shows_the_same_sky_from_any_cone() {
        let center = Icrs::from_degrees(83.6, 22.0);
        let wide = cone(1, center, Angle::from_degrees(0.5));
        let narrow = cone(1, Icrs::from_degrees(83.7, 22.1), Angle::from_degrees(0.1));
        assert!(narrow.len() > 40 && narrow.iter().all(|star| wide.contains(star)));
        assert!(cone(2, center, Angle::from_degrees(0.5)) != wide);
    }

    #[test]
    fn the_invented_sky_can_be_read_as_a_catalogue() {
        let center = Icrs::from_degrees(10.0, -60.0);
        let radius = Angle::from_degrees(0.2);
        let written = Catalogue::from_bytes(written_out(7, center, radius, 2026.9)).unwrap();
        let read = written.cone(center.ra, center.dec, radius, 20.0, 2026.9);
        let invented = cone(7, center, radius);
        assert!(read.len() >= invented.len() && invented.len() > 100);
        for star in &invented[..20] {
            let near = |other: &CatalogueStar| {
                let apart = separation(&Icrs { ra: star.ra, dec: star.dec }, &Icrs { ra: other.ra, dec: other.dec });
                apart.arcseconds() < 0.05 && (star.mag - other.mag).abs() < 0.011
            };
            assert!(read.iter().any(near), "{star:?}");
        }
    }
}
