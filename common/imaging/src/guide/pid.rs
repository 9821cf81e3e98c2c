//! The predecessor's controller, for those who want it: proportional, integral, differential, per frame.
//!
//! `u = kp e + ki sum(e) + kd (e - e_before)`, the sum held within 500 px; no time in it.

/// Gains of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gains {
    /// Of the error itself.
    pub proportional: f64,
    /// Of the sum of all errors.
    pub integral: f64,
    /// Of the change since the last frame.
    pub differential: f64,
}

impl Gains {
    /// The predecessor's for its x axis (right ascension with its cameras).
    pub const FIRST_AXIS: Self = Self { proportional: 0.7, integral: 0.02, differential: 0.0 };
    /// The predecessor's for its y axis.
    pub const SECOND_AXIS: Self = Self { proportional: 0.5, integral: 0.02, differential: 0.0 };
    /// While stabilising: the error is taken back whole.
    pub(super) const WHOLE: Self = Self { proportional: 1.0, integral: 0.0, differential: 0.0 };
}

/// The sum of errors stays within this, px.
const GREATEST_SUM_PX: f64 = 500.0;

/// A controller with its memory.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Pid {
    gains: Gains,
    sum_px: f64,
    before_px: f64,
}

impl Pid {
    pub(super) fn new(gains: Gains) -> Self {
        Self { gains, sum_px: 0.0, before_px: 0.0 }
    }

    /// How much of an error (px) is to be taken back, px.
    pub(super) fn output_px(&mut self, error_px: f64) -> f64 {
        self.sum_px = (self.sum_px + error_px).clamp(-GREATEST_SUM_PX, GREATEST_SUM_PX);
        let change_px = error_px - self.before_px;
        self.before_px = error_px;
        self.gains.proportional * error_px + self.gains.integral * self.sum_px + self.gains.differential * change_px
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_golden_numbers_of_the_predecessor_come_out() {
        // computed with Astra 1.2.0
        let mut pid = Pid::new(Gains::FIRST_AXIS);
        for (error_px, golden) in [(2.0, 1.44), (1.0, 0.76), (-0.5, -0.30), (0.0, 0.05)] {
            assert!((pid.output_px(error_px) - golden).abs() < 1e-12);
        }
    }

    #[test]
    fn the_sum_is_held() {
        let mut pid = Pid::new(Gains { proportional: 0.0, integral: 1.0, differential: 0.0 });
        let last = (0..1000).map(|_| pid.output_px(20.0)).last();
        assert_eq!(last, Some(500.0));
        let mut differential = Pid::new(Gains { proportional: 0.0, integral: 0.0, differential: 2.0 });
        assert_eq!((differential.output_px(1.0), differential.output_px(0.5)), (2.0, -1.0));
    }
}
