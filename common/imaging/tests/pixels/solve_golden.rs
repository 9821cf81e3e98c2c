//! The golden frames that the predecessor solves (and the one it must not): star lists of their truth always, the
//! frames themselves where `$STARMESH_GOLDEN` names a folder that has them (it is not in the repository).

use std::io::Read;
use std::path::{Path, PathBuf};

use imaging::catalogue;
use imaging::solve::{Detected, FIRST_LIGHT, Hint, Level};
use imaging::tangent::separation;
use imaging::{Camera, Frame, NoSolution, Solution, Star, StarSearch, Wcs, measure, solve};
use rand::{SeedableRng, rngs::StdRng};
use units::Angle;

use crate::drawn::{deg, normal, star};
use crate::fits;

/// A frame of `solve.csv.gz`.
struct Golden {
    name: String,
    width: usize,
    height: usize,
    target: (Angle, Angle),
    scale_arcsec_px: f64,
    fwhm_px: f64,
    truth: Wcs,
    stars: Vec<(f64, f64, f64)>,
    known: Vec<catalogue::CatalogueStar>,
}

fn golden() -> Vec<Golden> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden/solve.csv.gz");
    let mut table = String::new();
    flate2::read::GzDecoder::new(std::fs::File::open(path).unwrap()).read_to_string(&mut table).unwrap();
    let mut frames: Vec<Golden> = Vec::new();
    for line in table.lines() {
        let (word, rest) = line.split_once(',').unwrap();
        if word == "frame" {
            let (name, numbers) = rest.split_once(',').unwrap();
            let n: Vec<f64> = numbers.split(',').map(|n| n.parse().unwrap()).collect();
            let truth = Wcs {
                ra: deg(n[6]),
                dec: deg(n[7]),
                x_px: n[8] - 1.0,
                y_px: n[9] - 1.0,
                cd_deg_px: [[n[10], n[11]], [n[12], n[13]]],
                sip: None,
            };
            frames.push(Golden {
                name: name.to_owned(),
                width: n[0] as usize,
                height: n[1] as usize,
                target: (deg(n[2]), deg(n[3])),
                scale_arcsec_px: n[4],
                fwhm_px: n[5],
                truth,
                stars: Vec::new(),
                known: Vec::new(),
            });
            continue;
        }
        let n: Vec<f64> = rest.split(',').map(|n| n.parse().unwrap()).collect();
        let frame = frames.last_mut().unwrap();
        if word == "star" {
            frame.stars.push((n[0], n[1], n[2]));
        } else {
            frame.known.push(catalogue::CatalogueStar { ra: deg(n[0]), dec: deg(n[1]), mag: n[2] });
        }
    }
    assert_eq!(frames.len(), 12);
    frames
}

impl Golden {
    fn hint(&self) -> Hint {
        let mut hint = Hint::new(self.target.0, self.target.1, self.scale_arcsec_px);
        // the fixture's stars end soon after one field
        hint.furthest = Angle::default();
        hint
    }

    fn solve(&self, detected: &Detected, hint: &Hint) -> Result<Solution, NoSolution> {
        let cone = |ra: Angle, dec: Angle, radius: Angle, faintest: f64| {
            let near = |s: &&catalogue::CatalogueStar| {
                s.mag <= faintest && separation((s.ra, s.dec), (ra, dec)).degrees() <= radius.degrees()
            };
            self.known.iter().filter(near).copied().collect::<Vec<_>>()
        };
        solve(detected, hint, &cone)
    }

    /// Distance from the truth at the centre and at the worst corner, px; `drift` is how far the stars had moved in
    /// the middle of the exposure.
    fn errors_px(&self, wcs: &Wcs, drift: (f64, f64)) -> (f64, f64) {
        let error = |x: f64, y: f64| {
            let (ra, dec) = wcs.pixel_to_sky(x, y);
            let (tx, ty) = self.truth.sky_to_pixel(ra, dec).unwrap();
            (tx + drift.0 - x).hypot(ty + drift.1 - y)
        };
        let (right, top) = (self.width as f64 - 1.0, self.height as f64 - 1.0);
        let corners = [(0.0, 0.0), (right, 0.0), (0.0, top), (right, top)];
        (error(0.5 * right, 0.5 * top), corners.iter().map(|(x, y)| error(*x, *y)).fold(0.0, f64::max))
    }
}

#[test]
fn the_stars_that_were_drawn_are_recognised_and_then_again_by_a_shift() {
    let mut rng = StdRng::seed_from_u64(18);
    for frame in golden() {
        let noisy = |(x, y, flux): &(f64, f64, f64), rng: &mut StdRng| Star {
            fwhm_px: frame.fwhm_px,
            ..star(x + 0.05 * normal(rng), y + 0.05 * normal(rng), *flux, 0.05)
        };
        let stars: Vec<Star> = frame.stars.iter().map(|s| noisy(s, &mut rng)).collect();
        let detected = Detected { stars: &stars, width: frame.width, height: frame.height, quality: None };
        let answer = frame.solve(&detected, &frame.hint());
        if frame.name == "f11_two_stars" {
            assert_eq!(answer.unwrap_err(), NoSolution::TooFewStars { stars: 2, needed: 4 });
            continue;
        }
        let solution = answer.unwrap_or_else(|reason| panic!("{}: {reason}", frame.name));
        let (centre, corner) = frame.errors_px(&solution.wcs, (0.0, 0.0));
        println!("{}: {} of {}, centre {centre:.3} px", frame.name, solution.matched, stars.len());
        assert!(centre < 0.1 && corner < 0.3, "{}: {centre} {corner}", frame.name);
        assert_eq!(solution.mirrored, frame.name == "f13_mirrored", "{}", frame.name);
        // what was learned makes the next solve a shift
        let again = Hint { learned: Some(solution.learned()), ..frame.hint() };
        let again = frame.solve(&detected, &again).unwrap();
        assert_eq!(again.level, Level::Shift, "{}", frame.name);
        assert!(frame.errors_px(&again.wcs, (0.0, 0.0)).0 < 0.1);
    }
}

#[test]
fn the_frames_themselves_are_solved() {
    let folder = std::env::var_os("STARMESH_GOLDEN").map(PathBuf::from);
    let mut run = 0;
    for frame in golden() {
        let path = folder.as_ref().map(|f| f.join("frames").join(format!("{}.fits.gz", frame.name)));
        if let Some(path) = path.filter(|path| path.exists()) {
            whole_frame(&frame, &path);
            run += 1;
        }
    }
    println!("golden frames: {run} of 12 run");
    assert!(folder.is_none() || run == 12, "STARMESH_GOLDEN is set, but only {run} of 12 frames were found");
}

fn whole_frame(golden: &Golden, path: &Path) {
    let image = fits::read(path).unwrap();
    let frame = Frame::new(image.width, image.height, image.pixels()).unwrap();
    let measured = measure(&frame, &Camera::default(), &StarSearch::default()).unwrap();
    let detected =
        Detected { stars: &measured.stars, width: image.width, height: image.height, quality: Some(&measured.quality) };
    for tolerance in [0.02, FIRST_LIGHT] {
        let hint = Hint { scale_tolerance: tolerance, ..golden.hint() };
        let started = std::time::Instant::now();
        let answer = golden.solve(&detected, &hint);
        let ms = started.elapsed().as_secs_f64() * 1e3;
        if golden.name == "f11_two_stars" {
            assert!(matches!(answer, Err(NoSolution::TooFewStars { stars: 2 | 3, .. })), "{answer:?}");
            continue;
        }
        let solution = answer.unwrap_or_else(|reason| panic!("{}: {reason}", golden.name));
        let trailed = golden.name == "f16_trailed";
        let drift = if trailed { (3.3937, 1.4544) } else { (0.0, 0.0) };
        let (centre, corner) = golden.errors_px(&solution.wcs, drift);
        println!(
            "{} at {tolerance}: {} of {} stars, rms {:.3} px, centre {centre:.3} px, corner {corner:.3} px, \
             false alarm {:.0e}, {} hypotheses, {ms:.1} ms",
            golden.name,
            solution.matched,
            measured.quality.stars,
            solution.rms_px,
            solution.false_alarm,
            solution.hypotheses,
        );
        let limit = if trailed { 0.5 } else { 0.2 };
        assert!(centre < limit && corner < 3.0 * limit, "{}: {centre} {corner}", golden.name);
    }
}
