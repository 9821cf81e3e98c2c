//! Raises an alert for a device whose values close the dome, and that needs long to answer.

use std::time::Duration;

use contract::observatory::AlertKind;
use contract::{DeviceKind as _, Kind};

use super::Loop;
use crate::driver::Driver;

/// A device that needs longer than this, and than half its period, for all its values is slow.
const SLOW: Duration = Duration::from_secs(3);

impl<D: Driver> Loop<D> {
    /// All values were asked for, which took so long.
    pub(super) fn note_slowness(&self, took: Duration) {
        if !matches!(D::Kind::KIND, Kind::SafetyMonitor | Kind::ObservingConditions | Kind::Switch) {
            return;
        }
        let alerts = &self.serve.node.alerts;
        let instance = self.instance();
        if is_slow(took, self.period()) {
            let cause = format!("{instance} needed {:.1} s to answer for all its values", took.as_secs_f64());
            alerts.raise(AlertKind::SlowDevice, &instance, &cause);
        } else {
            alerts.clear(AlertKind::SlowDevice, &instance);
        }
    }
}

fn is_slow(took: Duration, period: Duration) -> bool {
    took > SLOW && took > period / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_is_what_needs_more_than_three_seconds_and_half_its_period() {
        let s = Duration::from_secs_f64;
        for (took_s, period_s, expected) in
            [(2.9, 1.0, false), (3.1, 1.0, true), (15.0, 60.0, false), (31.0, 60.0, true), (15.0, 10.0, true)]
        {
            assert_eq!(is_slow(s(took_s), s(period_s)), expected, "{took_s} s of {period_s} s");
        }
    }
}
