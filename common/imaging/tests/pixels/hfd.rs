//! Half-flux diameters against what was drawn: points, discs and rings, on pedestals, with neighbours.

use imaging::hfd::{FrameHfd, HfdSearch, NoHfd, measure_hfd};
use imaging::{Camera, Frame, Pixels};
use rand::{RngExt, SeedableRng, rngs::StdRng};

use crate::defocus::{Blur, counts, places};

const SKY: f64 = 150.0;

fn frame(
    blur: &Blur,
    width: usize,
    places: &[(f64, f64)],
    fluxes: &[f64],
    pedestal: f64,
    rng: &mut StdRng,
) -> Vec<u16> {
    let mut light = vec![SKY; width * width];
    places.iter().zip(fluxes).for_each(|(place, flux)| blur.draw(&mut light, width, *place, *flux));
    counts(&light, pedestal, 6.0, rng)
}

fn measured(pixels: &[u16], width: usize, expected_px: Option<f64>) -> Result<FrameHfd, NoHfd> {
    let frame = Frame::new(width, width, Pixels::U16(pixels)).unwrap();
    measure_hfd(&frame, &Camera::default(), &HfdSearch { expected_px, ..HfdSearch::default() })
}

/// Seeing, diameter (px) and obstruction.
const SHAPES: [(f64, f64, f64); 9] = [
    (1.6, 0.0, 0.0),
    (3.0, 0.0, 0.0),
    (8.0, 0.0, 0.0),
    (3.0, 8.0, 0.0),
    (3.0, 8.0, 0.4),
    (3.0, 20.0, 0.0),
    (2.5, 20.0, 0.45),
    (3.0, 40.0, 0.4),
    (4.0, 70.0, 0.45),
];

#[test]
fn sizes_of_points_discs_and_rings_are_true_whatever_is_expected_and_whatever_the_pedestal() {
    for (number, (seeing, diameter, obstruction)) in SHAPES.into_iter().enumerate() {
        let blur = Blur::new(seeing, diameter, obstruction);
        let truth = blur.hfd_px();
        let width = if diameter > 30.0 { 640 } else { 320 };
        for (seed, expected) in [(0, None), (1, Some(truth)), (2, Some(0.4 * truth)), (3, Some(2.5 * truth))] {
            let mut rng = StdRng::seed_from_u64(100 * number as u64 + seed);
            let places = places(12, width as f64, 30.0 + diameter, 2.2 * diameter + 20.0, &mut rng);
            let fluxes: Vec<f64> =
                places.iter().map(|_| 10_f64.powf(rng.random_range(4.2..5.0)) * (1.0 + diameter / 20.0)).collect();
            let pedestal = [0.0, 300.0, 1000.0, 2000.0][seed as usize];
            let pixels = frame(&blur, width, &places, &fluxes, pedestal, &mut rng);
            let found = measured(&pixels, width, expected).unwrap();
            let off = found.hfd_px.value / truth - 1.0;
            let (count, drawn) = (found.stars.len(), places.len());
            let what = format!("seeing {seeing}, disc {diameter}, dark {obstruction}, expected {expected:.1?}");
            println!("{what}: {:.2?}, drawn {truth:.2} ({off:+.3}), {count} of {drawn}", found.hfd_px);
            assert!(off.abs() < 0.03 + found.hfd_px.error / truth, "{what}: {off}");
            assert!(10 * count >= 6 * drawn, "{what}: {count} of {drawn}");
        }
    }
}

#[test]
fn errors_are_what_many_frames_scatter() {
    let blur = Blur::new(3.0, 6.0, 0.3);
    let pulls: Vec<f64> = (0..60)
        .map(|seed| {
            let mut rng = StdRng::seed_from_u64(900 + seed);
            let places = places(15, 256.0, 20.0, 30.0, &mut rng);
            let fluxes: Vec<f64> = places.iter().map(|_| rng.random_range(8e3..2e4)).collect();
            let found = measured(&frame(&blur, 256, &places, &fluxes, 500.0, &mut rng), 256, Some(6.0)).unwrap();
            (found.hfd_px.value - blur.hfd_px()) / found.hfd_px.error
        })
        .collect();
    let mean = pulls.iter().sum::<f64>() / pulls.len() as f64;
    let rms = (pulls.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / pulls.len() as f64).sqrt();
    println!("pulls: mean {mean:.2}, scatter {rms:.2}");
    assert!(mean.abs() < 1.0 && (0.6..1.5).contains(&rms), "{mean} {rms}");
}

#[test]
fn neighbours_and_saturated_stars_do_not_spoil_the_size() {
    let blur = Blur::new(3.0, 5.0, 0.3);
    let truth = blur.hfd_px();
    let mut rng = StdRng::seed_from_u64(5);
    let mut all = places(9, 320.0, 40.0, 60.0, &mut rng);
    let mut fluxes = vec![3e4; all.len()];
    // each star but one gets a companion of half its light, 2.5 HFD away
    for n in 1..9 {
        let turn = rng.random_range(0.0..std::f64::consts::TAU);
        all.push((all[n].0 + 2.5 * truth * turn.cos(), all[n].1 + 2.5 * truth * turn.sin()));
        fluxes.push(1.5e4);
    }
    fluxes[0] = 6e6;
    let found = measured(&frame(&blur, 320, &all, &fluxes, 1000.0, &mut rng), 320, None).unwrap();
    let off = found.hfd_px.value / truth - 1.0;
    println!("with neighbours: {:?}, drawn {truth:.3} ({off:+.3}), {} stars", found.hfd_px, found.stars.len());
    assert!(off.abs() < 0.03 && found.stars.len() >= 8, "{off} {found:?}");
    let near_saturated = |s: &imaging::hfd::StarHfd| (s.x_px - all[0].0).hypot(s.y_px - all[0].1) < truth;
    assert!(!found.stars.iter().any(near_saturated), "{found:?}");
}

#[test]
fn frames_without_stars_are_reported() {
    let mut rng = StdRng::seed_from_u64(6);
    let empty = counts(&vec![SKY; 256 * 256], 500.0, 6.0, &mut rng);
    assert!(matches!(measured(&empty, 256, None), Err(NoHfd::NoStar { .. })));
    assert!(matches!(measured(&empty, 256, Some(f64::NAN)), Err(NoHfd::NoStar { .. })));
    assert!(matches!(measured(&empty, 256, Some(1e9)), Err(NoHfd::NoStar { .. })));
    for (width, height) in [(1, 1), (1, 50), (50, 1), (7, 5), (200, 3)] {
        for value in [0, 65_535] {
            let pixels = vec![value; width * height];
            let frame = Frame::new(width, height, Pixels::U16(&pixels)).unwrap();
            for expected_px in [None, Some(3.0), Some(50.0)] {
                let search = HfdSearch { expected_px, ..HfdSearch::default() };
                assert!(measure_hfd(&frame, &Camera::default(), &search).is_err(), "{width} x {height} of {value}");
            }
        }
    }
    let floats = vec![f32::NAN; 4096];
    let frame = Frame::new(64, 64, Pixels::F32(&floats)).unwrap();
    assert!(matches!(measure_hfd(&frame, &Camera::default(), &HfdSearch::default()), Err(NoHfd::Frame(_))));
}
