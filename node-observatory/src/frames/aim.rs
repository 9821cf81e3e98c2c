//! Where a frame was pointed and how large its pixels are, as far as that is known before it is solved.

use contract::device::camera::Frame;
use contract::device::telescope::{EquatorialSystem, Fields, PierSide};
use contract::observatory::{Unsolved, UnsolvedClass};
use contract::{Name, Reading};
use imaging::solve::LearnedOptics;
use imaging::{Star, Wcs};
use sky::{Icrs, OfDate};
use units::{Angle, Utc};

use super::mounts::Mounts;
use crate::authority::Authority;
use crate::devices::{Chain, Devices};

/// A mount that reports to be further from the target than this does not point there, whatever the frame is for.
const ON_TARGET: Angle = Angle::from_degrees(5.0);
/// Focal lengths above are mm, though ASCOM asks for metres: no tube is as long, and no camera has a shorter lens.
const LONGEST_M: f64 = 20.0;
/// Arcseconds of a radian.
const ARCSEC: f64 = 206_264.806;

/// What is known of a frame before it is solved.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameAim {
    /// What it is taken of.
    pub target: Option<Icrs>,
    /// Where the middle of the sensor points, by target or mount.
    pub place: Option<Icrs>,
    /// Size of a (binned) pixel, arcsec, to 5 %.
    pub scale_arcsec_px: Option<f64>,
    /// Side of the pier on which it was taken.
    pub pier_side: Option<PierSide>,
    /// Columns and rows of the sensor, binned.
    pub sensor_px: Option<[f64; 2]>,
}

impl FrameAim {
    /// Collects what devices, configuration and the frame's purpose give.
    pub fn of(authority: &Authority, devices: &Devices, mounts: &Mounts, frame: &Frame) -> Self {
        let target = frame.purpose.ra_deg.zip(frame.purpose.dec_deg);
        let target = target.map(|(ra, dec)| Icrs::from_degrees(ra, dec)).and_then(|icrs| icrs.checked().ok());
        let chain = frame.camera.parse::<Name>().ok().and_then(|name| devices.chain(&name).ok());
        let Some(chain) = chain else { return Self { target, place: target, ..Self::default() } };
        let mount = chain.mount.and_then(|mount| {
            let speed = authority.node.bus.clock().speed();
            mounts.at(&mount.instrument.device.name, middle_of(frame), speed)
        });
        let pointed = mount.as_ref().and_then(|fields| direction(authority, frame, &chain, fields));
        let pier_side = mount.and_then(|fields| fields.pier_side.known().copied());
        let bin = f64::from(frame.bin.max(1));
        let can = chain.camera.instrument.can().filter(|can| can.width_px > 0 && can.height_px > 0);
        Self {
            target,
            place: place(target, pointed),
            scale_arcsec_px: scale_arcsec_px(&chain, frame),
            pier_side: pier_side.filter(|side| *side != PierSide::Unknown),
            sensor_px: can
                .map(|can| [(f64::from(can.width_px) / bin).floor(), (f64::from(can.height_px) / bin).floor()]),
        }
    }

    /// The place of the sensor's middle on a frame, px; the frame's own middle where the sensor's size is not known.
    pub fn middle_px(&self, frame: &Frame) -> (f64, f64) {
        let along = |length: u32, origin: u32, sensor: Option<f64>| match sensor {
            Some(sensor) => 0.5 * (sensor - 1.0) - f64::from(origin),
            None => 0.5 * (f64::from(length) - 1.0),
        };
        let sensor = |axis: usize| self.sensor_px.map(|sensor| sensor[axis]);
        (along(frame.width_px, frame.origin_px[0], sensor(0)), along(frame.height_px, frame.origin_px[1], sensor(1)))
    }

    /// How far the middle of the frame is from that of the sensor, px.
    pub fn off_middle_px(&self, frame: &Frame) -> f64 {
        let ((x, y), (centre_x, centre_y)) = (self.middle_px(frame), centre_px(frame));
        (centre_x - x).hypot(centre_y - y)
    }

    /// Where the middle of the frame should be; of a part of the sensor only with optics that are known, else where the
    /// sensor's middle should be.
    ///
    /// # Errors
    /// When nothing gives the place where the telescope pointed.
    pub fn frame_centre(&self, frame: &Frame, learned: Option<&LearnedOptics>) -> Result<Icrs, Unsolved> {
        let place = self.place.ok_or_else(|| Unsolved {
            class: UnsolvedClass::NoPlace,
            detail: "where the telescope pointed is not known: the frame has no target, and its mount did not say"
                .to_owned(),
        })?;
        let Some(learned) = learned else { return Ok(place) };
        let ((x_px, y_px), (centre_x, centre_y)) = (self.middle_px(frame), centre_px(frame));
        let scale = learned.scale_arcsec_px / 3600.0;
        let (sin, cos) = Angle::from_degrees(learned.rotation_deg).radians().sin_cos();
        let sense = if learned.mirrored { -1.0 } else { 1.0 };
        // +y points to the position angle of the rotation, +x is a quarter turn from it, on the side of the parity.
        let cd_deg_px = [[sense * scale * cos, scale * sin], [-sense * scale * sin, scale * cos]];
        let wcs = Wcs { ra: place.ra, dec: place.dec, x_px, y_px, cd_deg_px, sip: None };
        let (ra, dec) = wcs.pixel_to_sky(centre_x, centre_y);
        Ok(Icrs { ra, dec })
    }

    /// Where the middle of a part of the sensor looks once pointing has brought it to the target. `None` if that is the
    /// same place as [`Self::frame_centre`], or if the mount reports that it is elsewhere.
    pub fn part_on_target(&self, frame: &Frame) -> Option<Icrs> {
        // A place within a quarter of the field is found from either place.
        let is_aside = self.off_middle_px(frame) > 0.25 * f64::from(frame.width_px.min(frame.height_px));
        self.target.filter(|_| is_aside && self.place == self.target)
    }

    /// The star of the target among those of a frame: the brightest within two of its own widths, or three pixels, of
    /// the target's place.
    pub fn target_star<'a>(&self, wcs: &Wcs, stars: &'a [Star]) -> Option<&'a Star> {
        let target = self.target?;
        let (x, y) = wcs.sky_to_pixel(target.ra, target.dec)?;
        let is_there = |star: &&Star| (star.x_px - x).hypot(star.y_px - y) <= (2.0 * star.fwhm_px).max(3.0);
        stars.iter().filter(is_there).max_by(|one, other| one.peak_adu.total_cmp(&other.peak_adu))
    }

    /// How far the middle of the frame, which pointing brings there, is from the target: for a part of the sensor the
    /// middle of that part.
    pub fn off_target(&self, frame: &Frame, wcs: &Wcs) -> Option<Angle> {
        let target = self.target?;
        let (x, y) = centre_px(frame);
        let (ra, dec) = wcs.pixel_to_sky(x, y);
        let off = imaging::tangent::separation((ra, dec), (target.ra, target.dec));
        off.is_finite().then_some(off)
    }
}

/// The target, unless the mount reports to be elsewhere; else the mount.
fn place(target: Option<Icrs>, pointed: Option<Icrs>) -> Option<Icrs> {
    match (target, pointed) {
        (Some(target), Some(pointed)) if sky::separation(&target, &pointed).degrees() > ON_TARGET.degrees() => {
            Some(pointed)
        }
        (Some(target), _) => Some(target),
        (None, pointed) => pointed,
    }
}

/// Where a mount reports to have pointed in the middle of the exposure.
fn direction(authority: &Authority, frame: &Frame, chain: &Chain<'_>, fields: &Fields) -> Option<Icrs> {
    let (ra, dec) = fields.ra_deg.known().zip(fields.dec_deg.known())?;
    let (ra, dec) = (Angle::from_degrees(*ra), Angle::from_degrees(*dec));
    match chain.mount?.frame() {
        EquatorialSystem::Topocentric => {
            Some(authority.observer(middle_of(frame)).ok()?.of_date_to_icrs(&OfDate { ra, dec }))
        }
        EquatorialSystem::J2000 | EquatorialSystem::Other => Icrs { ra, dec }.checked().ok(),
        // Nobody points by them either.
        EquatorialSystem::J2050 | EquatorialSystem::B1950 => None,
    }
}

/// As configured, else by the camera's pixels and the mount's focal length.
fn scale_arcsec_px(chain: &Chain<'_>, frame: &Frame) -> Option<f64> {
    let bin = f64::from(frame.bin.max(1));
    if let Some(scale) = chain.camera.config.scale_arcsec_px {
        return Some(scale * bin);
    }
    let of_frame = frame.readings.get("PixelSizeX").and_then(positive);
    let can = || chain.camera.instrument.can()?.pixel_width_um.known().copied().filter(|um| *um > 0.0);
    let pixel_um = of_frame.or_else(can)?;
    let mount = chain.mount?.instrument.newest()?.sample.body;
    let focal = mount.readings.get("FocalLength").and_then(positive)?;
    Some(of_focal_length(pixel_um * bin, focal))
}

/// Size of a pixel, arcsec; the focal length is in metres, or in mm where that can only be.
fn of_focal_length(pixel_um: f64, focal: f64) -> f64 {
    let focal_m = if focal > LONGEST_M { focal * 1e-3 } else { focal };
    pixel_um * 1e-6 / focal_m * ARCSEC
}

fn positive(reading: &Reading) -> Option<f64> {
    reading.value()?.number().filter(|value| value.is_finite() && *value > 0.0)
}

fn centre_px(frame: &Frame) -> (f64, f64) {
    (0.5 * (f64::from(frame.width_px) - 1.0), 0.5 * (f64::from(frame.height_px) - 1.0))
}

/// The middle of the exposure, sky time.
pub fn middle_of(frame: &Frame) -> Utc {
    frame.started_utc.plus_seconds(0.5 * frame.exposure_s.clamp(0.0, 86_400.0))
}

#[cfg(test)]
mod tests {
    use super::super::tests::frame;
    use super::*;

    #[test]
    fn the_target_counts_unless_the_mount_is_surely_elsewhere() {
        let at = |ra, dec| Some(Icrs::from_degrees(ra, dec));
        assert_eq!(place(at(10.0, 20.0), at(11.0, 20.0)), at(10.0, 20.0));
        assert_eq!(place(at(10.0, 20.0), at(40.0, 20.0)), at(40.0, 20.0));
        assert_eq!(place(None, at(40.0, 20.0)), at(40.0, 20.0));
        assert_eq!(place(at(10.0, 20.0), None), at(10.0, 20.0));
        assert_eq!(place(None, None), None);
    }

    #[test]
    fn a_focal_length_is_metres_or_what_it_can_only_be() {
        // 13.5 um at 8 m, a SPECULOOS camera: 0.348 arcsec.
        assert!((of_focal_length(13.5, 8.0) - 0.348).abs() < 1e-3);
        assert!((of_focal_length(13.5, 8000.0) - 0.348).abs() < 1e-3);
        assert!((of_focal_length(3.76, 0.135) - 5.745).abs() < 1e-2);
    }

    #[test]
    fn the_middle_of_the_sensor_is_found_on_a_part_of_it() {
        let aim = FrameAim { sensor_px: Some([2000.0, 1000.0]), ..FrameAim::default() };
        let part = Frame { width_px: 100, height_px: 80, origin_px: [1900, 0], ..frame("f") };
        assert_eq!(aim.middle_px(&part), (999.5 - 1900.0, 499.5));
        assert_eq!(FrameAim::default().middle_px(&part), (49.5, 39.5));
        assert_eq!(FrameAim::default().off_middle_px(&part), 0.0);
    }

    #[test]
    fn the_star_of_the_target_is_the_brightest_one_at_its_place() {
        let target = Icrs::from_degrees(80.0, 60.0);
        let s = 2.0 / 3600.0;
        let wcs =
            Wcs { ra: target.ra, dec: target.dec, x_px: 50.0, y_px: 40.0, cd_deg_px: [[-s, 0.0], [0.0, s]], sip: None };
        let star = |x_px: f64, fwhm_px: f64, peak_adu: f64| Star {
            x_px,
            y_px: 40.0,
            x_error_px: 0.01,
            y_error_px: 0.01,
            flux_adu: 1e5,
            flux_error_adu: 400.0,
            snr: 250.0,
            significance: 200.0,
            peak_adu,
            fwhm_px,
            ellipticity: 0.0,
            angle_deg: 0.0,
            flags: Default::default(),
        };
        let aim = FrameAim { target: Some(target), ..FrameAim::default() };
        let peak = |stars: &[Star]| aim.target_star(&wcs, stars).map(|star| star.peak_adu);
        assert_eq!(peak(&[star(80.0, 3.0, 65_535.0)]), None, "it is another star");
        assert_eq!(peak(&[star(80.0, 3.0, 65_535.0), star(52.0, 1.2, 900.0), star(55.0, 3.0, 9_000.0)]), Some(9_000.0));
        assert_eq!(FrameAim::default().target_star(&wcs, &[star(50.0, 3.0, 9.0)]), None, "there is no target");
    }

    #[test]
    fn the_centre_of_a_part_of_the_sensor_lies_where_known_optics_put_it() {
        let place = Icrs::from_degrees(80.0, 60.0);
        let aim = FrameAim { place: Some(place), sensor_px: Some([2000.0, 1000.0]), ..FrameAim::default() };
        let part = Frame { width_px: 100, height_px: 80, origin_px: [1900, 0], ..frame("f") };
        for (rotation_deg, mirrored) in [(0.0, false), (37.0, false), (-120.0, true), (180.0, true)] {
            let learned = LearnedOptics { scale_arcsec_px: 2.0, rotation_deg, mirrored, sip: None };
            let centre = aim.frame_centre(&part, Some(&learned)).unwrap();
            let away = sky::separation(&place, &centre).arcseconds();
            assert!((away - 2.0 * aim.off_middle_px(&part)).abs() < 0.1, "{away}");
            // A solution with these optics that has its centre there has the target in the sensor's middle.
            let sense = if mirrored { -1.0 } else { 1.0 };
            let (sin, cos) = rotation_deg.to_radians().sin_cos();
            let s = 2.0 / 3600.0;
            let (x_px, y_px) = aim.middle_px(&part);
            let cd_deg_px = [[sense * s * cos, s * sin], [-sense * s * sin, s * cos]];
            let wcs = Wcs { ra: place.ra, dec: place.dec, x_px, y_px, cd_deg_px, sip: None };
            assert!((wcs.rotation_deg() - rotation_deg + 540.0).rem_euclid(360.0) - 180.0 < 1e-9);
            assert_eq!(wcs.mirrored(), mirrored);
            assert!((wcs.scale_arcsec_px() - 2.0).abs() < 1e-9);
            let here = wcs.sky_to_pixel(centre.ra, centre.dec).unwrap();
            assert!((here.0 - 49.5).hypot(here.1 - 39.5) < 1e-6, "{here:?}");
            // Pointing brings the part's middle to the target, and the offset is reported for the same place.
            let sensor = FrameAim { target: Some(place), ..aim.clone() };
            let off = sensor.off_target(&part, &wcs).unwrap().arcseconds();
            assert!((off - away).abs() < 1e-6, "the sensor's middle on the target leaves the part off it: {off}");
            let brought = FrameAim { target: Some(centre), ..aim.clone() };
            assert!(brought.off_target(&part, &wcs).unwrap().arcseconds() < 1e-6);
        }
        assert_eq!(aim.frame_centre(&part, None), Ok(place));
        // It is looked for there too, unless the mount is elsewhere or the part lies in the middle.
        let on_target = FrameAim { target: Some(place), ..aim.clone() };
        assert_eq!(on_target.part_on_target(&part), Some(place));
        let elsewhere = FrameAim { place: Some(Icrs::from_degrees(10.0, 60.0)), ..on_target.clone() };
        assert_eq!(elsewhere.part_on_target(&part), None);
        let middle = Frame { origin_px: [960, 455], ..part.clone() };
        assert_eq!((on_target.part_on_target(&middle), aim.part_on_target(&part)), (None, None));
        assert_eq!(FrameAim::default().frame_centre(&part, None).unwrap_err().class, UnsolvedClass::NoPlace);
    }
}
