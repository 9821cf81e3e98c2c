//! Which devices belong to a frame.

use std::collections::HashMap;

use config::Observatory;
use contract::device::camera::Frame;
use contract::{Device, Kind};

/// The camera and the devices that belong to a frame: those that the frame names, else those that the configuration
/// pairs with the camera.
pub fn pairing(config: &Observatory, camera: &Device, frame: &Frame) -> HashMap<Kind, Device> {
    let mut devices = HashMap::from([(Kind::Camera, camera.clone())]);
    for (kind, name) in &frame.purpose.paired {
        match (kind.parse::<Kind>(), name.parse()) {
            (Ok(kind), Ok(name)) if kind != Kind::Camera => drop(devices.insert(kind, config.device(kind, &name))),
            (Ok(_), Ok(_)) => {}
            _ => tracing::warn!(kind, name, frame = %frame.id, "a pairing that names nothing"),
        }
    }
    let block = config.camera.iter().find(|block| block.common.name == camera.name);
    if let (true, Some(block)) = (frame.purpose.paired.is_empty(), block) {
        let pairs = [
            (Kind::Telescope, &block.telescope),
            (Kind::FilterWheel, &block.filterwheel),
            (Kind::Focuser, &block.focuser),
            (Kind::Dome, &block.dome),
            (Kind::Rotator, &block.rotator),
            (Kind::CoverCalibrator, &block.covercalibrator),
            (Kind::SafetyMonitor, &block.safetymonitor),
            (Kind::ObservingConditions, &block.observingconditions),
            (Kind::Switch, &block.switch),
        ];
        let named = pairs.into_iter().filter_map(|(kind, name)| Some((kind, name.as_ref()?)));
        devices.extend(named.map(|(kind, name)| (kind, config.device(kind, name))));
    }
    devices
}
