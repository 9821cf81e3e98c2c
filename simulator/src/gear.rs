//! A gear with play: the load stands still while the motor crosses the play after a reversal.

/// The play between a motor and its load, in the unit that its owner counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gear {
    play: f64,
    /// How much of the play the motor has crossed forward: 0 drives backward, `play` drives forward.
    crossed: f64,
}

impl Gear {
    /// Ready to drive forward; a negative play counts as none.
    pub fn driving_forward(play: f64) -> Self {
        let play = play.max(0.0);
        Self { play, crossed: play }
    }

    /// Lets the motor move by this; only the motion beyond the play moves the load.
    pub fn turn(&mut self, by: f64) {
        self.crossed = (self.crossed + by).clamp(0.0, self.play);
    }

    /// Motor less load, counted from the middle of the play: half the play when driving forward.
    pub fn lag(&self) -> f64 {
        self.crossed - self.play / 2.0
    }

    /// Gives it another play, driving forward or backward as before.
    pub fn set_play(&mut self, play: f64) {
        let part = if self.play > 0.0 { self.crossed / self.play } else { 1.0 };
        self.play = play.max(0.0);
        self.crossed = part * self.play;
    }

    /// The whole play.
    pub fn play(&self) -> f64 {
        self.play
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reversal_is_eaten_by_the_play_and_going_on_is_not() {
        let mut gear = Gear::driving_forward(10.0);
        let mut motor = 0.0;
        let mut load = |by: f64| {
            motor += by;
            gear.turn(by);
            motor - gear.lag()
        };
        let start = load(0.0);
        assert_eq!(load(4.0) - start, 4.0);
        assert_eq!(load(-6.0) - start, 4.0, "inside the play");
        assert_eq!(load(-6.0) - start, 2.0, "ten crossed, two moved");
        assert_eq!(load(3.0) - start, 2.0);
        assert_eq!(load(8.0) - start, 3.0);
    }

    #[test]
    fn without_play_the_load_follows_the_motor() {
        let mut gear = Gear::driving_forward(-1.0);
        gear.turn(-3.0);
        assert_eq!((gear.lag(), gear.play()), (0.0, 0.0));
        gear.set_play(4.0);
        assert_eq!(gear.lag(), 2.0);
    }
}
