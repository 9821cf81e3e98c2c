//! The state of all telescopes, shared by the subscribers and the routes.

use std::sync::{Arc, Mutex, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::Duration;

use bus::{Clock, MachineTime, Received};
use contract::node::Level;
use contract::{Address, Key};
use serde_json::Value;
use users::Principal;

use crate::diary::Line;
use crate::model::{Image, Model, OwnTelescope, Telescope};
use crate::summary::Summary;

/// Several clients and scripts share one summary for so long.
const SUMMARY_VALID: Duration = Duration::from_millis(200);

/// The model of the whole network.
pub struct Network {
    clock: Clock,
    model: RwLock<Model>,
    summaries: Mutex<Option<(MachineTime, Arc<Vec<Summary>>)>>,
}

impl Network {
    /// An empty network, but for the telescope of this node's own file.
    pub fn new(clock: Clock, own: impl Into<OwnTelescope>) -> Self {
        Self { clock, model: RwLock::new(Model::new(own)), summaries: Mutex::default() }
    }

    /// The clock that ages are judged by.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// The model as it is now; never held across an await.
    pub fn read(&self) -> RwLockReadGuard<'_, Model> {
        self.model.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, Model> {
        self.model.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a payload in; true when it is new.
    pub fn accept(&self, received: Received<Value>) -> bool {
        self.write().accept(received)
    }

    /// Notes that a payload was not taken, and why.
    pub fn refuse(&self, key: &Key, why: String, arrived: MachineTime) {
        self.write().refuse(key, why, arrived);
    }

    /// Notes the image of a frame, or why there is none.
    pub fn show_image(&self, address: &Address, image: Image) {
        let mut model = self.write();
        model.revision += 1;
        if let Some(telescope) = model.telescopes.get_mut(address) {
            telescope.image = Some(image);
        }
    }

    /// Leaves the image as it is, and notes why the newest frame has none.
    pub fn miss_image(&self, address: &Address, problem: String) {
        let mut model = self.write();
        model.revision += 1;
        if let Some(image) = model.telescopes.get_mut(address).and_then(|telescope| telescope.image.as_mut()) {
            image.problem = Some(problem);
        }
    }

    /// Drops what ended in good order a day ago, and what fell silent two weeks ago.
    pub fn forget(&self) {
        self.write().forget(self.clock.machine());
    }

    /// One summary per telescope, `shared` included, at most 200 ms old.
    pub fn summaries(&self) -> Arc<Vec<Summary>> {
        let now = self.clock.machine();
        let mut cached = self.summaries.lock().unwrap_or_else(PoisonError::into_inner);
        match &*cached {
            Some((made, summaries)) if now.since(*made) < SUMMARY_VALID => summaries.clone(),
            _ => {
                let (model, utc) = (self.read(), self.clock.utc());
                let known = model.telescopes.iter();
                let made = known.map(|(address, telescope)| Summary::of(&model, address, telescope, now, utc));
                let made = Arc::new(made.collect::<Vec<_>>());
                *cached = Some((now, made.clone()));
                made
            }
        }
    }
}

/// The telescopes of which somebody may read the log: all, or one and what its site shares.
pub fn logs<'a>(
    model: &'a Model,
    caller: &'a Principal,
    telescope: Option<&'a Address>,
) -> impl Iterator<Item = (&'a Address, &'a Telescope)> {
    let is_of =
        move |address: &Address| telescope.is_none_or(|wanted| address == wanted || *address == wanted.shared());
    model.telescopes.iter().filter(move |(address, _)| caller.right_at(address).is_some() && is_of(address))
}

/// Their lines after a number, at least so urgent, in the order of their arrival.
pub fn lines<'a>(
    model: &'a Model,
    caller: &'a Principal,
    telescope: Option<&'a Address>,
    level: Level,
    after: u64,
) -> Vec<(&'a Address, &'a Line)> {
    let of = |(address, telescope): (&'a Address, &'a Telescope)| {
        telescope.diary.after(after).map(move |line| (address, line))
    };
    let mut lines: Vec<_> =
        logs(model, caller, telescope).flat_map(of).filter(|(_, line)| line.line.level <= level).collect();
    lines.sort_by_key(|(_, line)| line.number);
    lines
}
