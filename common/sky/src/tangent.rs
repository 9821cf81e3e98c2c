//! The gnomonic projection (FITS `TAN`): a piece of the sky laid flat.

use sofars::projection::{tpsts, tpxes};
use units::Angle;

use crate::Icrs;

/// A plane that touches the sky at one point; the plane a perfect camera sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tangent {
    center: Icrs,
}

impl Tangent {
    /// The plane that touches at `center` (FITS `CRVAL`).
    pub const fn new(center: Icrs) -> Self {
        Self { center }
    }

    /// The point of contact.
    pub const fn center(&self) -> &Icrs {
        &self.center
    }

    /// (xi, eta): east and north on the plane, the tangent of the distance given as an angle (FITS intermediate world
    /// coordinates). None for a star 90 deg or more away.
    pub fn project(&self, star: &Icrs) -> Option<(Angle, Angle)> {
        let Icrs { ra, dec } = self.center;
        let (xi, eta, status) = tpxes(star.ra.radians(), star.dec.radians(), ra.radians(), dec.radians());
        (status == 0).then(|| (Angle::from_radians(xi), Angle::from_radians(eta)))
    }

    /// The star that falls on (xi, eta).
    pub fn unproject(&self, xi: Angle, eta: Angle) -> Icrs {
        let Icrs { ra, dec } = self.center;
        let (ra, dec) = tpsts(xi.radians(), eta.radians(), ra.radians(), dec.radians());
        Icrs { ra: Angle::from_radians(ra).wrapped_positive(), dec: Angle::from_radians(dec) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::separation;

    #[test]
    fn projecting_and_back_changes_nothing_even_over_the_pole() {
        for (ra, dec) in [(0.01, 0.0), (180.0, 45.0), (77.0, 89.9), (300.0, -90.0)] {
            let plane = Tangent::new(Icrs::from_degrees(ra, dec));
            for (xi, eta) in [(0.0, 0.0), (0.5, 0.3), (-1.0, 2.0), (-0.02, -3.0)] {
                let (xi, eta) = (Angle::from_degrees(xi), Angle::from_degrees(eta));
                let star = plane.unproject(xi, eta);
                let (xi_back, eta_back) = plane.project(&star).unwrap();
                let off = (xi_back - xi).arcseconds().hypot((eta_back - eta).arcseconds());
                assert!(off < 1e-6, "{plane:?} {xi:?} {eta:?}: {off}");
                let distance = separation(plane.center(), &star).radians().tan();
                assert!((distance - xi.radians().hypot(eta.radians())).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn the_far_half_of_the_sky_has_no_place_on_the_plane() {
        let plane = Tangent::new(Icrs::from_degrees(10.0, 20.0));
        assert!(plane.project(&Icrs::from_degrees(10.0, -69.0)).is_some());
        assert!(plane.project(&Icrs::from_degrees(10.0, -70.0)).is_none());
        assert!(plane.project(&Icrs::from_degrees(190.0, -20.0)).is_none());
    }
}
