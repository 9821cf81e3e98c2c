//! What is known of the sensor that took a frame, for its header and for all that is measured on it.

use contract::device::camera::{Frame, Pixel};

use crate::Observatory;

/// A sensor: what the configuration says of it, and where that is silent what its driver reported with the frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sensor {
    /// Electrons of one ADU.
    pub electrons_per_adu: Option<f64>,
    /// Read noise, electrons; no driver reports it.
    pub read_noise_e: Option<f64>,
    /// A pixel of this value or above is saturated, ADU; only where it is configured.
    pub saturation_adu: Option<f64>,
    /// The greatest value of a pixel, ADU, as the driver reports it.
    pub max_adu: Option<f64>,
}

impl Sensor {
    /// The sensor that took a frame.
    pub fn of(config: &Observatory, frame: &Frame) -> Self {
        let block = config.camera.iter().find(|block| block.common.name.as_str() == frame.camera);
        // Drivers report 0 for what they do not know.
        let reported = |property: &str| {
            let number = frame.readings.get(property)?.value()?.number()?;
            (number.is_finite() && number > 0.0).then_some(number)
        };
        // No pixel is above what its numbers can hold.
        let holds_adu = if frame.pixel == Pixel::U16 { f64::from(u16::MAX) } else { f64::INFINITY };
        Self {
            electrons_per_adu: block.and_then(|block| block.electrons_per_adu).or_else(|| reported("ElectronsPerADU")),
            read_noise_e: block.and_then(|block| block.read_noise_e),
            saturation_adu: block.and_then(|block| block.saturation_adu).map(|adu| adu.min(holds_adu)),
            max_adu: reported("MaxADU"),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::path::Path;

    use contract::datum::ReadingOutcome;
    use contract::device::camera::Purpose;
    use contract::{CommandId, Reading, Scalar};
    use units::Utc;

    use super::*;

    fn sensor(of_block: &str, readings: &[(&str, f64)]) -> Sensor {
        let text = format!(
            "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0.0\nlongitude_deg = 0.0\nelevation_m = 0.0\n\
             [[camera]]\nname = \"cam\"\nserver = \"h:1\"\n{of_block}"
        );
        let read = |(name, value): &(&str, f64)| {
            let outcome = ReadingOutcome::Value { value: Scalar::Float(*value), unit: String::new() };
            ((*name).to_owned(), Reading { outcome, at_utc: Utc::EPOCH, age_s: None })
        };
        let frame = Frame {
            id: CommandId("f".to_owned()),
            camera: "cam".to_owned(),
            purpose: Purpose::default(),
            width_px: 2,
            height_px: 1,
            planes: 1,
            pixel: Pixel::U16,
            bin: 1,
            origin_px: [0, 0],
            started_utc: Utc::EPOCH,
            exposure_s: 1.0,
            url: String::new(),
            bytes: 4,
            sha256: String::new(),
            readings: readings.iter().map(read).collect::<BTreeMap<_, _>>(),
        };
        Sensor::of(&crate::parse(&text, Path::new(".")).unwrap(), &frame)
    }

    #[test]
    fn what_is_configured_is_before_what_the_driver_reports_and_nothing_is_not_zero() {
        let driver = [("ElectronsPerADU", 1.3), ("MaxADU", 65_535.0)];
        let reported = Sensor { electrons_per_adu: Some(1.3), max_adu: Some(65_535.0), ..Sensor::default() };
        assert_eq!(sensor("", &driver), reported);
        let all = "electrons_per_adu = 0.25\nread_noise_e = 2.5\nsaturation_adu = 50000.0\n";
        let configured = Sensor {
            electrons_per_adu: Some(0.25),
            read_noise_e: Some(2.5),
            saturation_adu: Some(50_000.0),
            max_adu: Some(65_535.0),
        };
        assert_eq!(sensor(all, &driver), configured);
        assert_eq!(sensor(all, &[("ElectronsPerADU", 0.0)]), Sensor { max_adu: None, ..configured });
        assert_eq!(sensor("", &[("ElectronsPerADU", 0.0), ("MaxADU", -1.0)]), Sensor::default());
        assert_eq!(sensor("saturation_adu = 100000.0\n", &[]).saturation_adu, Some(65_535.0), "16 bits hold no more");
    }
}
