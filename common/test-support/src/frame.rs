//! A frame, for tests that need one and set what matters to them.

use contract::CommandId;
use contract::device::camera::{Frame, Pixel, Purpose};
use units::Utc;

/// The begin of the exposure of [`frame`], s since 1970: 2026-11-21T03:00:00Z.
const STARTED_S: f64 = 1_795_230_000.0;

/// A frame of the camera `andor` for no purpose: 4 x 2 pixels of 16 bits, not binned, 5 s.
pub fn frame(id: &str) -> Frame {
    Frame {
        id: CommandId(id.to_owned()),
        camera: "andor".to_owned(),
        purpose: Purpose::default(),
        width_px: 4,
        height_px: 2,
        planes: 1,
        pixel: Pixel::U16,
        bin: 1,
        origin_px: [0, 0],
        started_utc: Utc::from_seconds(STARTED_S),
        exposure_s: 5.0,
        url: String::new(),
        bytes: 16,
        sha256: String::new(),
        readings: Default::default(),
    }
}
