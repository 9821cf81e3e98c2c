//! Completes headers as soon as the telemetry around their exposures has arrived, without being asked.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use anyhow::{Context as _, bail};
use bus::{MachineTime, Publisher};
use config::Observatory;
use config::header::{HeaderTable, Source};
use contract::archive::Stored;
use contract::device::camera::Frame;
use contract::device::telescope::EquatorialSystem;
use contract::observatory::{AlertKind, FrameFacts};
use contract::{BootId, CommandId, Device, Kind, Scalar};
use node::Node;
use tokio::sync::Notify;

use crate::card::Card;
use crate::completion::{Completer, CompletionError, read_header};
use crate::database::{Database, DatabaseError, StoredFacts, StoredImage, Write};
use crate::facts;
use crate::folder::{all_here, without_links};
use crate::header::{Later, completion, needed, unknown_before};
use crate::interpolate::{Around, Rest, flag_of};
use crate::pairing::pairing;
use crate::plan::Plan;
use crate::quality::GUIDED;
use crate::reader::Reader;
use crate::sensor::unknown_of_sensor;
use crate::stored_header::Header;
use crate::telemetry::Newest;
use crate::{guided, quality, solution};

/// How often frames that wait for telemetry are looked at again at least, machine time.
const PERIOD: Duration = Duration::from_millis(500);
/// Frames looked at in one go.
const AT_ONCE: u32 = 64;
/// A header waits so long for telemetry, machine time; then it is completed with a note of what is missing.
const TIMEOUT: Duration = Duration::from_secs(10);
/// A poll further away than this is not used, sky s at speed 1; or three periods of a slow device.
const HOLDS_S: f64 = 60.0;
const HOLDS_PERIODS: f64 = 3.0;
/// First and longest wait before a file that failed is tried again.
const FIRST_WAIT: Duration = Duration::from_secs(5);
const LONGEST_WAIT: Duration = Duration::from_secs(600);
const FAILURES_BEFORE_ALERT: u32 = 3;
/// The properties from which the direction of a frame without a target is computed, whether the table lists them or
/// not.
const POINTING: [(Kind, &str); 3] =
    [(Kind::Telescope, "RightAscension"), (Kind::Telescope, "Declination"), (Kind::Telescope, "Altitude")];

/// Everything that is needed to complete headers.
pub struct Pass {
    /// The node.
    pub node: Node,
    /// The database to which rows are written.
    pub database: Database,
    /// The newest states of the devices.
    pub newest: Newest,
    /// Publishes which headers are complete.
    pub stored: Arc<Publisher<Stored>>,
    /// Notified when there is a header to complete.
    pub incomplete: Arc<Notify>,
    /// Headers complete, since the database began.
    pub count: AtomicI64,
}

/// The state of a frame that is not complete.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    since: MachineTime,
    failures: u32,
    not_before: MachineTime,
}

/// The outcome of one look at a frame.
enum Outcome {
    /// With the facts of this sample, where there are any.
    Complete(Option<(BootId, u64)>),
    NotYet,
    Failed(String),
}

/// Everything that is needed to complete a header of a site.
pub struct Site<'a> {
    /// The site's configuration.
    pub config: &'a Observatory,
    /// Its header table.
    pub table: &'a HeaderTable,
    /// The newest states of its devices.
    pub newest: &'a Newest,
    /// Speed of sky time.
    pub speed: f64,
    /// The completer that writes the headers.
    pub completer: &'a Completer,
}

/// Completes the header of one stored image from the polls around its exposure, and from what was measured on it, and
/// returns what was added.
///
/// `None` when polls after the exposure are still to come, unless `impatient` is set. Reads files: not for async
/// threads.
pub fn complete_image(
    site: &Site<'_>,
    reader: &Reader,
    image: &StoredImage,
    facts: Option<&FrameFacts>,
    impatient: bool,
) -> anyhow::Result<Option<Plan>> {
    let (frame, config) = (&image.frame, site.config);
    let camera = config.address().device(Kind::Camera, &frame.camera.parse()?);
    let devices = pairing(config, &camera, frame);
    let _snapshot = reader.snapshot()?;
    let holds_s = site.holds_s();
    let mut polls: HashMap<(Kind, &str), Around> = flags(reader, &devices, frame, holds_s)?;
    let rests: HashMap<Kind, Rest> = polls.iter().map(|((kind, _), around)| (*kind, around.rest)).collect();
    let look = |kind: Kind, device: &Device, property: &str| {
        // A focuser that has moved is as warm as before.
        let rest = rests.get(&kind).filter(|_| property != "Temperature").copied().unwrap_or_default();
        let around = reader.around(device, property, rest.begins(frame.started_utc));
        around.map(|around| Around { rest, ..around })
    };
    let flags = needed(site.table).filter_map(|(kind, _)| Some((kind, flag_of(kind)?)));
    for (kind, property) in needed(site.table).chain(flags) {
        let Some(device) = devices.get(&kind) else { continue };
        let around = match polls.remove(&(kind, property)) {
            Some(around) => around,
            None => look(kind, device, property)?,
        };
        // A property that never had a value is not waited for once its device has published a state.
        let is_void = around.before.is_empty() && site.newest.received_since(device, frame.started_utc);
        if !around.received_since && !is_void && !impatient {
            return Ok(None);
        }
        let received_since = around.received_since || is_void;
        polls.insert((kind, property), Around { received_since, ..around });
    }
    let path = image.path(&config.folders.images);
    let stored = own_header(&config.folders.images, site.completer, image)?;
    let (present, unknown) = (stored.keywords(), unknown_before(site.table, &stored));
    for (kind, property) in missing_fixed(site.table, &present).chain(POINTING) {
        if let (Some(device), false) = (devices.get(&kind), polls.contains_key(&(kind, property))) {
            polls.insert((kind, property), look(kind, device, property)?);
        }
    }
    let around = |kind: Kind, property: &str| {
        devices.get(&kind)?;
        Some(polls.get(&(kind, property)).cloned().unwrap_or_default())
    };
    let mount = devices.get(&Kind::Telescope).map_or(EquatorialSystem::Other, |mount| site.mount_frame(mount));
    let (place, unknown_before) = (&config.place, unknown.as_ref());
    let later = Later { frame, place, mount, holds_s, present: &present, unknown_before, around: &around };
    let mut plan = completion(site.table, &later)?;
    plan.history.extend(unknown_of_sensor(&present));
    if let Some(facts) = facts {
        plan.extend(measured(site.table, facts, frame));
    }
    let mut guided = guided::plan(reader, config.place.telescope.as_str(), frame)?;
    if present.contains(GUIDED) {
        // What was measured then may be forgotten by now.
        guided.history.clear();
    }
    plan.extend(guided);
    site.completer.complete(&path, stored, &plan)?;
    Ok(Some(plan))
}

/// The polls of the flags of all devices that can move, and between which moves the frame was exposed: one look for each.
fn flags(
    reader: &Reader,
    devices: &HashMap<Kind, Device>,
    frame: &Frame,
    holds_s: f64,
) -> Result<HashMap<(Kind, &'static str), Around>, DatabaseError> {
    let start = frame.started_utc;
    let (exposure, mut flags) = ((start, start.plus_seconds(frame.exposure_s)), HashMap::new());
    for (kind, device) in devices {
        if let Some(flag) = flag_of(*kind) {
            let said = reader.polls(device, flag, (start.plus_seconds(-holds_s), start.plus_seconds(holds_s)))?;
            flags.insert((*kind, flag), Around::of_flag(said, exposure, holds_s));
        }
    }
    Ok(flags)
}

/// The header of a frame's file, once what a kill interrupted is finished.
///
/// # Errors
/// There is no such file, or it is none of this frame: somebody has put another one in its place, which keeps its header.
fn own_header(images: &Path, completer: &Completer, image: &StoredImage) -> anyhow::Result<Header> {
    let path = image.path(images);
    without_links(images, &path).context("the file is not where it was written")?;
    completer.recover(&path)?;
    let header = read_header(&path)?;
    if let Some(other) = other_frame(&header, image) {
        let (path, own) = (path.display(), &image.frame.id);
        bail!("{path} is the file of frame {other}; put that of frame {own} back under this name");
    }
    Ok(header)
}

/// The frame that a header names, where it is another one.
fn other_frame(header: &Header, image: &StoredImage) -> Option<String> {
    // As a card has it: cut, and without what FITS cannot carry.
    let own = Card::new("FRAMEID", image.frame.id.0.as_str().into(), "").record()?;
    let is_own = header.cards().any(|card| card.starts_with(own.trim_end()));
    header.value("FRAMEID").filter(|_| !is_own)
}

/// An error in words for a person, with the folder that is away where that is the reason.
fn reason(images: &Path, image: &StoredImage, error: &anyhow::Error) -> String {
    match all_here(images, image.path(images).parent()) {
        Ok(()) => format!("{error:#}"),
        Err(away) => format!("{error:#}: {away:#}"),
    }
}

/// The keywords that the facts of a frame add to its header.
fn measured(table: &HeaderTable, facts: &FrameFacts, frame: &Frame) -> Plan {
    let mut plan = quality::plan(table, facts);
    plan.extend(solution::plan(table, facts, frame));
    plan
}

/// What became of facts that came after their header was complete.
enum Late {
    InHeader,
    /// The file was moved away or is none of ours, for this reason.
    Gone(String),
    Failed(String),
}

/// Puts facts that came late into a header that is complete already. Blocks.
fn put_late(images: &Path, table: &HeaderTable, image: &StoredImage, facts: &FrameFacts) -> Late {
    let (path, completer) = (image.path(images), Completer::new(images));
    let put = || -> anyhow::Result<()> {
        let header = own_header(images, &completer, image)?;
        Ok(completer.complete(&path, header, &measured(table, facts, &image.frame))?)
    };
    match put() {
        Ok(()) => Late::InHeader,
        Err(error) if is_gone(images, image) => Late::Gone(format!("{error:#}")),
        Err(error) => Late::Failed(reason(images, image, &error)),
    }
}

/// Whether there is no file of ours at the path of a frame whose folder is there.
fn is_gone(images: &Path, image: &StoredImage) -> bool {
    let path = image.path(images);
    let is_missing = |error: &CompletionError| match error {
        CompletionError::NoHeader(_) => true,
        CompletionError::File { source, .. } => source.kind() == ErrorKind::NotFound,
    };
    let is_none = || match read_header(&path) {
        Ok(header) => other_frame(&header, image).is_some(),
        Err(error) => is_missing(&error),
    };
    all_here(images, path.parent()).is_ok() && (without_links(images, &path).is_err() || is_none())
}

/// Fixed properties that the devices had not published yet when the file was made.
fn missing_fixed<'a>(table: &'a HeaderTable, present: &BTreeSet<String>) -> impl Iterator<Item = (Kind, &'a str)> {
    let rows = table.rows.iter().filter(|row| row.fixed && !present.contains(&row.keyword));
    rows.filter_map(|row| match &row.source {
        Source::Property(kind, property) => Some((*kind, property.as_str())),
        _ => None,
    })
}

impl Site<'_> {
    /// The frame of a mount's coordinates: as configured, else as the mount reports it.
    fn mount_frame(&self, mount: &Device) -> EquatorialSystem {
        let block = self.config.telescope.iter().find(|telescope| telescope.common.name == mount.name);
        let choice = block.map(|telescope| telescope.equatorial_system).unwrap_or_default();
        choice.of(Some(self.newest.equatorial_system(mount)))
    }

    /// Polls keep machine time, so in a fast simulation they lie further apart on the sky's.
    fn holds_s(&self) -> f64 {
        let slowest = self.config.devices().iter().map(|(_, common)| common.period_s).fold(0.0, f64::max);
        HOLDS_S.max(slowest * HOLDS_PERIODS) * self.speed.max(1.0)
    }
}

/// Completes headers until the node ends.
pub async fn keep(pass: Pass) -> anyhow::Result<()> {
    let pass = Arc::new(pass);
    let mut waiting: HashMap<CommandId, Waiting> = HashMap::new();
    let mut late: HashMap<CommandId, Waiting> = HashMap::new();
    loop {
        pass.amend(&mut late).await?;
        // Frames that fail stay; they must not hide the ones behind them.
        let failing = waiting.values().filter(|waiting| waiting.failures > 0).count();
        let images = pass.look(failing).await?;
        if images.is_empty() {
            waiting.clear();
            if late.is_empty() {
                pass.node.alerts.clear(AlertKind::ArchiveHeaders, "");
                pass.incomplete.notified().await;
            } else {
                let _ = tokio::time::timeout(FIRST_WAIT, pass.incomplete.notified()).await;
            }
            continue;
        }
        let now = pass.node.bus.clock().machine();
        let fresh = Waiting { since: now, failures: 0, not_before: now };
        let due: Vec<(StoredImage, Duration)> = images
            .into_iter()
            .filter_map(|image| {
                let waiting = waiting.entry(image.frame.id.clone()).or_insert(fresh);
                (waiting.not_before <= now).then(|| (image, now.since(waiting.since)))
            })
            .collect();
        let worker = pass.clone();
        let done = tokio::task::spawn_blocking(move || worker.complete_all(due)).await??;
        let completed: Vec<(&StoredImage, &Option<(BootId, u64)>)> = done
            .iter()
            .filter_map(|(image, outcome)| match outcome {
                Outcome::Complete(origin) => Some((image, origin)),
                Outcome::NotYet | Outcome::Failed(_) => None,
            })
            .collect();
        pass.publish(&completed).await?;
        let progress = !completed.is_empty();
        for (image, outcome) in &done {
            match outcome {
                Outcome::Complete(_) => drop(waiting.remove(&image.frame.id)),
                Outcome::NotYet => {}
                Outcome::Failed(error) => {
                    if let Some(waiting) = waiting.get_mut(&image.frame.id) {
                        pass.failed(image, error, waiting);
                    }
                }
            }
        }
        if !progress {
            // A poll after the exposure comes when it comes; a new frame or its facts are looked at as soon as they are
            // received.
            let _ = tokio::time::timeout(PERIOD, pass.incomplete.notified()).await;
        }
    }
}

impl Pass {
    async fn look(&self, failing: usize) -> anyhow::Result<Vec<StoredImage>> {
        let database = self.database.path().to_owned();
        let most = u32::try_from(failing).unwrap_or(u32::MAX).saturating_add(AT_ONCE * 16);
        let telescope = self.node.config.place.telescope.clone();
        let look = move || Reader::open(&database, telescope.as_str())?.incomplete(most);
        Ok(tokio::task::spawn_blocking(look).await??)
    }

    /// Completes those that are ready, at most [`AT_ONCE`]; each comes with how long it has waited.
    fn complete_all(&self, due: Vec<(StoredImage, Duration)>) -> anyhow::Result<Vec<(StoredImage, Outcome)>> {
        let reader = Reader::open(self.database.path(), self.node.config.place.telescope.as_str())?;
        let mut done = Vec::new();
        let mut completed = 0;
        for (image, waited) in due {
            let outcome = match self.complete(&reader, &image, waited) {
                Ok(outcome) => outcome,
                Err(error) => Outcome::Failed(reason(&self.node.config.folders.images, &image, &error)),
            };
            completed += u32::from(matches!(outcome, Outcome::Complete(_)));
            done.push((image, outcome));
            if completed >= AT_ONCE || self.node.stop.is_stopped() {
                break;
            }
        }
        Ok(done)
    }

    fn complete(&self, reader: &Reader, image: &StoredImage, waited: Duration) -> anyhow::Result<Outcome> {
        let known = reader.facts(&image.frame.id)?;
        if known.is_none() && waited < facts::TIMEOUT {
            return Ok(Outcome::NotYet);
        }
        let telescope = self.node.config.place.telescope.as_str();
        if guided::is_awaited(reader, telescope, &image.frame, waited)? {
            return Ok(Outcome::NotYet);
        }
        let completer = Completer::new(&self.node.config.folders.images);
        let site = Site {
            config: &self.node.config,
            table: &self.node.header,
            newest: &self.newest,
            speed: self.node.bus.clock().speed(),
            completer: &completer,
        };
        let facts = known.as_ref().map(|known| &known.facts);
        let Some(plan) = complete_image(&site, reader, image, facts, waited >= TIMEOUT)? else {
            return Ok(Outcome::NotYet);
        };
        for line in &plan.history {
            tracing::info!(file = image.file, "{line}");
        }
        Ok(Outcome::Complete(known.map(|known| known.origin)))
    }

    /// Puts facts that came late into headers that are complete already; those that failed wait in `late`.
    async fn amend(&self, late: &mut HashMap<CommandId, Waiting>) -> anyhow::Result<()> {
        let (database, node) = (self.database.path().to_owned(), self.node.clone());
        let now = self.node.bus.clock().machine();
        let not_due: HashSet<CommandId> =
            late.iter().filter(|(_, waiting)| waiting.not_before > now).map(|(frame, _)| frame.clone()).collect();
        // Those that fail must not hide the ones behind them.
        let most = u32::try_from(late.len()).unwrap_or(u32::MAX).saturating_add(AT_ONCE);
        let work = move || -> anyhow::Result<Vec<(StoredImage, StoredFacts, Option<Late>)>> {
            let found = Reader::open(&database, node.config.place.telescope.as_str())?.late_facts(most)?;
            let put = |(image, known): (StoredImage, StoredFacts)| {
                let is_due = !not_due.contains(&image.frame.id);
                let put = is_due.then(|| put_late(&node.config.folders.images, &node.header, &image, &known.facts));
                (image, known, put)
            };
            Ok(found.into_iter().map(put).collect())
        };
        let looked = tokio::task::spawn_blocking(work).await??;
        let listed: HashSet<CommandId> = looked.iter().map(|(image, ..)| image.frame.id.clone()).collect();
        late.retain(|frame, _| listed.contains(frame));
        let mut writes = Vec::new();
        for (image, StoredFacts { origin, .. }, put) in looked {
            let frame = image.frame.id.clone();
            let in_header = match put {
                None => continue,
                Some(Late::InHeader) => true,
                Some(Late::Gone(error)) => {
                    // The facts are in the database.
                    tracing::warn!(file = image.file, error, "late facts are in no header: its file is not there");
                    false
                }
                Some(Late::Failed(error)) => {
                    let fresh = Waiting { since: now, failures: 0, not_before: now };
                    self.failed(&image, &error, late.entry(frame).or_insert(fresh));
                    continue;
                }
            };
            late.remove(&frame);
            writes.push(Write::FactsTaken { frame, origin, in_header });
        }
        Ok(self.database.commit(writes).await?)
    }

    async fn publish(&self, completed: &[(&StoredImage, &Option<(BootId, u64)>)]) -> anyhow::Result<()> {
        if completed.is_empty() {
            return Ok(());
        }
        let writes = completed.iter().flat_map(|(image, origin)| {
            let frame = image.frame.id.clone();
            let taken =
                (*origin).clone().map(|origin| Write::FactsTaken { frame: frame.clone(), origin, in_header: true });
            std::iter::once(Write::Complete(frame)).chain(taken)
        });
        self.database.commit(writes.collect()).await?;
        let count = self.count.fetch_add(completed.len() as i64, Ordering::Relaxed) + completed.len() as i64;
        self.node.figure("headers_complete", Scalar::Int(count));
        for (image, _) in completed {
            let stored = Stored {
                frame: image.frame.id.clone(),
                camera: image.frame.camera.clone(),
                file: image.file.clone(),
                bytes: image.bytes,
                header_complete: true,
            };
            self.stored.put(stored).await?;
        }
        Ok(())
    }

    fn failed(&self, image: &StoredImage, error: &str, waiting: &mut Waiting) {
        waiting.failures += 1;
        let pause = FIRST_WAIT.saturating_mul(1 << waiting.failures.min(10)).min(LONGEST_WAIT);
        waiting.not_before = self.node.bus.clock().machine().plus(pause);
        tracing::warn!(file = image.file, error, "a header could not be completed; it will be tried again");
        if waiting.failures >= FAILURES_BEFORE_ALERT {
            let cause = format!("the header of {} cannot be completed: {error}", image.file);
            self.node.alerts.raise(AlertKind::ArchiveHeaders, "", &cause);
        }
    }
}

#[cfg(test)]
#[path = "pass_tests.rs"]
mod tests;
