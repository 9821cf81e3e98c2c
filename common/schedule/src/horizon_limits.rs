//! The part of the sky that a site leaves to one mount: above walls and hills, and above the least altitude. Pure.
//!
//! Rows are compared with it when a schedule is checked (docs/decisions/0027), and again before every slew to a target
//! (docs/decisions/0036).

use config::{Horizon, HorizonSource, Observatory, Telescope};
use sky::{Horizontal, Icrs, Observer};
use units::Utc;

/// The step of the search along a window for times when a target stands clear, s, unless the window is long.
const STEP_S: f64 = 60.0;
const MOST_STEPS: f64 = 500.0;

/// A target of a slew has to be so far above a wall, degrees: the sky turns by that in four minutes.
const ROOM_DEG: f64 = 1.0;

/// The horizon limits of one mount; the plain horizon at 0 deg by default.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HorizonLimits {
    altitude_min_deg: f64,
    horizon: Option<Horizon>,
}

impl HorizonLimits {
    /// From the least altitude and the horizon of the site.
    pub fn new(altitude_min_deg: f64, horizon: Option<Horizon>) -> Self {
        Self { altitude_min_deg, horizon }
    }

    /// As the configuration has it for a mount; reads the file of its horizon.
    ///
    /// # Errors
    /// The limits without the horizon, and in words why that cannot be read.
    pub fn of(config: &Observatory, mount: &Telescope) -> Result<Self, (Self, String)> {
        let least_deg = altitude_min_deg(config, Some(mount));
        match mount.horizon.as_ref().map(read).transpose() {
            Ok(horizon) => Ok(Self::new(least_deg, horizon)),
            Err(why) => Err((Self::new(least_deg, None), why)),
        }
    }

    /// Why a target cannot be observed now, with numbers and units; `None` where it can.
    pub fn hides(&self, target: &Icrs, sky: &Observer) -> Option<String> {
        let (ra, dec) = (target.ra.degrees(), target.dec.degrees());
        let at = sky.to_horizontal(target);
        let altitude_deg = at.altitude.degrees();
        let words = if altitude_deg > 0.0 && altitude_deg >= self.altitude_min_deg {
            let azimuth_deg = at.azimuth.degrees();
            let wall_deg = self.behind(&at)?;
            format!("at azimuth {azimuth_deg:.1} deg, below the horizon of the site, which is {wall_deg:.1} deg there")
        } else if altitude_deg > 0.0 {
            format!("high, the least is {} deg", self.altitude_min_deg)
        } else {
            // Also for a place that is no number.
            "high, below the horizon".to_owned()
        };
        Some(format!("ra {ra:.4}, dec {dec:.4} deg stands {altitude_deg:.1} deg {words}"))
    }

    /// The lowest altitude that is left in a direction, with room for the sky to turn, degrees.
    pub fn lowest_deg(&self, azimuth_deg: f64) -> f64 {
        let wall_deg = self.horizon.as_ref().map_or(0.0, |horizon| horizon.altitude_deg(azimuth_deg) + ROOM_DEG);
        self.altitude_min_deg.max(wall_deg)
    }

    /// Altitude of the wall or hill that hides a direction, degrees.
    fn behind(&self, at: &Horizontal) -> Option<f64> {
        let horizon = self.horizon.as_ref()?;
        let wall_deg = horizon.altitude_deg(at.azimuth.degrees());
        (at.altitude.degrees() < wall_deg).then_some(wall_deg)
    }

    /// The time from which a target stands clear, searched every minute from `from` until `to`; `sky` is the sky at an
    /// instant.
    pub fn clear_from(&self, target: &Icrs, from: Utc, to: Utc, sky: impl Fn(Utc) -> Option<Observer>) -> Option<Utc> {
        let span_s = to.seconds_since(from);
        let step_s = STEP_S.max(span_s / MOST_STEPS);
        let steps = (span_s / step_s).floor().max(0.0) as u32;
        (0..=steps)
            .map(|step| from.plus_seconds(f64::from(step) * step_s))
            .find(|at| sky(*at).is_some_and(|sky| self.hides(target, &sky).is_none()))
    }
}

/// The least altitude for a mount: its own limit and `schedule.check`, and never below the plain horizon; degrees.
pub fn altitude_min_deg(config: &Observatory, mount: Option<&Telescope>) -> f64 {
    let limit_deg = mount.map_or(0.0, |mount| mount.limits.altitude_min_deg);
    limit_deg.max(config.schedule.check.altitude_min_deg).max(0.0)
}

/// A telescope's horizon; a file of it is read.
///
/// # Errors
/// In words: the file cannot be read, or is no horizon.
pub fn read(source: &HorizonSource) -> Result<Horizon, String> {
    match source {
        HorizonSource::Points(points) => Horizon::new(points),
        HorizonSource::File(path) => {
            let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
            text.parse().map_err(|why| format!("{}: {why}", path.display()))
        }
    }
}

#[cfg(test)]
#[path = "horizon_limits_tests.rs"]
mod tests;
