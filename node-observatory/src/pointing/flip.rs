//! The meridian flip of a German mount: between two frames, once the next one would end too far past the meridian.
//!
//! A slew to the same place is what turns such a mount over. One that stays on its side is left there: frames go on
//! until the mount's device node stops it at its limit (`telescope.limits.meridian_past_min`), whatever this node does.

use std::time::Duration;

use contract::device::telescope::PierSide;
use schedule::meridian_flip::is_past;
use sky::Icrs;
use units::Utc;

use super::fix::pier_side;
use crate::devices::telescope::Mount;
use crate::row_context::RowContext;

/// A mount that has turned over reports its other side within this, machine time: some drivers are late with it.
const REPORTED_WITHIN: Duration = Duration::from_secs(10);
/// How often that is looked after.
const LOOKED_AFTER: Duration = Duration::from_millis(50);

/// Watches for the moment to turn a mount over.
pub struct Flip<'a> {
    context: &'a RowContext,
    mount: &'a Mount,
    /// A flip that was commanded did not happen.
    is_ignored: bool,
}

impl<'a> Flip<'a> {
    /// Of a row that tracks with this mount.
    pub fn of(context: &'a RowContext, mount: &'a Mount) -> Self {
        Self { context, mount, is_ignored: false }
    }

    /// Must the mount be turned over before a frame of this length that begins now?
    pub fn is_due(&self, target: &Icrs, exposure_s: f64, now: Utc) -> bool {
        let config = &self.mount.config;
        if !config.meridian_flip || self.is_ignored {
            return false;
        }
        let Ok(then) = self.context.observer(now.plus_seconds(exposure_s)) else { return false };
        is_past(pier_side(self.mount), then.hour_angle(target), config.meridian_flip_min)
    }

    /// The side that the mount reports.
    pub fn side(&self) -> Option<PierSide> {
        pier_side(self.mount)
    }

    /// After the slew that should have turned it over from `side`: returns a note if it did not. This waits for a mount
    /// that reports its side late.
    pub async fn note(&mut self, side: PierSide) -> Option<String> {
        if !stays(REPORTED_WITHIN, side, || pier_side(self.mount)).await {
            return None;
        }
        self.is_ignored = true;
        let name = &self.mount.instrument.device.name;
        Some(format!("no meridian flip: {name} stayed on its side of the pier"))
    }
}

/// Does a mount report all the time that its tube is on the side of the pier on which it was?
async fn stays(within: Duration, before: PierSide, side: impl Fn() -> Option<PierSide> + Send + Sync) -> bool {
    let reported_otherwise = async {
        while side() == Some(before) {
            tokio::time::sleep(LOOKED_AFTER).await;
        }
    };
    tokio::time::timeout(within, reported_otherwise).await.is_err()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use units::Angle;

    use super::*;

    /// Whether a mount that reports these sides one after the other, and the last for ever, is found to have stayed.
    async fn concluded(within: Duration, before: PierSide, sides: &[Option<PierSide>]) -> bool {
        let looks = AtomicUsize::new(0);
        let side = || sides[looks.fetch_add(1, Ordering::Relaxed).min(sides.len() - 1)];
        stays(within, before, side).await
    }

    /// It stayed, however soon that is asked.
    async fn stayed(before: PierSide, sides: &[Option<PierSide>]) -> bool {
        concluded(5 * LOOKED_AFTER, before, sides).await
    }

    /// It has turned, or nobody knows, however late that is seen.
    async fn turned(before: PierSide, sides: &[Option<PierSide>]) -> bool {
        !concluded(Duration::from_secs(600), before, sides).await
    }

    #[tokio::test]
    async fn a_mount_that_reports_its_side_late_has_turned_over_all_the_same() {
        let [west, east] = [Some(PierSide::West), Some(PierSide::East)];
        assert!(turned(PierSide::West, &[east]).await, "it shows at once");
        assert!(turned(PierSide::West, &[west, west, west, east]).await, "it is late");
        assert!(
            turned(PierSide::West, &[west, None]).await,
            "it reports nothing any more: nobody knows that it stayed"
        );
        assert!(stayed(PierSide::West, &[west, west, west]).await, "it stayed");
        // Past the lower meridian it turns over the other way.
        assert!(stayed(PierSide::East, &[east, east, east]).await, "it stayed");
        assert!(turned(PierSide::East, &[east, east, west]).await, "it turned over");
    }

    #[tokio::test]
    async fn a_mount_that_reports_its_sides_the_wrong_way_round_is_asked_to_turn_over_once_and_left_alone() {
        // Truly east of the pier and looking west, where it belongs; its driver reports west.
        let half_an_hour = Angle::from_hours(0.5);
        assert!(is_past(Some(PierSide::West), half_an_hour, 5.0), "one slew to where it stands already");
        assert!(stayed(PierSide::West, &[Some(PierSide::West)]).await, "which is noted, and not tried again");
        // Truly west of the pier, as it was before the meridian; its driver reports east: its device node stops it.
        assert!(!is_past(Some(PierSide::East), half_an_hour, 5.0));
    }
}
