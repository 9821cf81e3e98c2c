//! Publishes which frames wait in the spool: each when it is safe, and again until the archive releases it.

use std::sync::Arc;
use std::time::Duration;

use bus::Publisher;
use contract::device::camera::Frame;
use contract::observatory::AlertKind;
use contract::{CommandId, Key, Kind, Name};
use node::Node;
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval};

use crate::spool::{Spool, SpoolError};

/// Frames that nobody released are announced again so often.
const AGAIN: Duration = Duration::from_secs(30);
/// Released frames are removed, and free space is measured, so often.
const SWEEP: Duration = Duration::from_secs(10);

/// Announces the frames of these cameras until the node is stopped.
pub async fn run(
    node: Node,
    spool: Arc<Spool>,
    cameras: Vec<Name>,
    mut stored: mpsc::UnboundedReceiver<Result<CommandId, (CommandId, SpoolError)>>,
) -> anyhow::Result<()> {
    let mut publishers = Vec::new();
    for camera in cameras {
        let key = Key::Frame(node.config.address().device(Kind::Camera, &camera));
        publishers.push((camera, node.bus.publisher::<Frame>(&key).await?));
    }
    let clock = node.bus.clock().clone();
    let announce = async |publisher: &Publisher<Frame>, frame: Frame| {
        let id = frame.id.clone();
        match publisher.put(frame).await {
            Ok(()) => spool.announced(&id, clock.machine()),
            Err(error) => tracing::warn!(frame = %id, %error, "a frame could not be announced; it will be again"),
        }
    };
    let mut again = interval(AGAIN);
    again.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut sweep = interval(SWEEP);
    sweep.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = node.stop.wait() => return Ok(()),
            Some(outcome) = stored.recv() => match outcome {
                Ok(id) => {
                    node.alerts.clear(AlertKind::SpoolCannotWrite, "");
                    let Some(frame) = spool.frame(&id) else { continue };
                    node.alerts.clear(AlertKind::ImageUnreadable, &frame.camera);
                    tracing::info!(camera = frame.camera, frame = %id, exposure_s = frame.exposure_s, "frame in the spool");
                    if let Some((_, publisher)) = publishers.iter().find(|(name, _)| name.as_str() == frame.camera) {
                        announce(publisher, frame).await;
                    }
                }
                Err((id, error)) => {
                    tracing::error!(frame = %id, %error, "a frame is lost");
                    let cause = format!("frame {id} could not be kept: {error}");
                    // The disk has no part in what a camera answers.
                    match error {
                        SpoolError::Image { camera, .. } => {
                            node.alerts.raise(AlertKind::ImageUnreadable, camera, &cause);
                        }
                        SpoolError::Disk { .. } | SpoolError::Describe(_) => {
                            node.alerts.raise(AlertKind::SpoolCannotWrite, "", &cause);
                        }
                    }
                }
            },
            // The first tick is now: frames that waited for a restart.
            _ = again.tick() => {
                for (camera, publisher) in &publishers {
                    for frame in spool.unreleased(camera) {
                        announce(publisher, frame).await;
                    }
                }
            }
            _ = sweep.tick() => {
                let (spool, now) = (spool.clone(), clock.machine());
                let swept = tokio::task::spawn_blocking(move || {
                    spool.sweep(now);
                    spool.measure_free();
                });
                if let Err(error) = swept.await {
                    tracing::error!(%error, "the spool could not be swept");
                }
            }
        }
    }
}
