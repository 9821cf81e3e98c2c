//! Four stars as a shape: four numbers that neither place, rotation, scale nor parity change.
//!
//! The two stars furthest apart, A and B, are the points 0 and 1 of a plane of complex numbers; the places C and D of
//! the other two on it are the code (Lang et al. 2010, AJ 139, 1782, section 2.1, who keep parity apart). What is left
//! to choose is chosen so that each shape has one code: which end is A, which star is C, and which side is up.

use super::similarity::{Place, divide};

/// A code: C and D, each along AB and across it, in lengths of AB.
pub(super) type Code = [f64; 4];

/// Four stars in the order A, B, C, D of a code.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shape {
    pub(super) code: Code,
    /// Which of the four given places is A, B, C and D.
    pub(super) order: [usize; 4],
    /// The side that is up was below.
    pub(super) flipped: bool,
}

/// The shapes of four places: one, and for places whose errors might change a choice (`slack`, in lengths of AB) the
/// ones that they might have as well. None for places that coincide.
pub(super) fn shapes(places: &[Place; 4], slack: f64, mut found: impl FnMut(Shape)) {
    const PAIRS: [(usize, usize); 6] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
    let squared = PAIRS.map(|(p, q)| (places[q].0 - places[p].0).powi(2) + (places[q].1 - places[p].1).powi(2));
    let longest = squared.iter().fold(0.0, |most: f64, s| most.max(*s));
    // what is not finite is no shape
    if !(longest > 0.0 && longest.is_finite()) {
        return;
    }
    // strictly one without slack: the first of equals
    let mut only = squared.iter().position(|s| *s == longest);
    for (n, (p, q)) in PAIRS.into_iter().enumerate() {
        let is_longest =
            if slack > 0.0 { squared[n] >= longest * (1.0 - 2.0 * slack).powi(2) } else { only == Some(n) };
        if is_longest {
            only = None;
            let (r, s) = PAIRS[5 - n];
            ends(places, [p, q, r, s], slack, &mut found);
        }
    }
}

/// The shapes whose ends are the first two of four places.
fn ends(places: &[Place; 4], [p, q, r, s]: [usize; 4], slack: f64, found: &mut impl FnMut(Shape)) {
    let base = (places[q].0 - places[p].0, places[q].1 - places[p].1);
    let on_base = |n: usize| divide((places[n].0 - places[p].0, places[n].1 - places[p].1), base);
    let (c, d) = (on_base(r), on_base(s));
    let mut is_found = false;
    for [swapped, turned, flipped] in (0..8).map(|n| [n & 1 != 0, n & 2 != 0, n & 4 != 0]) {
        let ((c, d), (r, s)) = if swapped { ((d, c), (s, r)) } else { ((c, d), (r, s)) };
        let end = |z: Place| if turned { (1.0 - z.0, -z.1) } else { z };
        let side = |z: Place| if flipped { (z.0, -z.1) } else { z };
        let (c, d) = (side(end(c)), side(end(d)));
        let chosen = c.0 + d.0 <= 1.0 + slack && c.0 <= d.0 + slack && c.1 + d.1 >= -slack;
        // of equals the first, where there must be one alone
        if chosen && !(is_found && slack == 0.0) {
            is_found = true;
            let (a, b) = if turned { (q, p) } else { (p, q) };
            found(Shape { code: [c.0, c.1, d.0, d.1], order: [a, b, r, s], flipped });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::similarity::Similarity;
    use super::*;

    fn all(places: &[Place; 4], slack: f64) -> Vec<Shape> {
        let mut shapes = Vec::new();
        super::shapes(places, slack, |shape| shapes.push(shape));
        shapes
    }

    const FOUR: [Place; 4] = [(10.0, 20.0), (55.0, -130.0), (-80.0, -20.0), (40.0, 33.0)];

    #[test]
    fn a_shape_has_one_code_wherever_and_however_it_lies() {
        let first = all(&FOUR, 0.0);
        assert_eq!(first.len(), 1);
        for n in 0..48 {
            let (sin, cos) = f64::from(n).sin_cos();
            let size = 0.2 + f64::from(n);
            let similarity = Similarity { s: (size * cos, size * sin), t: (70.0 * sin, 3.0), mirrored: n % 2 == 0 };
            let moved = FOUR.map(|place| similarity.apply(place));
            // and in whatever order
            let turned: [Place; 4] = std::array::from_fn(|k| moved[(k + n as usize) % 4]);
            let shape = all(&turned, 0.0);
            assert_eq!(shape.len(), 1, "{shape:?}");
            let far = |i: usize| (shape[0].code[i] - first[0].code[i]).abs();
            assert!((0..4).all(|i| far(i) < 1e-9), "{shape:?} is not {first:?}");
            assert_eq!(shape[0].flipped, first[0].flipped != (n % 2 == 0));
            let named = |i: usize| (shape[0].order[i] + n as usize) % 4;
            assert!((0..4).all(|i| named(i) == first[0].order[i]), "{shape:?} is not {first:?}");
        }
    }

    #[test]
    fn with_slack_every_choice_that_errors_may_turn_about_is_offered() {
        // AB and AC nearly as long, D nearly in the middle: each push lands on another side of the choices
        let even = [(0.0, 0.0), (100.0, 0.2), (50.1, 86.6), (50.0, 20.0)];
        let offered = all(&even, 0.01);
        assert!(offered.len() > 1 && offered.len() <= 24);
        for n in 0..100 {
            let (sin, cos) = f64::from(n).sin_cos();
            let pushed: [Place; 4] = std::array::from_fn(|k| {
                if k == n as usize % 4 { (even[k].0 + 0.3 * cos, even[k].1 + 0.3 * sin) } else { even[k] }
            });
            let shape = all(&pushed, 0.0)[0];
            let near = |other: &Shape| {
                other.order == shape.order
                    && other.flipped == shape.flipped
                    && (0..4).all(|i| (other.code[i] - shape.code[i]).abs() < 0.02)
            };
            assert!(offered.iter().any(near), "push {n}: {shape:?} is not offered");
        }
    }

    #[test]
    fn places_that_coincide_or_are_no_numbers_are_no_shape() {
        assert!(all(&[(1.0, 1.0); 4], 0.01).is_empty());
        assert!(all(&[(f64::NAN, 1.0), (0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], 0.0).len() <= 1);
        assert!(all(&[(f64::INFINITY, 1.0), (0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], 0.0).is_empty());
    }
}
