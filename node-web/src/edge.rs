//! Checks what is taken from the bus: a payload must have the type that its key promises, and be no larger than a page
//! can use.
//!
//! Any program on the bus can publish anything. One field of a wrong type must not reach a browser, where it would stop
//! the page; so each payload is decoded as its type here. A payload that cannot be decoded is not shown; the page
//! reports its key with the telescope.

use contract::{Key, Part};
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
        Key::Observatory(_, Part::Schedule | Part::FocusLearned | Part::Optics | Part::Focus | Part::Pointing) => {
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
    // Nothing else than what is published is subscribed to.
    let Some(payload) = key.published() else { return Ok(()) };
    match (key, body) {
        // Its URL is not for browsers and was taken out.
        (Key::Frame(_), Value::Object(fields)) if !fields.contains_key("url") => {
            let mut whole = fields.clone();
            whole.insert("url".to_owned(), Value::String(String::new()));
            (payload.check)(&Value::Object(whole))
        }
        _ => (payload.check)(body),
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
    use contract::{Address, Kind, Name, NodeTopic, Role};

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
        let address = Address::new("paranal", "callisto").unwrap();
        let name = |name: &str| name.parse::<Name>().unwrap();
        let node = |topic| Key::Node(address.clone(), Role::Web, name("main"), topic);
        let mut keys: Vec<Key> = Kind::ALL
            .into_iter()
            .map(|kind| address.device(kind, &name("d")))
            .flat_map(|device| [Key::State(device.clone()), Key::Capabilities(device)])
            .collect();
        keys.extend(Part::ALL.map(|part| Key::Observatory(address.clone(), part)));
        keys.extend([NodeTopic::State, NodeTopic::Alerts, NodeTopic::Diary].map(node));
        keys.extend([
            Key::Guard(address.device(Kind::Dome, &name("d"))),
            Key::Frame(address.device(Kind::Camera, &name("d"))),
            Key::Facts(address.clone(), name("f")),
            Key::Stored(address.clone()),
        ]);
        let samples = |key: &Key| golden(key.published().unwrap().name);
        keys.iter().flat_map(|key| samples(key).into_iter().map(|sample| (key.clone(), sample))).collect()
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
