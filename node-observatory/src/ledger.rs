//! The frames that were exposed and announced, and those that an archive has stored with a complete header.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use bus::{Catch, MachineTime};
use contract::archive::Stored;
use contract::device::camera::Frame;
use contract::observatory::AlertKind;
use contract::{CommandId, Key, Name, Topic};
use node::Node;
use tokio::sync::watch;

use crate::journal::Journal;
use crate::night::PublishedNight;
use crate::tasks::Tasks;

/// What is known of the frames.
#[derive(Debug, Clone, Default)]
pub struct Frames {
    /// Frames that were exposed and not announced yet.
    expected: BTreeMap<String, Expected>,
    /// Announced frames with the night they belong to.
    announced: BTreeMap<String, String>,
    /// Frames whose file has all keywords.
    complete: BTreeSet<String>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Expected {
    night: String,
    camera: Name,
    since: MachineTime,
}

impl Frames {
    /// Has its camera's node announced that it is on disk?
    pub fn is_announced(&self, frame: &CommandId) -> bool {
        self.announced.contains_key(&frame.0)
    }

    /// How many frames of a night have complete headers, and how many frames it has.
    pub fn complete(&self, night: &str) -> (usize, usize) {
        let announced = self.announced.iter().filter(|(_, of)| *of == night).map(|(frame, _)| frame);
        let announced: Vec<&String> = announced.collect();
        let expected = self.expected.values().filter(|expected| expected.night == night).count();
        let complete = announced.iter().filter(|frame| self.complete.contains(**frame)).count();
        (complete, announced.len() + expected)
    }
}

/// Exposed, announced and stored frames, as a value that can be followed.
#[derive(Debug)]
pub struct Ledger {
    frames: watch::Sender<Frames>,
}

/// A frame that was exposed is announced within this time, or something has swallowed it.
const ANNOUNCED_WITHIN: Duration = Duration::from_secs(120);

impl Default for Ledger {
    fn default() -> Self {
        Self { frames: watch::channel(Frames::default()).0 }
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

    /// A frame of this night was exposed and will be announced.
    pub fn expect(&self, frame: &CommandId, night: &str, camera: &Name, now: MachineTime) {
        self.frames.send_if_modified(|frames| {
            let is_awaited = !frames.announced.contains_key(&frame.0);
            if is_awaited {
                let expected = Expected { night: night.to_owned(), camera: camera.clone(), since: now };
                frames.expected.insert(frame.0.clone(), expected);
            }
            is_awaited
        });
    }

    /// Frames that were not announced in time, each reported once; nothing waits for them any more.
    fn lost(&self, now: MachineTime) -> Vec<(String, Name)> {
        let mut lost = Vec::new();
        self.frames.send_if_modified(|frames| {
            let late = frames.expected.extract_if(.., |_, expected| now.since(expected.since) > ANNOUNCED_WITHIN);
            lost.extend(late.map(|(id, expected)| (id, expected.camera)));
            !lost.is_empty()
        });
        lost
    }

    /// Notes an announced frame; true the first time, since a spool repeats what nobody has taken yet.
    fn announced(&self, frame: &CommandId, night: &str) -> bool {
        self.frames.send_if_modified(|frames| {
            frames.expected.remove(&frame.0);
            frames.announced.insert(frame.0.clone(), night.to_owned()).is_none()
        })
    }
}

/// Starts the tasks that count frames.
pub fn start(
    tasks: &mut Tasks,
    node: &Node,
    ledger: &Arc<Ledger>,
    journal: &Arc<Journal>,
    night: &Arc<PublishedNight>,
) {
    let counting = keep_counting_frames(node.clone(), ledger.clone(), journal.clone(), night.clone());
    tasks.spawn("frames", counting);
    tasks.spawn("files", keep_counting_files(node.clone(), ledger.clone(), journal.clone()));
}

/// Receives announced frames: counts those of this incarnation, and reports to the journal those that a crash left
/// open.
async fn keep_counting_frames(
    node: Node,
    ledger: Arc<Ledger>,
    journal: Arc<Journal>,
    night: Arc<PublishedNight>,
) -> anyhow::Result<()> {
    let (own, started_utc) = (node.config.address(), node.bus.clock().utc());
    let frames = node.bus.subscribe::<Frame>(Topic::Frame.at(&own), Catch::All, 1000).await?;
    let clock = node.bus.clock().clone();
    loop {
        let received = tokio::time::timeout(Duration::from_secs(10), frames.recv()).await;
        for (frame, camera) in ledger.lost(clock.machine()) {
            let cause = format!("frame {frame} of {camera} was exposed and never announced");
            node.alerts.raise(AlertKind::FrameLost, camera, &cause);
        }
        let Ok(received) = received else { continue };
        let frame = received.sample.body;
        if let Key::Frame(device) = &received.key {
            node.alerts.clear(AlertKind::FrameLost, &device.name);
        }
        tracing::debug!(frame = %frame.id, camera = frame.camera, "announced");
        let (journal, clock, id) = (journal.clone(), clock.clone(), frame.id.clone());
        let noted = tokio::task::spawn_blocking(move || journal.taken(&id, clock.utc()));
        if let Err(error) = noted.await? {
            tracing::warn!(%error, "an announced frame is not in the journal; a restart may take it again");
        }
        // After the journal: a task that sees it here finds it counted there.
        let is_new = ledger.announced(&frame.id, &frame.purpose.night);
        if is_new && received.sample.at_utc >= started_utc {
            night.frame(&frame.id);
        }
    }
}

/// Receives what the archives have stored.
async fn keep_counting_files(node: Node, ledger: Arc<Ledger>, journal: Arc<Journal>) -> anyhow::Result<()> {
    let key = Key::Stored(node.config.address()).to_string();
    let stored = node.bus.subscribe::<Stored>(&key, Catch::All, 1000).await?;
    loop {
        let stored = stored.recv().await.sample.body;
        if stored.header_complete {
            ledger.complete(&stored.frame);
        }
        // One that was announced, stored and forgotten by its spool while this node was away.
        let (journal, clock, frame) = (journal.clone(), node.bus.clock().clone(), stored.frame);
        let noted = tokio::task::spawn_blocking(move || journal.taken(&frame, clock.utc()));
        if let Err(error) = noted.await? {
            tracing::warn!(%error, "a stored frame is not in the journal");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(name: &str) -> CommandId {
        CommandId(name.to_owned())
    }

    #[test]
    fn only_frames_of_the_night_are_waited_for() {
        let ledger = Ledger::default();
        for (frame, night) in [("a", "20261120"), ("b", "20261121"), ("c", "20261121")] {
            assert!(ledger.announced(&id(frame), night));
        }
        ledger.complete(&id("c"));
        assert_eq!(ledger.watch().borrow().complete("20261121"), (1, 2));
        assert_eq!(ledger.watch().borrow().complete("20261122"), (0, 0));
    }

    #[test]
    fn a_frame_whose_light_is_in_is_waited_for_before_it_is_announced() {
        let (ledger, camera) = (Ledger::default(), "cam".parse().unwrap());
        ledger.expect(&id("a"), "20261121", &camera, MachineTime::from_boot(Duration::ZERO));
        assert_eq!(ledger.watch().borrow().complete("20261121"), (0, 1));
        assert!(ledger.announced(&id("a"), "20261121") && !ledger.announced(&id("a"), "20261121"));
        ledger.complete(&id("a"));
        assert_eq!(ledger.watch().borrow().complete("20261121"), (1, 1));
    }

    #[test]
    fn a_frame_that_is_exposed_and_never_announced_is_reported_once() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let (ledger, camera) = (Ledger::default(), "cam".parse().unwrap());
        ledger.expect(&id("a"), "20261121", &camera, at(0));
        assert_eq!(ledger.lost(at(120)), []);
        assert_eq!(ledger.lost(at(121)), [("a".to_owned(), camera)]);
        assert_eq!(ledger.lost(at(200)), []);
        assert_eq!(ledger.watch().borrow().complete("20261121"), (0, 0));
    }
}
