//! Where a frame shows stars at all: a roof or trees may hide a part of it.
//!
//! Stars can only agree where they are seen. The catalogue is taken as deep as the seen part asks for, and the probability
//! of agreement by chance is that of the seen part, where the frame's stars are as dense as they are, not that of the
//! whole frame.

use super::similarity::Place;

/// Cells along a side.
const SIDE: usize = 24;
/// A place is seen when a star lies within so many mean distances of it: `exp(-FAR^2)`, 1 in 50, of an open sky does not.
const FAR: f64 = 2.0;
/// Rounds in which the mean distance is taken from the seen part alone.
const ROUNDS: usize = 4;
/// From this share on the frame counts as open: gaps of that size come by chance.
const OPEN: f64 = 0.75;
/// Fewer stars show nothing.
const FEWEST: usize = 10;

/// The part of a frame in which its stars are.
pub(super) struct StarArea {
    /// None where the frame is open.
    cells: Option<Vec<bool>>,
    /// Seen share of the frame.
    pub(super) share: f64,
}

impl StarArea {
    /// `places` are the frame's stars, px from its centre.
    pub(super) fn new(places: &[Place], width: f64, height: f64) -> Self {
        let open = Self { cells: None, share: 1.0 };
        if places.len() < FEWEST {
            return open;
        }
        let (mut share, mut cells) = (1.0, Vec::new());
        for _ in 0..ROUNDS {
            let far2 = FAR * FAR * share * width * height / (std::f64::consts::PI * places.len() as f64);
            cells = (0..SIDE * SIDE)
                .map(|n| {
                    let at = |n: usize, length: f64| ((n as f64 + 0.5) / SIDE as f64 - 0.5) * length;
                    let (x, y) = (at(n % SIDE, width), at(n / SIDE, height));
                    places.iter().any(|place| (place.0 - x).powi(2) + (place.1 - y).powi(2) <= far2)
                })
                .collect();
            share = cells.iter().filter(|seen| **seen).count() as f64 / (SIDE * SIDE) as f64;
            if share >= OPEN {
                return open;
            }
        }
        // a place without any cell cannot be: the nearest cell's middle may be just too far
        if share > 0.0 { Self { cells: Some(cells), share } } else { open }
    }

    /// Whether stars are seen around a place inside of the frame.
    pub(super) fn holds(&self, x: f64, y: f64, width: f64, height: f64) -> bool {
        let Some(cells) = &self.cells else { return true };
        let cell = |at: f64, length: f64| (((at / length + 0.5) * SIDE as f64).max(0.0) as usize).min(SIDE - 1);
        cells.get(cell(y, height) * SIDE + cell(x, width)).copied().unwrap_or(false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scattered(count: usize, inside: impl Fn(f64, f64) -> bool) -> Vec<Place> {
        // the additive sequence of the plastic number covers evenly
        let all = (0..10_000).map(|n| {
            let at = |step: f64| (0.5 + step * f64::from(n)).fract() - 0.5;
            (1000.0 * at(0.754_877_666_246_693), 1000.0 * at(0.569_840_290_998_053))
        });
        all.filter(|(x, y)| inside(*x, *y)).take(count).collect()
    }

    #[test]
    fn an_open_frame_is_whole_and_a_hidden_part_is_reported() {
        for count in [12, 40, 300] {
            assert_eq!(StarArea::new(&scattered(count, |_, _| true), 1000.0, 1000.0).share, 1.0);
        }
        let seen = StarArea::new(&scattered(60, |x, _| x < -150.0), 1000.0, 1000.0);
        assert!((0.34..0.65).contains(&seen.share), "{}", seen.share);
        assert!(seen.holds(-400.0, 100.0, 1000.0, 1000.0) && !seen.holds(300.0, 100.0, 1000.0, 1000.0));
    }
}
