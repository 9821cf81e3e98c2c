//! Samples that are followed by their numbers across restarts of the archive, and the alert about those that are lost.

use std::time::Duration;

use bus::{Gap, MachineTime, Received, Subscriber};
use contract::Payload;
use contract::observatory::AlertKind;
use node::Node;

use crate::database::{Database, Write};
use crate::reader::Reader;

/// Lost samples are looked for so often.
pub(crate) const LOOK: Duration = Duration::from_secs(5);
/// The alert about them stays active so long.
const ACTIVE: Duration = Duration::from_secs(600);

/// All samples of some keys: those since the last one that is stored, and all that follow.
pub(crate) struct Stream<T>(Subscriber<T>);

impl<T: Payload> Stream<T> {
    pub async fn open(node: &Node, database: &Database, keys: String, capacity: usize) -> anyhow::Result<Self> {
        let (path, telescope) = (database.path().to_owned(), node.config.place.telescope.clone());
        let read = move || Reader::open(&path, telescope.as_str())?.streams();
        let known = tokio::task::spawn_blocking(read).await??;
        Ok(Self(node.bus.subscribe_after(keys, known, capacity).await?))
    }
}

impl<T> Stream<T> {
    /// Samples that gave way to newer ones, and are asked for again.
    pub fn lost(&self) -> u64 {
        self.0.lost()
    }

    /// Samples that are missing, or lost.
    pub fn missing(&self) -> u64 {
        self.0.missing()
    }
}

/// The next sample of any of these.
pub(crate) async fn first<T: Payload>(streams: &[Stream<T>]) -> Received<T> {
    let waits = streams.iter().map(|stream| Box::pin(stream.0.recv()));
    futures_util::future::select_all(waits).await.0
}

/// What is written after the rows of a sample.
pub(crate) fn received<T>(received: &Received<T>) -> Write {
    let sample = &received.sample;
    Write::Received { key: received.key.clone(), origin: (sample.boot_id.clone(), sample.seq), at: sample.at_utc }
}

/// Reports what is lost.
pub(crate) struct Lost<'a> {
    node: &'a Node,
    /// What is lost, and the word for it in the alert's id.
    what: (&'static str, &'static str),
    /// Since when the alert is active, and how many samples it reports.
    active: Option<(MachineTime, u64)>,
}

impl<'a> Lost<'a> {
    pub fn new(node: &'a Node, what: (&'static str, &'static str)) -> Self {
        Self { node, what, active: None }
    }

    /// Writes new gaps into the database and raises the alert, or clears it after its time.
    pub async fn look<T>(&mut self, database: &Database, streams: &[Stream<T>]) -> anyhow::Result<()> {
        let now = self.node.bus.clock().machine();
        let gaps: Vec<Gap> = streams.iter().flat_map(|stream| stream.0.given_up()).collect();
        let Some(newest) = gaps.last().cloned() else {
            if self.active.is_some_and(|(since, _)| now.since(since) > ACTIVE) {
                self.active = None;
                self.node.alerts.clear(AlertKind::ArchiveLost, self.what.1);
            }
            return Ok(());
        };
        let count = gaps.iter().map(|gap| gap.last - gap.first + 1).fold(0, u64::saturating_add);
        let count = count.saturating_add(self.active.map_or(0, |(_, count)| count));
        for gap in gaps {
            database.put(Write::Lost(gap)).await?;
        }
        let ((what, word), key) = (self.what, newest.key.path());
        let cause = format!("{count} {what} were not received and are lost, the last of them on {key}");
        self.node.alerts.raise(AlertKind::ArchiveLost, word, &cause);
        self.active = Some((now, count));
        Ok(())
    }
}
