//! All payloads received from all telescopes: the newest payload of each key with its arrival, and the last log lines.
//!
//! Payloads are stored as the JSON in which they came, so that fields of a newer node that our contract does not have
//! still reach the page. Each accepted payload gets the next revision; a client that remembers the revision it has seen
//! needs no queue of its own: it lacks exactly the newer revisions, and a slow client gets each key once.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use bus::{MachineTime, Received};
use contract::node::{DiaryLine, NodeState};
use contract::observatory::{FrameFacts, LAST_WORD};
use contract::{Address, CommandId, Key, Name, NodeTopic, Role, Stamped};
use interlock::Succession;
use schemars::JsonSchema;
use serde::{Deserialize as _, Serialize, Serializer};
use serde_json::Value;
use sky::{EarthOrientation, Place};
use units::Utc;

use crate::diary::{Diary, Line};
use crate::edge::weight;
use crate::freshness::{Quality, period};
use crate::place;
use crate::ring::Ring;

/// A broken or hostile publisher must not fill the memory.
const MOST_KEYS: usize = 2000;
const MOST_TELESCOPES: usize = 200;
/// The memory that payloads may take: those of one telescope, and all.
const MOST_WEIGHT: usize = 32 << 20;
const MOST_WEIGHT_OF_ALL: usize = 256 << 20;
/// An entry that has been silent for so long is removed when there is no room for a new one.
const GIVES_WAY_AFTER: Duration = Duration::from_secs(60);
/// The search for silent entries takes time, and a flood asks for room thousands of times a second.
const LOOK_EVERY: Duration = Duration::from_secs(5);
/// Keys of one telescope whose payloads could not be decoded; they are reported for a minute.
const MOST_UNREADABLE: usize = 20;
const UNREADABLE_FOR: Duration = Duration::from_secs(60);
/// What ended in good order and has been silent for so long was taken away.
const FORGET_AFTER: Duration = Duration::from_secs(24 * 3600);
/// The memory that the succession of an entry takes at most: it remembers eight incarnations with ids of 128 bytes.
/// So many announced frames are remembered per telescope, none of which weighs more than this.
const MOST_FRAMES: usize = 100;
const MOST_WEIGHT_OF_FRAME: usize = 16 << 10;
const WEIGHT_OF_SUCCESSION: usize = 4 << 10;

/// The known state; readers hold it for one expression.
#[derive(Default)]
pub struct Model {
    /// All telescopes, and `shared` of each site.
    pub telescopes: BTreeMap<Address, Telescope>,
    /// Counts what was accepted.
    pub revision: u64,
    own: Option<OwnTelescope>,
    weight: usize,
    /// When all room was found to be in use.
    full: Option<MachineTime>,
}

/// The telescope of this node's own file: there is always room for it, though it may never publish anything.
pub struct OwnTelescope {
    address: Address,
    /// Where the file says that its site is.
    place: Option<(Place, EarthOrientation)>,
}

impl From<&config::Place> for OwnTelescope {
    fn from(of: &config::Place) -> Self {
        let address = Address { site: of.site.clone(), telescope: of.telescope.clone() };
        Self { address, place: of.on_earth().ok() }
    }
}

/// A frame as its device node announced it.
#[derive(Debug, Serialize)]
pub struct AnnouncedFrame {
    /// Key of the announcement, without its root.
    pub key: String,
    /// Sky time of the announcement.
    pub at_utc: Utc,
    /// The announcement, as the AsyncAPI document of the bus describes it.
    #[serde(serialize_with = "shared")]
    pub body: Arc<Value>,
}

fn shared<S: Serializer>(body: &Arc<Value>, serializer: S) -> Result<S::Ok, S::Error> {
    body.as_ref().serialize(serializer)
}

/// The payloads received from one address.
pub struct Telescope {
    /// The newest payload of each key, under the key without its root.
    pub states: BTreeMap<String, Entry>,
    /// The last log lines.
    pub diary: Diary,
    /// The last frames that were announced.
    pub frames: Ring<AnnouncedFrame>,
    /// Number of the newest announced frame that is no longer there.
    pub forgotten_frame: u64,
    /// The newest frame that could be turned into an image, or why it could not.
    pub image: Option<Image>,
    /// Where it stands by its mounts: found when one of them is new, differs or goes, since many look each second.
    place: Option<Place>,
    unreadable: BTreeMap<String, (String, MachineTime)>,
    weight: usize,
    full: Option<MachineTime>,
}

/// A key whose newest payload is not what the contract promises.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize)]
pub struct Unreadable {
    /// The key without its root.
    pub key: String,
    /// The fault.
    pub why: String,
}

/// One payload as it was received.
#[derive(Debug, Clone)]
pub struct Entry {
    /// Its key.
    pub key: Key,
    /// The body of the payload.
    pub body: Arc<Value>,
    /// Sky time of the sender.
    pub at_utc: Utc,
    /// When it arrived here.
    pub arrived: MachineTime,
    /// Revision of the newest arrival.
    pub revision: u64,
    /// Revision at which the body last differed.
    pub changed: u64,
    succession: Succession,
    weight: usize,
}

/// The image that the page shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// The announced frame, without its URL.
    pub frame: Arc<Value>,
    /// Which frame.
    pub id: CommandId,
    /// When the frame was announced here.
    pub arrived: MachineTime,
    /// Why a newer frame has no image; absent when the newest one has.
    pub problem: Option<String>,
}

impl Default for Telescope {
    fn default() -> Self {
        Self {
            states: BTreeMap::new(),
            diary: Diary::default(),
            frames: Ring::of(MOST_FRAMES),
            forgotten_frame: 0,
            image: None,
            place: None,
            unreadable: BTreeMap::new(),
            weight: 0,
            full: None,
        }
    }
}

impl Entry {
    /// Time since it arrived.
    pub fn age(&self, now: MachineTime) -> Duration {
        now.since(self.arrived)
    }

    /// How often it is published again.
    pub fn period(&self) -> Option<Duration> {
        period(&self.key, &self.body)
    }

    /// Was it published by the same incarnation of a node as another one?
    pub fn is_beside(&self, other: &Self) -> bool {
        self.succession.incarnation() == other.succession.incarnation()
    }

    /// Its quality now.
    pub fn quality(&self, now: MachineTime) -> Quality {
        Quality::of(self.age(now), self.period())
    }
}

impl Telescope {
    /// Keys whose payloads were refused within the last minute and have not been readable since.
    pub fn unreadable(&self, now: MachineTime) -> Vec<Unreadable> {
        let recent = self.unreadable.iter().filter(|(_, (_, at))| now.since(*at) < UNREADABLE_FOR);
        recent.map(|(key, (why, _))| Unreadable { key: key.clone(), why: why.clone() }).collect()
    }

    /// The newest payload of a key, read as its type; `None` where it never came or cannot be read.
    pub fn read<T: serde::de::DeserializeOwned>(&self, key: &Key) -> Option<(&Entry, T)> {
        let entry = self.states.get(&short(key))?;
        Some((entry, T::deserialize(entry.body.as_ref()).ok()?))
    }

    /// The facts of the newest measured frame; `None` where none came or they cannot be read.
    pub fn facts(&self, address: &Address) -> Option<(&Entry, FrameFacts)> {
        let entry = self.states.get(&newest_facts(address))?;
        Some((entry, FrameFacts::deserialize(entry.body.as_ref()).ok()?))
    }
}

impl Model {
    /// An empty model, but for the telescope of this node's own file.
    pub fn new(own: impl Into<OwnTelescope>) -> Self {
        let own = own.into();
        let telescopes = BTreeMap::from([(own.address.clone(), Telescope::default())]);
        Self { telescopes, own: Some(own), ..Self::default() }
    }

    /// Where a telescope stands: as this server's file says of its own site, else as its mount does, else as another mount
    /// of its site does. `None` until one is known.
    pub fn place(&self, address: &Address) -> Option<(Place, EarthOrientation)> {
        let in_file = self.own.as_ref().filter(|own| own.address.site == address.site).and_then(|own| own.place);
        if in_file.is_some() {
            return in_file;
        }
        let beside = self.telescopes.iter().filter(|(other, _)| other.site == address.site).map(|(_, beside)| beside);
        let place = self.telescopes.get(address).into_iter().chain(beside).find_map(|telescope| telescope.place)?;
        Some((place, EarthOrientation::default()))
    }

    fn is_expected(&self, address: &Address) -> bool {
        self.own.as_ref().is_some_and(|own| own.address == *address)
    }

    /// Takes a payload in; true when it is new.
    pub fn accept(&mut self, received: Received<Value>) -> bool {
        let address = received.key.address().clone();
        if self.telescopes.len() >= MOST_TELESCOPES
            && !self.telescopes.contains_key(&address)
            && !self.give_way(received.arrived)
        {
            return false;
        }
        let is_expected = self.is_expected(&address);
        let room = if is_expected { usize::MAX } else { MOST_WEIGHT_OF_ALL.saturating_sub(self.weight) };
        let telescope = self.telescopes.entry(address).or_default();
        let before = telescope.weight;
        let revision = self.revision + 1;
        let taken = match &received.key {
            Key::Node(_, role, id, NodeTopic::Diary) => match DiaryLine::deserialize(&received.sample.body) {
                Ok(line) => telescope.diary.write(Line {
                    number: revision,
                    node: contract::node::name(*role, id),
                    at_utc: received.sample.at_utc,
                    boot_id: received.sample.boot_id.clone(),
                    seq: received.sample.seq,
                    line,
                }),
                Err(_) => false,
            },
            _ => {
                let key = received.key.clone();
                let taken = telescope.keep(received, revision, room);
                if taken && matches!(key, Key::Frame(_)) {
                    telescope.remember_frame(&key, revision);
                }
                taken
            }
        };
        self.weight = (self.weight + telescope.weight).saturating_sub(before);
        if taken {
            self.revision = revision;
        }
        taken
    }

    /// Notes that a payload was not taken, and why.
    pub fn refuse(&mut self, key: &Key, why: String, arrived: MachineTime) {
        // A telescope of an unknown program is not created by payloads that cannot be decoded.
        let Some(telescope) = self.telescopes.get_mut(key.address()) else { return };
        telescope.unreadable.retain(|_, (_, at)| arrived.since(*at) < UNREADABLE_FOR);
        let name = short(key);
        if telescope.unreadable.len() < MOST_UNREADABLE || telescope.unreadable.contains_key(&name) {
            if telescope.unreadable.insert(name, (why.clone(), arrived)).is_none() {
                tracing::warn!(%key, why, "a payload is not what its key promises; it is not shown");
            }
            self.revision += 1;
        }
    }

    /// Drops what ended in good order a day ago, and what fell silent two weeks ago; the expected telescope stays.
    pub fn forget(&mut self, now: MachineTime) {
        let own = self.own.as_ref().map(|own| &own.address);
        self.telescopes.retain(|address, telescope| !telescope.forget(now) || own == Some(address));
        self.weight = self.telescopes.values().map(|telescope| telescope.weight).sum();
    }

    /// Forgets the telescope that has been silent the longest, if any has.
    fn give_way(&mut self, now: MachineTime) -> bool {
        if self.full.is_some_and(|at| now.since(at) < LOOK_EVERY) {
            return false;
        }
        let newest = |telescope: &Telescope| telescope.states.values().map(|entry| entry.arrived).max();
        let others = self.telescopes.iter().filter(|(address, _)| !self.is_expected(address));
        let silent = others.filter(|(_, t)| newest(t).is_none_or(|at| now.since(at) > GIVES_WAY_AFTER));
        let Some(address) = silent.min_by_key(|(_, t)| newest(t)).map(|(address, _)| address.clone()) else {
            self.full = Some(now);
            return false;
        };
        if let Some(gone) = self.telescopes.remove(&address) {
            self.weight = self.weight.saturating_sub(gone.weight);
        }
        true
    }
}

impl Telescope {
    /// Drops the nodes that are gone; true where all of the telescope is.
    fn forget(&mut self, now: MachineTime) -> bool {
        let node = |entry: &Entry| match &entry.key {
            Key::Node(_, role, id, NodeTopic::State) => {
                let ended = NodeState::deserialize(entry.body.as_ref()).is_ok_and(|state| state.ended_well());
                Some(((*role, id.clone()), (ended, entry.age(now))))
            }
            _ => None,
        };
        let nodes: BTreeMap<(Role, Name), (bool, Duration)> = self.states.values().filter_map(node).collect();
        let has_ended = !nodes.is_empty() && nodes.values().all(|(ended, _)| *ended);
        let after = if has_ended { FORGET_AFTER } else { LAST_WORD };
        let is_gone = !self.states.is_empty() && self.states.values().all(|entry| entry.age(now) > after);
        // The last word of a role says that its silence is no fault: it stays as long as the telescope.
        let goes_on = |wanted: Role| {
            nodes.iter().any(|((role, _), (ended, age))| *role == wanted && !ended && *age <= FORGET_AFTER)
        };
        self.states.retain(|_, entry| match &entry.key {
            Key::Node(_, role, id, _) => match nodes.get(&(*role, id.clone())) {
                Some((true, _)) => entry.age(now) <= FORGET_AFTER || !goes_on(*role),
                Some((false, _)) | None => entry.age(now) <= LAST_WORD,
            },
            _ => true,
        });
        self.weight = self.states.values().map(|entry| entry.weight).sum();
        is_gone
    }

    /// Forgets the key that has been silent the longest, if one has.
    fn give_way(&mut self, now: MachineTime) -> bool {
        if self.full.is_some_and(|at| now.since(at) < LOOK_EVERY) {
            return false;
        }
        let silent = self.states.iter().filter(|(_, entry)| now.since(entry.arrived) > GIVES_WAY_AFTER);
        let Some(name) = silent.min_by_key(|(_, entry)| entry.arrived).map(|(name, _)| name.clone()) else {
            self.full = Some(now);
            return false;
        };
        if let Some(gone) = self.states.remove(&name) {
            self.weight = self.weight.saturating_sub(gone.weight);
            if place::is_of_mount(&gone.key) {
                self.find_place();
            }
        }
        true
    }

    /// Asks its mounts where they stand; the first one that knows counts.
    fn find_place(&mut self) {
        let mounts = self.states.values().filter(|entry| place::is_of_mount(&entry.key));
        self.place = mounts.map(|mount| mount.body.as_ref()).find_map(place::by_mount);
    }

    fn remember_frame(&mut self, key: &Key, revision: u64) {
        let name = short(key);
        if let Some(Entry { at_utc, body, changed, weight, .. }) = self.states.get(&name)
            && *changed == revision
            && *weight <= MOST_WEIGHT_OF_FRAME + WEIGHT_OF_SUCCESSION
        {
            let frame = AnnouncedFrame { key: name, at_utc: *at_utc, body: body.clone() };
            self.forgotten_frame = self.frames.push(revision, frame).map_or(self.forgotten_frame, |(number, _)| number);
        }
    }

    /// Stores a payload unless it is old or there is no room for it; all others may weigh `room` more.
    fn keep(&mut self, received: Received<Value>, revision: u64, room: usize) -> bool {
        let name = short(&received.key);
        // Of some keys a telescope has only one: a flood of others must not keep them out.
        let is_single = matches!(received.key, Key::Observatory(..) | Key::Facts(..) | Key::Stored(_));
        let Received { key, sample: Stamped { boot_id, seq, at_utc, body, .. }, arrived } = received;
        let weight = weight(&body) + WEIGHT_OF_SUCCESSION;
        let had = self.states.get(&name).map_or(0, |have| have.weight);
        let room = room.min(MOST_WEIGHT.saturating_sub(self.weight));
        if weight > had && weight - had > room {
            return false;
        }
        let is_new = !self.states.contains_key(&name);
        if is_new && !is_single && self.states.len() >= MOST_KEYS && !self.give_way(arrived) {
            return false;
        }
        let mut entry = Entry {
            key,
            body: Arc::new(body),
            at_utc,
            arrived,
            revision,
            changed: revision,
            succession: Succession::default(),
            weight,
        };
        match self.states.get_mut(&name) {
            Some(have) => {
                // The facts of two frames share an entry but not a counter.
                if have.key == entry.key {
                    entry.succession = std::mem::take(&mut have.succession);
                }
                if !entry.succession.is_newer(&boot_id, seq, arrived) {
                    have.succession = entry.succession;
                    return false;
                }
                if have.body == entry.body {
                    entry.body = have.body.clone();
                    entry.changed = have.changed;
                }
                *have = entry;
            }
            None => {
                entry.succession.is_newer(&boot_id, seq, arrived);
                self.states.insert(name.clone(), entry);
            }
        }
        let has_changed = |entry: &Entry| entry.changed == revision && place::is_of_mount(&entry.key);
        if self.states.get(&name).is_some_and(has_changed) {
            self.find_place();
        }
        self.weight = (self.weight + weight).saturating_sub(had);
        self.unreadable.remove(&name);
        true
    }
}

/// A key without its root; the facts of all frames share one, because only the newest are shown.
pub fn short(key: &Key) -> String {
    match key {
        Key::Facts(address, _) => newest_facts(address),
        _ => key.path(),
    }
}

fn newest_facts(address: &Address) -> String {
    format!("{address}/observatory/frame/facts")
}

#[cfg(test)]
#[path = "model_tests.rs"]
pub(crate) mod tests;
