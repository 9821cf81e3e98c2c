//! The state of all telescopes, shared by the subscribers and the routes.

use std::sync::{Arc, Mutex, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::Duration;

use bus::{Clock, Heard, MachineTime};
use contract::{Address, Key};
use serde_json::Value;

use crate::model::{Image, Model};
use crate::summary::Summary;

/// Several clients and scripts share one summary for so long.
const SUMMARY_KEPT: Duration = Duration::from_millis(200);

/// The model of the whole network.
pub struct Network {
    clock: Clock,
    model: RwLock<Model>,
    summaries: Mutex<Option<(MachineTime, Arc<Vec<Summary>>)>>,
}

impl Network {
    /// An empty network, with a telescope that is expected though it may never publish anything.
    pub fn new(clock: Clock, expected: Address) -> Self {
        Self { clock, model: RwLock::new(Model::new(expected)), summaries: Mutex::default() }
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
    pub fn accept(&self, heard: Heard<Value>) -> bool {
        self.write().accept(heard)
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

    /// Drops what has been silent for a day.
    pub fn forget(&self) {
        self.write().forget(self.clock.machine());
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
