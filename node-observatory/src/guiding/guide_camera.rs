//! A camera of its own for guiding: exposed again and again in parallel with the row's camera, as long as guiding
//! lasts.

use std::sync::Arc;
use std::time::Duration;

use contract::CommandId;
use contract::device::camera::{Command, Purpose};
use node::Node;
use schedule::Row;

use super::Wanted;
use crate::action_error::ActionError;
use crate::devices::Devices;
use crate::devices::camera::Camera;
use crate::row_context::RowTools;

/// A camera that failed rests so long, machine time.
const REST: Duration = Duration::from_secs(5);
/// Nothing is exposed while there is an objection to the row; asked again after this, machine time.
const AGAIN: Duration = Duration::from_secs(1);

/// Stops the exposure that is under way when it is dropped.
struct UnderWay {
    devices: Arc<Devices>,
    camera: contract::Name,
    exposing: bool,
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        if !self.exposing {
            return;
        }
        let (devices, camera) = (self.devices.clone(), self.camera.clone());
        // Outside of a runtime the node is ending, and the exposure ends by itself.
        if let Ok(runtime) = tokio::runtime::Handle::try_current() {
            runtime.spawn(async move {
                if let Ok(chain) = devices.chain(&camera) {
                    let _ = chain.camera.abort().await;
                }
            });
        }
    }
}

/// Exposes until it is dropped.
pub async fn keep_exposing(tools: Arc<RowTools>, row: Row, index: u32, wanted: Wanted, camera: contract::Name) {
    let (authority, devices) = (&tools.authority, &tools.devices);
    let mut under_way = UnderWay { devices: devices.clone(), camera: camera.clone(), exposing: false };
    let mut sequence = 0;
    loop {
        // `begin` has found it, and the configuration does not change.
        let Ok(chain) = devices.chain(&camera) else { return };
        if authority.objection(Some(&row)).is_some() {
            tokio::time::sleep(AGAIN).await;
            continue;
        }
        let purpose =
            purpose(&authority.node, &row, index, &wanted, chain.wheel.and_then(|wheel| wheel.filter()), sequence);
        sequence += 1;
        under_way.exposing = true;
        let taken = expose(chain.camera, &authority.node, purpose).await;
        under_way.exposing = false;
        if let Err(error) = taken {
            tracing::warn!(camera = %camera, %error, "the guide camera took no frame");
            tokio::time::sleep(REST).await;
        }
    }
}

async fn expose(camera: &Camera, node: &Node, purpose: Purpose) -> Result<(), ActionError> {
    let config = &node.config.guiding;
    let (id, exposure_s) = (CommandId::fresh(), config.exposure_s);
    let command =
        Command::Expose { exposure_s, light: true, bin: config.bin, subframe: None, purpose: Box::new(purpose) };
    camera.instrument.ask_in_turn(&id, command).await?;
    camera.exposed(&id, exposure_s).await
}

fn purpose(node: &Node, row: &Row, index: u32, wanted: &Wanted, filter: Option<String>, sequence: u32) -> Purpose {
    let longitude = units::Angle::from_degrees(node.config.place.longitude_deg);
    Purpose {
        action: "guiding".to_owned(),
        object: Some(wanted.object.clone()),
        image_type: "Light Frame".to_owned(),
        filter,
        ra_deg: wanted.target_deg.map(|[ra, _]| ra),
        dec_deg: wanted.target_deg.map(|[_, dec]| dec),
        night: sky::night_date(longitude, row.start).to_string(),
        sequence,
        row: Some(index),
        programme: row.programme.clone(),
        ..Purpose::default()
    }
}
