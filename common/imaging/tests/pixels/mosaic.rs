//! Frames of a camera with red, green and blue pixels, drawn from a truth that is known.

use imaging::{Camera, Frame, Pixels, StarSearch, is_mosaic, measure_mosaic};

use crate::sky::{Psf, Sky, mean_and_spread, sigma};

const WIDTH: usize = 500;
const HEIGHT: usize = 401;
/// Share of the light that red, green and blue pixels catch.
const COLOURS: [f64; 3] = [0.55, 1.0, 0.4];
/// Colours of the four pixels of a cell, in the four ways the pattern can begin.
const TURNS: [[usize; 4]; 4] = [[0, 1, 1, 2], [1, 0, 2, 1], [1, 2, 0, 1], [2, 1, 1, 0]];

/// 40 stars of FWHM 5 px and 20,000 e- on a sky of 800 e-.
fn drawn(seed: u64) -> Sky {
    let mut sky = Sky::new(WIDTH, HEIGHT, 800.0, seed);
    for (x, y) in sky.places(40, 30.0) {
        sky.add_star(Psf::Gaussian(sigma(5.0)), x, y, 20_000.0);
    }
    sky
}

fn through_filters(sky: &mut Sky, turn: [usize; 4]) -> Vec<u16> {
    for (n, light) in sky.light.iter_mut().enumerate() {
        *light *= COLOURS[turn[n % WIDTH % 2 + n / WIDTH % 2 * 2]];
    }
    sky.counts(500.0, 6.0)
}

#[test]
fn stars_behind_a_colour_mosaic_are_found_where_they_are_and_no_others() {
    let mut offs = Vec::new();
    for (seed, turn) in TURNS.into_iter().enumerate() {
        let mut sky = drawn(seed as u64);
        let counts = through_filters(&mut sky, turn);
        let frame = Frame::new(WIDTH, HEIGHT, Pixels::U16(&counts)).unwrap();
        assert!(is_mosaic(&frame), "turn {turn:?}");
        let measured = measure_mosaic(&frame, &Camera::default(), &StarSearch::default()).unwrap();
        assert_eq!(measured.stars.len(), sky.stars.len(), "turn {turn:?}");
        for truth in &sky.stars {
            let apart = |star: &&imaging::Star| (star.x_px - truth.x).hypot(star.y_px - truth.y);
            let star = measured.stars.iter().min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap();
            assert!(apart(&star) < 0.5, "turn {turn:?}: {truth:?} {star:?}");
            offs.extend([star.x_px - truth.x, star.y_px - truth.y]);
            // red, blue and two green pixels
            let light = star.flux_adu / truth.flux / 0.7375;
            assert!((0.9..1.1).contains(&light), "turn {turn:?}: light {light}");
        }
        let quality = measured.quality;
        let width = quality.fwhm_px.unwrap().value;
        assert!((4.9..5.6).contains(&width), "width {width}");
        assert!((quality.background_adu - 500.0 - 0.7375 * 800.0).abs() < 3.0, "{quality:?}");
        let noise = (0.7375 * 800.0_f64 + 36.0).sqrt();
        assert!((quality.noise_adu / noise - 1.0).abs() < 0.05, "{quality:?}, drawn {noise}");
    }
    let (bias, spread) = mean_and_spread(&offs);
    println!("mosaic: places off by {bias:.4} +- {spread:.4} px");
    assert!(bias.abs() < 0.02 && spread < 0.15, "{bias} {spread}");
}

#[test]
fn what_is_no_mosaic_is_not_taken_for_one() {
    let looks = |counts: &[u16]| is_mosaic(&Frame::new(WIDTH, HEIGHT, Pixels::U16(counts)).unwrap());
    let mut sky = drawn(7);
    sky.add_light(|x, y| 0.5 * x + 0.3 * y);
    let plain = sky.counts(500.0, 6.0);
    assert!(!looks(&plain), "a gradient");
    let lifted = |which: fn(usize, usize) -> bool| -> Vec<u16> {
        let at = |(n, count): (usize, &u16)| count + if which(n % WIDTH, n / WIDTH) { 100 } else { 0 };
        plain.iter().enumerate().map(at).collect()
    };
    assert!(!looks(&lifted(|x, _| x % 2 == 1)), "two amplifiers by columns");
    assert!(!looks(&lifted(|_, y| y % 2 == 1)), "two amplifiers by rows");
    assert!(looks(&lifted(|x, y| (x + y) % 2 == 1)), "green pixels");
    assert!(!looks(&vec![700; WIDTH * HEIGHT]), "no light at all");
    assert!(
        !is_mosaic(&Frame::new(3, 3, Pixels::U16(&[1, 9, 1, 9, 1, 9, 1, 9, 1])).unwrap()),
        "too small to be recognised"
    );
}

#[test]
fn saturation_bad_pixels_and_darks_are_seen_through_the_mosaic() {
    let mut sky = drawn(9);
    let (x, y) = (sky.stars[0].x, sky.stars[0].y);
    sky.add_star(Psf::Gaussian(sigma(5.0)), x, y, 6e6);
    let mut counts = through_filters(&mut sky, TURNS[0]);
    // twelve clusters of warm pixels, as in every frame of this camera
    let mut dark = vec![100_u16; WIDTH * HEIGHT];
    for n in 0..12 {
        for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1), (2, 1), (2, 2), (1, 2)] {
            let at = (n * 30 + 20 + j) * WIDTH + 33 * n + 40 + i;
            dark[at] = 900;
            counts[at] = counts[at].saturating_add(800);
        }
    }
    let frame = Frame::new(WIDTH, HEIGHT, Pixels::U16(&counts)).unwrap();
    let dark = Frame::new(WIDTH, HEIGHT, Pixels::U16(&dark)).unwrap();
    let found = |camera: &Camera| measure_mosaic(&frame, camera, &StarSearch::default()).unwrap().stars;
    let false_stars = |stars: &[imaging::Star]| {
        let drawn = |s: &&imaging::Star| !sky.stars.iter().any(|t| (t.x - s.x_px).hypot(t.y - s.y_px) < 12.0);
        stars.iter().filter(drawn).count()
    };
    let plain = found(&Camera::default());
    assert!(plain[0].flags.saturated && (plain[0].x_px - x).hypot(plain[0].y_px - y) < 0.5, "{:?}", plain[0]);
    assert!(false_stars(&plain) > 5, "without a dark the warm pixels should show: {}", false_stars(&plain));
    assert_eq!(false_stars(&found(&Camera { dark: Some(dark), ..Camera::default() })), 0);
    let map = imaging::BadPixelMap::from_dark(&dark).unwrap();
    assert_eq!(false_stars(&found(&Camera { bad_pixels: Some(&map), ..Camera::default() })), 0);
    let small = Frame::new(2, 2, Pixels::U16(&[0; 4])).unwrap();
    assert!(
        measure_mosaic(&frame, &Camera { dark: Some(small), ..Camera::default() }, &StarSearch::default()).is_err()
    );
    let row = Frame::new(4, 1, Pixels::U16(&[0; 4])).unwrap();
    assert!(measure_mosaic(&row, &Camera::default(), &StarSearch::default()).is_err(), "no cell of 2 x 2 px");
}
