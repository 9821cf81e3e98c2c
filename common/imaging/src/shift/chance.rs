//! How often would as many places agree by chance?

/// Agreements that chance brings about more often than this are none.
const FALSE_ALARM: f64 = 3e-5;

/// So many pairs of places agree on a shift.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Agreement {
    /// Pairs that agree.
    pub(crate) agree: usize,
    /// Pairs that there are in the common part of both frames.
    pub(crate) pairs: usize,
    /// The common part, px^2.
    pub(crate) area_px2: f64,
    /// Within how many px they agree.
    pub(crate) reach_px: f64,
    /// The shift that they agree on, px.
    pub(crate) shift_px: f64,
}

impl Agreement {
    /// Whether chance would hardly do the same: as many pairs, in places spread evenly, on any shift as small as this one.
    pub(crate) fn is_sure(&self) -> bool {
        let circle_px2 = std::f64::consts::PI * self.reach_px.powi(2);
        let usual = self.pairs as f64 * circle_px2 / self.area_px2;
        // shifts that differ by less than the reach share their pairs
        let tried = (1.0 + self.shift_px / self.reach_px).powi(2) * std::f64::consts::PI;
        tried * at_least(self.agree, usual) < FALSE_ALARM
    }
}

/// The chance of at least `count` where `usual` are usual (Poisson).
fn at_least(count: usize, usual: f64) -> f64 {
    if usual.is_nan() || usual >= count as f64 {
        return 1.0;
    }
    let mut term = (1..=count).fold(-usual, |log, n| log + usual.ln() - (n as f64).ln()).exp();
    let mut sum = term;
    for n in count + 1..count + 200 {
        term *= usual / n as f64;
        sum += term;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tail_of_poisson_is_that_of_tables() {
        assert!((at_least(1, 0.5) - 0.393_469).abs() < 1e-6);
        assert!((at_least(5, 2.0) - 0.052_653).abs() < 1e-6);
        assert_eq!((at_least(0, 0.0), at_least(3, 4.0), at_least(1, f64::NAN)), (1.0, 1.0, 1.0));
        assert!(at_least(4, 0.0) == 0.0);
    }

    #[test]
    fn few_pairs_are_sure_only_where_hardly_another_shift_was_tried() {
        let two = Agreement { agree: 2, pairs: 4, area_px2: 1e6, reach_px: 3.0, shift_px: 2.0 };
        assert!(two.is_sure());
        assert!(!Agreement { shift_px: 300.0, area_px2: 2e5, ..two }.is_sure());
        assert!(!Agreement { agree: 1, pairs: 1, ..two }.is_sure());
        assert!(Agreement { agree: 5, pairs: 25, shift_px: 300.0, area_px2: 5e5, ..two }.is_sure());
        assert!(!Agreement { agree: 0, pairs: 0, ..two }.is_sure());
    }
}
