//! Pointing: how far a telescope looks from where it was sent, and where to send it so that it looks where it should.
//!
//! A mount's error is reported in the mount's own directions, east and north at the place that was commanded: there an
//! encoder that is off, or a tube that bends, gives the same error for neighbouring targets, at the pole too. [`MountErrorModel`]
//! learns it over the sky.

mod model;

use units::Angle;

pub use model::{FEWEST, MountErrorModel, MountErrorPoint};

use crate::tangent::{TangentPlane, separation};

/// Where a telescope looks, seen from where it was sent: on the plane that touches the sky at the commanded direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Miss {
    /// Towards the east.
    pub east: Angle,
    /// Towards the north.
    pub north: Angle,
}

impl Miss {
    /// What a telescope that was sent to `commanded` misses when it looks at `seen` (ICRS right ascension and
    /// declination). None where both are 90 deg apart or more.
    pub fn of(commanded: (Angle, Angle), seen: (Angle, Angle)) -> Option<Self> {
        let (xi, eta) = TangentPlane::new(commanded.0, commanded.1).project(seen.0, seen.1)?;
        Some(Self { east: Angle::from_radians(xi), north: Angle::from_radians(eta) })
    }

    /// Its size.
    pub fn size(&self) -> Angle {
        Angle::from_radians(self.east.radians().hypot(self.north.radians()))
    }

    /// Where to send a telescope that misses by so much so that it looks at `target`.
    ///
    /// Asks for the commanded direction from which the target is seen at this miss; so near to the pole that there is
    /// none, the miss is taken back in the directions of the target.
    pub fn aim(&self, target: (Angle, Angle)) -> (Angle, Angle) {
        let (east, north) = (self.east.radians(), self.north.radians());
        let back = TangentPlane::new(target.0, target.1).direction(-east, -north);
        let mut commanded = back;
        for _ in 0..ROUNDS {
            let plane = TangentPlane::new(commanded.0, commanded.1);
            let Some((xi, eta)) = plane.project(target.0, target.1) else { return back };
            let (xi, eta) = (xi - east, eta - north);
            if xi.hypot(eta) < ENOUGH_RAD {
                return commanded;
            }
            commanded = plane.direction(xi, eta);
        }
        back
    }
}

/// Rounds in which the aim is found anywhere but next to the pole.
const ROUNDS: usize = 30;
/// A thousandth of an arcsecond.
const ENOUGH_RAD: f64 = 5e-9;

/// How the commanded directions of one target came to be, and what follows: the loop of corrections.
///
/// Each correction rests on where the telescope was sent and where it was seen to look, so that nothing learned by the
/// corrections before is lost (docs/formulae.md, "Correction of the pointing").
#[derive(Debug, Clone, PartialEq)]
pub struct CorrectionLoop {
    target: (Angle, Angle),
    commanded: (Angle, Angle),
    threshold: Angle,
    /// How far off the target each frame was.
    seen: Vec<Angle>,
}

/// What to do after a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PointingStep {
    /// The telescope looks at the target.
    OnTarget,
    /// Slew there.
    Slew((Angle, Angle)),
    /// Two corrections in a row helped too little: this mount does not go where it is sent.
    Hopeless,
}

/// A correction that leaves more than this share of the distance helps too little.
const SHRINKS_TO: f64 = 0.7;

impl CorrectionLoop {
    /// A telescope on its way to `target`, sent to `commanded`; it is on target within `threshold`.
    pub fn new(target: (Angle, Angle), commanded: (Angle, Angle), threshold: Angle) -> Self {
        Self { target, commanded, threshold, seen: Vec::new() }
    }

    /// Where the telescope was sent last.
    pub fn commanded(&self) -> (Angle, Angle) {
        self.commanded
    }

    /// How far off the target each frame was, the first first.
    pub fn distances(&self) -> &[Angle] {
        &self.seen
    }

    /// The telescope is seen to look at `seen`.
    pub fn look(&mut self, seen: (Angle, Angle)) -> PointingStep {
        let distance = separation(self.target, seen);
        self.seen.push(distance);
        if distance < self.threshold {
            return PointingStep::OnTarget;
        }
        let helped_little = |pair: &[Angle]| pair[1].degrees() > SHRINKS_TO * pair[0].degrees();
        let last = &self.seen[self.seen.len().saturating_sub(3)..];
        if last.len() == 3 && last.windows(2).all(helped_little) {
            return PointingStep::Hopeless;
        }
        let Some(miss) = Miss::of(self.commanded, seen) else { return PointingStep::Hopeless };
        self.commanded = miss.aim(self.target);
        PointingStep::Slew(self.commanded)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    fn deg(ra: f64, dec: f64) -> (Angle, Angle) {
        (Angle::from_degrees(ra), Angle::from_degrees(dec))
    }

    fn arcmin(arcmin: f64) -> Angle {
        Angle::from_degrees(arcmin / 60.0)
    }

    /// Where a mount looks that misses by so much at every place.
    fn looks(commanded: (Angle, Angle), east_arcmin: f64, north_arcmin: f64) -> (Angle, Angle) {
        let plane = TangentPlane::new(commanded.0, commanded.1);
        plane.direction(arcmin(east_arcmin).radians(), arcmin(north_arcmin).radians())
    }

    #[test]
    fn one_correction_takes_back_a_constant_miss_at_ra_0_and_beside_the_poles() {
        for (ra, dec) in [(0.01, 0.0), (359.99, -30.0), (123.0, 89.8), (10.0, -89.8), (200.0, 60.0)] {
            let mut approach = CorrectionLoop::new(deg(ra, dec), deg(ra, dec), arcmin(0.1));
            let PointingStep::Slew(to) = approach.look(looks(deg(ra, dec), 4.0, -3.0)) else { panic!("{ra} {dec}") };
            assert!((0.0..360.0).contains(&to.0.degrees()) && to.1.degrees().abs() <= 90.0, "{to:?}");
            assert_eq!(approach.look(looks(to, 4.0, -3.0)), PointingStep::OnTarget, "{:?}", approach.distances());
            assert!(approach.distances()[1] < arcmin(0.001), "{:?}", approach.distances());
        }
    }

    #[test]
    fn within_two_corrections_a_miss_of_5_arcmin_is_within_a_tenth_and_a_third_never_harms() {
        // constant error 5', random 2"
        for seed in 0..100 {
            let mut chance = rand::rngs::StdRng::seed_from_u64(seed);
            let mut scatter = || arcmin(chance.random_range(-2.0..2.0) / 60.0).degrees() * 60.0;
            let (ra, dec) = (seed as f64 * 3.6, 89.0 * (seed as f64 * 0.7).sin());
            let mut approach = CorrectionLoop::new(deg(ra, dec), deg(ra, dec), arcmin(0.1));
            let mut at = deg(ra, dec);
            let mut frames = 0;
            while let PointingStep::Slew(to) = approach.look(looks(at, 3.0 + scatter(), 4.0 + scatter())) {
                (at, frames) = (to, frames + 1);
                assert!(frames <= 2, "{seed}: {:?}", approach.distances());
            }
            let far: Vec<f64> = approach.distances().iter().map(|angle| angle.degrees() * 60.0).collect();
            assert!((far[0] - 5.0).abs() < 0.1 && far.last().is_some_and(|last| *last < 0.1), "{seed}: {far:?}");
            // once more from where it stands
            let again = Miss::of(at, looks(at, 3.0 + scatter(), 4.0 + scatter())).unwrap().aim(deg(ra, dec));
            let off = separation(deg(ra, dec), looks(again, 3.0 + scatter(), 4.0 + scatter()));
            assert!(off < arcmin(0.15), "{seed}: {off:?}");
        }
    }

    #[test]
    fn a_mount_that_does_not_go_where_it_is_sent_is_given_up_after_two_corrections() {
        let mut approach = CorrectionLoop::new(deg(10.0, 20.0), deg(10.0, 20.0), arcmin(0.1));
        let stuck = looks(deg(10.0, 20.0), 3.0, 0.0);
        assert!(matches!(approach.look(stuck), PointingStep::Slew(_)));
        assert!(matches!(approach.look(stuck), PointingStep::Slew(_)));
        assert_eq!(approach.look(stuck), PointingStep::Hopeless);
        // one that comes nearer, however slowly, is not
        let mut approach = CorrectionLoop::new(deg(10.0, 20.0), deg(10.0, 20.0), arcmin(0.1));
        for off in [8.0, 5.0, 3.4, 2.0, 1.3] {
            assert!(matches!(approach.look(looks(deg(10.0, 20.0), off, 0.0)), PointingStep::Slew(_)));
        }
        assert_eq!(approach.look(deg(190.0, -20.0)), PointingStep::Hopeless, "the other side of the sky");
    }

    #[test]
    fn beside_the_pole_where_no_aim_fits_the_answer_is_still_a_direction() {
        for distance_arcmin in [0.0, 0.1, 1.0, 4.0] {
            let target = deg(77.0, 90.0 - distance_arcmin / 60.0);
            let miss = Miss { east: arcmin(4.0), north: arcmin(3.0) };
            let aim = miss.aim(target);
            assert!(separation(aim, target) < arcmin(10.1) && aim.1.degrees() <= 90.0, "{aim:?}");
        }
    }
}
