//! The reader against stars that are known, and against a search through all of them.

use std::time::Instant;

use super::*;

fn deg(d: f64) -> Angle {
    Angle::from_degrees(d)
}

fn apart_arcsec(u: [f64; 3], v: [f64; 3]) -> f64 {
    let chord = (0..3).map(|i| (u[i] - v[i]).powi(2)).sum::<f64>().sqrt();
    Angle::from_radians(2.0 * (0.5 * chord).asin()).arcseconds()
}

/// Stars all over the sky, spread by a low-discrepancy walk.
fn drawn() -> Vec<Entry> {
    (0..60_000)
        .map(|i| {
            let i = f64::from(i);
            Entry {
                ra: deg(i * 137.507_764_05 % 360.0),
                dec: Angle::from_radians((1.0 - 2.0 * ((i * 0.754_877_666 + 0.5) % 1.0)).asin()),
                pm_ra_mas: ((i * 7.3) % 2400.0) - 1200.0,
                pm_dec_mas: ((i * 3.1) % 1800.0) - 900.0,
                mag: (i * 0.618_033_98) % 1.0 * 18.0 - 1.0,
            }
        })
        .collect()
}

#[test]
fn a_cone_agrees_with_a_search_through_all_stars() {
    let entries = drawn();
    let catalogue = Catalogue::from_bytes(build(&entries, 6, 2016.0)).unwrap();
    assert_eq!(catalogue.len(), entries.len());
    for (ra, dec, radius, limit) in
        [(10.0, 20.0, 2.0, 20.0), (0.01, -0.3, 3.0, 9.0), (200.0, 89.9, 4.0, 12.0), (77.0, -88.0, 5.0, 15.0)]
    {
        let years = 10.9;
        let axis = unit(deg(ra), deg(dec));
        let mut expected: Vec<[f64; 3]> = entries
            .iter()
            .filter(|e| ((e.mag + 2.0) * 50.0).round() <= ((limit + 2.0) * 50.0_f64).round())
            .map(|e| {
                moved(
                    [e.ra.sin(), e.ra.cos(), e.dec.sin(), e.dec.cos()],
                    e.pm_ra_mas.round() * years,
                    e.pm_dec_mas.round() * years,
                )
            })
            .filter(|at| apart_arcsec(*at, axis) <= radius * 3600.0)
            .collect();
        let mut found: Vec<[f64; 3]> = catalogue
            .cone(deg(ra), deg(dec), deg(radius), limit + 1e-9, 2016.0 + years)
            .iter()
            .map(|star| unit(star.ra, star.dec))
            .collect();
        expected.sort_by(|a, b| a[0].total_cmp(&b[0]));
        found.sort_by(|a, b| a[0].total_cmp(&b[0]));
        assert_eq!(found.len(), expected.len(), "around {ra} {dec}");
        assert!(found.len() > 5);
        for (a, b) in found.iter().zip(&expected) {
            assert!(apart_arcsec(*a, *b) < 0.06, "{a:?} {b:?}");
        }
    }
}

#[test]
fn damaged_bytes_are_refused() {
    let good = build(&drawn()[..500], 3, 2000.0);
    assert!(Catalogue::from_bytes(&good).is_ok());
    assert_eq!(Catalogue::from_bytes(&good[..20]).unwrap_err(), CatalogueError::Format);
    assert!(matches!(Catalogue::from_bytes(&good[..good.len() - 1]), Err(CatalogueError::Damaged(_))));
    let mut shuffled = good.clone();
    shuffled[HEADER + 400] ^= 0xFF;
    assert!(matches!(Catalogue::from_bytes(&shuffled), Err(CatalogueError::Damaged(_))));
    let mut other = good;
    other[7] = 2;
    assert_eq!(Catalogue::from_bytes(&other).unwrap_err(), CatalogueError::Format);
}

#[test]
fn the_same_stars_give_the_same_bytes_in_any_order() {
    let mut entries = drawn();
    let bytes = build(&entries, 5, 2016.0);
    entries.reverse();
    assert!(build(&entries, 5, 2016.0) == bytes);
}

fn shipped() -> Catalogue<&'static [u8]> {
    Catalogue::from_bytes(&include_bytes!("../../../../catalogue/default.smcat")[..]).unwrap()
}

#[test]
fn bright_stars_of_the_shipped_catalogue_are_where_they_should_be() {
    // ICRS at epoch J2000.0: Hipparcos-2 (van Leeuwen 2007), as SIMBAD gives it
    for (name, ra, dec, faintest) in [
        ("Sirius", 101.287_155, -16.716_116, 0.0),
        ("Vega", 279.234_735, 38.783_689, 0.5),
        ("Polaris", 37.954_561, 89.264_109, 2.5),
        ("Arcturus", 213.915_300, 19.182_409, 0.5),
        ("Canopus", 95.987_958, -52.695_661, 0.0),
        ("Barnard's star", 269.452_076, 4.693_391, 10.0),
    ] {
        let stars = shipped().cone(deg(ra), deg(dec), Angle::from_arcseconds(1.0), faintest, 2000.0);
        let near = shipped().cone(deg(ra), deg(dec), Angle::from_arcseconds(60.0), faintest, 2000.0);
        assert_eq!((stars.len(), near.len()), (1, 1), "{name}: {near:?}");
    }
}

#[test]
fn the_shipped_catalogue_covers_the_whole_sky() {
    let catalogue = shipped();
    let mut poorest = usize::MAX;
    let (mut longest, mut total) = (0.0_f64, 0.0);
    for i in 0..400 {
        let (ra, dec) = (f64::from(i) * 137.507_764, (1.0 - 2.0 * (f64::from(i) + 0.5) / 400.0).asin().to_degrees());
        let started = Instant::now();
        let stars = catalogue.cone(deg(ra), deg(dec), deg(1.0), 20.0, 2026.9);
        let took = started.elapsed().as_secs_f64() * 1e3;
        (longest, total) = (longest.max(took), total + took);
        poorest = poorest.min(stars.len());
    }
    println!("cone of 1 deg: mean {:.3} ms, longest {longest:.3} ms; poorest field {poorest} stars", total / 400.0);
    assert!(poorest >= 20, "{poorest}");
}

#[test]
fn pieces_of_the_sky_give_the_same_bytes_as_the_whole() {
    let entries = drawn();
    let mut pieces = Pieces::new(5, 2016.0);
    let cells = healpix::cells(5);
    let records: Vec<u8> = (0..48).flat_map(|n| pieces.add(n * cells / 48..(n + 1) * cells / 48, &entries)).collect();
    assert_eq!(pieces.head().len(), pieces.head_length());
    assert!([pieces.head(), records, pieces.tail()].concat() == build(&entries, 5, 2016.0));
}

#[test]
fn the_order_follows_the_density_and_never_costs_places_or_a_large_index() {
    assert_eq!([0, 1000, 1_900_000, 16_000_000, 297_000_000].map(|stars| order_for(stars, 1.0)), [7, 7, 7, 9, 11]);
    assert_eq!(order_for(5000, 1e-4), 9, "the stars of one field, however dense");
    assert_eq!(order_for(5000, f64::NAN), 7);
}

#[test]
fn a_star_is_moved_along_its_great_circle_even_over_the_pole() {
    let star = Entry { ra: deg(10.0), dec: deg(89.999), pm_ra_mas: 0.0, pm_dec_mas: 7200.0, mag: 5.0 };
    // 3.6" from the pole and 7.2" northwards: as far beyond it, on the other side
    let there = star.after(1.0);
    assert!((there.ra.degrees() - 190.0).abs() < 1e-3 && (there.dec.degrees() - 89.999).abs() < 1e-8, "{there:?}");
    // it came northwards and leaves southwards, along the same circle
    assert!((there.pm_dec_mas + 7200.0).abs() < 1e-3 && there.pm_ra_mas.abs() < 0.2, "{there:?}");
    let back = there.after(-1.0);
    assert!((back.dec.degrees() - 89.999).abs() < 1e-9 && (back.pm_dec_mas - 7200.0).abs() < 1e-3, "{back:?}");
}
