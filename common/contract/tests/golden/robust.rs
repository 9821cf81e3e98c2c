//! Whatever the bus brings, decoders answer with a value or an error and never panic.

use contract::Key;
use contract::row::PayloadType;
use contract::table::payloads as claims;
use proptest::prelude::*;
use serde_json::Value;

use crate::places::places;
use crate::samples;

/// What is read can be written, and what was written can be read.
fn reads_or_refuses(claim: &PayloadType, bytes: &[u8]) -> Result<(), TestCaseError> {
    if let Ok(value) = (claim.again)(bytes) {
        let text = serde_json::to_vec(&value).unwrap();
        prop_assert!((claim.again)(&text).is_ok(), "{}: {value}", claim.name);
    }
    Ok(())
}

fn any_json() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        any::<u64>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        ".{0,12}".prop_map(Value::from),
        Just(Value::from("9999-12-31T23:59:59.999999Z")),
        Just(Value::from("-009999-01-01T00:00:00Z")),
    ];
    leaf.prop_recursive(3, 12, 4, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
            prop::collection::vec(("[a-z_]{1,8}", inner), 0..4).prop_map(|pairs| pairs.into_iter().collect()),
        ]
    })
}

/// A payload and one of its samples.
fn any_sample() -> impl Strategy<Value = (usize, Value)> {
    let all: Vec<(usize, Value)> = claims()
        .iter()
        .enumerate()
        .flat_map(|(i, claim)| samples(claim.name).into_iter().map(move |sample| (i, sample)))
        .collect();
    prop::sample::select(all)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(512) })]

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        for claim in claims() {
            reads_or_refuses(&claim, &bytes)?;
        }
    }

    #[test]
    fn random_json_never_panics(value in any_json()) {
        let bytes = serde_json::to_vec(&value).unwrap();
        for claim in claims() {
            reads_or_refuses(&claim, &bytes)?;
        }
    }

    #[test]
    fn a_damaged_sample_never_panics(
        (i, sample) in any_sample(),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<Option<u8>>()), 1..5),
    ) {
        let mut bytes = serde_json::to_vec(&sample).unwrap();
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            match byte {
                Some(byte) => bytes[at] = byte,
                None => bytes.truncate(at.max(1)),
            }
        }
        reads_or_refuses(&claims()[i], &bytes)?;
    }

    #[test]
    fn a_sample_with_a_wrong_value_never_panics(
        (i, sample) in any_sample(), at in any::<prop::sample::Index>(), wrong in any_json(),
    ) {
        let places = places(&sample);
        let changed = places[at.index(places.len())].replaced(&sample, wrong);
        reads_or_refuses(&claims()[i], &serde_json::to_vec(&changed).unwrap())?;
    }

    #[test]
    fn a_random_key_never_panics(text in "(starmesh/v1/)?[a-z*@/{}é]{0,40}") {
        if let Some(key) = Key::parse(&text) {
            prop_assert_eq!(key.to_string(), text);
        }
    }
}

#[test]
fn a_list_nested_without_end_is_refused() {
    let deep = "[".repeat(100_000);
    for claim in claims() {
        assert!((claim.again)(deep.as_bytes()).is_err(), "{}", claim.name);
    }
    let mut state = samples("node.state").remove(0);
    state["figures"]["deep"] = Value::from("HERE");
    let text = state.to_string().replace("\"HERE\"", &format!("{}1{}", "[".repeat(100_000), "]".repeat(100_000)));
    let node = claims().into_iter().find(|claim| claim.name == "node.state").unwrap();
    assert!((node.again)(text.as_bytes()).is_err());
}
