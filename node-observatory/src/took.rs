//! How long something took, for the plans of later nights.

use bus::Clock;
use units::Utc;

/// Sky time since an instant, s, to the hundredth.
pub fn took_s(clock: &Clock, began: Utc) -> f64 {
    (100.0 * clock.utc().seconds_since(began)).round() / 100.0
}
