//! Computes which azimuths of a dome leave the telescope's view free.
//!
//! Lengths in metres, origin in the middle of the dome's sphere, axes to the east (e), the north (n) and the zenith
//! (z).
//!
//! A telescope at hour angle `H` and declination `d` looks along `s = cos d cos H a + cos d sin H b + sin d p`, where
//! `p` is the celestial pole, `a` the meridian's point of the celestial equator and `b` the west. The polar and the
//! declination axis meet at `m`. The declination axis of an equatorial mount stands on `p` and on `s`, along `w = -sin
//! H a + cos H b`: so the optical axis passes through `c = m + arm w` where the tube lies west of the pier, and through
//! `m - arm w` where it lies east of it. A ray that leaves a point `q` of the aperture meets the dome at `q + t s`,
//! with `t` the greater root of `|q + t s|^2 = radius^2`.
//!
//! The slit has parallel sides. Turned to azimuth `A` it is open where, seen along `A`, a point of the dome lies no
//! further to the side than half the width and no further behind the zenith than the slit reaches. For a point at
//! horizontal distance `r` in azimuth `B` that is an arc of `A` around `B`: of `asin(half / r)` to both sides where
//! `r > half`. The whole view is free in what the arcs of the aperture's rim have in common.

use units::Angle;

use crate::{Arc, Horizontal};

/// Turn of the sky, degrees per second of time.
const SIDEREAL_DEG_PER_S: f64 = 360.985_647_37 / 86_400.0;
/// Points of the rim that are followed; they stand on a polygon around the aperture, so nothing of it is overlooked.
const RIM: u32 = 24;
/// Steps in which the sky is followed ahead, s.
const STEP_S: f64 = 60.0;
/// Points that stand for equal parts of the aperture where it is weighed: a hundredth each.
const PARTS: u32 = 100;

/// On which side of its pier the tube of a German mount lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TubeSide {
    /// East of the pier, as for a target that has passed the meridian (ASCOM `pierEast`).
    East,
    /// West of the pier, as for a target that has not (ASCOM `pierWest`).
    West,
}

/// The direction of a telescope, in the terms of an equatorial mount.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aim {
    /// Of date, negative in the east.
    pub hour_angle: Angle,
    /// Of date.
    pub declination: Angle,
    /// It matters only for a mount with an arm.
    pub side: TubeSide,
}

impl Aim {
    /// At an hour angle and a declination, on the side that a mount takes when it slews there.
    pub fn at(hour_angle: Angle, declination: Angle) -> Self {
        let hour_angle = hour_angle.wrapped_signed();
        let side = if hour_angle.degrees() < 0.0 { TubeSide::West } else { TubeSide::East };
        Self { hour_angle, declination, side }
    }

    /// In a direction at the site, on the side that a mount takes when it slews there.
    pub fn towards(direction: &Horizontal, latitude: Angle) -> Self {
        let (altitude, azimuth) = (direction.altitude, direction.azimuth);
        let s = [altitude.cos() * azimuth.sin(), altitude.cos() * azimuth.cos(), altitude.sin()];
        let [a, b, p] = equator(latitude);
        let hour_angle = Angle::from_radians(dot(s, b).atan2(dot(s, a)));
        Self::at(hour_angle, Angle::from_radians(dot(s, p).clamp(-1.0, 1.0).asin()))
    }

    /// On this side of the pier.
    pub fn on(self, side: TubeSide) -> Self {
        Self { side, ..self }
    }

    /// Angle to another aim, [0, 180] deg.
    pub fn separation(&self, other: &Self) -> Angle {
        // The side of the pier has no effect here.
        let place = |aim: &Self| Horizontal { altitude: aim.declination, azimuth: aim.hour_angle };
        place(self).separation(&place(other))
    }

    /// Where a mount that follows the sky looks so many seconds later.
    pub fn after(&self, seconds: f64) -> Self {
        let turned = self.hour_angle + Angle::from_degrees(seconds * SIDEREAL_DEG_PER_S);
        Self { hour_angle: turned.wrapped_signed(), ..*self }
    }
}

/// A dome with a slit, and the telescope in it. Lengths in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slit {
    /// Of the site, north positive.
    pub latitude: Angle,
    /// Of the dome's sphere.
    pub radius_m: f64,
    /// Of the slit.
    pub width_m: f64,
    /// How far the slit reaches behind the zenith, along the ground.
    pub past_zenith_m: f64,
    /// Where the mount's axes meet, from the middle of the sphere: east, north, up.
    pub axes_m: [f64; 3],
    /// From there to the optical axis, along the declination axis; 0 for forks.
    pub arm_m: f64,
    /// Diameter of the aperture.
    pub aperture_m: f64,
}

impl Slit {
    /// A dome of which only the tolerance is known: how far its slit may be from the telescope's azimuth at the
    /// horizon.
    pub fn of_tolerance(latitude: Angle, tolerance: Angle) -> Self {
        let half_m = tolerance.sin();
        let (axes_m, arm_m, aperture_m) = ([0.0; 3], 0.0, 0.0);
        Self { latitude, radius_m: 1.0, width_m: 2.0 * half_m, past_zenith_m: half_m, axes_m, arm_m, aperture_m }
    }

    /// Where the middle of the slit belongs: the azimuth at which the optical axis meets the dome, [0, 360) deg.
    pub fn azimuth(&self, aim: &Aim) -> Angle {
        let (through, along) = self.optical_axis(aim);
        bearing(self.meets_dome(through, along)).1
    }

    /// Azimuths of the slit that leave the whole aperture free; none where the slit is too narrow there. Near the
    /// zenith it may be all.
    pub fn clear(&self, aim: &Aim) -> Option<Arc> {
        let (through, along) = self.optical_axis(aim);
        let [across, up] = square_to(along);
        let outer_m = 0.5 * self.aperture_m / (std::f64::consts::PI / f64::from(RIM)).cos();
        // The middle first: arcs that meet twice are joined on the side where it is.
        let middle = self.clear_for_point(self.meets_dome(through, along));
        (0..RIM).try_fold(middle, |clear, index| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(index) / f64::from(RIM)).sin_cos();
            let rim = add(through, add(scaled(across, outer_m * cos), scaled(up, outer_m * sin)));
            clear.intersection(&self.clear_for_point(self.meets_dome(rim, along)))
        })
    }

    /// How long from now a slit at `azimuth` leaves the whole aperture free while the mount follows the sky, s, at most
    /// `most_s`; `margin` stays free at both ends. None where it does not even now.
    pub fn clear_for_s(&self, aim: &Aim, azimuth: Angle, margin: Angle, most_s: f64) -> Option<f64> {
        let steps = times(most_s);
        steps.take_while(|s| self.clear(&aim.after(*s)).is_some_and(|arc| arc.shrunk(margin).contains(azimuth))).last()
    }

    /// The azimuth that leaves the whole aperture free for longest from now on, and how long, s, at most `most_s`; of
    /// several the one nearest to `near`. None where no azimuth does even now.
    ///
    /// If the dome turns to it each time, it turns the fewest times that are possible.
    pub fn lasting(&self, aim: &Aim, near: Angle, margin: Angle, most_s: f64) -> Option<(Angle, f64)> {
        let clear = |s: f64| self.clear(&aim.after(s)).map(|arc| arc.shrunk(margin));
        let mut best = (clear(0.0)?, 0.0);
        for s in times(most_s) {
            match clear(s).and_then(|arc| best.0.intersection(&arc)) {
                Some(common) => best = (common, s),
                None => break,
            }
        }
        Some((best.0.nearest(near), best.1))
    }

    /// The part of the aperture that a slit at `azimuth` leaves free, 0 to 1, to a few hundredths. Without a diameter
    /// it is all or nothing.
    pub fn free(&self, aim: &Aim, azimuth: Angle) -> f64 {
        let (through, along) = self.optical_axis(aim);
        let [across, up] = square_to(along);
        // A spiral whose turns are divided by the golden section covers a disc evenly (Vogel 1979).
        let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
        let passes = |part: &u32| {
            let out_m = 0.5 * self.aperture_m * ((f64::from(*part) + 0.5) / f64::from(PARTS)).sqrt();
            let (sin, cos) = (golden * f64::from(*part)).sin_cos();
            let from = add(through, add(scaled(across, out_m * cos), scaled(up, out_m * sin)));
            self.is_open_at(self.meets_dome(from, along), azimuth)
        };
        let passed = (0..PARTS).filter(passes).map(|_| 1.0).sum::<f64>();
        passed / f64::from(PARTS)
    }

    /// Is a slit at `azimuth` open where this point of the dome lies?
    fn is_open_at(&self, [east, north, _]: [f64; 3], azimuth: Angle) -> bool {
        let forward_m = east * azimuth.sin() + north * azimuth.cos();
        let aside_m = east * azimuth.cos() - north * azimuth.sin();
        aside_m.abs() <= 0.5 * self.width_m && forward_m >= -self.past_zenith_m
    }

    /// A point of the optical axis, and its direction.
    fn optical_axis(&self, aim: &Aim) -> ([f64; 3], [f64; 3]) {
        let [a, b, p] = equator(self.latitude);
        let (hour_angle, dec) = (aim.hour_angle, aim.declination);
        let towards = add(scaled(a, dec.cos() * hour_angle.cos()), scaled(b, dec.cos() * hour_angle.sin()));
        let west = add(scaled(a, -hour_angle.sin()), scaled(b, hour_angle.cos()));
        let arm_m = if aim.side == TubeSide::West { self.arm_m } else { -self.arm_m };
        (add(self.axes_m, scaled(west, arm_m)), add(towards, scaled(p, dec.sin())))
    }

    /// Where a ray from within meets the sphere; one from without counts as if it touched it.
    fn meets_dome(&self, from: [f64; 3], along: [f64; 3]) -> [f64; 3] {
        let near = dot(from, along);
        let way = -near + (near * near - dot(from, from) + self.radius_m * self.radius_m).max(0.0).sqrt();
        add(from, scaled(along, way))
    }

    /// Azimuths of the slit in which a point of the dome lies.
    fn clear_for_point(&self, point: [f64; 3]) -> Arc {
        let (distance_m, azimuth) = bearing(point);
        let half_m = 0.5 * self.width_m;
        let half_width = if distance_m > half_m {
            // The part of the slit behind the zenith, which some of these points lie in too, is left out.
            (half_m / distance_m).asin()
        } else if distance_m > self.past_zenith_m {
            (-self.past_zenith_m / distance_m).acos()
        } else {
            return Arc::FULL;
        };
        Arc::around(azimuth, Angle::from_radians(half_width))
    }
}

/// Seconds from 0 to `most_s`, in steps.
fn times(most_s: f64) -> impl Iterator<Item = f64> {
    let steps = (most_s / STEP_S).ceil().clamp(1.0, 1e4) as u32;
    (0..=steps).map(move |step| (f64::from(step) * STEP_S).min(most_s.max(0.0)))
}

/// The meridian's point of the celestial equator, the west, and the pole, as east, north, up.
fn equator(latitude: Angle) -> [[f64; 3]; 3] {
    let (sin, cos) = latitude.radians().sin_cos();
    [[0.0, -sin, cos], [-1.0, 0.0, 0.0], [0.0, cos, sin]]
}

/// Two directions square to `along` and to each other.
fn square_to(along: [f64; 3]) -> [[f64; 3]; 2] {
    let other = if along[2].abs() < 0.9 { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] };
    let across = cross(along, other);
    let across = scaled(across, 1.0 / dot(across, across).sqrt());
    [across, cross(across, along)]
}

/// Horizontal distance and azimuth of a point.
fn bearing([east, north, _]: [f64; 3]) -> (f64, Angle) {
    (east.hypot(north), Angle::from_radians(east.atan2(north)).wrapped_positive())
}

fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + b[i])
}

fn scaled(a: [f64; 3], by: f64) -> [f64; 3] {
    a.map(|x| x * by)
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests;
