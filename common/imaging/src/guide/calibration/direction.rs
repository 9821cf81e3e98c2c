//! The four directions of guide pulses.

/// A direction of a pulse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Declination up.
    North,
    /// Declination down.
    South,
    /// Right ascension up.
    East,
    /// Right ascension down.
    West,
}

impl Direction {
    /// 1 for North and East, -1 for South and West.
    pub(super) fn sign(self) -> f64 {
        match self {
            Self::North | Self::East => 1.0,
            Self::South | Self::West => -1.0,
        }
    }
}
