//! Asteroids and comets: the orbit of two bodies, of any shape, from the elements that the Minor Planet Center and JPL
//! give.

use units::Angle;

use crate::SkyError;

/// Square root of the Sun's gravitational constant: Gauss' constant, au^1.5 per day.
const GAUSS: f64 = 0.017_202_098_95;
/// Of the ecliptic of J2000 to which elements refer (IAU 1976).
const OBLIQUITY: Angle = Angle::from_degrees(84_381.448 / 3600.0);
/// Kepler's equation is solved when a step is smaller than this part of the whole.
const CONVERGED: f64 = 1e-14;
/// Bisection alone would need fewer.
const MOST_STEPS: u32 = 300;

/// The size of an orbit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Perihelion distance, au: for comets, and any eccentricity.
    Perihelion(f64),
    /// Half the longer axis, au: for eccentricities below 1.
    SemiMajorAxis(f64),
}

/// The time at which the body is at a place of its orbit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum When {
    /// It passes its perihelion at this Julian date, TT.
    PerihelionAt(f64),
    /// Its mean anomaly at an epoch, which is a Julian date, TT: for eccentricities below 1.
    MeanAnomaly {
        /// From the perihelion.
        anomaly: Angle,
        /// Julian date, TT.
        epoch: f64,
    },
}

/// An orbit about the Sun that nothing else disturbs: good to some arcseconds for weeks about the epoch of the
/// elements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orbit {
    perihelion_au: f64,
    eccentricity: f64,
    /// Passage of the perihelion, Julian date, TT.
    passage: f64,
    /// To the perihelion, ICRS axes.
    toward: [f64; 3],
    /// The direction of motion at the perihelion, ICRS axes.
    ahead: [f64; 3],
}

impl Orbit {
    /// From osculating elements about the Sun against ecliptic and equinox of J2000.
    ///
    /// # Errors
    /// When a value is not a number, or the elements describe no orbit.
    pub fn new(
        shape: Shape,
        eccentricity: f64,
        (inclination, node, perihelion): (Angle, Angle, Angle),
        when: When,
    ) -> Result<Self, SkyError> {
        let refuse = |what: &str| Err(SkyError::Elements(what.to_owned()));
        if !(0.0..=100.0).contains(&eccentricity) {
            return refuse("eccentricity: expected 0 to 100");
        }
        if ![inclination, node, perihelion].iter().all(|angle| angle.is_finite()) {
            return refuse("inclination, node and argument of perihelion must be numbers");
        }
        let perihelion_au = match shape {
            Shape::Perihelion(distance_au) => distance_au,
            Shape::SemiMajorAxis(_) if eccentricity >= 1.0 => {
                return refuse("an eccentricity of 1 or more needs the perihelion distance, not the semi-major axis");
            }
            Shape::SemiMajorAxis(axis_au) => axis_au * (1.0 - eccentricity),
        };
        if !(1e-4..=1e4).contains(&perihelion_au) {
            return refuse("perihelion distance: expected 0.0001 to 10000 au");
        }
        let passage = match when {
            When::PerihelionAt(passage) => passage,
            When::MeanAnomaly { .. } if eccentricity >= 1.0 => {
                return refuse("an eccentricity of 1 or more needs the time of the perihelion, not the mean anomaly");
            }
            When::MeanAnomaly { anomaly, epoch } => {
                let axis_au = perihelion_au / (1.0 - eccentricity);
                epoch - anomaly.wrapped_signed().radians() * axis_au.powf(1.5) / GAUSS
            }
        };
        // Years 1600 to 2400.
        if !(2_305_000.0..=2_598_000.0).contains(&passage) && eccentricity >= 1.0 || !passage.is_finite() {
            return refuse("the time of the perihelion is no Julian date between 1600 and 2400");
        }
        let (sin_p, cos_p) = (perihelion.sin(), perihelion.cos());
        let (sin_n, cos_n) = (node.sin(), node.cos());
        let (sin_i, cos_i) = (inclination.sin(), inclination.cos());
        let toward = [cos_p * cos_n - sin_p * sin_n * cos_i, cos_p * sin_n + sin_p * cos_n * cos_i, sin_p * sin_i];
        let ahead = [-sin_p * cos_n - cos_p * sin_n * cos_i, -sin_p * sin_n + cos_p * cos_n * cos_i, cos_p * sin_i];
        Ok(Self { perihelion_au, eccentricity, passage, toward: to_equator(toward), ahead: to_equator(ahead) })
    }

    /// From the Sun, ICRS axes, au, at a terrestrial time (Julian date in two parts).
    pub(super) fn at(&self, tt: (f64, f64)) -> [f64; 3] {
        let (along, across) = self.in_plane((tt.0 - self.passage) + tt.1);
        std::array::from_fn(|i| along * self.toward[i] + across * self.ahead[i])
    }

    /// In the plane of the orbit: towards the perihelion and where the body heads there, au, so many days after it.
    ///
    /// By the universal Kepler equation, which is the same for ellipses, parabolas and hyperbolas (Bate, Mueller and
    /// White, Fundamentals of Astrodynamics, 4.4), begun at the perihelion, where the body moves straight across.
    fn in_plane(&self, days: f64) -> (f64, f64) {
        let (q, e) = (self.perihelion_au, self.eccentricity);
        let inverse_axis = (1.0 - e) / q;
        let days = if inverse_axis > 0.0 {
            let period = std::f64::consts::TAU / (GAUSS * inverse_axis.powf(1.5));
            days - period * (days / period).round()
        } else {
            days
        };
        let wanted = GAUSS * days.abs();
        // The time grows with x everywhere, at the rate of the distance from the Sun, which is never below q.
        let (mut low, mut high) = (0.0, wanted / q);
        let mut x = high.min(wanted.cbrt());
        for _ in 0..MOST_STEPS {
            let (c, s) = stumpff(inverse_axis * x * x);
            let miss = e * x.powi(3) * s + q * x - wanted;
            let distance = q + e * x * x * c;
            if miss > 0.0 {
                high = x
            } else {
                low = x
            }
            let newton = x - miss / distance;
            let next = if newton >= low && newton <= high { newton } else { f64::midpoint(low, high) };
            let step = (next - x).abs();
            x = next;
            if step <= CONVERGED * x.abs() {
                break;
            }
        }
        let (c, s) = stumpff(inverse_axis * x * x);
        let along = q - x * x * c;
        let across = (wanted - x.powi(3) * s) * ((1.0 + e) / q).sqrt();
        (along, across.copysign(days))
    }
}

/// Stumpff's functions c2 and c3.
fn stumpff(z: f64) -> (f64, f64) {
    if z.abs() < 0.5 {
        // By series, where the closed forms lose digits.
        let (mut c, mut s, mut c_term, mut s_term) = (0.5, 1.0 / 6.0, 0.5, 1.0 / 6.0);
        for k in 1..12 {
            let n = f64::from(2 * k);
            c_term *= -z / ((n + 1.0) * (n + 2.0));
            s_term *= -z / ((n + 2.0) * (n + 3.0));
            c += c_term;
            s += s_term;
        }
        return (c, s);
    }
    let root = z.abs().sqrt();
    if z > 0.0 {
        ((1.0 - root.cos()) / z, (root - root.sin()) / root.powi(3))
    } else {
        ((root.cosh() - 1.0) / -z, (root.sinh() - root) / root.powi(3))
    }
}

fn to_equator([x, y, z]: [f64; 3]) -> [f64; 3] {
    let (sin, cos) = (OBLIQUITY.sin(), OBLIQUITY.cos());
    [x, cos * y - sin * z, sin * y + cos * z]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const EPOCH: f64 = 2_461_000.5;

    fn orbit(q: f64, e: f64) -> Orbit {
        let flat = (Angle::from_degrees(0.0), Angle::from_degrees(0.0), Angle::from_degrees(0.0));
        Orbit::new(Shape::Perihelion(q), e, flat, When::PerihelionAt(EPOCH)).unwrap()
    }

    #[test]
    fn a_circle_is_gone_round_in_a_gaussian_year() {
        let circle = orbit(1.0, 0.0);
        let quarter = std::f64::consts::TAU / GAUSS / 4.0;
        let (along, across) = circle.in_plane(quarter);
        assert!(along.abs() < 1e-12 && (across - 1.0).abs() < 1e-12, "{along} {across}");
        let (along, across) = circle.in_plane(-quarter);
        assert!(along.abs() < 1e-12 && (across + 1.0).abs() < 1e-12, "{along} {across}");
    }

    #[test]
    fn a_parabola_satisfies_barkers_equation() {
        // Barker's equation: t = sqrt(2) q^1.5 / k (tan(v/2) + tan(v/2)^3 / 3); at v = 90 deg that is 4/3 sqrt(2) q^1.5
        // / k.
        let q = 0.7_f64;
        let days = 4.0 / 3.0 * 2.0_f64.sqrt() * q.powf(1.5) / GAUSS;
        let (along, across) = orbit(q, 1.0).in_plane(days);
        assert!(along.abs() < 1e-12 && (across - 2.0 * q).abs() < 1e-12, "{along} {across}");
    }

    #[test]
    fn axis_and_anomaly_give_the_same_as_perihelion_and_passage() {
        let angles = (Angle::from_degrees(10.6), Angle::from_degrees(80.3), Angle::from_degrees(73.6));
        let (axis, e) = (2.77, 0.08);
        let period = std::f64::consts::TAU / GAUSS * 2.77_f64.powf(1.5);
        let passage = When::PerihelionAt(EPOCH - period / 4.0);
        let quarter = When::MeanAnomaly { anomaly: Angle::from_degrees(90.0), epoch: EPOCH };
        let a = Orbit::new(Shape::Perihelion(axis * (1.0 - e)), e, angles, passage).unwrap();
        let b = Orbit::new(Shape::SemiMajorAxis(axis), e, angles, quarter).unwrap();
        for day in [0.0, 100.0, 5000.0] {
            let (a, b) = (a.at((EPOCH, day)), b.at((EPOCH, day)));
            assert!((0..3).all(|i| (a[i] - b[i]).abs() < 1e-9), "{a:?} {b:?}");
        }
    }

    #[test]
    fn elements_that_describe_no_orbit_are_refused() {
        let zero = Angle::from_degrees(0.0);
        let try_with = |shape, e, when| Orbit::new(shape, e, (zero, zero, zero), when);
        let at = When::PerihelionAt(EPOCH);
        assert!(try_with(Shape::Perihelion(f64::NAN), 0.1, at).is_err());
        assert!(try_with(Shape::Perihelion(-1.0), 0.1, at).is_err());
        assert!(try_with(Shape::Perihelion(1.0), f64::NAN, at).is_err());
        assert!(try_with(Shape::SemiMajorAxis(1.0), 1.0, at).is_err());
        let anomaly = When::MeanAnomaly { anomaly: zero, epoch: EPOCH };
        assert!(try_with(Shape::Perihelion(1.0), 1.2, anomaly).is_err());
        assert!(try_with(Shape::Perihelion(1.0), 1.2, When::PerihelionAt(f64::INFINITY)).is_err());
    }

    proptest! {
        /// Energy and area show whether a place belongs to its time, whatever the orbit: the speed between two near
        /// times is that which the distance allows, and equal areas are swept in equal times.
        #[test]
        fn every_orbit_keeps_its_energy_and_its_areas(q in 0.3..30.0f64, e in 0.0..3.0f64, days in -4000.0..4000.0f64) {
            let orbit = orbit(q, e);
            // Small against the time in which the orbit bends.
            let half = 1e-4 * q.powf(1.5) / GAUSS;
            let (before, now, after) = (orbit.in_plane(days - half), orbit.in_plane(days), orbit.in_plane(days + half));
            let velocity = ((after.0 - before.0) / (2.0 * half), (after.1 - before.1) / (2.0 * half));
            let distance = now.0.hypot(now.1);
            let expected = GAUSS * GAUSS * (2.0 / distance - (1.0 - e) / q);
            let speed = velocity.0.powi(2) + velocity.1.powi(2);
            let scale = GAUSS * GAUSS * 2.0 / distance;
            prop_assert!((speed - expected).abs() < 1e-5 * scale, "{speed} {expected}");
            let area = now.0 * velocity.1 - now.1 * velocity.0;
            let areal = GAUSS * (q * (1.0 + e)).sqrt();
            prop_assert!((area / areal - 1.0).abs() < 1e-5, "{area} {areal}");
        }
    }
}
