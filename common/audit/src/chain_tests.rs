use contract::audit::AuditOutcome;
use contract::{BootId, CommandId};
use proptest::prelude::*;
use units::Utc;

use super::*;

fn record(verb: &str, outcome: AuditOutcome) -> AuditRecord {
    AuditRecord {
        chain: String::new(),
        number: 0,
        at_utc: Utc::from_seconds(1_795_228_200.25),
        boot_time_ms: 12_345,
        boot_id: BootId::fresh(),
        node: "device/alpha/main".to_owned(),
        host: "dome-pc".to_owned(),
        from: "web/ana \"the first\" \u{7f}\u{1}\u{e4}".to_owned(),
        from_host: String::new(),
        id: CommandId::fresh(),
        device: "dome/roof".to_owned(),
        verb: verb.to_owned(),
        parameters: "{\"azimuth_deg\":181.49999999999997}".to_owned(),
        token: Some(u64::MAX),
        reason: "wind\nrain".to_owned(),
        outcome,
        previous: String::new(),
        sha256: String::new(),
    }
}

fn chain(name: &str, length: usize) -> Vec<Proven> {
    let mut last = Link::beginning(name.to_owned());
    let mut all = Vec::new();
    for n in 0..length {
        let sealed = seal(record(&format!("verb{n}"), AuditOutcome::Accepted), &last).unwrap();
        last = sealed.link();
        all.push(sealed);
    }
    all
}

#[test]
fn a_chain_proves_itself_in_order_and_in_no_other() {
    let all = chain("a", 4);
    assert_eq!(all[0].record.number, 0);
    assert_eq!(all[0].record.previous, NOTHING);
    let mut last = None;
    for one in &all {
        assert_eq!(prove(&one.line).as_ref(), Ok(one));
        one.follows(last.as_ref()).unwrap();
        last = Some(one.link());
    }
    assert!(all[2].follows(Some(&all[0].link())).is_err(), "one is left out");
    assert!(all[1].follows(Some(&all[1].link())).is_err(), "one is doubled");
    assert!(all[1].follows(None).is_err(), "the beginning is cut off");
    let other = chain("a", 2);
    assert!(other[1].follows(Some(&all[0].link())).is_err(), "another record stands before");
}

#[test]
fn another_chain_may_follow_from_its_beginning() {
    let (old, new) = (chain("a", 2), chain("b", 2));
    new[0].follows(Some(&old[1].link())).unwrap();
    assert!(new[1].follows(Some(&old[1].link())).is_err(), "not from its middle");
}

#[test]
fn a_hash_is_what_the_contract_defines() {
    // Counted by Python: json.dumps of the sample without "sha256", separators=(",", ":").
    let text = include_str!("../../contract/golden/v1/node.audit.json");
    let samples: Vec<serde_json::Value> = serde_json::from_str(text).unwrap();
    for sample in samples {
        let proven = prove_value(&sample["record"]).unwrap();
        assert_eq!(proven.record.node, "device/callisto/dome-pc");
    }
}

#[test]
fn a_field_that_this_version_does_not_know_is_proven_too() {
    let known = chain("a", 1).remove(0);
    let content = known.line.rsplit_once(SEAL).unwrap().0;
    let content = format!("{content},\"new_field\":{{\"b\":[1,true]}}");
    let line = format!("{content}{SEAL}{}\"}}", hash(&content));
    assert_eq!(prove(&line).unwrap().record.verb, "verb0");
    let received: serde_json::Value = serde_json::from_str(&line).unwrap();
    assert_eq!(prove_value(&received).unwrap().line, line, "and keeps its bytes over the bus");
}

#[test]
fn any_byte_that_is_changed_is_found() {
    let all = chain("a", 2);
    for one in &all {
        for at in 0..one.line.len() {
            for flip in [0x01_u8, 0x20, 0x80] {
                let mut bytes = one.line.clone().into_bytes();
                bytes[at] ^= flip;
                let found = String::from_utf8(bytes).map_or(true, |line| prove(&line).is_err());
                assert!(found, "byte {at} of {}", one.line);
            }
        }
    }
}

proptest! {
    #[test]
    fn every_published_record_is_proven_again_also_over_the_bus(from in ".*", reason in ".*", missing: u64, token: Option<u64>) {
        let mut published = record("open_shutter", AuditOutcome::Lost { missing });
        (published.from, published.reason, published.token) = (from, reason, token);
        let sealed = seal(published, &Link::beginning("c".to_owned())).unwrap();
        prop_assert_eq!(prove(&sealed.line), Ok(sealed.clone()));
        let received: serde_json::Value = serde_json::from_str(&sealed.line).unwrap();
        prop_assert_eq!(prove_value(&received), Ok(sealed));
    }

    #[test]
    fn a_line_with_something_put_in_or_taken_out_is_found(at in 0usize..400, byte in 0x20u8..0x7f, remove: bool) {
        let line = chain("a", 1).remove(0).line;
        let at = at.min(line.len() - 1);
        let mut bytes = line.clone().into_bytes();
        if remove { bytes.remove(at); } else { bytes.insert(at, byte); }
        if let Ok(changed) = String::from_utf8(bytes) {
            prop_assert!(changed == line || prove(&changed).is_err());
        }
    }
}
