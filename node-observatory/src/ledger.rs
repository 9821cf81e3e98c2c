//! The frames that were announced, and those that an archive has stored with a complete header.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bus::{Catch, MachineTime};
use contract::archive::Stored;
use contract::device::camera::Frame;
use contract::observatory::Priority;
use contract::{CommandId, Key, Kind, Name};
use tokio::sync::watch;

use crate::control_room::ControlRoom;

/// What is known of the frames.
#[derive(Debug, Clone, Default)]
pub struct Frames {
    /// Announced frames with the night they belong to.
    pub announced: BTreeMap<String, String>,
    /// Frames whose file has all keywords.
    pub complete: BTreeSet<String>,
}

impl Frames {
    /// Announced frames of a night that are not yet stored with a complete header, and the number of all.
    pub fn missing(&self, night: &str) -> (Vec<String>, usize) {
        let of_night: Vec<&String> =
            self.announced.iter().filter(|(_, of)| *of == night).map(|(frame, _)| frame).collect();
        let missing = of_night.iter().filter(|frame| !self.complete.contains(**frame)).map(|frame| (*frame).clone());
        (missing.collect(), of_night.len())
    }
}

/// Announced and stored frames, as a value that can be followed.
#[derive(Debug)]
pub struct Ledger {
    frames: watch::Sender<Frames>,
    expected: Mutex<BTreeMap<String, (Name, MachineTime)>>,
}

/// A frame that was exposed is announced within this time, or something has swallowed it.
const ANNOUNCED_WITHIN: Duration = Duration::from_secs(120);

impl Default for Ledger {
    fn default() -> Self {
        Self { frames: watch::channel(Frames::default()).0, expected: Mutex::default() }
    }
}

impl Ledger {
    /// Follows the frames.
    pub fn watch(&self) -> watch::Receiver<Frames> {
        self.frames.subscribe()
    }

    /// A frame's file has all keywords.
    pub fn complete(&self, frame: &CommandId) {
        self.frames.send_if_modified(|frames| frames.complete.insert(frame.0.clone()));
    }

    /// A frame was exposed and will be announced.
    pub fn expect(&self, frame: &CommandId, camera: &Name, now: MachineTime) {
        if !self.frames.borrow().announced.contains_key(&frame.0) {
            self.expected().insert(frame.0.clone(), (camera.clone(), now));
        }
    }

    /// Frames that were not announced in time, each told once.
    fn lost(&self, now: MachineTime) -> Vec<(String, Name)> {
        let mut expected = self.expected();
        let late = |(_, since): &(Name, MachineTime)| now.since(*since) > ANNOUNCED_WITHIN;
        let lost: Vec<_> =
            expected.iter().filter(|(_, of)| late(of)).map(|(id, (camera, _))| (id.clone(), camera.clone())).collect();
        expected.retain(|_, of| !late(of));
        lost
    }

    fn expected(&self) -> MutexGuard<'_, BTreeMap<String, (Name, MachineTime)>> {
        self.expected.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes an announced frame; true the first time, since a spool repeats what nobody has taken yet.
    fn announced(&self, frame: &Frame) -> bool {
        self.expected().remove(&frame.id.0);
        self.frames.send_if_modified(|frames| {
            frames.announced.insert(frame.id.0.clone(), frame.purpose.night.clone()).is_none()
        })
    }
}

/// Hears announced frames: counts those of this life, and tells the journal of those that a crash left open.
pub async fn keep_counting_frames(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let (own, started_utc) = (room.node.config.address(), room.node.bus.clock().utc());
    let expression = format!("{}/{own}/device/{}/*/frame", contract::key::ROOT, Kind::Camera);
    let frames = room.node.bus.subscribe::<Frame>(&expression, Catch::All, 1000).await?;
    let clock = room.node.bus.clock().clone();
    loop {
        let heard = tokio::time::timeout(Duration::from_secs(10), frames.hear()).await;
        for (frame, camera) in room.ledger.lost(clock.machine()) {
            room.node.alerts.raise(
                &format!("frame-lost/{camera}"),
                Priority::Medium,
                &format!("frame {frame} of {camera} was exposed and never announced"),
                "It may not be on disk.",
                "Look at the device node of the camera and its spool.",
            );
        }
        let Ok(heard) = heard else { continue };
        let frame = heard.said.body;
        if let Key::Frame(device) = &heard.key {
            room.node.alerts.clear(&format!("frame-lost/{}", device.name));
        }
        tracing::debug!(frame = %frame.id, camera = frame.camera, "announced");
        let is_new = room.ledger.announced(&frame);
        if is_new && heard.said.at_utc >= started_utc {
            room.board.frame(&frame.id);
        }
        let (at, id) = (room.clone(), frame.id);
        let noted = tokio::task::spawn_blocking(move || at.journal.taken(&id, at.node.bus.clock().utc()));
        if let Err(error) = noted.await? {
            tracing::warn!(%error, "an announced frame is not in the journal");
        }
    }
}

/// Hears what the archives have stored.
pub async fn keep_counting_files(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let key = Key::Stored(room.node.config.address()).to_string();
    let stored = room.node.bus.subscribe::<Stored>(&key, Catch::All, 1000).await?;
    loop {
        let heard = stored.hear().await;
        if heard.said.body.header_complete {
            room.ledger.complete(&heard.said.body.frame);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_frames_of_the_night_are_waited_for() {
        let mut frames = Frames::default();
        for (frame, night) in [("a", "20261120"), ("b", "20261121"), ("c", "20261121")] {
            frames.announced.insert(frame.to_owned(), night.to_owned());
        }
        frames.complete.insert("c".to_owned());
        assert_eq!(frames.missing("20261121"), (vec!["b".to_owned()], 2));
        assert_eq!(frames.missing("20261122"), (vec![], 0));
    }

    #[test]
    fn a_frame_that_is_exposed_and_never_announced_is_told_once() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let (ledger, camera) = (Ledger::default(), "cam".parse().unwrap());
        ledger.expect(&CommandId("a".to_owned()), &camera, at(0));
        assert_eq!(ledger.lost(at(120)), []);
        assert_eq!(ledger.lost(at(121)), [("a".to_owned(), camera)]);
        assert_eq!(ledger.lost(at(200)), []);
    }
}
