//! What a row can be known to do before it runs: where it looks, and what it exposes.

use sky::{Body, Horizontal, Icrs};

/// Where a row looks.
#[derive(Debug, Clone, PartialEq)]
pub enum Place {
    /// A place among the stars.
    Icrs(Icrs),
    /// What stands there when the row begins, and is then followed.
    Horizontal(Horizontal),
    /// A body that moves among the stars.
    Moving(Body),
}

/// Exposures of one length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposures {
    /// Of each, s.
    pub exposure_s: f64,
    /// How many; `None` until the row's window ends.
    pub frames: Option<u32>,
    /// What each takes in addition to its exposure and its reading out, such as a slew; s.
    pub extra_s: f64,
}

impl Exposures {
    /// So many, or until the window ends.
    pub fn of(exposure_s: f64, frames: Option<u32>) -> Self {
        Self { exposure_s, frames, extra_s: 0.0 }
    }

    /// Each with so much more time.
    pub fn with_extra_s(self, extra_s: f64) -> Self {
        Self { extra_s, ..self }
    }
}
