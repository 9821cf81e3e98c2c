//! The value that a focus run measures on a frame, and the curve through the values.

use imaging::focus::sweep::Curve;
use imaging::focus::{Better, Operator, Smoother};

/// Name of the half-flux diameter among the operators; it is the usual one.
pub const HFD: &str = "hfd";
/// How frames are measured.
#[derive(Debug, Clone)]
pub struct Meter {
    /// Of the predecessor; the half-flux diameter where absent.
    pub operator: Option<&'static Operator>,
    /// Least signal-to-noise of a star that counts.
    pub least_snr: f64,
    /// Further values that are computed of each frame.
    pub others: Vec<&'static Operator>,
    /// Whether saturated stars are to be reported.
    pub looks_for_saturation: bool,
}

impl Meter {
    /// The operator's name.
    pub fn name(&self) -> &'static str {
        self.operator.map_or(HFD, |operator| operator.name)
    }

    /// The name of the values, with their unit.
    pub fn label(&self) -> &'static str {
        self.operator.map_or("HFD, px", |operator| operator.what)
    }

    /// The curve through the values: a hyperbola through sizes of stars, the smoother through anything else.
    pub fn curve(&self, smoother: &'static Smoother) -> Curve {
        match self.operator {
            Some(operator) if operator.better == Better::Larger => Curve::Smoothed(smoother, operator.better),
            _ => Curve::Hyperbola,
        }
    }
}
