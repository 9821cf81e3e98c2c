//! The part of the telescope's view that the dome's slit leaves free: rays from all over the aperture, followed to the
//! dome.

use units::Angle;

use crate::options::{Options, SlitOptions};
use crate::scene::Pointing;

/// Rings of rays around the middle one; the last is the rim.
const RINGS: u32 = 3;

/// The free part of the aperture, 0 to 1, with the slit at `azimuth`; 1 for a roof, which has no slit.
pub fn free(options: &Options, pointing: &Pointing, azimuth: Angle) -> f64 {
    let Some(slit) = &options.dome.slit else { return 1.0 };
    let (altitude, bearing) = (pointing.horizontal.altitude, pointing.horizontal.azimuth);
    let along = [altitude.cos() * bearing.sin(), altitude.cos() * bearing.cos(), altitude.sin()];
    let pole = [0.0, options.latitude.cos(), options.latitude.sin()];
    // The declination axis of an equatorial mount is square to its polar axis and to the tube.
    let arm_m = if options.mount.german { options.mount.arm_m } else { 0.0 };
    let to_tube = unit(cross(along, pole)).map(|part| if pointing.pier_west { part * arm_m } else { -part * arm_m });
    let middle: [f64; 3] = std::array::from_fn(|i| slit.axes_m[i] + to_tube[i]);
    let sideways = unit(cross(along, if altitude.degrees() > 60.0 { [0.0, 1.0, 0.0] } else { [0.0, 0.0, 1.0] }));
    let upright = cross(sideways, along);
    let radius_m = options.camera.aperture_mm / 2e3;
    let (mut rays, mut passed) = (0_u32, 0_u32);
    for ring in 0..=RINGS {
        let count = (6 * ring).max(1);
        let at_m = radius_m * f64::from(ring) / f64::from(RINGS);
        for ray in 0..count {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(ray) / f64::from(count)).sin_cos();
            let from = std::array::from_fn(|i| middle[i] + at_m * (cos * sideways[i] + sin * upright[i]));
            rays += 1;
            passed += u32::from(passes(slit, from, along, azimuth));
        }
    }
    f64::from(passed) / f64::from(rays)
}

/// Does a ray leave the dome through the slit?
fn passes(slit: &SlitOptions, from: [f64; 3], along: [f64; 3], azimuth: Angle) -> bool {
    let ahead = dot(from, along);
    let root = ahead * ahead - dot(from, from) + slit.radius_m * slit.radius_m;
    if root < 0.0 {
        return false;
    }
    let way = root.sqrt() - ahead;
    let [east, north] = [from[0] + way * along[0], from[1] + way * along[1]];
    let forward = east * azimuth.sin() + north * azimuth.cos();
    let aside = east * azimuth.cos() - north * azimuth.sin();
    2.0 * aside.abs() <= slit.width_m && forward >= -slit.past_zenith_m
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A vector of length 1; zero stays zero.
fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = dot(a, a).sqrt();
    if length > 1e-12 { a.map(|part| part / length) } else { a }
}

#[cfg(test)]
mod tests {
    use sky::{Horizontal, Icrs};

    use super::*;

    fn free_at(options: &Options, altitude: f64, bearing: f64, pier_west: bool, azimuth: f64) -> f64 {
        let horizontal = Horizontal::from_degrees(altitude, bearing);
        let pointing = Pointing { icrs: Icrs::from_degrees(0.0, 0.0), horizontal, pier_west };
        free(options, &pointing, Angle::from_degrees(azimuth))
    }

    #[test]
    fn a_slit_is_free_ahead_half_free_at_its_edge_and_shut_elsewhere() {
        let options = Options::default();
        assert_eq!(free_at(&options, 30.0, 90.0, false, 90.0), 1.0);
        // The middle of the view stands at the edge of the slit: half the slit's width, seen from the middle.
        let slit = options.dome.slit.unwrap();
        let edge = (0.5 * slit.width_m / (slit.radius_m * 30.0_f64.to_radians().cos())).asin().to_degrees();
        let half = free_at(&options, 30.0, 90.0, false, 90.0 + edge);
        assert!((0.35..0.65).contains(&half), "{half}");
        assert_eq!(free_at(&options, 30.0, 90.0, false, 180.0), 0.0);
        assert_eq!(free_at(&options, 89.0, 90.0, false, 270.0), 1.0, "near the zenith any azimuth will do");
    }

    #[test]
    fn the_tube_of_a_german_mount_looks_out_beside_the_middle() {
        let mut options = Options::default();
        options.mount.arm_m = 0.5;
        let (west, east) = (free_at(&options, 30.0, 0.0, true, 0.0), free_at(&options, 30.0, 0.0, false, 0.0));
        assert!(west < 1.0 && east < 1.0, "{west} {east}");
        let edge_deg = (0.5_f64 / (2.5 * 30.0_f64.to_radians().cos())).asin().to_degrees();
        assert_eq!(free_at(&options, 30.0, 0.0, true, -edge_deg), 1.0);
        assert_eq!(free_at(&options, 30.0, 0.0, false, edge_deg), 1.0);
    }

    #[test]
    fn a_roof_hides_nothing() {
        let mut options = Options::default();
        options.dome.slit = None;
        assert_eq!(free_at(&options, 30.0, 90.0, false, 270.0), 1.0);
    }
}
