//! Checks what is taken from the bus: a payload must have the type that its key promises, and be no larger than a page
//! can use.
//!
//! Any program on the bus can publish anything. One field of a wrong type must not reach a browser, where it would stop
//! the page; so each payload is decoded as its type here. A payload that cannot be decoded is not shown; the page
//! reports its key with the telescope.

use contract::archive::Stored;
use contract::device::camera::{Camera, Frame};
use contract::device::cover_calibrator::CoverCalibrator;
use contract::device::dome::{Dome, Guard};
use contract::device::filter_wheel::FilterWheel;
use contract::device::focuser::Focuser;
use contract::device::observing_conditions::ObservingConditions;
use contract::device::rotator::Rotator;
use contract::device::safety_monitor::SafetyMonitor;
use contract::device::switch::Switch;
use contract::device::telescope::Telescope;
use contract::device::{Description, DeviceKind};
use contract::node::{DiaryLine, NodeState};
use contract::observatory::{
    Alerts, FocusLearnt, FocusState, FrameFacts, GuidingState, Lease, NightState, OpticsState, PointingState,
    SafetyState, ScheduleState, StandingOrders,
};
use contract::{DeviceState, Key, Kind, NodeTopic, Part};
use serde::de::DeserializeOwned;
use serde_json::Value;

/// A payload may weigh so much in memory.
const MOST_WEIGHT: usize = 256 << 10;
/// Schedules of thousands of rows, and the learned state of many nights.
const MOST_WEIGHT_OF_LISTS: usize = 8 << 20;
/// The memory that one value takes in addition to its text.
const WEIGHT_OF_VALUE: usize = 48;

/// Is this a payload of its key? If not, the error is the reason.
pub fn check(key: &Key, body: &Value) -> Result<(), String> {
    let weight = weight(body);
    let most = match key {
        Key::Observatory(_, Part::Schedule | Part::FocusLearnt | Part::Optics | Part::Focus | Part::Pointing) => {
            MOST_WEIGHT_OF_LISTS
        }
        _ => MOST_WEIGHT,
    };
    if weight > most {
        return Err(format!("it takes {weight} bytes of memory; expected at most {most}"));
    }
    read_as_promised(key, body).map_err(|error| error.to_string().chars().take(200).collect())
}

fn read_as_promised(key: &Key, body: &Value) -> Result<(), serde_json::Error> {
    match key {
        Key::State(device) => (Checks::of(device.kind).state)(body),
        Key::Capabilities(device) => (Checks::of(device.kind).capabilities)(body),
        Key::Guard(_) => is::<Guard>(body),
        // Its URL is not for browsers and was taken out.
        Key::Frame(_) => {
            let mut whole = body.clone();
            if let Value::Object(fields) = &mut whole {
                fields.entry("url").or_insert_with(|| Value::String(String::new()));
            }
            is::<Frame>(&whole)
        }
        Key::Facts(..) => is::<FrameFacts>(body),
        Key::Stored(_) => is::<Stored>(body),
        Key::Observatory(_, part) => match part {
            Part::Safety => is::<SafetyState>(body),
            Part::Lease => is::<Lease>(body),
            Part::Night => is::<NightState>(body),
            Part::Schedule => is::<ScheduleState>(body),
            Part::Alerts => is::<Alerts>(body),
            Part::Pointing => is::<PointingState>(body),
            Part::Guiding => is::<GuidingState>(body),
            Part::Focus => is::<FocusState>(body),
            Part::Standing => is::<StandingOrders>(body),
            Part::Optics => is::<OpticsState>(body),
            Part::FocusLearnt => is::<FocusLearnt>(body),
        },
        Key::Node(_, _, _, NodeTopic::State) => is::<NodeState>(body),
        Key::Node(_, _, _, NodeTopic::Alerts) => is::<Alerts>(body),
        Key::Node(_, _, _, NodeTopic::Diary) => is::<DiaryLine>(body),
        // Nothing else is subscribed to.
        _ => Ok(()),
    }
}

fn is<T: DeserializeOwned>(body: &Value) -> Result<(), serde_json::Error> {
    T::deserialize(body).map(drop)
}

/// The checks of the two payloads that every kind of device has.
struct Checks {
    state: fn(&Value) -> Result<(), serde_json::Error>,
    capabilities: fn(&Value) -> Result<(), serde_json::Error>,
}

impl Checks {
    fn of(kind: Kind) -> Self {
        fn of<D: DeviceKind>() -> Checks {
            Checks { state: is::<DeviceState<D::Fields>>, capabilities: is::<Description<D::Capabilities>> }
        }
        match kind {
            Kind::Telescope => of::<Telescope>(),
            Kind::Camera => of::<Camera>(),
            Kind::FilterWheel => of::<FilterWheel>(),
            Kind::Focuser => of::<Focuser>(),
            Kind::Dome => of::<Dome>(),
            Kind::SafetyMonitor => of::<SafetyMonitor>(),
            Kind::ObservingConditions => of::<ObservingConditions>(),
            Kind::CoverCalibrator => of::<CoverCalibrator>(),
            Kind::Switch => of::<Switch>(),
            Kind::Rotator => of::<Rotator>(),
        }
    }
}

/// Roughly what a value takes in memory.
pub fn weight(value: &Value) -> usize {
    WEIGHT_OF_VALUE
        + match value {
            Value::String(text) => text.len(),
            Value::Array(values) => values.iter().map(weight).sum(),
            Value::Object(fields) => fields.iter().map(|(name, value)| name.len() + weight(value)).sum(),
            Value::Null | Value::Bool(_) | Value::Number(_) => 0,
        }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn golden(name: &str) -> Vec<Value> {
        let path = format!("{}/../common/contract/golden/v1/{name}.json", env!("CARGO_MANIFEST_DIR"));
        match serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap() {
            Value::Array(samples) => samples,
            sample => vec![sample],
        }
    }

    /// A key of each sort that is subscribed to, with its golden sample.
    fn all() -> Vec<(Key, Value)> {
        let mut found = Vec::new();
        let mut add = |key: &str, sample: &str| {
            let key = Key::parse(&format!("{}/paranal/callisto/{key}", contract::key::ROOT)).unwrap();
            found.extend(golden(sample).into_iter().map(|sample| (key.clone(), sample)));
        };
        for kind in Kind::ALL {
            add(&format!("device/{kind}/d/state"), &format!("{kind}.state"));
            add(&format!("device/{kind}/d/capabilities"), &format!("{kind}.capabilities"));
        }
        for part in Part::ALL {
            let sample = match part {
                Part::Alerts => "alerts".to_owned(),
                part => format!("observatory.{}", part.word().replace('-', "_")),
            };
            add(&format!("observatory/{}/state", part.word()), &sample);
        }
        add("device/dome/d/guard", "dome.guard");
        add("device/camera/d/frame", "camera.frame");
        add("observatory/frame/f/facts", "observatory.facts");
        add("archive/stored", "archive.stored");
        add("node/web/main/state", "node.state");
        add("node/web/main/alerts", "alerts");
        add("node/web/main/diary", "node.diary");
        found
    }

    #[test]
    fn every_golden_sample_is_taken() {
        for (key, sample) in all() {
            assert_eq!(check(&key, &sample).err(), None, "{key}");
        }
    }

    #[test]
    fn a_required_field_of_a_wrong_type_is_not_taken() {
        let mut refused = 0;
        for (key, sample) in all() {
            for name in sample.as_object().unwrap().keys() {
                let mut spoilt = sample.clone();
                // No field of the contract is a list of lists.
                spoilt[name] = serde_json::json!([[[1]]]);
                refused += usize::from(check(&key, &spoilt).is_err());
            }
        }
        assert!(refused > 200, "{refused}");
    }

    #[test]
    fn what_is_too_large_for_a_page_is_not_taken() {
        let (key, mut sample) = all().remove(0);
        sample["readings"] = (0..10_000).map(|i| (format!("r{i}"), serde_json::json!({"value": 1}))).collect();
        assert!(check(&key, &sample).is_err_and(|why| why.contains("bytes of memory")));
    }
}
