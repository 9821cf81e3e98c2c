//! One telescope in a few words: safety, posture, mode, activity, alerts, age.
//!
//! The verdict is the observatory node's own and is never recomputed here; a stale one counts as unknown, because a permit
//! would not outlive it either. The posture is then that of the domes by their own device nodes.

use std::time::Duration;

use bus::MachineTime;
use contract::device::camera::Frame;
use contract::node::NodeState;
use contract::observatory::{
    ActionNow, Alert, GuidingState, NightState, OperatorOrders, Posture, Priority, RowStatus, SafetyState,
    ScheduleState, Standing,
};
use contract::{Address, Chunk, Key, NodeTopic, Part, Role};
use overview::{DomeView, Seen};
use schemars::JsonSchema;
use serde::{Deserialize as _, Serialize};
use units::Utc;

use crate::alerts::{Counts, about, active};
use crate::domes;
use crate::freshness::Quality;
use crate::model::{Entry, Model, Telescope, Unreadable};
use crate::place::PlaceOnEarth;
use crate::safety::{self, Safety};
use crate::stopped::{StoppedTelescope, is_over, stopped};

/// A tile of the overview, and the head of the telescope page.
#[derive(Debug, Clone, JsonSchema, Serialize)]
pub struct Summary {
    /// The content of the tile; sent again only when it differs.
    #[serde(flatten)]
    pub face: Face,
    /// How old it is.
    #[serde(flatten)]
    pub ages: Ages,
}

/// The part that changes only when something happens.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize)]
pub struct Face {
    /// `site/telescope`, unique on the network.
    pub id: String,
    /// The site.
    pub site_id: Chunk,
    /// The telescope, unique within its site.
    pub telescope_id: Chunk,
    /// Where it stands; absent until a mount of its site says so, where this server's file is of another site.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<PlaceOnEarth>,
    /// The date under which frames of now are filed, such as `20261121`: from noon to noon of local mean time, by the sky's
    /// clock of this server; absent where the place is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub night: Option<String>,
    /// Not a telescope but the devices that a site's telescopes share.
    pub shared: bool,
    /// Quality of the observatory node's payloads.
    pub quality: Quality,
    /// Its observatory nodes were stopped in good order: that they are silent is no fault.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stopped: Option<StoppedTelescope>,
    /// The safety word.
    pub safety: Safety,
    /// The posture: of the observatory node while it publishes, else by the domes' own device nodes; `unknown` where
    /// neither is known.
    pub posture: Posture,
    /// The source of the posture.
    pub posture_by: Reporter,
    /// Sky time since when the observatory node is silent, where that is known; absent while it publishes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub observatory_silent_since_utc: Option<Utc>,
    /// What it does now, or the present reason why it waits, in words.
    pub now: String,
    /// While the observatory node is silent: how each dome stands, what closes it by itself, and when.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub domes: Vec<String>,
    /// How it is run.
    pub mode: Mode,
    /// The devices are simulated.
    pub simulated: bool,
    /// Speed of sky time.
    pub speed: f64,
    /// The night's schedule is done.
    pub ended: bool,
    /// The actions under way; empty when stale.
    pub activity: Vec<ActionNow>,
    /// Frames announced since the observatory node started.
    pub frames: u64,
    /// How far the schedule is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub schedule: Option<ScheduleSummary>,
    /// Alerts: those that need somebody first, then those that somebody sees to or has shelved, and last those whose cause is
    /// gone; of each the most urgent first.
    pub alerts: Vec<Alert>,
    /// Alerts whose cause is there, by priority.
    pub alert_counts: Counts,
    /// How much the telescope concerns an operator: safety and posture together, and never less than the most urgent alert that
    /// needs somebody; absent when all is well.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub concern: Option<Priority>,
    /// How much safety and posture alone do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub safety_concern: Option<Priority>,
    /// Known devices, and those without link or silent.
    pub device_count: Heads,
    /// Known nodes, and those that fell silent.
    pub node_count: Heads,
    /// Keys whose newest payload cannot be decoded; their values here are older.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub unreadable: Vec<Unreadable>,
    /// The newest image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image: Option<ImageCaption>,
    /// How well it guides and focuses.
    pub figures: Figures,
}

/// What the newest frames say of guiding and focus; absent where it is not known, or not of now.
#[derive(Debug, Clone, Copy, PartialEq, Default, JsonSchema, Serialize)]
pub struct Figures {
    /// Root mean square of the guide loop that runs, arcsec.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guide_rms_arcsec: Option<f64>,
    /// Median FWHM of the stars of the newest measured frame, arcsec.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fwhm_arcsec: Option<f64>,
}

/// Ages on this machine's own clock, s; the reader adds the time since it read them.
#[derive(Debug, Clone, Copy, PartialEq, JsonSchema, Serialize)]
pub struct Ages {
    /// Since the observatory node last published safety or the night; absent when it never did.
    pub age_s: Option<f64>,
    /// Since the shown image's frame was announced.
    pub image_age_s: Option<f64>,
    /// The observatory node's own time of its newest payload.
    pub reported_utc: Option<Utc>,
}

/// The source of the posture of a telescope.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reporter {
    /// Its observatory node.
    Observatory,
    /// The device nodes of its domes; the observatory node is silent.
    Domes,
    /// Nobody.
    Nobody,
}

/// How a telescope is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// It works through its schedule by itself.
    Robotic,
    /// People decide.
    Manual,
    /// There is no fresh state.
    Unknown,
}

/// How far the schedule is.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize)]
pub struct ScheduleSummary {
    /// Rows in all.
    pub rows: usize,
    /// Rows finished.
    pub finished: usize,
    /// Rows failed or skipped.
    pub failed: usize,
    /// Action of the next row that waits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next: Option<String>,
    /// Its earliest start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next_utc: Option<Utc>,
}

/// How many there are, and how many of them are silent or without link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, JsonSchema, Serialize)]
pub struct Heads {
    /// Known since start.
    pub known: usize,
    /// Silent, or without link.
    pub lost: usize,
}

/// The caption under the image.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize)]
pub struct ImageCaption {
    /// Which frame.
    pub frame: String,
    /// Which camera.
    pub camera: String,
    /// The object that it shows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// `Light Frame`, `Dark Frame` …
    pub image_type: String,
    /// Filter in the beam.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Seconds of light.
    pub exposure_s: f64,
    /// Sky time of the shutter's opening.
    pub started_utc: Utc,
    /// Columns and rows of the frame.
    pub size_px: [u32; 2],
    /// Why a newer frame could not be shown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
}

/// One node, for `/api/v1/network`.
#[derive(Debug, Clone, JsonSchema, Serialize)]
pub struct NodeSummary {
    /// Its name.
    pub id: String,
    /// The state that it publishes.
    #[serde(flatten)]
    pub state: NodeState,
    /// Since its last sample, s.
    pub age_s: f64,
    /// The quality of that state.
    pub quality: Quality,
}

/// The measures of a frame say something of now for so long.
const FACTS_OF_NOW: Duration = Duration::from_secs(1800);

impl Face {
    /// Of the alerts of what a site shares, those that stand at none of its telescopes here: what is told of a telescope is
    /// not told again.
    pub fn alerts_beside<'a>(&self, faces: impl Iterator<Item = &'a Self> + Clone) -> Vec<Alert> {
        let is_told = |alert: &Alert| {
            let mut telescopes = faces.clone().filter(|face| face.site_id == self.site_id && !face.shared);
            let is_same = |told: &Alert| told.cause == alert.cause && told.raised_utc == alert.raised_utc;
            telescopes.any(|face| face.alerts.iter().any(is_same))
        };
        self.alerts.iter().filter(|alert| !is_told(alert)).cloned().collect()
    }
}

impl Summary {
    /// Sums up what is known now; `utc` is sky time.
    pub fn of(model: &Model, address: &Address, telescope: &Telescope, now: MachineTime, utc: Utc) -> Self {
        let shared = address.telescope.as_str() == Address::SHARED;
        let part = |part| Key::Observatory(address.clone(), part);
        let night = telescope.read::<NightState>(&part(Part::Night));
        let safety = telescope.read::<SafetyState>(&part(Part::Safety));
        let spoke: Vec<&Entry> =
            night.as_ref().map(|(e, _)| *e).into_iter().chain(safety.as_ref().map(|(e, _)| *e)).collect();
        let newest = spoke.iter().max_by_key(|entry| entry.arrived);
        let quality = newest.map_or(Quality::Never, |entry| entry.quality(now));
        let speed = night.as_ref().map_or(1.0, |(_, night)| night.speed);

        let fresh_night = night.as_ref().filter(|(entry, _)| entry.quality(now) == Quality::Fresh).map(|(_, n)| n);
        let site = model.telescopes.get(&address.shared()).filter(|_| !shared);
        // An observatory node that publishes speaks for its domes; those of the site are asked for the alerts about them.
        let silent = Some(telescope).filter(|_| !shared && fresh_night.is_none());
        let domes = domes::over(address, silent.into_iter().chain(site), now);
        let of_domes = Posture::least_closed(domes.iter().map(DomeView::posture));
        let (posture, posture_by) = match (fresh_night, of_domes) {
            (Some(night), _) => (night.posture, Reporter::Observatory),
            (None, Some(posture)) => (posture, Reporter::Domes),
            (None, None) => (Posture::Unknown, Reporter::Nobody),
        };
        let is_silent = quality != Quality::Fresh && !shared;
        let renewed = domes.iter().filter_map(|dome| dome.renewed(address)).max();
        let silent_since = newest.map(|entry| entry.at_utc).or(renewed).filter(|_| is_silent);
        let words = safety::words(safety.as_ref(), silent_since, now);
        let held_s = safety.as_ref().map_or(f64::INFINITY, |(entry, state)| {
            entry.at_utc.seconds_since(state.since_utc) / speed + entry.age(now).as_secs_f64()
        });
        let names = domes.iter().filter(|view| view.dome.address != *address).map(|view| &view.dome.name);
        let stopped = StoppedTelescope::of(telescope);
        let is_stopped_closed = stopped.as_ref().is_some_and(StoppedTelescope::is_closed);
        let nodes = nodes(telescope, now);
        let of_shared = site.map(|site| about(site, names, now)).unwrap_or_default();
        let was_ended = is_over(telescope);
        let alerts = active(telescope, of_shared, now);
        let fresh_safety = safety.as_ref().filter(|(entry, _)| entry.quality(now) == Quality::Fresh).map(|(_, s)| s);
        let schedule = telescope.read::<ScheduleState>(&part(Part::Schedule)).map(|(_, schedule)| schedule);
        let orders = telescope.read::<OperatorOrders>(&part(Part::OperatorOrders)).map(|(_, orders)| orders);
        let seen = Seen {
            address,
            now: newest.map(|entry| entry.at_utc),
            night: fresh_night,
            safety: fresh_safety,
            schedule: schedule.as_ref(),
            orders: orders.as_ref(),
            alerts: &alerts,
            silent_since,
        };
        let safety_concern = match quality {
            _ if shared || is_stopped_closed => None,
            Quality::Never if posture_by == Reporter::Nobody => None,
            _ => safety::concern(words.state, posture, held_s),
        };
        let needs_somebody = alerts.iter().filter(|alert| alert.standing() == Standing::Active);
        let image = telescope.image.as_ref();
        let place = model.place(address).map(|(place, _)| place);
        let face = Face {
            id: address.to_string(),
            site_id: address.site.clone(),
            telescope_id: address.telescope.clone(),
            place: place.as_ref().map(PlaceOnEarth::from),
            night: place.map(|place| sky::night_date(place.longitude_east(), utc).to_string()),
            shared,
            quality,
            // The most urgent priority is the least.
            concern: needs_somebody.map(|alert| alert.priority).chain(safety_concern).min(),
            safety_concern,
            safety: words,
            posture,
            posture_by,
            observatory_silent_since_utc: silent_since,
            now: match &stopped {
                _ if shared => String::new(),
                Some(stopped) => stopped.text.clone(),
                None => seen.now(),
            },
            domes: match fresh_night {
                None if !was_ended => domes.iter().map(DomeView::words).collect(),
                _ => Vec::new(),
            },
            mode: match fresh_night.map(|night| night.robotic) {
                Some(true) => Mode::Robotic,
                Some(false) => Mode::Manual,
                None => Mode::Unknown,
            },
            simulated: night.as_ref().is_some_and(|(_, night)| night.simulated),
            speed,
            ended: fresh_night.is_some_and(|night| night.ended),
            activity: fresh_night.map(|night| night.actions.clone()).unwrap_or_default(),
            frames: night.as_ref().map_or(0, |(_, night)| night.frames),
            schedule: schedule.as_ref().map(summed),
            alert_counts: Counts::of(&alerts),
            alerts,
            device_count: devices(telescope, now),
            node_count: heads(nodes.iter().map(|node| node.quality >= Quality::Lost && !node.state.ended_well())),
            unreadable: telescope.unreadable(now),
            image: image.and_then(|image| {
                let frame = Frame::deserialize(image.frame.as_ref()).ok()?;
                Some(ImageCaption {
                    frame: frame.id.to_string(),
                    camera: frame.camera,
                    object: frame.purpose.object,
                    image_type: frame.purpose.image_type,
                    filter: frame.purpose.filter,
                    exposure_s: frame.exposure_s,
                    started_utc: frame.started_utc,
                    size_px: [frame.width_px, frame.height_px],
                    problem: image.problem.clone(),
                })
            }),
            stopped,
            figures: fresh_night.map(|_| figures(address, telescope, now)).unwrap_or_default(),
        };
        let ages = Ages {
            age_s: newest.map(|entry| entry.age(now).as_secs_f64()),
            image_age_s: image.map(|image| now.since(image.arrived).as_secs_f64()),
            reported_utc: newest.map(|entry| entry.at_utc),
        };
        Self { face, ages }
    }
}

/// The nodes of a telescope by role and id.
pub fn nodes(telescope: &Telescope, now: MachineTime) -> Vec<NodeSummary> {
    let of = |entry: &Entry| match &entry.key {
        Key::Node(_, _, id, NodeTopic::State) => Some(NodeSummary {
            id: id.to_string(),
            state: NodeState::deserialize(entry.body.as_ref()).ok()?,
            age_s: entry.age(now).as_secs_f64(),
            quality: entry.quality(now),
        }),
        _ => None,
    };
    telescope.states.values().filter_map(of).collect()
}

/// Pixels become arcsec by the scale of the newest solved frame of the same camera.
fn figures(address: &Address, telescope: &Telescope, now: MachineTime) -> Figures {
    let Some((_, facts)) = telescope.facts(address).filter(|(entry, _)| entry.age(now) < FACTS_OF_NOW) else {
        return Figures::default();
    };
    let arcsec = |px: Option<f64>| Some(px? * facts.scale_arcsec_px?).filter(|arcsec| arcsec.is_finite());
    let guiding = telescope.read::<GuidingState>(&Key::Observatory(address.clone(), Part::Guiding));
    let rms_px = guiding.and_then(|(entry, guiding)| {
        let is_of_now = guiding.active && entry.quality(now) == Quality::Fresh && guiding.camera == facts.camera;
        guiding.rms_px.filter(|_| is_of_now)
    });
    Figures { guide_rms_arcsec: arcsec(rms_px), fwhm_arcsec: arcsec(facts.fwhm_px) }
}

fn devices(telescope: &Telescope, now: MachineTime) -> Heads {
    let mut nodes = telescope.states.values().filter_map(|entry| match &entry.key {
        Key::Node(_, Role::Device, _, NodeTopic::State) => Some(stopped(entry)),
        _ => None,
    });
    // Devices whose nodes were stopped are silent, and that is no fault.
    let first = nodes.next();
    if first.is_some_and(|first| first.is_some()) && nodes.all(|stopped| stopped.is_some()) {
        return heads(telescope.states.values().filter(|entry| matches!(entry.key, Key::State(_))).map(|_| false));
    }
    let states = telescope.states.values().filter(|entry| matches!(entry.key, Key::State(_)));
    heads(states.map(|entry| entry.quality(now) >= Quality::Lost || entry.body["link"]["is"] == "lost"))
}

fn heads(lost: impl Iterator<Item = bool>) -> Heads {
    lost.fold(Heads::default(), |heads, lost| Heads { known: heads.known + 1, lost: heads.lost + usize::from(lost) })
}

fn summed(schedule: &ScheduleState) -> ScheduleSummary {
    let of = |wanted: &[RowStatus]| schedule.rows.iter().filter(|row| wanted.contains(&row.status)).count();
    let next = schedule.rows.iter().find(|row| row.status == RowStatus::Pending);
    ScheduleSummary {
        rows: schedule.rows.len(),
        finished: of(&[RowStatus::Finished]),
        failed: of(&[RowStatus::Failed, RowStatus::Skipped]),
        next: next.map(|row| match &row.object {
            Some(object) => format!("{} {object}", row.action),
            None => row.action.clone(),
        }),
        next_utc: next.map(|row| row.start_utc),
    }
}

#[cfg(test)]
#[path = "summary_tests.rs"]
mod tests;
