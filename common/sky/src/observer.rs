//! One place at one instant: everything that turns coordinates from frame to frame.

use sofars::astro::{self, IauAstrom};
use sofars::{eph, erst, pnp};
use units::{Angle, Utc};

use crate::time_scale::Scales;
use crate::{EarthOrientation, Horizontal, Icrs, OfDate, Place, SkyError};

/// A place at an instant, with all values that do not depend on the star.
///
/// Building one costs some 70 us (nutation and the Earth's orbit), a conversion less than 1 us.
#[derive(Debug, Clone)]
pub struct Observer {
    pub(crate) place: Place,
    pub(crate) orientation: EarthOrientation,
    pub(crate) at: Utc,
    pub(crate) scales: Scales,
    pub(crate) astrometry: IauAstrom,
    /// Position and velocity of the Earth seen from the Sun, ICRS axes, au and au per day.
    pub(crate) earth_from_sun: [[f64; 3]; 2],
    /// Position and velocity of the Earth in the solar system, ICRS axes, au and au per day.
    pub(crate) earth: [[f64; 3]; 2],
    /// Earth rotation angle minus Greenwich apparent sidereal time.
    equation_of_origins: Angle,
}

impl Observer {
    /// Computes the sky of `place` at `at`; refused outside 1972 to 2099 and when the Earth's orientation is no number.
    pub fn new(place: &Place, orientation: &EarthOrientation, at: Utc) -> Result<Self, SkyError> {
        let orientation = orientation.checked()?;
        let scales = Scales::new(at, orientation.dut1_s)?;
        let (tt1, tt2) = scales.tt;
        let (earth_from_sun, earth) = eph::epv00(tt1, tt2).ok_or(SkyError::Time { at })?;
        let to_date = pnp::pnm06a(tt1, tt2);
        let (pole_x, pole_y) = pnp::bpn2xy(&to_date);
        let origin = pnp::s06(tt1, tt2, pole_x, pole_y);
        let mut astrometry = IauAstrom::default();
        astro::apco(
            tt1,
            tt2,
            &earth,
            &earth_from_sun[0],
            pole_x,
            pole_y,
            origin,
            erst::era00(scales.ut1.0, scales.ut1.1),
            place.longitude_east().radians(),
            place.latitude().radians(),
            place.elevation_m(),
            Angle::from_arcseconds(orientation.polar_x_arcsec).radians(),
            Angle::from_arcseconds(orientation.polar_y_arcsec).radians(),
            pnp::sp00(tt1, tt2),
            0.0, // No refraction.
            0.0,
            &mut astrometry,
        );
        let equation_of_origins = Angle::from_radians(pnp::eors(&to_date, origin));
        Ok(Self { place: *place, orientation, at, scales, astrometry, earth_from_sun, earth, equation_of_origins })
    }

    /// The same place at another instant, turned only with the Earth, which costs very little time.
    ///
    /// Good to 0.1 arcsec within half an hour of the instant this observer was built for.
    pub fn turned_to(&self, at: Utc) -> Result<Self, SkyError> {
        let mut turned = self.clone();
        turned.at = at;
        turned.scales = Scales::new(at, self.orientation.dut1_s)?;
        astro::aper(erst::era00(turned.scales.ut1.0, turned.scales.ut1.1), &mut turned.astrometry);
        Ok(turned)
    }

    /// The place of this observer.
    pub const fn place(&self) -> &Place {
        &self.place
    }

    /// The instant of this observer.
    pub const fn at(&self) -> Utc {
        self.at
    }

    /// Altitude and azimuth of a catalogue place, without refraction.
    pub fn to_horizontal(&self, place: &Icrs) -> Horizontal {
        self.intermediate_to_horizontal(self.icrs_to_intermediate(place))
    }

    /// The catalogue place that now stands in this direction.
    pub fn to_icrs(&self, direction: &Horizontal) -> Icrs {
        self.intermediate_to_icrs(self.horizontal_to_intermediate(direction))
    }

    /// The apparent place of date ("JNow") of a catalogue place.
    pub fn to_of_date(&self, place: &Icrs) -> OfDate {
        self.intermediate_to_of_date(self.icrs_to_intermediate(place))
    }

    /// The catalogue place behind an apparent place of date ("JNow").
    pub fn of_date_to_icrs(&self, apparent: &OfDate) -> Icrs {
        self.intermediate_to_icrs(self.of_date_to_intermediate(apparent))
    }

    /// Altitude and azimuth of an apparent place of date.
    pub fn of_date_to_horizontal(&self, apparent: &OfDate) -> Horizontal {
        self.intermediate_to_horizontal(self.of_date_to_intermediate(apparent))
    }

    /// Local apparent sidereal time, [0, 360) deg; ASCOM's `SiderealTime`.
    pub fn sidereal_time(&self) -> Angle {
        let rotation = Angle::from_radians(erst::era00(self.scales.ut1.0, self.scales.ut1.1));
        (rotation - self.equation_of_origins + self.place.longitude_east()).wrapped_positive()
    }

    /// Local mean sidereal time, [0, 360) deg: the apparent one without nutation, off by up to 1.2 s.
    pub fn mean_sidereal_time(&self) -> Angle {
        let Scales { ut1, tt, .. } = self.scales;
        (Angle::from_radians(erst::gmst06(ut1.0, ut1.1, tt.0, tt.1)) + self.place.longitude_east()).wrapped_positive()
    }

    /// Hour angle of date, [-180, 180) deg: sidereal time minus apparent right ascension, negative in the east.
    pub fn hour_angle(&self, place: &Icrs) -> Angle {
        (self.sidereal_time() - self.to_of_date(place).ra).wrapped_signed()
    }

    // Between the frames is the celestial intermediate system (CIRS), in radians, which sofars uses.

    fn icrs_to_intermediate(&self, place: &Icrs) -> (f64, f64) {
        let mut astrometry = self.astrometry; // `sofars` asks for `&mut` but only reads.
        astro::atciq(place.ra.radians(), place.dec.radians(), 0.0, 0.0, 0.0, 0.0, &mut astrometry)
    }

    fn intermediate_to_icrs(&self, (ra, dec): (f64, f64)) -> Icrs {
        let mut astrometry = self.astrometry; // As above.
        let (ra, dec) = astro::aticq(ra, dec, &mut astrometry);
        Icrs { ra: Angle::from_radians(ra).wrapped_positive(), dec: Angle::from_radians(dec) }
    }

    fn intermediate_to_horizontal(&self, (ra, dec): (f64, f64)) -> Horizontal {
        let (azimuth, zenith_distance, ..) = astro::atioq(ra, dec, &self.astrometry);
        Horizontal {
            altitude: Angle::from_degrees(90.0) - Angle::from_radians(zenith_distance),
            azimuth: Angle::from_radians(azimuth).wrapped_positive(),
        }
    }

    fn horizontal_to_intermediate(&self, direction: &Horizontal) -> (f64, f64) {
        let zenith_distance = Angle::from_degrees(90.0) - direction.altitude;
        astro::atoiq("A", direction.azimuth.radians(), zenith_distance.radians(), &self.astrometry)
    }

    fn intermediate_to_of_date(&self, (ra, dec): (f64, f64)) -> OfDate {
        let ra = Angle::from_radians(ra) - self.equation_of_origins;
        OfDate { ra: ra.wrapped_positive(), dec: Angle::from_radians(dec) }
    }

    fn of_date_to_intermediate(&self, apparent: &OfDate) -> (f64, f64) {
        ((apparent.ra + self.equation_of_origins).radians(), apparent.dec.radians())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::separation;

    fn observer() -> Observer {
        let place = Place::new(Angle::from_degrees(-24.6), Angle::from_degrees(-70.4), 2500.0).unwrap();
        let orientation = EarthOrientation { dut1_s: 0.1, polar_x_arcsec: 0.2, polar_y_arcsec: 0.4 };
        Observer::new(&place, &orientation, "2026-11-21T03:00:00Z".parse().unwrap()).unwrap()
    }

    #[test]
    fn every_frame_leads_back_to_the_catalogue_place() {
        let observer = observer();
        for ra_deg in (0..360).step_by(30) {
            for dec_deg in [-89.9, -60.0, -24.6, 0.0, 30.0, 89.9] {
                let star = Icrs::from_degrees(f64::from(ra_deg), dec_deg);
                let apparent = observer.to_of_date(&star);
                let direction = observer.to_horizontal(&star);
                for back in [
                    observer.to_icrs(&direction),
                    observer.of_date_to_icrs(&apparent),
                    observer.to_icrs(&observer.of_date_to_horizontal(&apparent)),
                ] {
                    assert!(separation(&star, &back).arcseconds() < 1e-5, "{star:?} came back as {back:?}");
                }
            }
        }
    }

    #[test]
    fn a_star_on_the_meridian_has_hour_angle_zero_and_then_goes_west() {
        let observer = observer();
        let meridian = OfDate { ra: observer.sidereal_time(), dec: Angle::from_degrees(20.0) };
        let star = observer.of_date_to_icrs(&meridian);
        assert!(observer.hour_angle(&star).arcseconds().abs() < 1e-3);
        let later = observer.turned_to(observer.at().plus_seconds(600.0)).unwrap();
        assert!((later.hour_angle(&star).hours() * 3600.0 - 601.643).abs() < 0.01);
        assert!(later.to_horizontal(&star).azimuth.degrees() > 180.0);
    }

    #[test]
    fn turning_with_the_earth_is_good_for_half_an_hour() {
        let observer = observer();
        for minutes in [-30.0, 30.0] {
            let at = observer.at().plus_seconds(minutes * 60.0);
            let exact = Observer::new(&observer.place, &observer.orientation, at).unwrap();
            let turned = observer.turned_to(at).unwrap();
            for (ra, dec) in [(0.0, 0.0), (90.0, 40.0), (200.0, -70.0)] {
                let star = Icrs::from_degrees(ra, dec);
                let off = exact.to_horizontal(&star).separation(&turned.to_horizontal(&star));
                assert!(off.arcseconds() < 0.1, "{ra} {dec}: {off:?}");
            }
        }
    }
}
