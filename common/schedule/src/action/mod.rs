//! The actions of a schedule: one file with the parameters of each, and one line in the table below.
//!
//! What an action does stands elsewhere: `plan/steps` follows it in a forecast, and the observatory node executes it. Both
//! ask the parameters what comes next.

pub mod autofocus;
pub mod calibrate_guiding;
pub mod calibration;
pub mod close;
pub mod complete_headers;
pub mod cool_camera;
mod described;
pub mod flats;
pub mod object;
pub mod open;
pub mod parameters;
mod planned;
pub mod pointing_model;
mod schema;

use std::collections::BTreeMap;
use std::ops::Deref;
use std::sync::LazyLock;

use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde_json::Value;
use sky::Observer;

pub use autofocus::Autofocus;
pub use calibrate_guiding::CalibrateGuiding;
pub use calibration::Calibration;
pub use close::Close;
pub use complete_headers::CompleteHeaders;
pub use cool_camera::CoolCamera;
pub use described::{Parameter, page};
pub use flats::Flats;
pub use object::Object;
pub use open::Open;
pub use planned::{Exposures, Place};
pub use pointing_model::PointingModel;

use crate::wrong::Wrong;

/// What must hold while an action runs, and which devices it uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Needs {
    /// A safe sky.
    pub safe: bool,
    /// The mount, or the roof over it: two such actions never run at once.
    pub mount: bool,
    /// May run alongside the next rows.
    pub parallel: bool,
    /// Every row before it has ended; it sums up, and must not keep an interrupted row from going on.
    pub all_before: bool,
}

impl Needs {
    /// Does it open what is shut? What leaves roof and mount alone takes its frames as they are.
    pub fn opens(self) -> bool {
        self.safe && self.mount
    }
}

/// What the parameters of an action say of it, before it runs.
pub trait Parameters {
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
}

/// A type of action: its parameters, as they stand in `action_value`.
///
/// The type is the description of each parameter: its doc comment, its `unit`, its range or choices and its default make
/// the schema ([`Entry::schema`]), which refuses what does not fit, the operator's page, and the web's form. Parameters of
/// several actions stand in [`parameters`] and are flattened in.
pub trait ActionType: Parameters + DeserializeOwned + JsonSchema {
    /// `action_type` in the schedule.
    const NAME: &'static str;
    /// A row's `action_value` that a test parses.
    const EXAMPLE: &'static str;
}

/// Declares the table of actions and the type that holds any of them.
macro_rules! actions {
    ($($action:ident),* $(,)?) => {
        /// An action with its parameters.
        #[derive(Debug, Clone)]
        pub enum Action {
            $(
                #[doc = concat!("See [`struct@", stringify!($action), "`].")]
                $action($action),
            )*
        }

        impl Action {
            /// `action_type` in the schedule.
            pub fn name(&self) -> &'static str {
                match self {
                    $(Self::$action(_) => <$action as ActionType>::NAME,)*
                }
            }
        }

        impl Deref for Action {
            type Target = dyn Parameters;

            fn deref(&self) -> &Self::Target {
                match self {
                    $(Self::$action(parameters) => parameters,)*
                }
            }
        }

        /// All actions.
        pub const ACTIONS: &[Entry] = &[
            $(Entry {
                name: <$action as ActionType>::NAME,
                example: <$action as ActionType>::EXAMPLE,
                make: |value| read_checked(value).map(Action::$action),
                describe: || schema::of::<$action>(<$action as ActionType>::NAME),
            },)*
        ];
    };
}

actions![
    Open,
    Close,
    CoolCamera,
    Object,
    Calibration,
    CalibrateGuiding,
    PointingModel,
    CompleteHeaders,
    Autofocus,
    Flats,
];

/// One line of the table.
pub struct Entry {
    /// `action_type` in the schedule.
    pub name: &'static str,
    /// A row's `action_value`.
    pub example: &'static str,
    make: fn(Value) -> Result<Action, Wrong>,
    describe: fn() -> Value,
}

/// By `action_type`.
static SCHEMAS: LazyLock<BTreeMap<&'static str, Value>> =
    LazyLock::new(|| ACTIONS.iter().map(|entry| (entry.name, (entry.describe)())).collect());

impl Entry {
    /// What its parameters may be, as JSON Schema (draft 2020-12) with `unit` in addition to its words.
    pub fn schema(&self) -> &'static Value {
        SCHEMAS.get(self.name).unwrap_or(&Value::Null)
    }

    /// Reads and checks an `action_value`.
    pub fn read(&self, value: Value) -> Result<Action, Wrong> {
        (self.make)(schema::checked(self.schema(), value)?)
    }
}

fn read_checked<A: ActionType>(value: Value) -> Result<A, Wrong> {
    let action: A = serde_json::from_value(value).map_err(|error| Wrong::whole(error.to_string()))?;
    action.check()?;
    Ok(action)
}

/// Reads a text as a schedule's row would be, for tests.
#[cfg(test)]
fn read_text<A: ActionType>(text: &str) -> Result<A, String> {
    let value: Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
    schema::checked(&schema::of::<A>(A::NAME), value).and_then(read_checked).map_err(|wrong| wrong.to_string())
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
