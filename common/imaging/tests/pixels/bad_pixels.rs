//! Clusters of hot pixels look like stars in one frame; three pointings, or a dark, distinguish them.

use imaging::{BadPixelMap, BadPixelVotes};
use imaging::{Camera, Clean, Frame, Pixels, StarSearch, measure};

use crate::sky::{Psf, Sky, sigma};

const SIDE: usize = 300;
/// Lower left corners of clusters of 3 x 3 hot pixels.
const CLUSTERS: [(usize, usize); 3] = [(40, 50), (150, 200), (260, 90)];

/// A field of ten stars; each seed is another pointing of the same camera.
fn field(seed: u64) -> (Sky, Vec<u16>) {
    let mut sky = Sky::new(SIDE, SIDE, 200.0, seed);
    for (x, y) in sky.places(10, 30.0) {
        sky.add_star(Psf::Gaussian(sigma(3.0)), x, y, 20_000.0);
    }
    let mut counts = sky.counts(300.0, 5.0);
    heat(&mut counts);
    (sky, counts)
}

fn heat(counts: &mut [u16]) {
    for (x, y) in CLUSTERS {
        for n in 0..9 {
            counts[(y + n / 3) * SIDE + x + n % 3] += 2500;
        }
    }
}

/// How many stars stand on a cluster, and how many of the drawn ones were found.
fn found(sky: &Sky, counts: &[u16], camera: &Camera) -> (usize, usize) {
    let frame = Frame::new(SIDE, SIDE, Pixels::U16(counts)).unwrap();
    let stars = measure(&frame, camera, &StarSearch::default()).unwrap().stars;
    let any_near = |x: f64, y: f64, reach: f64| stars.iter().any(|s| (s.x_px - x).hypot(s.y_px - y) < reach);
    let on_clusters = CLUSTERS.iter().filter(|(x, y)| any_near(*x as f64 + 1.0, *y as f64 + 1.0, 3.0)).count();
    (on_clusters, sky.stars.iter().filter(|s| any_near(s.x, s.y, 1.0)).count())
}

#[test]
fn clusters_are_learned_from_three_pointings() {
    let mut votes = BadPixelVotes::new(SIDE, SIDE);
    for seed in 1..=3 {
        assert!(votes.map().positions().is_empty(), "after {} pointings", seed - 1);
        let counts = field(seed).1;
        let frame = Frame::new(SIDE, SIDE, Pixels::U16(&counts)).unwrap();
        votes.add(&Clean::new(&frame, &Camera::default(), Some(3.2)).unwrap()).unwrap();
    }
    let map = votes.map();
    assert_eq!(map.positions().len(), 27, "the clusters and nothing else");
    let (sky, counts) = field(4);
    assert_eq!(found(&sky, &counts, &Camera::default()).0, 3, "without a map they pass for stars");
    let camera = Camera { bad_pixels: Some(&map), ..Camera::default() };
    assert_eq!(found(&sky, &counts, &camera), (0, 10));
    let other = Frame::new(2, 2, Pixels::U16(&[1; 4])).unwrap();
    assert!(votes.add(&Clean::new(&other, &Camera::default(), None).unwrap()).is_err());
}

#[test]
fn a_dark_shows_the_bad_pixels_and_takes_warm_ones_out() {
    let mut dark = Sky::new(SIDE, SIDE, 20.0, 9).counts(300.0, 5.0);
    heat(&mut dark);
    let dark = Frame::new(SIDE, SIDE, Pixels::U16(&dark)).unwrap();
    let map = BadPixelMap::from_dark(&dark).unwrap();
    assert_eq!(map.positions().len(), 27);
    assert_eq!((map.width(), map.height()), (SIDE, SIDE));

    let (sky, counts) = field(5);
    let camera = Camera { dark: Some(dark), ..Camera::default() };
    assert_eq!(found(&sky, &counts, &camera), (0, 10));
    // the bias went with the dark; nothing wrapped below zero
    let frame = Frame::new(SIDE, SIDE, Pixels::U16(&counts)).unwrap();
    let sky = measure(&frame, &camera, &StarSearch::default()).unwrap().quality;
    assert!((sky.background_adu - 180.0).abs() < 1.0, "{sky:?}");
}
