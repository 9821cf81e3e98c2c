//! What is known of a camera's sensor, and what is not.

use std::collections::BTreeSet;

pub use config::Sensor;
use contract::datum::ReadingOutcome;
use contract::device::camera::Frame;
use contract::{NoData, Reading, Scalar};

/// What photometry needs of the sensor, and what gives it where the driver does not: the history names what is missing.
const OF_SENSOR: [(&str, &str); 3] =
    [("GAIN", "electrons_per_adu"), ("RDNOISE", "read_noise_e"), ("SATURATE", "saturation_adu")];

/// Says which values of the sensor a header does not have, and what gives them.
pub fn unknown_of_sensor(present: &BTreeSet<String>) -> Vec<String> {
    let is_missing = |(keyword, _): &&(&str, &str)| !present.contains(*keyword);
    let line = |(keyword, key): &(&str, &str)| format!("{keyword} not known: give {key} of the camera's block");
    OF_SENSOR.iter().filter(is_missing).map(line).collect()
}

/// Properties of a camera that are the same whenever they are read. All others may be those of another exposure.
pub fn is_constant(property: &str) -> bool {
    let names = ["Name", "Description", "DriverInfo", "DriverVersion", "InterfaceVersion", "SensorName"];
    let colours = ["SensorType", "BayerOffsetX", "BayerOffsetY"];
    let sizes = ["PixelSizeX", "PixelSizeY", "CameraXSize", "CameraYSize", "MaxBinX", "MaxBinY", "HasShutter"];
    names.contains(&property) || colours.contains(&property) || sizes.contains(&property) || property.starts_with("Can")
}

/// A property of the camera as it was during the exposure of a frame. Of what the camera did not answer meanwhile,
/// `newest` is right only where it cannot change.
pub fn during(frame: &Frame, property: &str, newest: impl FnOnce() -> Option<Scalar>) -> Option<Scalar> {
    let set = match property {
        "BinX" | "BinY" => frame.bin,
        "StartX" => frame.origin_px[0],
        "StartY" => frame.origin_px[1],
        "NumX" => frame.width_px,
        "NumY" => frame.height_px,
        _ => {
            let own = frame.readings.get(property).and_then(Reading::value).cloned();
            return own.or_else(|| if is_constant(property) { newest() } else { None });
        }
    };
    Some(Scalar::Int(set.into()))
}

/// Whether the camera has a property and could not answer during the exposure.
pub fn was_lost(frame: &Frame, property: &str) -> bool {
    let lost = |reading: &Reading| match &reading.outcome {
        ReadingOutcome::Missing { no_data } => *no_data != NoData::not_implemented(),
        ReadingOutcome::Value { .. } => false,
    };
    frame.readings.get(property).is_some_and(lost)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(readings: &[(&str, ReadingOutcome)]) -> Frame {
        let mut frame = test_support::frame("frame");
        let at_utc = frame.started_utc;
        let reading = |outcome: &ReadingOutcome| Reading { outcome: outcome.clone(), at_utc, age_s: None };
        frame.readings = readings.iter().map(|(name, outcome)| ((*name).to_owned(), reading(outcome))).collect();
        frame
    }

    #[test]
    fn what_a_camera_did_not_answer_during_the_exposure_is_not_taken_from_another_one() {
        let lost = || ReadingOutcome::Missing { no_data: NoData::new("timeout", "no answer within 2 s") };
        let given = ReadingOutcome::Value { value: Scalar::Int(120), unit: String::new() };
        let mut frame = frame(&[("BinX", lost()), ("StartX", lost()), ("Gain", lost()), ("Offset", given)]);
        (frame.bin, frame.origin_px, frame.width_px, frame.height_px) = (2, [64, 32], 500, 400);
        let of = |property: &str| during(&frame, property, || Some(Scalar::Int(1))).and_then(|value| value.number());
        let of_frame = ["BinX", "BinY", "StartX", "StartY", "NumX", "NumY"].map(of);
        assert_eq!(of_frame, [2.0, 2.0, 64.0, 32.0, 500.0, 400.0].map(Some));
        assert_eq!(["Gain", "ReadoutMode", "Offset", "PixelSizeX"].map(of), [None, None, Some(120.0), Some(1.0)]);
        assert_eq!(["Gain", "ReadoutMode", "Offset"].map(|property| was_lost(&frame, property)), [true, false, false]);
    }
}
