//! Parameters that several actions share.

use std::collections::BTreeMap;

use contract::device::camera::Subframe;
use serde::Deserialize;
use serde_json::Value;

use crate::rig::camera::{Camera, subframe};
use crate::trouble::Trouble;

/// Values for `action_metadata` rows of the FITS-header table; numbers and booleans are taken as their text.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(transparent)]
pub struct Metadata(BTreeMap<String, Value>);

impl Metadata {
    /// As texts.
    pub fn texts(&self) -> BTreeMap<String, String> {
        let text = |value: &Value| match value {
            Value::String(text) => text.clone(),
            other => other.to_string(),
        };
        self.0.iter().map(|(key, value)| (key.clone(), text(value))).collect()
    }
}

/// A part of the sensor as schedules ask for it: size in binned pixels, centre from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Columns.
    pub width: Option<u32>,
    /// Rows.
    pub height: Option<u32>,
    /// 0 is the left edge, 1 the right one.
    pub center_x: f64,
    /// 0 is the first row's edge, 1 the last one's.
    pub center_y: f64,
}

impl Part {
    /// Refuses half a size and a centre off the sensor.
    pub fn check(&self) -> Result<(), String> {
        match (self.width, self.height) {
            (None, None) => {}
            (Some(width), Some(height)) if width > 0 && height > 0 => {}
            (Some(_), Some(_)) => return Err("subframe_width: width and height must be above 0".to_owned()),
            _ => return Err("subframe_width: give subframe_width and subframe_height, or neither".to_owned()),
        }
        for (name, centre) in [("subframe_center_x", self.center_x), ("subframe_center_y", self.center_y)] {
            if !(0.0..=1.0).contains(&centre) {
                return Err(format!("{name}: expected 0 to 1, found {centre}"));
            }
        }
        Ok(())
    }

    /// The pixels, once the sensor is known; `None` is the whole sensor.
    pub async fn on(&self, camera: &Camera, bin: u32) -> Result<Option<Subframe>, Trouble> {
        let (Some(width), Some(height)) = (self.width, self.height) else { return Ok(None) };
        let can = camera.instrument.capabilities().await?;
        let centre = (self.center_x, self.center_y);
        Ok(Some(subframe((can.width_px, can.height_px), bin, (width, height), centre)))
    }
}

/// Binning where a row names none.
pub fn one() -> u32 {
    1
}

/// Centre where a row names none.
pub fn half() -> f64 {
    0.5
}

/// Refuses an exposure time that no camera can take.
pub fn check_exptime(exptime: f64) -> Result<(), String> {
    if (0.0..=86_400.0).contains(&exptime) {
        Ok(())
    } else {
        Err(format!("exptime: expected seconds, 0 or more, found {exptime}"))
    }
}

/// Refuses a binning that no camera has.
pub fn check_bin(bin: u32) -> Result<(), String> {
    if (1..=16).contains(&bin) { Ok(()) } else { Err(format!("bin: expected 1 to 16, found {bin}")) }
}
