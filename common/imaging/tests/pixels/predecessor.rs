//! The golden numbers of operators that are not built here (docs/formulae.md, "What tests compare with"): each is
//! computed again in this file, so that it is known what it does, and compared with what took its place, on frames
//! whose truth is known.

use imaging::projection::from_projections;
use imaging::shift::from_stars;
use imaging::{Camera, Clean, Frame, Pixels, Star, StarSearch, measure};
use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};

use crate::sky::{Psf, Sky, sigma};

/// DAOFIND's kernel for round stars (docs/formulae.md, "DAOFIND's kernel").
struct Daofind {
    sigma: f64,
    /// Half width, px.
    reach: usize,
    pixels: usize,
    relative_error: f64,
    /// Row by row.
    kernel: Vec<f64>,
}

impl Daofind {
    fn new(fwhm_px: f64) -> Self {
        let sigma = fwhm_px / 2.35482;
        let reach = (1.5 * sigma).max(2.0) as usize;
        let width = 2 * reach + 1;
        let place = |n: usize| ((n % width) as f64 - reach as f64).hypot((n / width) as f64 - reach as f64);
        let inside = |n: usize| place(n) <= 1.5 * sigma || place(n) <= 2.0;
        let gauss = |n: usize| if inside(n) { (-place(n).powi(2) / (2.0 * sigma * sigma)).exp() } else { 0.0 };
        let pixels = (0..width * width).filter(|n| inside(*n)).count();
        let sum: f64 = (0..width * width).map(gauss).sum();
        let squares: f64 = (0..width * width).map(|n| gauss(n).powi(2)).sum();
        let spread = squares - sum * sum / pixels as f64;
        let density = |n: usize| if inside(n) { (gauss(n) - sum / pixels as f64) / spread } else { 0.0 };
        let kernel = (0..width * width).map(density).collect();
        Self { sigma, reach, pixels, relative_error: 1.0 / spread.sqrt(), kernel }
    }

    fn at(&self, row: usize, column: usize) -> f64 {
        self.kernel[row * (2 * self.reach + 1) + column]
    }

    /// The amplitude of the Gaussian that fits best around a pixel.
    fn amplitude(&self, image: &[f64], width: usize, (x, y): (usize, usize)) -> f64 {
        let side = 0..2 * self.reach + 1;
        let row = |j: usize| side.clone().map(move |i| (j, i));
        let pixels = side.clone().flat_map(row);
        pixels.map(|(j, i)| self.at(j, i) * image[(y + j - self.reach) * width + x + i - self.reach]).sum()
    }

    /// The pixel of the greatest amplitude, away from the edge, and that amplitude.
    fn peak(&self, image: &[f64], width: usize) -> ((usize, usize), f64) {
        let height = image.len() / width;
        let rows = self.reach..height - self.reach;
        let all = rows.flat_map(|y| (self.reach..width - self.reach).map(move |x| (x, y)));
        all.map(|at| (at, self.amplitude(image, width, at))).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap()
    }

    /// Offset of a star from its peak pixel along one axis by the fit of marginal sums, px.
    fn offset(&self, image: &[f64], width: usize, (x, y): (usize, usize), along_x: bool) -> f64 {
        let (r, side) = (self.reach as f64, 2 * self.reach + 1);
        let weight = |k: usize| r + 1.0 - (k as f64 - r).abs();
        let value = |k: usize, across: usize| {
            let (i, j) = if along_x { (k, across) } else { (across, k) };
            image[(y + j - self.reach) * width + x + i - self.reach]
        };
        let gauss = |k: usize, across: usize| {
            let squares = (k as f64 - r).powi(2) + (across as f64 - r).powi(2);
            (-squares / (2.0 * self.sigma * self.sigma)).exp()
        };
        let data: Vec<f64> = (0..side).map(|k| (0..side).map(|a| weight(a) * value(k, a)).sum()).collect();
        let model: Vec<f64> = (0..side).map(|k| (0..side).map(|a| weight(a) * gauss(k, a)).sum()).collect();
        let sum = |of: &dyn Fn(usize) -> f64| (0..side).map(|k| weight(k) * of(k)).sum::<f64>();
        let (ones, data_sum, model_sum) = (sum(&|_| 1.0), sum(&|k| data[k]), sum(&|k| model[k]));
        let height = (sum(&|k| data[k] * model[k]) - data_sum * model_sum / ones)
            / (sum(&|k| model[k].powi(2)) - model_sum.powi(2) / ones);
        let slope = sum(&|k| data[k] * model[k] * (k as f64 - r));
        self.sigma.powi(2) * slope / (height * sum(&|k| model[k].powi(2) * (k as f64 - r).powi(2)))
    }

    fn centroid(&self, image: &[f64], width: usize) -> (f64, f64) {
        let (at, _) = self.peak(image, width);
        let offset = |along_x| self.offset(image, width, at, along_x);
        (at.0 as f64 + offset(true), at.1 as f64 + offset(false))
    }
}

/// The 5x5 median, mirrored at the edges without repeating them.
fn median_5x5(image: &[f64], width: usize) -> Vec<f64> {
    let height = image.len() / width;
    let mirrored = |at: isize, length: usize| {
        let last = length as isize - 1;
        (last - (last - at.abs()).abs()) as usize
    };
    let pixel = |n: usize| {
        let (x, y) = ((n % width) as isize, (n / width) as isize);
        let mut near: Vec<f64> = (-2..=2)
            .flat_map(|dy| (-2..=2).map(move |dx| (dx, dy)))
            .map(|(dx, dy)| image[mirrored(y + dy, height) * width + mirrored(x + dx, width)])
            .collect();
        near.sort_by(f64::total_cmp);
        near[12]
    };
    (0..image.len()).map(pixel).collect()
}

fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

fn near(found: f64, golden: f64, digits: i32) {
    assert!((found - golden).abs() < 0.51 * 10_f64.powi(-digits), "{found}, golden {golden}");
}

#[test]
fn daofinds_kernels_are_the_golden_ones() {
    for (fwhm_px, width, pixels, relative_error, centre, edge) in [
        (2.0, 5, 13, 1.068311489, 0.768175583, -0.301783265),
        (3.0, 5, 13, 1.285033309, 0.728340075, -0.441395086),
        (5.714285714, 7, 45, 0.749632455, 0.236066645, -0.064177672),
    ] {
        let daofind = Daofind::new(fwhm_px);
        let middle = daofind.reach;
        assert_eq!((2 * middle + 1, daofind.pixels), (width, pixels));
        // the golden ones come of 2.354820045 sigma
        for (found, golden) in [
            (daofind.relative_error, relative_error),
            (daofind.at(middle, middle), centre),
            (daofind.at(middle, 0), edge),
        ] {
            near(found, golden, 7);
        }
        assert!(daofind.kernel.iter().sum::<f64>().abs() < 1e-12);
    }
    let daofind = Daofind::new(3.0);
    near(daofind.at(2, 1), 0.290524, 6);
    near(daofind.at(1, 1), -0.031213, 6);
    assert_eq!(daofind.at(0, 0), 0.0);
}

#[test]
fn daofinds_centroid_is_the_golden_one_and_ours_is_nearer_to_the_truth() {
    let (width, s) = (41, 4.0 / 2.35482);
    let gauss = |n: usize, (x, y): (f64, f64)| {
        let squares = ((n % width) as f64 - x).powi(2) + ((n / width) as f64 - y).powi(2);
        1000.0 * (-squares / (2.0 * s * s)).exp()
    };
    let image: Vec<f64> = (0..width * width).map(|n| gauss(n, (20.3, 19.6))).collect();
    let daofind = Daofind::new(4.0);
    let (x, y) = daofind.centroid(&image, width);
    near(x, 20.307792, 6);
    near(y, 19.581159, 6);
    near(image[20 * width + 20], 957.603280, 3);
    let cut: f64 = (18..23).flat_map(|y| (18..23).map(move |x| (x, y))).map(|(x, y)| image[y * width + x]).sum();
    near(cut, 13284.537090, 3);

    // the same star at all phases between the pixels, in noise
    let (mut old, mut cleaned, mut ours) = (Vec::new(), Vec::new(), Vec::new());
    let mut rng = StdRng::seed_from_u64(8);
    for n in 0..100 {
        let truth = (20.0 + 0.1 * (n % 10) as f64, 20.0 + 0.1 * (n / 10) as f64);
        let noisy = |n: usize| gauss(n, truth) + 10.0 * Distribution::<f64>::sample(&StandardNormal, &mut rng);
        let image: Vec<f64> = (0..width * width).map(noisy).collect();
        let off = |(x, y): (f64, f64)| [x - truth.0, y - truth.1];
        old.extend(off(daofind.centroid(&image, width)));
        // as the predecessor's solver did it
        cleaned.extend(off(daofind.centroid(&median_5x5(&image, width), width)));
        let counts: Vec<f32> = image.iter().map(|value| (500.0 + value) as f32).collect();
        let frame = Frame::new(width, width, Pixels::F32(&counts)).unwrap();
        let measured =
            measure(&frame, &Camera::default(), &StarSearch { fwhm_px: Some(4.0), ..StarSearch::default() }).unwrap();
        let brightest = measured.stars.iter().max_by(|a, b| a.flux_adu.total_cmp(&b.flux_adu)).unwrap();
        ours.extend(off((brightest.x_px, brightest.y_px)));
    }
    let rms = |off: &[f64]| (off.iter().map(|o| o * o).sum::<f64>() / off.len() as f64).sqrt();
    println!("centroids: DAOFIND {:.4}, after the median {:.4}, ours {:.4} px", rms(&old), rms(&cleaned), rms(&ours));
    assert!(rms(&ours) < 0.75 * rms(&old) && rms(&ours) < 0.75 * rms(&cleaned));
}

#[test]
fn the_5x5_median_hides_noise_and_narrow_stars_alike_and_ours_neither() {
    let side = 256;
    let white = |seed: u64| -> Vec<f64> {
        let mut rng = StdRng::seed_from_u64(seed);
        (0..side * side).map(|_| 10.0 * Distribution::<f64>::sample(&StandardNormal, &mut rng)).collect()
    };
    // away from the edges, where the mirror repeats pixels; of one image it is known to a hundredth
    let share = |seed: u64| {
        let inner = |of: &[f64]| -> Vec<f64> {
            let is_inner = |n: &usize| [n % side, n / side].iter().all(|at| (2..side - 2).contains(at));
            (0..side * side).filter(is_inner).map(|n| of[n]).collect()
        };
        let noise = white(seed);
        deviation(&inner(&median_5x5(&noise, side))) / deviation(&inner(&noise))
    };
    let share = (1..=6).map(share).sum::<f64>() / 6.0;
    println!("noise after the median: {share:.4}");
    assert!((0.245..0.2505).contains(&share), "{share}");
    let noise = white(3);
    let frame = |image: &[f64]| image.iter().map(|value| (500.0 + value) as f32).collect::<Vec<f32>>();
    let counts = frame(&noise);
    let clean = Clean::new(&Frame::new(side, side, Pixels::F32(&counts)).unwrap(), &Camera::default(), None).unwrap();
    let measured = f64::from(clean.background.noise.median());
    assert!((measured / deviation(&noise) - 1.0).abs() < 0.02, "{measured}");

    // stars of FWHM 2 px, 15 sigma high
    let mut sky = Sky::new(side, side, 0.0, 5);
    let places = sky.places(25, 30.0);
    // of the flux, the peak is 4 ln 2 / pi / FWHM^2 and a little less, as the pixel smears it
    places.iter().for_each(|(x, y)| sky.add_star(Psf::Gaussian(sigma(2.0)), x.round(), y.round(), 790.0));
    let image: Vec<f64> = sky.light.iter().zip(&noise).map(|(light, noise)| light + noise).collect();
    let peak = |of: &[f64], (x, y): (f64, f64)| of[y.round() as usize * side + x.round() as usize];
    let high = places.iter().map(|place| peak(&sky.light, *place)).fold(f64::INFINITY, f64::min);
    assert!((130.0..190.0).contains(&high), "{high}");
    let (cleaned, daofind) = (median_5x5(&image, side), Daofind::new(2.0));
    let limit = 7.0 * deviation(&median_5x5(&noise, side));
    let is_old = |place: &&(f64, f64)| {
        let at = (place.0.round() as usize, place.1.round() as usize);
        peak(&cleaned, **place) > limit && daofind.amplitude(&cleaned, side, at) > limit * daofind.relative_error
    };
    let counts = frame(&image);
    let frame = Frame::new(side, side, Pixels::F32(&counts)).unwrap();
    let stars = measure(&frame, &Camera::default(), &StarSearch::default()).unwrap().stars;
    let is_ours = |place: &&(f64, f64)| stars.iter().any(|star| (star.x_px - place.0).hypot(star.y_px - place.1) < 1.5);
    let (old, ours) = (places.iter().filter(is_old).count(), places.iter().filter(is_ours).count());
    println!("of {} narrow stars the predecessor sees {old}, ours {ours}", places.len());
    assert!(old == 0 && ours == places.len(), "{old}, {ours}");
}

/// The hash of four points, by brightness (docs/formulae.md, "Hash of four stars").
fn quad_hash(points: [(f64, f64); 4]) -> [f64; 4] {
    let apart = |i: usize, j: usize| (points[i].0 - points[j].0).hypot(points[i].1 - points[j].1);
    let pairs = (0..4).flat_map(|i| (i + 1..4).map(move |j| (i, j)));
    let (a, b) = pairs.max_by(|p, q| apart(p.0, p.1).total_cmp(&apart(q.0, q.1))).unwrap();
    let mut others: Vec<usize> = (0..4).filter(|n| *n != a && *n != b).collect();
    others.sort_by(|i, j| apart(a, *j).total_cmp(&apart(a, *i)));
    let (dx, dy) = (points[b].0 - points[a].0, points[b].1 - points[a].1);
    let square = dx * dx + dy * dy;
    let seen = |n: usize| {
        let (x, y) = (points[n].0 - points[a].0, points[n].1 - points[a].1);
        ((x * dx + y * dy) / square, (y * dx - x * dy) / square)
    };
    let (mut c, mut d) = (seen(others[0]), seen(others[1]));
    if c.1 <= 0.0 {
        (c.1, d.1) = (-c.1, -d.1);
    }
    [c.0 - c.1, d.0 - d.1, c.0 + c.1, d.0 + d.1].map(|sum| sum / 2.0_f64.sqrt())
}

#[test]
fn the_old_quad_hash_is_the_golden_one_and_depends_on_which_star_is_the_brighter() {
    let quad = [(0.0, 0.0), (10.0, 0.0), (6.0, 3.0), (3.0, -2.0)];
    let golden = [0.212132, 0.353553, 0.636396, 0.070711];
    let mirrored = quad.map(|(x, y)| (x, -y));
    let exchanged = [quad[1], quad[0], quad[2], quad[3]];
    for (quad, golden) in [(quad, golden), (mirrored, golden), (exchanged, [0.353553, 0.494975, 0.636396, 0.070711])] {
        quad_hash(quad).iter().zip(golden).for_each(|(found, golden)| near(*found, golden, 6));
    }
}

/// The predecessor's shift along one axis: sums, circular cross-correlation, a parabola through its peak
/// (docs/formulae.md, "Shift by projections"). The result is how to move back: minus the way of the stars.
fn donuts(reference: &[f64], check: &[f64]) -> f64 {
    let n = reference.len();
    let phi: Vec<f64> = (0..n).map(|lag| (0..n).map(|k| reference[k] * check[(k + lag) % n]).sum()).collect();
    let z = (0..n).max_by(|a, b| phi[*a].total_cmp(&phi[*b])).unwrap();
    let (before, at, after) = (phi[(z + n - 1) % n], phi[z], phi[(z + 1) % n]);
    let lag = z as f64 + 0.5 * (before - after) / (before - 2.0 * at + after);
    -(if lag > n as f64 / 2.0 { lag - n as f64 } else { lag })
}

#[test]
fn donuts_gives_the_golden_shifts_and_registered_stars_are_nearer_to_the_truth() {
    const SIDE: usize = 512;
    const BORDER: usize = 64;
    let places: Vec<(f64, f64)> = {
        // within the border also after the largest shift
        let places = Sky::new(SIDE, SIDE, 0.0, 21).places(200, 15.0);
        let inner = |(x, y): &(f64, f64)| (90.0..370.0).contains(x) && (90.0..420.0).contains(y);
        places.into_iter().filter(inner).take(30).collect()
    };
    assert_eq!(places.len(), 30);
    let drawn = |dx: f64, dy: f64, seed: u64| {
        let mut sky = Sky::new(SIDE, SIDE, 100.0, seed);
        let star = |(n, (x, y)): (usize, &(f64, f64))| (x + dx, y + dy, 20_000.0 + 3000.0 * n as f64);
        places
            .iter()
            .enumerate()
            .map(star)
            .for_each(|(x, y, flux)| sky.add_star(Psf::Gaussian(sigma(4.0)), x, y, flux));
        sky.counts(300.0, 5.0)
    };
    let read = |counts: &[u16]| -> (Clean, Vec<Star>, [Vec<f64>; 2]) {
        let frame = Frame::new(SIDE, SIDE, Pixels::U16(counts)).unwrap();
        let clean = Clean::new(&frame, &Camera::default(), Some(4.0)).unwrap();
        let stars = measure(&frame, &Camera::default(), &StarSearch::default()).unwrap().stars;
        let inner = BORDER..SIDE - BORDER;
        let at = |x: usize, y: usize| f64::from(clean.pixels[y * SIDE + x]);
        let columns = inner.clone().map(|x| inner.clone().map(|y| at(x, y)).sum()).collect();
        let rows = inner.clone().map(|y| inner.clone().map(|x| at(x, y)).sum()).collect();
        (clean, stars, [columns, rows])
    };
    let reference = read(&drawn(0.0, 0.0, 1));
    for (dx, dy, golden) in [(2.3, -1.4, (-2.28, 1.38)), (10.7, -7.2, (-10.70, 7.19)), (60.0, 10.0, (-60.0, -9.98))] {
        let check = read(&drawn(dx, dy, 2));
        let old = (donuts(&reference.2[0], &check.2[0]), donuts(&reference.2[1], &check.2[1]));
        assert!((old.0 - golden.0).abs() < 0.05 && (old.1 - golden.1).abs() < 0.05, "{old:?}, golden {golden:?}");
        let off = |x: f64, y: f64| (x - dx).hypot(y - dy);
        let stars = from_stars(&reference.1, &check.1, SIDE, SIDE).unwrap();
        let sums = from_projections(&reference.0, &check.0).unwrap();
        let (old, by_stars, by_sums) =
            (off(-old.0, -old.1), off(stars.dx_px, stars.dy_px), off(sums.dx_px, sums.dy_px));
        println!("({dx}, {dy}): donuts off by {old:.4}, our sums {by_sums:.4}, our stars {by_stars:.4} px");
        assert!(by_stars < 0.01 && by_stars < old + 0.002 && by_sums < 0.05, "({dx}, {dy})");
    }
}
