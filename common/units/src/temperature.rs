//! A temperature on the Celsius scale.

/// A temperature in degrees Celsius.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Celsius(f64);

impl Celsius {
    /// From degrees Celsius.
    pub const fn new(celsius: f64) -> Self {
        Self(celsius)
    }

    /// In degrees Celsius.
    pub const fn celsius(self) -> f64 {
        self.0
    }
}
