//! Compares every kind of source with numbers that are computed here, by the plain formulae of spherical trigonometry.
#![allow(clippy::unwrap_used, clippy::panic)]
#![allow(missing_docs)]

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use catalogue::{Band, Catalogue, Kind, Reading, Sorter, Tally, each_star};
use rusqlite::{Connection, params};
use tempfile::TempDir;
use units::Angle;

/// ra, dec (deg), pmra (with cos dec), pmdec (mas/yr; none: unknown), G, J.
type Known = (f64, f64, Option<(f64, f64)>, f64, f64);

/// Barnard's star and others that go wrong easily: at RA 0, at a pole, at a whole degree, without proper motion, fast
/// at high declination.
const STARS: [Known; 8] = [
    (269.448_503, 4.739_420, Some((-801.551, 10_362.394)), 8.19, 5.24),
    (359.999_995, 12.3, Some((150.0, -20.0)), 10.0, 9.0),
    (0.000_003, 12.301, Some((-150.0, 20.0)), 10.5, 9.4),
    (123.0, 89.995, Some((500.0, 900.0)), 11.0, 10.2),
    (77.0, -89.996, None, 12.0, 11.1),
    (210.0, 30.0, None, 13.0, 12.0),
    (45.0, 75.0, Some((2000.0, -1000.0)), 9.5, 8.3),
    (300.25, -45.5, Some((3.0, -4.0)), 14.25, 13.5),
];

fn deg(d: f64) -> Angle {
    Angle::from_degrees(d)
}

/// Where a star stands after so many years: the great circle that it moves along, in the vectors of the sky.
fn moved((ra, dec, motion, ..): Known, years: f64) -> [f64; 3] {
    let (a, d) = (ra.to_radians(), dec.to_radians());
    let (pm_a, pm_d) = motion.unwrap_or_default();
    let (east, north) = ((pm_a * years / 3.6e6).to_radians(), (pm_d * years / 3.6e6).to_radians());
    let way = east.hypot(north);
    let at = [d.cos() * a.cos(), d.cos() * a.sin(), d.sin()];
    if way == 0.0 {
        return at;
    }
    let to_east = [-a.sin(), a.cos(), 0.0];
    let to_north = [-d.sin() * a.cos(), -d.sin() * a.sin(), d.cos()];
    std::array::from_fn(|i| at[i] * way.cos() + (to_east[i] * east + to_north[i] * north) / way * way.sin())
}

fn vector(ra: Angle, dec: Angle) -> [f64; 3] {
    [dec.cos() * ra.cos(), dec.cos() * ra.sin(), dec.sin()]
}

fn apart_arcsec(u: [f64; 3], v: [f64; 3]) -> f64 {
    let chord = (0..3).map(|i| (u[i] - v[i]).powi(2)).sum::<f64>().sqrt();
    (2.0 * (0.5 * chord).asin()).to_degrees() * 3600.0
}

/// A Gaia-2MASS file as sites have it; with `dr3` columns as later ones.
fn sqlite(folder: &Path, dr3: bool) -> PathBuf {
    let path = folder.join(if dr3 { "gaia_dr3.db" } else { "gaia_tmass_16_jm_cut.db" });
    let file = Connection::open(&path).unwrap();
    let more = if dr3 { ", phot_bp_mean_mag REAL, phot_rp_mean_mag REAL" } else { "" };
    for d in -90..90 {
        let table = format!(
            "CREATE TABLE `{d}_{}` (ra REAL, dec REAL, pmra REAL, pmdec REAL, phot_g_mean_mag REAL, j_m REAL{more})",
            d + 1
        );
        file.execute(&table, []).unwrap();
    }
    for (ra, dec, motion, g, j) in STARS {
        let d = (dec.floor() as i32).min(89);
        let insert =
            format!("INSERT INTO `{d}_{}` (ra, dec, pmra, pmdec, phot_g_mean_mag, j_m) VALUES (?,?,?,?,?,?)", d + 1);
        match motion {
            Some((a, b)) => file.execute(&insert, params![ra, dec, a, b, g, j]).unwrap(),
            // An unknown value is empty text.
            None => file.execute(&insert, params![ra, dec, "", "", g, j]).unwrap(),
        };
    }
    path
}

fn csv(folder: &Path, text: &str) -> PathBuf {
    let path = folder.join("table.csv");
    std::fs::write(&path, text).unwrap();
    path
}

/// A FITS binary table with a string column between, places in doubles, an epoch of each star.
fn fits(folder: &Path) -> PathBuf {
    let mut bytes = Vec::new();
    let mut header = |cards: &[&str]| {
        let start = bytes.len();
        cards.iter().chain([&"END"]).for_each(|card| bytes.extend(format!("{card:80}").bytes()));
        bytes.resize(start + (bytes.len() - start).div_ceil(2880) * 2880, b' ');
    };
    header(&["SIMPLE  =                    T", "BITPIX  =                    8", "NAXIS   =                    0"]);
    let rows = format!("NAXIS2  = {:20}", STARS.len());
    header(&[
        "XTENSION= 'BINTABLE'",
        "BITPIX  =                    8",
        "NAXIS   =                    2",
        "NAXIS1  =                   41",
        &rows,
        "PCOUNT  =                    0",
        "GCOUNT  =                    1",
        "TFIELDS =                    7",
        "TTYPE1  = 'NAME'",
        "TFORM1  = '3A'",
        "TTYPE2  = 'RA'",
        "TFORM2  = 'D'",
        "TUNIT2  = 'deg'",
        "TTYPE3  = 'DEC'",
        "TFORM3  = '1D'",
        "TUNIT3  = 'deg'",
        "TTYPE4  = 'pmRA'",
        "TFORM4  = 'J'",
        "TUNIT4  = 'mas/yr'",
        "TSCAL4  = 1E-3",
        "TNULL4  = -2147483648",
        "TTYPE5  = 'pmDEC'",
        "TFORM5  = 'D'",
        "TUNIT5  = 'mas.yr-1'",
        "TTYPE6  = 'MAG'",
        "TFORM6  = 'E'",
        "TTYPE7  = 'EPOCH'",
        "TFORM7  = 'I'",
    ]);
    for (n, star) in STARS.iter().enumerate() {
        let (_, dec, motion, g, _) = *star;
        // Every other star as it stood at 2000; at the pole the directions of its motion would be others then.
        let year = if n % 2 == 0 || dec > 89.0 { 2016 } else { 2000 };
        let at = moved(*star, f64::from(year) - 2016.0);
        let (ra, dec) = (at[1].atan2(at[0]).to_degrees(), at[2].atan2(at[0].hypot(at[1])).to_degrees());
        bytes.extend(b"abc");
        bytes.extend(ra.to_be_bytes());
        bytes.extend(dec.to_be_bytes());
        bytes.extend(motion.map_or(i32::MIN, |(a, _)| (a * 1000.0).round() as i32).to_be_bytes());
        bytes.extend(motion.map_or(f64::NAN, |(_, d)| d).to_be_bytes());
        bytes.extend((g as f32).to_be_bytes());
        bytes.extend((year as i16).to_be_bytes());
    }
    // 3 + 8 + 8 + 4 + 8 + 4 + 2 bytes, and 4 that no column describes.
    let first = bytes.len() - 37 * STARS.len();
    let mut wide = bytes[..first].to_vec();
    bytes[first..].chunks(37).for_each(|row| wide.extend([row, &[0; 4]].concat()));
    wide.resize(wide.len().div_ceil(2880) * 2880, 0);
    let path = folder.join("table.fits.gz");
    let mut packed = flate2::write::GzEncoder::new(std::fs::File::create(&path).unwrap(), flate2::Compression::fast());
    packed.write_all(&wide).unwrap();
    packed.finish().unwrap();
    path
}

fn built(folder: &Path, source: &Path, reading: &Reading) -> (Catalogue, Tally) {
    let out = folder.join("out.smcat");
    let mut sorter = Sorter::new(&out).unwrap();
    let tally = each_star(source, reading, &mut |entry| sorter.take(&entry)).unwrap();
    let made = sorter.finish().unwrap();
    assert_eq!(u64::from(made.stars), tally.stars);
    (Catalogue::open(&out, &Reading::default()).unwrap(), tally)
}

/// Checks each star alone in a circle around its expected place, at several epochs.
fn judge(catalogue: &Catalogue, source_epoch: f64, tolerance_arcsec: f64) {
    for star in STARS {
        for year in [2000.0, 2016.0, 2026.89, 2050.0] {
            let expected = moved(star, year - source_epoch);
            let ra = Angle::from_radians(expected[1].atan2(expected[0])).wrapped_positive();
            let dec = Angle::from_radians(expected[2].atan2(expected[0].hypot(expected[1])));
            let found = catalogue.cone(ra, dec, Angle::from_arcseconds(20.0), 20.0, year).unwrap();
            let near: Vec<f64> = found.iter().map(|s| apart_arcsec(vector(s.ra, s.dec), expected)).collect();
            let own = near.iter().filter(|off| **off < tolerance_arcsec).count();
            assert_eq!(own, 1, "{star:?} in {year}: {near:?} arcsec off");
        }
    }
}

#[test]
fn each_star_of_each_source_stands_in_its_place_at_any_epoch_and_none_is_lost() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    let table = |motion: Option<(f64, f64)>| motion.map_or(",".to_owned(), |(a, d)| format!("{a},{d}"));
    let lines: String = STARS.iter().map(|(ra, dec, m, g, _)| format!("{ra},{dec},{},{g}\n", table(*m))).collect();
    let csv = csv(folder, &format!("# mine\nRA, Dec, pmra, pmdec, mag\n{lines}"));
    // The motion is rounded to 1 mas/yr and the place to 0.013": 34 years.
    for (source, epoch) in
        [(sqlite(folder, false), 2015.5), (sqlite(folder, true), 2016.0), (fits(folder), 2016.0), (csv, 2016.0)]
    {
        println!("{}", source.display());
        let (catalogue, tally) = built(folder, &source, &Reading::default());
        assert_eq!((tally.stars, tally.unmoving, tally.unplaced, tally.without_mag), (8, 2, 0, 0));
        assert_eq!(catalogue.stars(), Some(8));
        judge(&catalogue, epoch, 0.06);
        // Also without being built first.
        let direct = Catalogue::open(&source, &Reading::default()).unwrap();
        judge(&direct, epoch, 0.06);
    }
}

#[test]
fn the_epoch_and_the_magnitude_are_those_that_were_asked_for() {
    let folder = TempDir::new().unwrap();
    let source = sqlite(folder.path(), false);
    let reading = Reading { band: Some(Band::J), epoch_year: Some(2010.0) };
    let (catalogue, _) = built(folder.path(), &source, &reading);
    judge(&catalogue, 2010.0, 0.06);
    let all = catalogue.cone(deg(0.0), deg(0.0), deg(180.0), 20.0, 2016.0).unwrap();
    let mut mags: Vec<f64> = all.iter().map(|star| star.mag).collect();
    mags.sort_by(f64::total_cmp);
    let mut expected = STARS.map(|star| star.4);
    expected.sort_by(f64::total_cmp);
    assert!(mags.iter().zip(expected).all(|(mag, j)| (mag - j).abs() < 0.011), "{mags:?}");
    let refused = each_star(&source, &Reading { band: Some(Band::Ks), epoch_year: None }, &mut |_| Ok(()));
    let message = refused.unwrap_err().to_string();
    assert!(message.contains("has no magnitude Ks") && message.contains("j_m"), "{message}");
}

#[test]
fn a_circle_of_an_sqlite_file_agrees_with_a_look_at_every_star() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("drawn.db");
    let mut file = Connection::open(&path).unwrap();
    let all = file.transaction().unwrap();
    for d in -90..90 {
        let table = format!("CREATE TABLE `{d}_{}` (ra REAL, dec REAL, pmra, pmdec, phot_g_mean_mag, j_m)", d + 1);
        all.execute(&table, []).unwrap();
    }
    // Numbers without order: Steele's splitmix64.
    let mut state = 7_u64;
    let mut next = || {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (state ^ (state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    };
    let drawn: Vec<(f64, f64, f64)> =
        (0..8000).map(|_| (360.0 * next(), (1.0 - 2.0 * next()).asin().to_degrees(), 6.0 + 10.0 * next())).collect();
    for (ra, dec, mag) in &drawn {
        let d = dec.floor() as i32;
        all.execute(&format!("INSERT INTO `{d}_{}` VALUES (?,?,1,1,?,'')", d + 1), params![ra, dec, mag]).unwrap();
    }
    all.commit().unwrap();
    let catalogue = Catalogue::open(&path, &Reading { band: None, epoch_year: Some(2016.0) }).unwrap();
    for (ra, dec, radius) in [
        (0.2, 10.0, 8.0),
        (359.5, -20.0, 9.0),
        (180.0, 88.0, 6.0),
        (20.0, -87.5, 9.0),
        (100.0, 0.0, 7.0),
        (10.0, 75.0, 14.9),
    ] {
        let axis = vector(deg(ra), deg(dec));
        for limit in [11.0, 20.0] {
            let inside = |(a, d, mag): &&(f64, f64, f64)| {
                *mag <= limit && apart_arcsec(vector(deg(*a), deg(*d)), axis) <= radius * 3600.0
            };
            let expected = drawn.iter().filter(inside).count();
            let found = catalogue.cone(deg(ra), deg(dec), deg(radius), limit, 2016.0).unwrap().len();
            assert_eq!(found, expected, "around {ra} {dec}, to {limit}");
            assert!(expected > 2, "only {expected} around {ra} {dec}");
        }
    }
}

#[test]
fn what_is_no_catalogue_is_refused_with_what_was_expected() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let other = folder.join("other.db");
    Connection::open(&other).unwrap().execute("CREATE TABLE stars (ra REAL, dec REAL)", []).unwrap();
    for (path, words) in [
        (file("empty", b""), "is empty (0 bytes)"),
        (file("page.html", b"<html>busy</html>"), "is markup"),
        (file("noise", &[0, 159, 3, 7]), "expected Starmesh's format"),
        (file("cut.smcat", b"SMCAT\0\0\x01abc"), "not a star catalogue of format SMCAT 1"),
        (file("names.csv", b"name,ra,mag\na,1,2\n"), "has no declination"),
        (file("words.csv", b"ra,dec,mag\n1,2,3\n1h30m,2,3\n"), "has \"1h30m\" for ra in line 3"),
        (file("void.csv", b"ra,dec,mag\n"), "holds no star"),
        (file("cut.fits", b"SIMPLE  =                    T"), "cut short"),
        (file("cut.db", b"SQLite format 3\0broken"), "cannot be read as SQLite: "),
        (other, "only stars"),
        (folder.join("none"), "No such file"),
    ] {
        let message = Catalogue::open(&path, &Reading::default()).unwrap_err();
        let message = format!("{:#}", anyhow::Error::from(message));
        assert!(message.contains(words) && message.contains(path.to_str().unwrap()), "{words:?} in {message:?}");
    }
    let out = folder.join("none.smcat");
    let message = Sorter::new(&out).unwrap().finish().unwrap_err().to_string();
    assert!(message.contains("no star was found") && !out.exists(), "{message}");
    let left: Vec<_> = std::fs::read_dir(folder).unwrap().filter(|f| is_hidden(&f.as_ref().unwrap().path())).collect();
    assert!(left.is_empty(), "{left:?}");
}

fn is_hidden(path: &Path) -> bool {
    path.file_name().unwrap().to_str().unwrap().starts_with('.')
}

#[test]
fn the_shipped_catalogue_is_opened_where_it_lies_and_answers_cones_in_time() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../catalogue/default.smcat");
    assert_eq!(Kind::of(&path).unwrap(), Kind::Packed);
    let catalogue = Catalogue::open(&path, &Reading::default()).unwrap();
    assert!(matches!(catalogue, Catalogue::Mapped(_)) && catalogue.stars() > Some(1_800_000));
    let mut times = Vec::new();
    for n in 0..500 {
        let n = f64::from(n);
        let (ra, dec) = (n * 137.507_764_05 % 360.0, (1.0 - 2.0 * (n + 0.5) / 500.0).asin().to_degrees());
        let started = Instant::now();
        let found = catalogue.cone(deg(ra), deg(dec), deg(1.0), 20.0, 2026.9).unwrap();
        times.push(started.elapsed().as_secs_f64() * 1e3);
        assert!(found.len() >= 10, "{} around {ra} {dec}", found.len());
    }
    times.sort_by(f64::total_cmp);
    println!("cones of 1 deg: median {:.3} ms, 99 % {:.3} ms, longest {:.3} ms", times[250], times[495], times[499]);
}
