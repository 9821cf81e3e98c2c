//! Spoilt answers to "is it safe?", on their way to a value.

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use crate::response::parse_exactly;
use crate::transaction::Transactions;
use crate::value;

/// In the short form; `scripts/proof soak` asks for a million.
const ANSWERS: usize = 100_000;
/// Whole answers of which none means safe, and none is a letter or two away from it.
const BEGINNINGS: [&str; 12] = [
    r#"{"Value":false,"ClientTransactionID":71,"ServerTransactionID":1209,"ErrorNumber":0,"ErrorMessage":""}"#,
    r#"{"Value":null,"ErrorNumber":0,"ErrorMessage":""}"#,
    r#"{"Value":"Safe","ClientTransactionID":2}"#,
    r#"{"Value":"yes"}"#,
    r#"{"Value":1,"ErrorNumber":0}"#,
    r#"{"Value":NaN,"ErrorNumber":0}"#,
    r#"{"Value":{"IsSafe":1},"ErrorNumber":0}"#,
    r#"{"ErrorNumber":1031,"ErrorMessage":"not connected"}"#,
    r#"{"ErrorNumber":0,"ErrorMessage":""}"#,
    "<html><body><h1>502 Bad Gateway</h1></body></html>",
    "false",
    "",
];
/// The answer of a safe monitor; only with a status of success it means safe.
const SAFE: &str = r#"{"Value":true,"ErrorNumber":0,"ErrorMessage":""}"#;

/// Up to four faults: bytes changed, lost, doubled or inserted, an end cut off, another answer's end appended.
fn spoil(chance: &mut StdRng) -> Vec<u8> {
    let mut body = BEGINNINGS[chance.random_range(0..BEGINNINGS.len())].as_bytes().to_vec();
    for _ in 0..chance.random_range(1..=4) {
        let at = chance.random_range(0..=body.len());
        let inside = at < body.len();
        match chance.random_range(0..7) {
            0 if inside => body[at] = chance.random(),
            1 if inside => body[at] ^= 1 << chance.random_range(0..8),
            2 if inside => drop(body.remove(at)),
            3 => body.insert(at, b"{}[]\",:truefalsn0123456789eE+-. \0"[chance.random_range(0..33)]),
            4 => body.truncate(at),
            5 => {
                let other = BEGINNINGS[chance.random_range(0..BEGINNINGS.len())].as_bytes();
                body.truncate(at);
                body.extend(&other[chance.random_range(0..=other.len())..]);
            }
            _ => body.extend_from_within(at..),
        }
    }
    body
}

fn reads_as_safe(status: u16, body: &[u8]) -> bool {
    let answer = parse_exactly(status, body, &Transactions::fresh(), 71).ok().and_then(|answer| answer.value);
    answer.is_some_and(|answer| value::strict_flag(&answer) == Ok(true))
}

#[test]
fn no_spoilt_answer_reads_as_safe() {
    let answers = std::env::var("STARMESH_FUZZ_ANSWERS").map_or(ANSWERS, |number| number.parse().unwrap());
    let wrong: Vec<(u16, Vec<u8>)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..4_u64)
            .map(|seed| {
                scope.spawn(move || {
                    let mut chance = StdRng::seed_from_u64(seed);
                    assert!(reads_as_safe(200, SAFE.as_bytes()), "a safe monitor is believed");
                    let spoilt = (0..answers / 4).map(|number| match number % 10 {
                        0 => (200, (0..chance.random_range(0..80)).map(|_| chance.random()).collect()),
                        1 => (chance.random_range(300..600), SAFE.as_bytes().to_vec()),
                        _ => (200, spoil(&mut chance)),
                    });
                    spoilt.filter(|(status, body)| reads_as_safe(*status, body)).collect::<Vec<_>>()
                })
            })
            .collect();
        workers.into_iter().flat_map(|worker| worker.join().unwrap()).collect()
    });
    let shown: Vec<_> = wrong.iter().map(|(status, body)| (status, String::from_utf8_lossy(body))).collect();
    assert!(wrong.is_empty(), "{shown:#?}");
    println!("0 of {answers} spoilt answers read as safe");
}
