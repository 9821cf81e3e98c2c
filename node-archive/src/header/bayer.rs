//! The pattern of a one-shot colour sensor.

use contract::Kind;
use contract::device::camera::Frame;

use super::HeaderFacts;

/// ASCOM's `SensorType` of a sensor whose pixels see red and green, and in the next row green and blue.
const RGGB: f64 = 2.0;

impl HeaderFacts<'_> {
    /// Where in the pattern of a one-shot colour sensor the frame begins: column and row, 0 or 1; absent where no pixel of the
    /// file is one of such a sensor.
    pub(super) fn bayer_px(&self) -> Option<[i64; 2]> {
        let Frame { bin, planes, origin_px: [x, y], .. } = *self.frame;
        let offset = |property, origin: u32| {
            Some((self.number(Kind::Camera, property)? + f64::from(origin)).rem_euclid(2.0) as i64)
        };
        let has_pattern = bin == 1 && planes == 1 && self.number(Kind::Camera, "SensorType")? == RGGB;
        if has_pattern { Some([offset("BayerOffsetX", x)?, offset("BayerOffsetY", y)?]) } else { None }
    }
}
