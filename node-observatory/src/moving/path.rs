//! The path of a body over this site, as one mount counts it.

use schedule::moving_target;
use sky::{Body, Icrs, Observer};
use units::Utc;

use super::rated_motion::{Spot, TRAIL_ARCSEC};
use crate::action_error::ActionError;
use crate::devices::telescope::Mount;
use crate::row_context::RowContext;

/// Rates are renewed no more often than this where the row gives no other interval, s.
const INTERVAL_S: f64 = 10.0;
/// Where a path bends faster than straight pieces of that length can follow, shorter ones are tried.
const SHORTER_S: [f64; 3] = [5.0, 2.0, 1.0];
/// A body's path.
pub struct Path<'a> {
    context: &'a RowContext,
    mount: &'a Mount,
    body: &'a Body,
}

impl<'a> Path<'a> {
    /// The path of `body`.
    pub fn new(context: &'a RowContext, mount: &'a Mount, body: &'a Body) -> Self {
        Self { context, mount, body }
    }

    /// Its place among the stars.
    pub fn icrs(&self, at: Utc) -> Result<Icrs, ActionError> {
        Ok(self.body.seen(&self.context.observer(at)?)?.icrs)
    }

    /// Its place in the mount's frame.
    pub fn spot(&self, at: Utc) -> Result<Spot, ActionError> {
        let observer = self.context.observer(at)?;
        self.of_mount(&self.body.seen(&observer)?.icrs, &observer)
    }

    /// A place among the stars in the mount's frame.
    pub fn of_mount(&self, place: &Icrs, observer: &Observer) -> Result<Spot, ActionError> {
        let (ra, dec) = self.mount.place(place, observer)?;
        Ok(Spot { ra, dec })
    }

    /// How long rates may last now, s: as the row has it, or as long as a straight piece stays near the path.
    pub fn interval_s(&self, now: Utc, requested_s: Option<f64>) -> Result<f64, ActionError> {
        if let Some(requested_s) = requested_s {
            return Ok(requested_s.max(0.5));
        }
        let start = self.spot(now)?;
        for interval_s in std::iter::once(INTERVAL_S).chain(SHORTER_S) {
            let (middle, end) =
                (self.spot(now.plus_seconds(interval_s / 2.0))?, self.spot(now.plus_seconds(interval_s))?);
            let straight = Spot {
                ra: start.ra + (end.ra - start.ra).wrapped_signed() * 0.5,
                dec: start.dec + (end.dec - start.dec) * 0.5,
            };
            if straight.apart_arcsec(&middle) < TRAIL_ARCSEC {
                return Ok(interval_s);
            }
        }
        Ok(SHORTER_S[SHORTER_S.len() - 1])
    }

    /// Until when it is in what the site leaves of the sky from `from` on, but not beyond `to`.
    ///
    /// # Errors
    /// [`ActionError::Impossible`] where it does not at `from`.
    pub fn up_until(&self, from: Utc, to: Utc) -> Result<Utc, ActionError> {
        moving_target::up_until(
            self.body,
            (from, to),
            &self.mount.horizon_limits,
            |at| self.context.observer(at),
            ActionError::Impossible,
        )
    }
}
