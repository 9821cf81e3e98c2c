//! Measures and solves every frame of this telescope as soon as it is announced, and publishes the facts.
//!
//! The frame is fetched from its device node's spool, whether there is an archive or not. It is measured on a thread
//! that yields to all others: neither the safety loop nor the next exposure waits for it. The task works on one frame
//! per camera at a time, the newest first ([`waiting`]); a frame that cannot be had or measured gets facts with a
//! reason. Only the commander measures; a standby remembers which frames have no facts yet. [`triggers`] hold what
//! several frames show together; the night's state and alerts contain them, and a row may have its focus found anew for
//! one (`focus/between.rs`). Code that acts on single frames gets pixels, stars and solution from [`looked`].
//!
//! A row that asks for it has a dark taken off its frames first ([`dark`]).
//!
//! A frame with stars is solved ([`solving`]) from where it was pointed ([`aim`]) with what earlier frames taught of
//! the optics ([`optics`]); its catalogue stars give the zero point ([`zero_point`]).

pub mod aim;
pub mod dark;
mod look;
pub mod looked;
pub mod measure;
pub mod mounts;
pub mod optics;
pub mod publish;
pub mod solving;
pub mod triggers;
pub mod waiting;
pub mod widths;
pub mod zero_point;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use std::time::Duration;

use bus::Catch;
use contract::device::camera::Frame;
use contract::observatory::{AlertKind, FrameFacts, OpticsState, Trigger, TriggerKind};
use contract::{Scalar, Topic};
use node::Node;
use tokio::sync::{Semaphore, oneshot, watch};
use tokio::task::JoinSet;

use self::dark::Darks;
use self::look::{EarlierFrames, look};
use self::looked::{Looked, Looks};
use self::measure::unmeasured;
use self::mounts::Mounts;
use self::optics::{Lesson, Rivals};
use self::publish::FactsPublisher;
use self::triggers::Triggers;
use self::waiting::{Announced, Waiting};
use self::widths::Widths;
use crate::authority::Authority;
use crate::devices::Devices;
use crate::night::PublishedNight;
use crate::replicated::Replicated;
use crate::star_catalogue::{self, StarCatalogue};
use crate::tasks::Tasks;

/// Cameras whose frames are fetched at the same time, at most; pixels are in memory for so many frames.
const CAMERAS: usize = 4;
/// Frames that are measured at the same time: one takes all cores and several times its own memory.
const MEASURED_AT_ONCE: usize = 1;
/// The pixels are here within this time, or the newer frames get their turn, machine time.
const FETCH_DEADLINE: Duration = Duration::from_secs(30);
/// Announcements and facts of others that wait to be looked at.
const QUEUED: usize = 1000;
/// After so many frames of a camera in a row without facts, an alert informs a person.
const FAILURES_BEFORE_ALERT: u32 = 3;
/// If the search for a frame's place takes so long after its stars were measured, the facts are published twice, first
/// without the place: facts are there within a second of the pixels. Machine time.
const SOON: Duration = Duration::from_millis(300);
/// Triggers grow old at this pace, machine time.
const PERIOD: Duration = Duration::from_secs(5);

/// What frames have shown, and what their measuring goes by.
pub struct FrameData {
    /// The facts of frames as published.
    pub facts: FactsPublisher,
    /// What the newest frames showed, for the tasks that act on it.
    pub looks: Looks,
    /// The darks that are taken off frames before they are measured.
    pub darks: Darks,
    /// The star catalogue, once it is open.
    pub catalogue: Arc<StarCatalogue>,
    /// Where the mounts pointed lately.
    pub mounts: Mounts,
    /// What solved frames taught.
    pub optics: Replicated<OpticsState>,
}

impl FrameData {
    /// Reads what was learned before.
    pub async fn load(node: &Node) -> anyhow::Result<Self> {
        let optics = Replicated::load(node).await?;
        Ok(Self {
            facts: FactsPublisher::default(),
            looks: Looks::default(),
            darks: Darks::default(),
            catalogue: Arc::default(),
            mounts: Mounts::default(),
            optics,
        })
    }
}

/// What the measuring of frames works with.
pub struct Measuring {
    /// Whether this node may act.
    pub authority: Arc<Authority>,
    /// The devices.
    pub devices: Arc<Devices>,
    /// The published night, which shows what frames call for.
    pub night: Arc<PublishedNight>,
    /// What frames have shown.
    pub frames: Arc<FrameData>,
}

/// Starts the tasks about frames.
pub fn start(tasks: &mut Tasks, measuring: Measuring) {
    let (authority, devices, frames) =
        (measuring.authority.clone(), measuring.devices.clone(), measuring.frames.clone());
    frames.optics.start(tasks, &authority, watch::channel(OpticsState::default()).0);
    tasks.spawn("star catalogue", star_catalogue::keep_open(authority.node.clone(), frames.catalogue.clone()));
    tasks.spawn("mounts", mounts::keep_noting(devices, frames.clone()));
    tasks.spawn("measuring", keep_measuring(Arc::new(measuring)));
}

/// Measures the telescope's frames until the node ends.
async fn keep_measuring(measuring: Arc<Measuring>) -> anyhow::Result<()> {
    let (own, bus) = (measuring.authority.node.config.address(), &measuring.authority.node.bus);
    let started_utc = bus.clock().utc();
    let frames = bus.subscribe::<Frame>(Topic::Frame.at(&own), Catch::All, QUEUED).await?;
    let facts = bus.subscribe::<FrameFacts>(Topic::Facts.at(&own), Catch::Newest, QUEUED).await?;
    let mut frame_loop = FrameLoop::new(measuring.clone())?;
    let mut hold = measuring.authority.hold.clone();
    let mut work: JoinSet<Done> = JoinSet::new();
    loop {
        if frame_loop.commands() {
            while work.len() < CAMERAS
                && let Some(next) = frame_loop.waiting.next(&frame_loop.busy)
            {
                work.spawn(frame_loop.begin(next));
            }
        }
        tokio::select! {
            received = frames.recv() => {
                let is_old = received.sample.at_utc < started_utc;
                frame_loop.announced(Announced { frame: received.sample.body, is_old }).await?;
            }
            received = facts.recv() => {
                // Another commander's, while this node stood by.
                if received.sample.boot_id != *bus.boot_id() {
                    frame_loop.waiting.settle(&received.sample.body.frame);
                }
            }
            Some(done) = work.join_next() => frame_loop.finish(done?).await?,
            changed = hold.changed() => changed?,
            () = tokio::time::sleep(PERIOD) => {}
        }
        frame_loop.show();
    }
}

/// A frame whose turn is over.
struct Done {
    is_old: bool,
    looked: Looked,
    lesson: Option<Lesson>,
}

/// What the loop works with.
struct FrameLoop {
    measuring: Arc<Measuring>,
    client: reqwest::Client,
    turns: Arc<Semaphore>,
    waiting: Waiting,
    /// Cameras whose frame is worked on.
    busy: BTreeSet<String>,
    /// By camera and binning.
    before: HashMap<(String, u32), EarlierFrames>,
    /// The same: the widths of the stars.
    widths: HashMap<(String, u32), Widths>,
    triggers: Triggers,
    /// Solutions that disagree with the optics that are known.
    rivals: Rivals,
    /// Frames in a row without facts, by camera.
    failures: HashMap<String, u32>,
    raised: BTreeSet<(TriggerKind, String)>,
    measured: i64,
}

impl FrameLoop {
    fn new(measuring: Arc<Measuring>) -> anyhow::Result<Self> {
        Ok(Self {
            client: local_http::client_builder().connect_timeout(Duration::from_secs(5)).build()?,
            turns: Arc::new(Semaphore::new(MEASURED_AT_ONCE)),
            measuring,
            waiting: Waiting::default(),
            busy: BTreeSet::new(),
            before: HashMap::new(),
            widths: HashMap::new(),
            triggers: Triggers::default(),
            rivals: Rivals::default(),
            failures: HashMap::new(),
            raised: BTreeSet::new(),
            measured: 0,
        })
    }

    fn commands(&self) -> bool {
        self.measuring.authority.hold.borrow().token().is_some()
    }

    /// A frame is there. One that finds no room any more is published as unmeasured.
    async fn announced(&mut self, announced: Announced) -> anyhow::Result<()> {
        let Some(Announced { frame, is_old }) = self.waiting.push(announced) else { return Ok(()) };
        self.waiting.settle(&frame.id);
        if self.commands() && !is_old {
            let reason = Some(format!("not measured: {} newer frames waited", waiting::MOST));
            self.publish(FrameFacts { reason, ..unmeasured(&frame) }).await?;
        }
        Ok(())
    }

    async fn publish(&self, facts: FrameFacts) -> anyhow::Result<()> {
        self.measuring.frames.facts.publish(&self.measuring.authority.node, facts).await
    }

    /// The work on one frame.
    fn begin(&mut self, announced: Announced) -> impl Future<Output = Done> + Send + use<> {
        let frame = &announced.frame;
        self.busy.insert(frame.camera.clone());
        let before = self.before.get(&(frame.camera.clone(), frame.bin)).copied().unwrap_or_default();
        let (client, turns, measuring) = (self.client.clone(), self.turns.clone(), self.measuring.clone());
        async move {
            let Announced { frame, is_old } = announced;
            let pixels = match tokio::time::timeout(FETCH_DEADLINE, download::fetch(&client, &frame)).await {
                Ok(Ok(pixels)) => Ok(pixels),
                Ok(Err(error)) => Err(format!("not fetched: {error}")),
                Err(_) => Err(format!("not fetched: not within {FETCH_DEADLINE:?}")),
            };
            let looked = match pixels {
                Ok(pixels) => {
                    let of = frame.clone();
                    // It is never closed, and without a turn the frame is measured all the same.
                    let turn = turns.acquire_owned().await;
                    let ((sender, measured), here) = (oneshot::channel(), measuring.clone());
                    let looking = stepped_back(move || {
                        look(&here, of, pixels, before, move |facts| {
                            // One core is enough for what follows.
                            drop(turn);
                            if let Some(facts) = facts {
                                // The receiver may be gone.
                                let _ = sender.send(facts);
                            }
                        })
                    });
                    published_early(measured, looking, |facts| publish_early(measuring, facts)).await
                }
                Err(reason) => Err(reason),
            };
            let (looked, lesson) = looked.unwrap_or_else(|reason| {
                let facts = FrameFacts { reason: Some(reason), ..unmeasured(&frame) };
                (Looked { facts, frame, measured: None, solved: None }, None)
            });
            Done { is_old, looked, lesson }
        }
    }

    async fn finish(&mut self, done: Done) -> anyhow::Result<()> {
        let Done { is_old, looked, lesson } = done;
        let (frame, facts) = (looked.frame.clone(), looked.facts.clone());
        self.busy.remove(&frame.camera);
        let had_pixels = facts.measuring_s.is_some();
        if had_pixels {
            // Without pixels it is tried again when the spool announces it again.
            self.waiting.settle(&frame.id);
        }
        if !self.commands() || (is_old && !had_pixels) {
            tracing::debug!(frame = %frame.id, reason = facts.reason, "not published: somebody else may have measured it");
            return Ok(());
        }
        if let Some(lesson) = lesson {
            self.measuring.frames.optics.change(|optics| self.rivals.observe(optics, lesson));
        }
        self.measuring.frames.looks.looked(looked);
        self.count(&frame, &facts);
        let of = (frame.camera.clone(), frame.bin);
        let before = self.before.entry(of.clone()).or_default();
        let widths = self.widths.entry(of).or_default();
        widths.observe_facts(&facts);
        before.width = widths.known_px().map(|fwhm_px| fwhm_px as f32);
        match &facts.unsolved {
            None if facts.wcs.is_some() => before.unmatched = 0,
            Some(unsolved) if solving::may_be_scale(unsolved.class) => before.unmatched += 1,
            // Clouds and few stars do not show the scale.
            _ => {}
        }
        self.triggers.observe(&frame, &facts);
        tracing::debug!(frame = %frame.id, stars = facts.stars, fwhm_px = facts.fwhm_px, reason = facts.reason, "measured");
        self.publish(facts).await
    }

    /// Frames that were measured, and cameras whose frames are not.
    fn count(&mut self, frame: &Frame, facts: &FrameFacts) {
        let (alerts, camera) = (&self.measuring.authority.node.alerts, &frame.camera);
        if facts.measuring_s.is_some() {
            self.measured += 1;
            self.measuring.authority.node.figure("frames_measured", Scalar::Int(self.measured));
            if self.failures.remove(camera).is_some() {
                alerts.clear(AlertKind::FramesUnmeasured, camera);
            }
            return;
        }
        let failures = self.failures.entry(camera.clone()).or_default();
        *failures += 1;
        if *failures >= FAILURES_BEFORE_ALERT {
            let why = facts.reason.as_deref().unwrap_or_default();
            let cause = format!("{failures} frames of {camera} in a row were not measured; the last: {why}");
            alerts.raise(AlertKind::FramesUnmeasured, camera, &cause);
        }
    }

    /// Publishes the active triggers, in the night's state and as alerts; a node that does not command has none.
    fn show(&mut self) {
        let active = match self.commands() {
            true => self.triggers.active(self.measuring.authority.node.bus.clock().utc()),
            false => Vec::new(),
        };
        let mut now: BTreeMap<(TriggerKind, String), Vec<&Trigger>> = BTreeMap::new();
        for trigger in &active {
            now.entry((trigger.kind, trigger.camera.clone())).or_default().push(trigger);
        }
        let alerts = &self.measuring.authority.node.alerts;
        for (kind, camera) in self.raised.iter().filter(|raised| !now.contains_key(raised)) {
            alerts.clear(alert(*kind), camera);
        }
        for ((kind, camera), triggers) in now.iter().filter(|(key, _)| !self.raised.contains(key)) {
            let details = triggers.iter().map(|trigger| match &trigger.filter {
                Some(filter) => format!("{camera}, {filter}: {}", trigger.detail),
                None => format!("{camera}: {}", trigger.detail),
            });
            alerts.raise(alert(*kind), camera, &details.collect::<Vec<_>>().join("; "));
        }
        self.raised = now.into_keys().collect();
        self.measuring.night.triggers(active);
    }
}

/// The alert that informs a person of a trigger.
fn alert(kind: TriggerKind) -> AlertKind {
    match kind {
        TriggerKind::FocusDrift => AlertKind::FocusDrift,
        TriggerKind::Clouds => AlertKind::StarsGone,
        TriggerKind::Trailing => AlertKind::StarsTrailed,
        TriggerKind::WrongField => AlertKind::WrongField,
        TriggerKind::TargetSaturated => AlertKind::TargetSaturated,
    }
}

/// Waits for a look at a frame. If it takes long, the measurements are published meanwhile.
async fn published_early<T, F: Future<Output = ()>>(
    measured: oneshot::Receiver<FrameFacts>,
    looking: impl Future<Output = T>,
    publish: impl FnOnce(FrameFacts) -> F,
) -> T {
    tokio::pin!(looking);
    let late = async {
        match measured.await {
            Ok(facts) => {
                tokio::time::sleep(SOON).await;
                facts
            }
            Err(_) => std::future::pending().await,
        }
    };
    let facts = tokio::select! {
        biased;
        looked = &mut looking => return looked,
        facts = late => facts,
    };
    publish(facts).await;
    looking.await
}

async fn publish_early(measuring: Arc<Measuring>, facts: FrameFacts) {
    if measuring.authority.hold.borrow().token().is_none() {
        return;
    }
    let frame = facts.frame.clone();
    if let Err(error) = measuring.frames.facts.publish(&measuring.authority.node, facts).await {
        tracing::warn!(%frame, %error, "the facts of a frame could not be published before its place");
    }
}

/// Runs long work on a thread of its own that steps back behind all others.
pub(crate) async fn stepped_back<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, String> {
    let (sender, receiver) = oneshot::channel();
    let run = move || {
        node::step_back();
        // The receiver may be gone.
        let _ = sender.send(work());
    };
    let thread = std::thread::Builder::new().name("measuring".to_owned()).spawn(run);
    thread.map_err(|error| format!("not measured: no thread: {error}"))?;
    receiver.await.map_err(|_| "not measured: the measuring broke off".to_owned())
}

#[cfg(test)]
pub(crate) mod tests {
    use rand::SeedableRng as _;
    use rand_distr::{Distribution as _, Normal};
    use units::Utc;

    use super::*;

    pub fn frame(id: &str) -> Frame {
        Frame {
            camera: "cam".to_owned(),
            width_px: 2,
            height_px: 1,
            started_utc: Utc::from_seconds(1.8e9),
            exposure_s: 1.0,
            bytes: 4,
            ..test_support::frame(id)
        }
    }

    /// Gaussian stars of this width, in rows of ten, on a sky of 1000 ADU with a noise of 8 ADU.
    pub fn drawn(width: usize, height: usize, fwhm_px: f64, stars: usize) -> Vec<u16> {
        let mut chance = rand::rngs::StdRng::seed_from_u64(4);
        let noise = Normal::new(1000.0, 8.0).unwrap();
        let mut image: Vec<f64> = (0..width * height).map(|_| noise.sample(&mut chance)).collect();
        let rows = stars.div_ceil(10);
        for star in 0..stars {
            let x = (star % 10) as f64 * (width as f64 / 10.0) + 0.5 * width as f64 / 10.0 + 0.13 * star as f64 % 1.0;
            let y = ((star / 10) as f64 + 0.5) * height as f64 / rows as f64 + 0.29 * star as f64 % 1.0;
            let peak = 800.0 + 200.0 * (star % 7) as f64;
            let range = (4.0 * fwhm_px) as usize;
            for row in (y as usize).saturating_sub(range)..(y as usize + range).min(height) {
                for column in (x as usize).saturating_sub(range)..(x as usize + range).min(width) {
                    let r2 = (column as f64 - x).powi(2) + (row as f64 - y).powi(2);
                    image[row * width + column] += peak * (-4.0 * std::f64::consts::LN_2 * r2 / fwhm_px.powi(2)).exp();
                }
            }
        }
        image.into_iter().map(|value| value.round() as u16).collect()
    }

    #[tokio::test]
    async fn what_is_measured_is_published_before_a_place_that_takes_long_and_with_one_that_does_not() {
        fn never(_: FrameFacts) -> std::future::Ready<()> {
            panic!("reported twice")
        }
        let facts = || FrameFacts { stars: Some(7), ..FrameFacts::default() };
        let (measuring, measured) = oneshot::channel();
        measuring.send(facts()).unwrap();
        assert_eq!(published_early(measured, std::future::ready(1), never).await, 1);

        // The place is found only after the measurements are published.
        let (measuring, measured) = oneshot::channel();
        measuring.send(facts()).unwrap();
        let ((sender, place), began) = (oneshot::channel(), std::time::Instant::now());
        let slow = published_early(measured, place, |facts| async move { sender.send(facts.stars).unwrap() });
        assert_eq!(slow.await.unwrap(), Some(7));
        assert!(began.elapsed() >= SOON, "{:?}", began.elapsed());

        // No place is sought: the facts are published once, however long it takes.
        let (measuring, measured) = oneshot::channel();
        drop(measuring);
        let looking = async {
            tokio::time::sleep(2 * SOON).await;
            1
        };
        assert_eq!(published_early(measured, looking, never).await, 1);
    }

    #[tokio::test]
    async fn work_that_breaks_off_is_reported() {
        assert_eq!(stepped_back(|| 7).await, Ok(7));
        let broken: Result<(), String> = stepped_back(|| std::panic::resume_unwind(Box::new(()))).await;
        assert!(broken.unwrap_err().contains("broke off"));
    }
}
