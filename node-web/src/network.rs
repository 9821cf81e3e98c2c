//! Everything heard of all telescopes: the newest payload of each key with its arrival, and the last log lines.
//!
//! Payloads are kept as the JSON they came as, so that what a newer node says beyond our contract still reaches the
//! page. Each accepted payload gets the next revision; a client that remembers the revision it has seen needs no
//! queue of its own: what is newer is what it lacks, and however slow it is, it gets each key once.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::Duration;

use bus::{Clock, Heard, MachineTime};
use contract::key::ROOT;
use contract::node::DiaryLine;
use contract::{Address, BootId, CommandId, Key, NodeTopic};
use serde::Deserialize as _;
use serde_json::Value;
use std::sync::Arc;
use units::Utc;

use crate::diary::{Diary, Line};
use crate::freshness::{Quality, period};
use crate::summary::Summary;

/// A broken or hostile publisher must not fill the memory.
const MOST_KEYS: usize = 2000;
const MOST_TELESCOPES: usize = 200;
/// A telescope or node that has been silent for so long was taken away.
const FORGET_AFTER: Duration = Duration::from_secs(24 * 3600);
/// Two writers of one key: the younger one counts while it has spoken within this time.
const YOUNGER_HOLDS: Duration = Duration::from_secs(3);
/// Several clients and scripts share one summary for so long.
const SUMMARY_KEPT: Duration = Duration::from_millis(200);

/// The model of the whole network.
pub struct Network {
    clock: Clock,
    model: RwLock<Model>,
    summaries: Mutex<Option<(MachineTime, Arc<Vec<Summary>>)>>,
}

/// What is known; readers hold it for one expression.
#[derive(Default)]
pub struct Model {
    /// All telescopes, and `shared` of each site.
    pub telescopes: BTreeMap<Address, Telescope>,
    /// Counts what was accepted.
    pub revision: u64,
}

/// What was heard at one address.
#[derive(Default)]
pub struct Telescope {
    /// The newest payload of each key, under the key without its root.
    pub states: BTreeMap<String, Entry>,
    /// The last log lines.
    pub diary: Diary,
    /// The newest frame that could be turned into an image, or why it could not.
    pub image: Option<Image>,
}

/// One payload as it was heard.
#[derive(Debug, Clone)]
pub struct Entry {
    /// Its key.
    pub key: Key,
    /// What was said.
    pub body: Arc<Value>,
    /// Sky time of the sender.
    pub at_utc: Utc,
    /// When it arrived here.
    pub arrived: MachineTime,
    /// Revision of the newest arrival.
    pub revision: u64,
    /// Revision at which the body last differed.
    pub changed: u64,
    boot_id: BootId,
    seq: u64,
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

impl Entry {
    /// Time since it arrived.
    pub fn age(&self, now: MachineTime) -> Duration {
        now.since(self.arrived)
    }

    /// How often it is said again.
    pub fn period(&self) -> Option<Duration> {
        period(&self.key, &self.body)
    }

    /// What it is worth now.
    pub fn quality(&self, now: MachineTime) -> Quality {
        Quality::of(self.age(now), self.period())
    }
}

impl Telescope {
    /// The newest payload of a key, read as its type; `None` where it never came or cannot be read.
    pub fn read<T: serde::de::DeserializeOwned>(&self, key: &Key) -> Option<(&Entry, T)> {
        let entry = self.states.get(&short(key))?;
        Some((entry, T::deserialize(entry.body.as_ref()).ok()?))
    }
}

impl Network {
    /// An empty network, with a telescope that is expected though it may never speak.
    pub fn new(clock: Clock, expected: Address) -> Self {
        let telescopes = BTreeMap::from([(expected, Telescope::default())]);
        Self { clock, model: RwLock::new(Model { telescopes, revision: 0 }), summaries: Mutex::default() }
    }

    /// The clock that ages are judged by.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// What is known now; never held across an await.
    pub fn read(&self) -> RwLockReadGuard<'_, Model> {
        self.model.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, Model> {
        self.model.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a payload in; true when it is new.
    pub fn accept(&self, heard: Heard<Value>) -> bool {
        self.write().accept(heard)
    }

    /// Notes the image of a frame, or why there is none.
    pub fn show_image(&self, address: &Address, image: Image) {
        let mut model = self.write();
        model.revision += 1;
        if let Some(telescope) = model.telescopes.get_mut(address) {
            telescope.image = Some(image);
        }
    }

    /// Keeps the image that stands, and says why the newest frame has none.
    pub fn miss_image(&self, address: &Address, problem: String) {
        let mut model = self.write();
        model.revision += 1;
        if let Some(image) = model.telescopes.get_mut(address).and_then(|telescope| telescope.image.as_mut()) {
            image.problem = Some(problem);
        }
    }

    /// Drops what has been silent for a day.
    pub fn forget(&self) {
        let now = self.clock.machine();
        self.write().telescopes.retain(|_, telescope| {
            let gone = |entry: &Entry| entry.age(now) > FORGET_AFTER;
            telescope.states.retain(|_, entry| !(matches!(entry.key, Key::Node(..)) && gone(entry)));
            telescope.states.is_empty() || !telescope.states.values().all(gone)
        });
    }

    /// One summary per telescope, `shared` included, at most 200 ms old.
    pub fn summaries(&self) -> Arc<Vec<Summary>> {
        let now = self.clock.machine();
        let mut kept = self.summaries.lock().unwrap_or_else(PoisonError::into_inner);
        match &*kept {
            Some((made, summaries)) if now.since(*made) < SUMMARY_KEPT => summaries.clone(),
            _ => {
                let model = self.read();
                let made = model.telescopes.iter().map(|(address, telescope)| Summary::of(address, telescope, now));
                let made = Arc::new(made.collect::<Vec<_>>());
                *kept = Some((now, made.clone()));
                made
            }
        }
    }
}

impl Model {
    fn accept(&mut self, heard: Heard<Value>) -> bool {
        let address = heard.key.address().clone();
        if self.telescopes.len() >= MOST_TELESCOPES && !self.telescopes.contains_key(&address) {
            return false;
        }
        let telescope = self.telescopes.entry(address).or_default();
        let revision = self.revision + 1;
        let taken = match &heard.key {
            Key::Node(_, role, id, NodeTopic::Diary) => match DiaryLine::deserialize(&heard.said.body) {
                Ok(line) => telescope.diary.write(Line {
                    number: revision,
                    node: format!("{role}/{id}"),
                    at_utc: heard.said.at_utc,
                    boot_id: heard.said.boot_id.clone(),
                    seq: heard.said.seq,
                    line,
                }),
                Err(_) => false,
            },
            _ => telescope.keep(heard, revision),
        };
        if taken {
            self.revision = revision;
        }
        taken
    }
}

impl Telescope {
    fn keep(&mut self, heard: Heard<Value>, revision: u64) -> bool {
        let name = short(&heard.key);
        let full = self.states.len() >= MOST_KEYS;
        let Heard { key, said, arrived } = heard;
        let mut entry = Entry {
            key,
            body: Arc::new(said.body),
            at_utc: said.at_utc,
            arrived,
            revision,
            changed: revision,
            boot_id: said.boot_id,
            seq: said.seq,
        };
        match self.states.get_mut(&name) {
            Some(have) if is_older(&entry, have) => return false,
            Some(have) => {
                if have.body == entry.body {
                    entry.body = have.body.clone();
                    entry.changed = have.changed;
                }
                *have = entry;
            }
            None if full => return false,
            None => {
                self.states.insert(name, entry);
            }
        }
        true
    }
}

/// A key without its root; the facts of all frames share one, because only the newest are shown.
pub fn short(key: &Key) -> String {
    match key {
        Key::Facts(address, _) => format!("{address}/observatory/frame/facts"),
        _ => {
            let text = key.to_string();
            text.strip_prefix(ROOT).and_then(|rest| rest.strip_prefix('/')).unwrap_or(&text).to_owned()
        }
    }
}

/// Is `new` from before `have`? The answers to the question at start may cross the first published samples.
fn is_older(new: &Entry, have: &Entry) -> bool {
    if new.boot_id == have.boot_id {
        // the facts of two frames share an entry but not a counter
        new.seq <= have.seq && new.key == have.key
    } else {
        new.boot_id < have.boot_id && new.arrived.since(have.arrived) < YOUNGER_HOLDS
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use contract::Stamped;
    use serde_json::json;

    use super::*;

    pub fn heard(key: &str, boot: &str, seq: u64, at_s: u64, body: Value) -> Heard<Value> {
        Heard {
            key: Key::parse(&format!("{ROOT}/{key}")).unwrap(),
            said: Stamped {
                boot_id: serde_json::from_value(json!(boot)).unwrap(),
                seq,
                at_utc: Utc::from_seconds(1.8e9 + at_s as f64),
                body,
            },
            arrived: MachineTime::from_boot(Duration::from_secs(at_s)),
        }
    }

    fn network() -> Network {
        Network::new(Clock::machine_clock(), Address::new("paranal", "callisto").unwrap())
    }

    const NIGHT: &str = "paranal/callisto/observatory/night/state";

    fn entry(network: &Network) -> Entry {
        network.read().telescopes[&Address::new("paranal", "callisto").unwrap()].states[NIGHT].clone()
    }

    #[test]
    fn a_repeat_refreshes_the_arrival_but_is_no_change() {
        let network = network();
        assert!(network.accept(heard(NIGHT, "b1", 0, 10, json!({"frames": 1}))));
        assert!(network.accept(heard(NIGHT, "b1", 1, 11, json!({"frames": 1}))));
        let repeated = entry(&network);
        assert_eq!((repeated.revision, repeated.changed), (2, 1));
        assert_eq!(repeated.age(MachineTime::from_boot(Duration::from_secs(12))), Duration::from_secs(1));
        assert!(network.accept(heard(NIGHT, "b1", 2, 12, json!({"frames": 2}))));
        assert_eq!(entry(&network).changed, 3);
    }

    #[test]
    fn an_answer_that_crossed_a_newer_sample_is_dropped() {
        let network = network();
        assert!(network.accept(heard(NIGHT, "b1", 5, 10, json!({"frames": 5}))));
        assert!(!network.accept(heard(NIGHT, "b1", 4, 10, json!({"frames": 4}))));
        assert!(!network.accept(heard(NIGHT, "b0", 99, 10, json!({"frames": 9}))), "an older life of the node");
        assert_eq!(*entry(&network).body, json!({"frames": 5}));
    }

    #[test]
    fn an_older_life_counts_again_when_the_younger_one_has_gone_silent() {
        let network = network();
        network.accept(heard(NIGHT, "b2", 5, 10, json!({"frames": 5})));
        assert!(network.accept(heard(NIGHT, "b1", 700, 14, json!({"frames": 9}))));
    }

    #[test]
    fn telescopes_of_all_sites_are_found_and_never_mixed() {
        let network = network();
        for (i, address) in ["paranal/io", "teide/artemis"].iter().enumerate() {
            network.accept(heard(&format!("{address}/observatory/night/state"), "b", 0, 1, json!({ "frames": i })));
        }
        let model = network.read();
        let found: Vec<String> = model.telescopes.keys().map(ToString::to_string).collect();
        assert_eq!(found, ["paranal/callisto", "paranal/io", "teide/artemis"]);
        assert!(model.telescopes.values().all(|telescope| telescope.states.len() <= 1));
    }

    #[test]
    fn the_memory_for_one_telescope_is_bounded() {
        let network = network();
        for i in 0..MOST_KEYS + 50 {
            network.accept(heard(&format!("paranal/callisto/device/switch/s{i}/state"), "b", 0, 1, json!({})));
        }
        let model = network.read();
        assert_eq!(model.telescopes[&Address::new("paranal", "callisto").unwrap()].states.len(), MOST_KEYS);
    }
}
