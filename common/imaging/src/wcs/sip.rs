//! Distortion as a polynomial of the place in the frame: the SIP convention.
//!
//! Shupe et al. 2005, ASP Conf. 347, 491: with u, v px from CRPIX, the linear part of the WCS is given `u + A(u, v)`
//! and `v + B(u, v)`; the terms of A and B have a sum of powers from 2 to the order.

use crate::least_squares::LeastSquares;

/// Greatest sum of powers that this house fits.
pub const MAX_ORDER: usize = 3;
/// Powers (of u, of v) of each term.
const POWERS: [(i32, i32); 7] = [(2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)];
/// Powers of the inverse: linear terms too, and up to the fifth order, since that of r + k r^3 is r - k r^3 + 3 k^2 r^5 - ...
#[rustfmt::skip]
const INVERSE_POWERS: [(i32, i32); 20] = [
    (1, 0), (0, 1),
    (2, 0), (1, 1), (0, 2),
    (3, 0), (2, 1), (1, 2), (0, 3),
    (4, 0), (3, 1), (2, 2), (1, 3), (0, 4),
    (5, 0), (4, 1), (3, 2), (2, 3), (1, 4), (0, 5),
];
/// Order of the inverse.
pub(super) const INVERSE_ORDER: usize = 5;

/// One term `coefficient u^p v^q`; u, v and the sum in px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Term {
    /// Power of u.
    pub p: i32,
    /// Power of v.
    pub q: i32,
    /// Its factor, px^(1 - p - q).
    pub coefficient: f64,
}

/// A distortion of up to third order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sip {
    /// Coefficients of A in the order u2 uv v2 u3 u2v uv2 v3, px^(1 - p - q).
    pub a: [f64; 7],
    /// Coefficients of B, likewise.
    pub b: [f64; 7],
}

impl Sip {
    /// The corrected place of `(u, v)`, px from CRPIX.
    pub fn apply(&self, u: f64, v: f64) -> (f64, f64) {
        let terms = [u * u, u * v, v * v, u * u * u, u * u * v, u * v * v, v * v * v];
        let sum = |coefficients: &[f64; 7]| coefficients.iter().zip(terms).map(|(c, t)| c * t).sum::<f64>();
        (u + sum(&self.a), v + sum(&self.b))
    }

    /// The place whose corrected place is `(u, v)`, px from CRPIX; None where the distortion folds over.
    pub fn invert(&self, u: f64, v: f64) -> Option<(f64, f64)> {
        let (mut x, mut y) = (u, v);
        for _ in 0..50 {
            let (seen_x, seen_y) = self.apply(x, y);
            let (step_x, step_y) = (u - seen_x, v - seen_y);
            x += step_x;
            y += step_y;
            if step_x.hypot(step_y) < 1e-8 {
                return Some((x, y));
            }
        }
        None
    }

    /// Terms of A, then of B.
    pub fn terms(&self) -> [Vec<Term>; 2] {
        [self.a, self.b].map(|coefficients| {
            POWERS.iter().zip(coefficients).map(|((p, q), coefficient)| Term { p: *p, q: *q, coefficient }).collect()
        })
    }

    /// Terms AP, then BP of the inverse, `u = U + AP(U, V)`, fitted over `|u| <= half_width`, `|v| <= half_height`
    /// (px); readers that do not invert A and B themselves use them. None where the distortion folds over.
    pub fn inverse_terms(&self, half_width: f64, half_height: f64) -> Option<[Vec<Term>; 2]> {
        let scale = half_width.hypot(half_height).max(1.0);
        let mut sums = [LeastSquares::<20>::new(), LeastSquares::<20>::new()];
        for i in -8..=8 {
            for j in -8..=8 {
                let (u, v) = (half_width * f64::from(i) / 8.0, half_height * f64::from(j) / 8.0);
                let (seen_u, seen_v) = self.apply(u, v);
                let row = INVERSE_POWERS.map(|(p, q)| (seen_u / scale).powi(p) * (seen_v / scale).powi(q));
                sums[0].add(row, u - seen_u, 1.0);
                sums[1].add(row, v - seen_v, 1.0);
            }
        }
        let terms = |sums: &LeastSquares<20>| {
            let term = |((p, q), c): (&(i32, i32), f64)| Term { p: *p, q: *q, coefficient: c / scale.powi(p + q) };
            sums.solve().map(|solved| INVERSE_POWERS.iter().zip(solved).map(term).collect())
        };
        Some([terms(&sums[0])?, terms(&sums[1])?])
    }
}
