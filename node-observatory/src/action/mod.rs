//! The actions: one file each and one line in [`ACTIONS`].
//!
//! An action is its documented parameters; `run` tells it as an observer would. The runner owns waiting, safety,
//! retrying and settling: `run` may be dropped at any `.await`.

mod calibration;
mod close;
mod complete_headers;
mod cool_camera;
mod expose;
mod object;
mod open;
mod parameters;
mod stage;

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;

use serde::de::DeserializeOwned;
use serde_json::Value;
use sky::Observer;

pub use stage::Stage;

use crate::trouble::Trouble;

/// All actions.
pub const ACTIONS: &[Entry] = &[
    Entry::of::<open::Open>(),
    Entry::of::<close::Close>(),
    Entry::of::<cool_camera::CoolCamera>(),
    Entry::of::<object::Object>(),
    Entry::of::<calibration::Calibration>(),
    Entry::of::<complete_headers::CompleteHeaders>(),
];

/// Known actions of other systems that are not built yet.
pub const NOT_YET: [&str; 4] = ["flats", "calibrate_guiding", "pointing_model", "autofocus"];

/// What must hold while an action runs, and what it lays hands on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Needs {
    /// A safe sky.
    pub safe: bool,
    /// The mount, or the roof over it: two such actions never run at once.
    pub mount: bool,
    /// May run beside the next rows.
    pub parallel: bool,
    /// Every row before it has ended; it sums up, and must not keep an interrupted row from going on.
    pub all_before: bool,
}

/// A sort of action: its parameters, as they stand in `action_value`.
pub trait Action: DeserializeOwned + Send + Sync + 'static {
    /// `action_type` in the schedule.
    const NAME: &'static str;
    /// A row's `action_value` that a test parses.
    const EXAMPLE: &'static str;

    /// Refuses parameters that do not fit together; begins with the name of the parameter.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }

    /// What must hold.
    fn needs(&self) -> Needs;

    /// OBJECT, where there is one.
    fn object(&self) -> Option<&str> {
        None
    }

    /// Frames wanted, where that is a number.
    fn frames_wanted(&self) -> Option<u32> {
        None
    }

    /// Where the telescope is to look, degrees from north through east; `None` where it is not moved.
    fn azimuth_deg(&self, _sky: &Observer) -> Option<f64> {
        None
    }

    /// Does it; returns what is worth telling about how it went.
    fn run(&self, stage: &Stage) -> impl Future<Output = Result<String, Trouble>> + Send;
}

/// An action of any sort.
pub trait AnyAction: Send + Sync {
    /// `action_type` in the schedule.
    fn name(&self) -> &'static str;
    /// What must hold.
    fn needs(&self) -> Needs;
    /// OBJECT, where there is one.
    fn object(&self) -> Option<&str>;
    /// Frames wanted, where that is a number.
    fn frames_wanted(&self) -> Option<u32>;
    /// Where the telescope is to look, degrees from north through east; `None` where it is not moved.
    fn azimuth_deg(&self, sky: &Observer) -> Option<f64>;
    /// Does it.
    fn run<'a>(&'a self, stage: &'a Stage) -> Pin<Box<dyn Future<Output = Result<String, Trouble>> + Send + 'a>>;
}

impl<A: Action> AnyAction for A {
    fn name(&self) -> &'static str {
        A::NAME
    }

    fn needs(&self) -> Needs {
        Action::needs(self)
    }

    fn object(&self) -> Option<&str> {
        Action::object(self)
    }

    fn frames_wanted(&self) -> Option<u32> {
        Action::frames_wanted(self)
    }

    fn azimuth_deg(&self, sky: &Observer) -> Option<f64> {
        Action::azimuth_deg(self, sky)
    }

    fn run<'a>(&'a self, stage: &'a Stage) -> Pin<Box<dyn Future<Output = Result<String, Trouble>> + Send + 'a>> {
        Box::pin(Action::run(self, stage))
    }
}

/// Reads an `action_value` into an action.
type Read = fn(Value) -> Result<Arc<dyn AnyAction>, String>;

/// One line of the table.
pub struct Entry {
    /// `action_type` in the schedule.
    pub name: &'static str,
    /// A row's `action_value`.
    pub example: &'static str,
    /// Reads and checks an `action_value`.
    pub read: Read,
}

impl Entry {
    const fn of<A: Action>() -> Self {
        Self { name: A::NAME, example: A::EXAMPLE, read: read::<A> }
    }
}

fn read<A: Action>(value: Value) -> Result<Arc<dyn AnyAction>, String> {
    let action: A = serde_json::from_value(value).map_err(|error| error.to_string())?;
    action.check()?;
    Ok(Arc::new(action))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_example_is_read() {
        for entry in ACTIONS {
            let value = serde_json::from_str(entry.example).unwrap();
            let read = (entry.read)(value).map_err(|why| format!("{}: {why}", entry.name)).unwrap();
            assert_eq!(read.name(), entry.name);
        }
    }

    #[test]
    fn only_open_and_object_need_a_safe_sky() {
        for entry in ACTIONS {
            let action = (entry.read)(serde_json::from_str(entry.example).unwrap()).unwrap();
            assert_eq!(action.needs().safe, ["open", "object"].contains(&entry.name), "{}", entry.name);
        }
    }
}
