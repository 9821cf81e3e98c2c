//! What a camera is set to before an exposure.

use contract::device::camera::Subframe;

/// What a camera is set to before an exposure, binned pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Setting {
    /// Binning.
    pub bin: u32,
    /// The part of the sensor.
    pub part: Subframe,
}

impl Setting {
    /// The asked part of the sensor, or all of it.
    pub fn new(sensor_px: (u32, u32), bin: u32, part: Option<Subframe>) -> Self {
        let (width_px, height_px) = (sensor_px.0 / bin, sensor_px.1 / bin);
        Self { bin, part: part.unwrap_or(Subframe { x_px: 0, y_px: 0, width_px, height_px }) }
    }

    /// How many pixels it reads.
    pub fn pixels(self) -> u64 {
        u64::from(self.part.width_px) * u64::from(self.part.height_px)
    }
}
