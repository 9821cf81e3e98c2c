//! Real sky: the frames in the folder `$STARMESH_REAL_SKY` (not in the repository) against the catalogue that ships.

use std::path::{Path, PathBuf};

use imaging::catalogue::Catalogue;
use imaging::solve::{AllSky, Blind, Detected, Hint, Solution, at_epoch};
use imaging::{Camera, Frame, NoSolution, StarSearch, Wcs, measure, solve};

use crate::drawn::{deg, wcs};
use crate::fits;

struct Real {
    file: &'static str,
    /// Truth at the geometric centre (README there): RA, Dec, rotation, deg; scale, arcsec/px; mirrored.
    centre_deg: (f64, f64),
    scale_arcsec_px: f64,
    rotation_deg: f64,
    mirrored: bool,
    /// Where the mount thought it was, deg, and the scale it assumed.
    hint: (f64, f64, f64),
    epoch_year: f64,
}

const PANOPTES: Real = Real {
    file: "panoptes/unsolved.fits",
    centre_deg: (303.210_962, 46.019_547),
    scale_arcsec_px: 10.3066,
    rotation_deg: 89.59,
    mirrored: true,
    hint: (301.564_39, 44.456_875, 10.2),
    epoch_year: 2016.69,
};

const GALACTIC_CENTRE: [Real; 2] = [
    Real {
        file: "2mass/gc_2mass_j.fits",
        centre_deg: (266.399_978, -28.933_319),
        scale_arcsec_px: 5.0,
        rotation_deg: 0.0,
        mirrored: true,
        hint: (266.6, -28.8, 5.0),
        epoch_year: 1999.0,
    },
    Real {
        file: "2mass/gc_2mass_h.fits",
        centre_deg: (266.399_978, -28.933_319),
        scale_arcsec_px: 5.0,
        rotation_deg: 0.0,
        mirrored: true,
        hint: (266.3, -29.0, 5.0),
        epoch_year: 1999.0,
    },
];

fn solve_file(real: &Real, path: &Path) -> (Result<Solution, NoSolution>, Wcs, (f64, f64)) {
    let default = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../catalogue/default.smcat");
    let catalogue = Catalogue::from_bytes(std::fs::read(default).unwrap()).unwrap();
    let image = fits::read(path).unwrap();
    let frame = Frame::new(image.width, image.height, image.pixels()).unwrap();
    let measured = measure(&frame, &Camera::default(), &StarSearch::default()).unwrap();
    let (width, height) = (image.width, image.height);
    let detected = Detected { stars: &measured.stars, width, height, quality: Some(&measured.quality) };
    let (ra, dec, scale) = real.hint;
    let hint = Hint::new(deg(ra), deg(dec), scale);
    let started = std::time::Instant::now();
    let answer = solve(&detected, &hint, &at_epoch(&catalogue, real.epoch_year));
    println!("{}: {} stars, {:.1} ms", real.file, measured.quality.stars, started.elapsed().as_secs_f64() * 1e3);
    let (ra, dec) = real.centre_deg;
    let truth = wcs(deg(ra), deg(dec), (width, height), real.scale_arcsec_px, deg(real.rotation_deg), real.mirrored);
    (answer, truth, (width as f64 - 1.0, height as f64 - 1.0))
}

fn judge(real: &Real, solution: &Solution, truth: &Wcs, (right, top): (f64, f64)) {
    let error = |x: f64, y: f64| {
        let (ra, dec) = solution.wcs.pixel_to_sky(x, y);
        truth.sky_to_pixel(ra, dec).map_or(f64::INFINITY, |(tx, ty)| (tx - x).hypot(ty - y))
    };
    let corners = [(0.0, 0.0), (right, 0.0), (0.0, top), (right, top)].map(|(x, y)| error(x, y));
    let (centre, corner) = (error(0.5 * right, 0.5 * top), corners.into_iter().fold(0.0, f64::max));
    println!(
        "{}: {} matched, rms {:.2} px, {:?}, scale {:.4}, rotation {:.3}, mirrored {}, false alarm {:.0e}, \
         centre {centre:.2} px, corner {corner:.2} px off",
        real.file,
        solution.matched,
        solution.rms_px,
        solution.level,
        solution.scale_arcsec_px,
        solution.rotation_deg,
        solution.mirrored,
        solution.false_alarm,
    );
    assert_eq!(solution.mirrored, real.mirrored, "{}", real.file);
    assert!(centre < 1.0, "{}: centre {centre} px", real.file);
    assert!(corner < 2.0, "{}: corner {corner} px", real.file);
}

/// The file, where the folder of real frames is known.
fn real_file(real: &Real) -> Option<PathBuf> {
    let folder = std::env::var_os("STARMESH_REAL_SKY").map(PathBuf::from)?;
    let path = folder.join(real.file);
    assert!(path.exists(), "STARMESH_REAL_SKY is set, but {} is not there", path.display());
    Some(path)
}

#[test]
fn a_lens_on_the_sky_is_solved_two_degrees_from_where_the_mount_thought() {
    let Some(path) = real_file(&PANOPTES) else { return println!("real sky: 0 of 1 run") };
    let (answer, truth, size) = solve_file(&PANOPTES, &path);
    let solution = answer.unwrap_or_else(|reason| panic!("{reason}"));
    judge(&PANOPTES, &solution, &truth, size);
    println!("real sky: 1 of 1 run");
}

#[test]
fn the_galactic_centre_in_the_infrared_is_solved_or_refused_but_never_wrong() {
    let mut run = 0;
    for real in &GALACTIC_CENTRE {
        let Some(path) = real_file(real) else { continue };
        let (answer, truth, size) = solve_file(real, &path);
        match answer {
            Ok(solution) => judge(real, &solution, &truth, size),
            // stars that are bright in the infrared are not those that are bright in the catalogue's light
            Err(reason) => {
                println!("{}: {reason}", real.file);
                assert!(matches!(reason, NoSolution::NoMatch { .. }), "{reason:?}");
            }
        }
        run += 1;
    }
    println!("real sky: {run} of 2 run");
}

#[test]
fn the_real_lens_is_found_without_a_place() {
    let Some(folder) = std::env::var_os("STARMESH_REAL_SKY").map(PathBuf::from) else {
        return println!("real sky, blind: 0 of 1 run");
    };
    let default = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../catalogue/default.smcat");
    let catalogue = Catalogue::from_bytes(std::fs::read(default).unwrap()).unwrap();
    let image = fits::read(&folder.join(PANOPTES.file)).unwrap();
    let frame = Frame::new(image.width, image.height, image.pixels()).unwrap();
    let measured = measure(&frame, &Camera::default(), &StarSearch::default()).unwrap();
    let (width, height) = (image.width, image.height);
    let detected = Detected { stars: &measured.stars, width, height, quality: Some(&measured.quality) };
    // the scale to 15 %, as `starmesh solve` takes one that was given
    let blind = Blind { scales_arcsec_px: Some((8.7, 11.7)), ..Blind::default() };
    let solution = AllSky::new(at_epoch(&catalogue, PANOPTES.epoch_year)).solve(&detected, &blind).unwrap();
    let (ra, dec) = PANOPTES.centre_deg;
    let off = imaging::tangent::separation((solution.ra, solution.dec), (deg(ra), deg(dec)));
    println!("real sky, blind: 1 of 1 run: {:.2} px off", off.arcseconds() / PANOPTES.scale_arcsec_px);
    assert!(off.arcseconds() < PANOPTES.scale_arcsec_px, "{solution:?}");
}
