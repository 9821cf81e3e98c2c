//! How fast the field turns: the slope of the measured rotations over the last hour or so.
//!
//! Guiding holds one point; a misaligned polar axis or a rotator that does not follow turns the field around it.

/// Weight of the past falls to 1/e in this time, s.
const MEMORY_S: f64 = 3600.0;
/// Nothing is left of what was seen so long ago, s.
const FORGOTTEN_S: f64 = 100.0 * MEMORY_S;
/// Rotation that is reported, deg/h, if it is so many standard errors from none: chosen, not measured.
const MEASURED_DEG_H: f64 = 0.05;
const BEYOND_DOUBT: f64 = 3.0;
const FEWEST: f64 = 5.0;

/// Sums for a straight line whose origin travels with the newest frame: times are s before it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Rotation {
    last_s: Option<f64>,
    weight: f64,
    t: f64,
    tt: f64,
    r: f64,
    tr: f64,
    rr: f64,
}

impl Rotation {
    /// Takes in a rotation (degrees) at a time (s).
    pub(super) fn note(&mut self, time_s: f64, rotation_deg: f64) {
        let dt_s = time_s - self.last_s.unwrap_or(time_s);
        if !(dt_s >= 0.0 && rotation_deg.is_finite()) {
            return;
        }
        if dt_s > FORGOTTEN_S {
            *self = Self::default();
        }
        let dt_s = if self.last_s.is_some() { dt_s } else { 0.0 };
        self.last_s = Some(time_s);
        // the origin moves on: t' = t - dt
        self.tt += dt_s * (dt_s * self.weight - 2.0 * self.t);
        self.tr -= dt_s * self.r;
        self.t -= dt_s * self.weight;
        let fade = (-dt_s / MEMORY_S).exp();
        for sum in [&mut self.weight, &mut self.t, &mut self.tt, &mut self.r, &mut self.tr, &mut self.rr] {
            *sum *= fade;
        }
        self.weight += 1.0;
        self.r += rotation_deg;
        self.rr += rotation_deg.powi(2);
    }

    /// Rate and its standard error, deg/h.
    pub(super) fn rate_deg_h(&self) -> Option<(f64, f64)> {
        let (t, r) = (self.t / self.weight, self.r / self.weight);
        let tt = self.tt - self.weight * t * t;
        let tr = self.tr - self.weight * t * r;
        let rr = self.rr - self.weight * r * r;
        if !(self.weight >= FEWEST && tt > 0.0) {
            return None;
        }
        let slope = tr / tt;
        let variance = (rr - slope * tr).max(0.0) / (self.weight - 2.0) / tt;
        let per_hour = (3600.0 * slope, 3600.0 * variance.sqrt());
        (per_hour.0.is_finite() && per_hour.1.is_finite()).then_some(per_hour)
    }

    /// Whether it turns beyond doubt.
    pub(super) fn is_measured(&self) -> bool {
        self.rate_deg_h().is_some_and(|(rate, error)| rate.abs() - BEYOND_DOUBT * error > MEASURED_DEG_H)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(rate_deg_h: f64) -> Rotation {
        let mut rotation = Rotation::default();
        for n in 0..120 {
            let noise = 0.002 * (f64::from(n * 7919 % 101) / 50.0 - 1.0);
            rotation.note(1e6 + 60.0 * f64::from(n), rate_deg_h * f64::from(n) / 60.0 + noise);
        }
        rotation
    }

    #[test]
    fn the_rate_is_that_of_the_line_and_certain() {
        for rate in [-0.3, 0.0, 0.04, 0.12] {
            let rotation = after(rate);
            let (found, error) = rotation.rate_deg_h().unwrap();
            assert!((found - rate).abs() < 4.0 * error && error < 0.002, "{found} +- {error}");
            assert_eq!(rotation.is_measured(), rate.abs() > 0.05);
        }
        assert_eq!(Rotation::default().rate_deg_h(), None);
    }

    #[test]
    fn times_that_go_back_and_what_is_no_number_are_passed_over() {
        let (mut rotation, clean) = (after(0.1), after(0.1));
        rotation.note(5.0, 3.0);
        rotation.note(f64::NAN, 3.0);
        rotation.note(2e6, f64::INFINITY);
        assert_eq!(rotation, clean);
    }

    #[test]
    fn after_a_time_that_no_clock_shows_the_rate_is_measured_anew() {
        let mut rotation = after(0.1);
        rotation.note(f64::MAX, 3.0);
        assert_eq!(rotation.rate_deg_h(), None);
        let mut anew = after(0.1);
        for n in 0..40 {
            anew.note(1e9 + 60.0 * f64::from(n), -0.3 * f64::from(n) / 60.0);
        }
        let (found, error) = anew.rate_deg_h().unwrap();
        assert!((found + 0.3).abs() < 1e-6 && error < 1e-6, "{found} +- {error}");
    }
}
