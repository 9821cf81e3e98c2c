//! `[[camera]] guide_calibration`: what guide pulses do to a camera's stars, as it was measured elsewhere.

use contract::device::telescope::PierSide;
use serde::Deserialize;

/// Velocities of a star's image while the mount is pulsed, in pixels of the whole, unbinned sensor; x counts columns and y
/// rows. What this node learns by itself goes before it.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GuideStart {
    /// During an East pulse at `dec_deg`, px/s.
    #[serde(deserialize_with = "crate::pair::pair")]
    pub east_px_per_s: [f64; 2],
    /// During a North pulse, px/s.
    #[serde(deserialize_with = "crate::pair::pair")]
    pub north_px_per_s: [f64; 2],
    /// Declination for which `east_px_per_s` holds, degrees.
    #[serde(default)]
    pub dec_deg: f64,
    /// Side of the pier for which it holds; absent for mounts without sides.
    #[serde(default)]
    pub pier_side: Option<PierSide>,
}

/// As near to the pole as a calibration shows anything of other declinations, degrees.
const HIGHEST_DEC_DEG: f64 = 60.0;
/// Least sine of the angle between the two directions.
const LEAST_ANGLE: f64 = 0.1;

impl GuideStart {
    /// What does not hold, in words that begin with the key.
    pub(crate) fn faults(&self) -> Vec<String> {
        let mut found = Vec::new();
        let speeds = [self.east_px_per_s, self.north_px_per_s].map(|[x, y]| x.hypot(y));
        for (key, speed) in ["east_px_per_s", "north_px_per_s"].into_iter().zip(speeds) {
            // slower than a pixel in three hours, or across any sensor at once
            if !(1e-4..=1e5).contains(&speed) {
                found.push(format!("guide_calibration.{key}: {speed} px/s: expected 0.0001 to 100000"));
            }
        }
        let ([east_x, east_y], [north_x, north_y]) = (self.east_px_per_s, self.north_px_per_s);
        let sine = (east_x * north_y - east_y * north_x) / (speeds[0] * speeds[1]);
        if found.is_empty() && sine.abs() < LEAST_ANGLE {
            found.push(
                "guide_calibration: East and North move stars along the same line: expected two directions".into(),
            );
        }
        if !(-HIGHEST_DEC_DEG..=HIGHEST_DEC_DEG).contains(&self.dec_deg) {
            let dec_deg = self.dec_deg;
            found.push(format!(
                "guide_calibration.dec_deg = {dec_deg}: expected -60 to 60: nearer to a pole it is worthless"
            ));
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    const HEAD: &str = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\n\
                        elevation_m = 0\n[[camera]]\nname = \"cam\"\nserver = \"a:1\"\n";

    #[test]
    fn a_camera_may_know_what_pulses_did_elsewhere() {
        let text = format!(
            "{HEAD}guide_calibration = {{ east_px_per_s = [14, 0.5], north_px_per_s = [0, -13.9], pier_side = \"east\" }}\n"
        );
        let known = crate::parse(&text, Path::new("/obs")).unwrap().camera[0].guide_calibration.unwrap();
        assert_eq!((known.east_px_per_s, known.dec_deg, known.pier_side), ([14.0, 0.5], 0.0, Some(PierSide::East)));
        assert!(crate::parse(HEAD, Path::new("/obs")).unwrap().camera[0].guide_calibration.is_none());
    }

    #[test]
    fn a_calibration_that_separates_no_two_directions_is_refused_with_what_is_expected() {
        for (table, message) in [
            (
                "east_px_per_s = [0, 0], north_px_per_s = [0, 1]",
                "camera \"cam\": guide_calibration.east_px_per_s: 0 px/s",
            ),
            ("east_px_per_s = [1, 0], north_px_per_s = [inf, 1]", "guide_calibration.north_px_per_s: inf px/s"),
            ("east_px_per_s = [1, 0], north_px_per_s = [nan, 1]", "guide_calibration.north_px_per_s: NaN px/s"),
            ("east_px_per_s = [1, 1], north_px_per_s = [-2, -2]", "along the same line"),
            (
                "east_px_per_s = [1, 0], north_px_per_s = [0, 1], dec_deg = 88",
                "guide_calibration.dec_deg = 88: expected",
            ),
            ("east_px_per_s = [1, 0]", "north_px_per_s"),
        ] {
            let text = format!("{HEAD}guide_calibration = {{ {table} }}\n");
            let refused = crate::parse(&text, Path::new("/obs")).unwrap_err().to_string();
            assert!(refused.contains(message), "{refused}");
        }
    }
}
