//! The tangent plane: the sky around a point laid flat (gnomonic projection), by unit vectors.
//!
//! Vectors know neither a pole nor where right ascension begins again. Formulae: Calabretta & Greisen 2002, A&A 395,
//! 1077, section 5.1.3 (TAN).

use units::Angle;

/// A plane that touches the sphere at one direction; xi points to the east, eta to the north, both in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TangentPlane {
    centre: [f64; 3],
    east: [f64; 3],
    north: [f64; 3],
}

impl TangentPlane {
    /// The plane that touches at an ICRS direction. At a pole, right ascension says where "north" points.
    pub fn new(ra: Angle, dec: Angle) -> Self {
        let (sin_ra, cos_ra) = ra.radians().sin_cos();
        let (sin_dec, cos_dec) = dec.radians().sin_cos();
        Self {
            centre: [cos_dec * cos_ra, cos_dec * sin_ra, sin_dec],
            east: [-sin_ra, cos_ra, 0.0],
            north: [-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec],
        }
    }

    /// Where a direction falls on the plane, rad; None for the far hemisphere, and for what is not finite.
    pub fn project(&self, ra: Angle, dec: Angle) -> Option<(f64, f64)> {
        let (sin_ra, cos_ra) = ra.radians().sin_cos();
        let (sin_dec, cos_dec) = dec.radians().sin_cos();
        let at = [cos_dec * cos_ra, cos_dec * sin_ra, sin_dec];
        let depth = dot(at, self.centre);
        (depth > 1e-9).then(|| (dot(at, self.east) / depth, dot(at, self.north) / depth))
    }

    /// The direction (right ascension in [0, 360) deg, declination) of a place on the plane, rad.
    pub fn direction(&self, xi: f64, eta: f64) -> (Angle, Angle) {
        let at: [f64; 3] = std::array::from_fn(|i| self.centre[i] + xi * self.east[i] + eta * self.north[i]);
        let ra = Angle::from_radians(at[1].atan2(at[0])).wrapped_positive();
        (ra, Angle::from_radians(at[2].atan2(at[0].hypot(at[1]))))
    }
}

/// The angle between two directions, good at any size.
pub fn separation(a: (Angle, Angle), b: (Angle, Angle)) -> Angle {
    let half = |angle: Angle| (0.5 * angle.radians()).sin().powi(2);
    let haversine = half(a.1 - b.1) + a.1.cos() * b.1.cos() * half(a.0 - b.0);
    Angle::from_radians(2.0 * haversine.clamp(0.0, 1.0).sqrt().asin())
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deg(degrees: f64) -> Angle {
        Angle::from_degrees(degrees)
    }

    #[test]
    fn a_place_survives_the_way_there_and_back_everywhere() {
        for (ra, dec) in [(0.0, 0.0), (359.999, -20.0), (123.0, 90.0), (77.0, -90.0), (10.0, 89.9), (180.0, 45.0)] {
            let plane = TangentPlane::new(deg(ra), deg(dec));
            for (xi, eta) in [(0.0, 0.0), (0.01, -0.02), (-0.3, 0.2), (1e-7, 0.0)] {
                let (ra, dec) = plane.direction(xi, eta);
                let (x, y) = plane.project(ra, dec).unwrap();
                assert!((x - xi).abs() < 1e-14 && (y - eta).abs() < 1e-14, "{x} {y} for {xi} {eta}");
            }
        }
    }

    #[test]
    fn the_far_hemisphere_has_no_place() {
        let plane = TangentPlane::new(deg(10.0), deg(20.0));
        assert!(plane.project(deg(190.0), deg(-20.0)).is_none());
        assert!(plane.project(deg(f64::NAN), deg(-20.0)).is_none());
    }

    #[test]
    fn separations_are_right_at_any_size() {
        assert!((separation((deg(359.5), deg(0.0)), (deg(0.5), deg(0.0))).degrees() - 1.0).abs() < 1e-12);
        assert!((separation((deg(0.0), deg(90.0)), (deg(200.0), deg(89.0))).degrees() - 1.0).abs() < 1e-12);
        assert!((separation((deg(0.0), deg(0.0)), (deg(180.0), deg(0.0))).degrees() - 180.0).abs() < 1e-6);
        let tiny = separation((deg(50.0), deg(60.0)), (deg(50.0), deg(60.0) + Angle::from_arcseconds(1e-4)));
        assert!((tiny.arcseconds() - 1e-4).abs() < 1e-9);
    }
}
