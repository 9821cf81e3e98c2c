//! A part that moves at one speed to its target: a shutter, a focuser, a rotator.

use units::Angle;

/// Position and target of a moving part, in whatever unit its owner counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Travel {
    at: f64,
    target: f64,
    per_s: f64,
}

impl Travel {
    /// At rest, able to move at `per_s` units per sky second.
    pub fn resting(at: f64, per_s: f64) -> Self {
        Self { at, target: at, per_s }
    }

    /// Where it is.
    pub fn at(&self) -> f64 {
        self.at
    }

    /// Where it goes, or rests.
    pub fn target(&self) -> f64 {
        self.target
    }

    /// Whether it moves.
    pub fn is_moving(&self) -> bool {
        self.at != self.target
    }

    /// Moves at `per_s` units per sky second from now on; at 0 it hangs.
    pub fn set_speed(&mut self, per_s: f64) {
        self.per_s = per_s;
    }

    /// Sends it somewhere.
    pub fn send(&mut self, target: f64) {
        self.target = target;
    }

    /// Sends it to an angle in degrees by the shorter way round.
    pub fn send_round(&mut self, target_deg: f64) {
        self.at = self.at.rem_euclid(360.0);
        self.target = self.at + Angle::from_degrees(target_deg - self.at).wrapped_signed().degrees();
    }

    /// The same part at rest elsewhere.
    pub fn moved_to(self, at: f64) -> Self {
        Self::resting(at, self.per_s)
    }

    /// Stops it where it is.
    pub fn stop(&mut self) {
        self.target = self.at;
    }

    /// Lets sky time pass.
    pub fn advance(&mut self, dt: f64) {
        let step = self.per_s * dt;
        self.at = if (self.target - self.at).abs() <= step {
            self.target
        } else {
            self.at + step * (self.target - self.at).signum()
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn travel_takes_its_time_and_arrives() {
        let mut shutter = Travel::resting(0.0, 0.1);
        shutter.send(1.0);
        shutter.advance(4.0);
        assert!((shutter.at() - 0.4).abs() < 1e-12 && shutter.is_moving());
        shutter.advance(60.0);
        assert!(shutter.at() == 1.0 && !shutter.is_moving());
    }

    #[test]
    fn a_dome_turns_the_shorter_way() {
        let mut dome = Travel::resting(350.0, 5.0);
        dome.send_round(10.0);
        dome.advance(1.0);
        assert_eq!(dome.at(), 355.0);
        dome.advance(10.0);
        assert_eq!(dome.at().rem_euclid(360.0), 10.0);
    }
}
