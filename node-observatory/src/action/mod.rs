//! The actions: one file each and one line in [`ACTIONS`].
//!
//! An action is its documented parameters; `run` tells it as an observer would. The runner owns waiting, safety,
//! retrying and settling: `run` may be dropped at any `.await`.

mod answer;
mod autofocus;
mod calibrate_guiding;
mod calibration;
mod close;
mod complete_headers;
mod cool_camera;
mod described;
pub mod expose;
mod flats;
mod object;
mod open;
pub(crate) mod parameters;
mod planned;
mod pointing_model;
mod schema;
mod spooled;
mod stage;
mod wrong;

use std::collections::BTreeMap;
use std::future::Future;
use std::pin::Pin;
use std::sync::{Arc, LazyLock};

use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde_json::Value;
use sky::Observer;

pub use answer::serve;
pub use described::{Parameter, page};
pub use planned::{Exposures, Place};
pub use stage::{Stage, took_s};
pub use wrong::Wrong;

use crate::plan::{Course, Halt};
use crate::trouble::Trouble;

/// All actions.
pub const ACTIONS: &[Entry] = &[
    Entry::of::<open::Open>(),
    Entry::of::<close::Close>(),
    Entry::of::<cool_camera::CoolCamera>(),
    Entry::of::<object::Object>(),
    Entry::of::<calibration::Calibration>(),
    Entry::of::<calibrate_guiding::CalibrateGuiding>(),
    Entry::of::<pointing_model::PointingModel>(),
    Entry::of::<complete_headers::CompleteHeaders>(),
    Entry::of::<autofocus::Autofocus>(),
    Entry::of::<flats::Flats>(),
];

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
///
/// The type is the description of each parameter: its doc comment, its `unit`, its range or choices and its default make
/// the schema ([`Entry::schema`]), which refuses what does not fit, the operator's page, and the web's form. What several
/// actions share stands in `parameters.rs` and is flattened in.
pub trait Action: DeserializeOwned + JsonSchema + Send + Sync + 'static {
    /// `action_type` in the schedule.
    const NAME: &'static str;
    /// A row's `action_value` that a test parses.
    const EXAMPLE: &'static str;

    /// Refuses parameters that do not fit together; each by itself fits the schema.
    fn check(&self) -> Result<(), Wrong> {
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

    /// A name of its target that is to be looked up online, where it has one.
    fn lookup_name(&self) -> Option<&str> {
        None
    }

    /// Where the telescope is to look, as far as that can be known before the row runs.
    fn looks_at(&self) -> Option<Place> {
        None
    }

    /// What it exposes, where that is known.
    fn exposures(&self) -> Vec<Exposures> {
        Vec::new()
    }

    /// Filters that it asks for by name.
    fn filters(&self) -> Vec<&str> {
        Vec::new()
    }

    /// Tells on paper what [`Self::run`] will do, with what that takes: both ask the same functions what comes next.
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt>;

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
    /// A name of its target that is to be looked up online, where it has one.
    fn lookup_name(&self) -> Option<&str>;
    /// Where the telescope is to look, as far as that can be known before the row runs.
    fn looks_at(&self) -> Option<Place>;
    /// What it exposes, where that is known.
    fn exposures(&self) -> Vec<Exposures>;
    /// Filters that it asks for by name.
    fn filters(&self) -> Vec<&str>;
    /// Tells on paper what [`Self::run`] will do, with what that takes.
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt>;
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

    fn lookup_name(&self) -> Option<&str> {
        Action::lookup_name(self)
    }

    fn looks_at(&self) -> Option<Place> {
        Action::looks_at(self)
    }

    fn exposures(&self) -> Vec<Exposures> {
        Action::exposures(self)
    }

    fn filters(&self) -> Vec<&str> {
        Action::filters(self)
    }

    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        Action::foresee(self, course)
    }

    fn run<'a>(&'a self, stage: &'a Stage) -> Pin<Box<dyn Future<Output = Result<String, Trouble>> + Send + 'a>> {
        Box::pin(Action::run(self, stage))
    }
}

/// One line of the table.
pub struct Entry {
    /// `action_type` in the schedule.
    pub name: &'static str,
    /// A row's `action_value`.
    pub example: &'static str,
    make: fn(Value) -> Result<Arc<dyn AnyAction>, Wrong>,
    describe: fn() -> Value,
}

/// By `action_type`.
static SCHEMAS: LazyLock<BTreeMap<&'static str, Value>> =
    LazyLock::new(|| ACTIONS.iter().map(|entry| (entry.name, (entry.describe)())).collect());

impl Entry {
    const fn of<A: Action>() -> Self {
        Self { name: A::NAME, example: A::EXAMPLE, make: make::<A>, describe: || schema::of::<A>(A::NAME) }
    }

    /// What its parameters may be, as JSON Schema (draft 2020-12) with `unit` beside its words.
    pub fn schema(&self) -> &'static Value {
        SCHEMAS.get(self.name).unwrap_or(&Value::Null)
    }

    /// Reads and checks an `action_value`.
    pub fn read(&self, value: Value) -> Result<Arc<dyn AnyAction>, Wrong> {
        (self.make)(schema::checked(self.schema(), value)?)
    }
}

fn make<A: Action>(value: Value) -> Result<Arc<dyn AnyAction>, Wrong> {
    Ok(Arc::new(made::<A>(value)?))
}

fn made<A: Action>(value: Value) -> Result<A, Wrong> {
    let action: A = serde_json::from_value(value).map_err(|error| Wrong::whole(error.to_string()))?;
    action.check()?;
    Ok(action)
}

/// Reads a text as a schedule's row would be, for tests.
#[cfg(test)]
fn read_text<A: Action>(text: &str) -> Result<A, String> {
    let value: Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
    schema::checked(&schema::of::<A>(A::NAME), value).and_then(made).map_err(|wrong| wrong.to_string())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn every_example_is_read() {
        for entry in ACTIONS {
            let value = serde_json::from_str(entry.example).unwrap();
            let read = entry.read(value).map_err(|why| format!("{}: {why}", entry.name)).unwrap();
            assert_eq!(read.name(), entry.name);
        }
    }

    #[test]
    fn only_what_looks_at_the_sky_needs_a_safe_one() {
        for entry in ACTIONS {
            let action = entry.read(serde_json::from_str(entry.example).unwrap()).unwrap();
            assert_eq!(
                action.needs().safe,
                ["open", "object", "autofocus", "calibrate_guiding", "pointing_model", "flats"].contains(&entry.name),
                "{}",
                entry.name
            );
        }
    }
    /// The example of an action with one parameter put to `value`.
    fn with(entry: &Entry, name: &str, value: &Value) -> Value {
        let mut row: Value = serde_json::from_str(entry.example).unwrap();
        row[name] = value.clone();
        row
    }

    #[test]
    fn what_the_schema_allows_the_type_can_hold() {
        for entry in ACTIONS {
            for (name, about) in schema::properties(entry.schema()) {
                let choices = about["enum"].as_array().cloned().unwrap_or_default();
                let ends = [about["minimum"].clone(), about["maximum"].clone(), about["default"].clone()];
                for value in ends.into_iter().chain(choices).filter(|value| !value.is_null()) {
                    // a parameter may need another one, but nothing is left to serde's own words
                    if let Err(wrong) = entry.read(with(entry, name, &value)) {
                        assert!(wrong.field.is_some(), "{} {name} {value}: {wrong}", entry.name);
                    }
                }
            }
        }
    }

    #[test]
    fn a_value_of_another_sort_is_refused_by_the_name_of_its_parameter() {
        for entry in ACTIONS {
            for (name, _) in schema::properties(entry.schema()) {
                let wrong = entry.read(with(entry, name, &serde_json::json!([{"no": "sort"}]))).err().unwrap();
                assert_eq!(wrong.field.as_deref(), Some(name), "{}: {wrong}", entry.name);
            }
            let wrong = entry.read(with(entry, "guidng", &Value::Bool(true))).err().unwrap();
            assert_eq!(wrong.field.as_deref(), Some("guidng"), "{}: {wrong}", entry.name);
        }
    }

    #[test]
    fn what_is_left_out_is_what_the_schema_calls_the_default() {
        for entry in ACTIONS {
            for (name, about) in schema::properties(entry.schema()) {
                let is_given = serde_json::from_str::<Value>(entry.example).unwrap().get(name).is_some();
                if !is_given && !schema::is_required(entry.schema(), name) && !about["default"].is_null() {
                    assert!(entry.read(with(entry, name, &about["default"])).is_ok(), "{} {name}", entry.name);
                }
            }
        }
    }
    fn any_value() -> impl Strategy<Value = Value> {
        let plain = prop_oneof![
            Just(Value::Null),
            any::<bool>().prop_map(Value::from),
            any::<i64>().prop_map(Value::from),
            any::<u64>().prop_map(Value::from),
            any::<f64>().prop_map(Value::from),
            (-100..100).prop_map(Value::from),
            ".{0,12}".prop_map(Value::from),
            Just(Value::from("2026-11-21T03:00:00Z")),
        ];
        let list = prop::collection::vec(plain.clone(), 0..4).prop_map(Value::from);
        prop_oneof![3 => plain, 1 => list]
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(512) })]

        #[test]
        fn whatever_a_parameter_is_it_is_read_or_refused_by_name(
            which in any::<prop::sample::Index>(),
            place in any::<prop::sample::Index>(),
            value in any_value(),
        ) {
            let entry = which.get(ACTIONS);
            let names: Vec<&str> = schema::properties(entry.schema()).map(|(name, _)| name).chain(["stranger"]).collect();
            let name = *place.get(&names);
            if let Err(wrong) = entry.read(with(entry, name, &value)) {
                prop_assert!(wrong.field.is_some(), "{} {name} {value}: {wrong}", entry.name);
            }
        }
    }
}
