//! How probable it is that stars agree by chance (docs/formulae.md, "Probability of agreement by chance").

/// Probability that at least `hits` of `trials` independent stars agree, each with probability `p`.
pub(super) fn at_least(hits: usize, trials: usize, p: f64) -> f64 {
    if hits == 0 {
        return 1.0;
    }
    if hits > trials || p <= 0.0 {
        return 0.0;
    }
    if p >= 1.0 {
        return 1.0;
    }
    // the first term by logarithms, the others by their ratio to the one before
    let choose: f64 = (1..=hits).map(|k| ((trials - hits + k) as f64 / k as f64).ln()).sum();
    let mut term = (choose + hits as f64 * p.ln() + (trials - hits) as f64 * (-p).ln_1p()).exp();
    let mut sum = term;
    for k in hits..trials {
        term *= (trials - k) as f64 / (k + 1) as f64 * p / (1.0 - p);
        sum += term;
        if term < 1e-17 * sum {
            break;
        }
    }
    sum.min(1.0)
}

/// Probability that a star that has nothing to do with `stars` in an area (px2) lies within `radius` px of one.
pub(super) fn near_one(stars: usize, radius_px: f64, area_px2: f64) -> f64 {
    -(-(stars as f64) * std::f64::consts::PI * radius_px * radius_px / area_px2).exp_m1()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_of_the_binomial_distribution() {
        // scipy 1.17.1: binom.sf(hits - 1, trials, p)
        for (hits, trials, p, expected) in [
            (1, 1, 0.25, 0.25),
            (2, 2, 1e-5, 1e-10),
            (3, 10, 0.1, 0.070_190_826_4),
            (60, 60, 0.5, 8.673_617_379_884_035e-19),
            (0, 5, 0.1, 1.0),
            (6, 5, 0.1, 0.0),
        ] {
            let found = at_least(hits, trials, p);
            assert!((found - expected).abs() <= 1e-9 * expected, "{found} for {hits} of {trials} at {p}");
        }
        assert_eq!(at_least(3, 10, 1.0), 1.0);
        assert_eq!(at_least(3, 10, 0.0), 0.0);
        assert!((at_least(1, 1000, 0.5) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_examples_of_the_specification() {
        // 10 catalogue stars in 2048 x 2048 px: 4 of 4 within 1.5 px with 1200 hypotheses; 3 of 3 shifted, 2 px, 1000 cells
        let area = 2048.0 * 2048.0;
        let four = at_least(2, 2, near_one(10, 1.5, area)) * 1200.0;
        assert!((3e-7..4e-7).contains(&four), "{four}");
        let three = at_least(2, 2, near_one(10, 2.0, area)) * 1000.0;
        assert!((8e-7..1e-6).contains(&three), "{three}");
        let five_of_six = at_least(3, 4, near_one(10, 1.5, area)) * 5900.0;
        assert!(five_of_six < 1e-9, "{five_of_six}");
    }
}
