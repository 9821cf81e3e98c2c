//! Spoilt texts for the readers of files that people write; included by the crates whose readers they are for.
//!
//! Some thousand inputs in the usual run; `STARMESH_FUZZ_CASES=1000000` for the whole form.

use proptest::prelude::*;
use proptest::test_runner::Config;

/// How many inputs each reader gets; `few` where the environment asks for no more.
pub fn config(few: u32) -> Config {
    let asked = std::env::var("STARMESH_FUZZ_CASES").ok();
    let cases = asked.map_or(few, |asked| asked.parse().expect("STARMESH_FUZZ_CASES is a number"));
    Config { cases, failure_persistence: None, max_shrink_iters: 2000, ..Config::default() }
}

/// One change of a text: which, where, and with what.
type Wound = (u8, u16, u16);

/// Texts with up to eight wounds, and now and then plain bytes. `words` are inserted at places of the text: signs and
/// keys of the format. Bytes that are not UTF-8 are replaced, because no reader gets them.
pub fn spoilt(good: &'static [&'static str], words: &'static [&'static str]) -> impl Strategy<Value = String> {
    let wounds = prop::collection::vec(any::<Wound>(), 0..8);
    let wounded = (0..good.len(), wounds).prop_map(move |(which, wounds)| wounded(good, words, which, &wounds));
    let bytes = prop::collection::vec(any::<u8>(), 0..200);
    prop_oneof![9 => wounded, 1 => bytes].prop_map(|bytes| String::from_utf8_lossy(&bytes).into_owned())
}

fn wounded(good: &[&str], words: &[&str], which: usize, wounds: &[Wound]) -> Vec<u8> {
    let mut text = good[which].as_bytes().to_vec();
    for (how, at, with) in wounds {
        let (at, with) = (usize::from(*at) % (text.len() + 1), usize::from(*with));
        let inside = at < text.len();
        match how % 9 {
            0 if inside => text[at] = (with % 256) as u8,
            1 if inside => text[at] ^= 1 << (with % 8),
            2 if inside => drop(text.remove(at)),
            3 => drop(text.splice(at..at, words[with % words.len()].bytes())),
            4 => text.truncate(at),
            // The end of another one appended.
            5 => {
                let other = good[with % good.len()].as_bytes();
                text.truncate(at);
                text.extend(&other[with % (other.len() + 1)..]);
            }
            6 if text.len() < 20_000 => text.extend_from_within(at..),
            // The same thing again and again: nests, long words, long lines.
            7 => {
                let word = words[with % words.len()].repeat(1 + with % 300);
                drop(text.splice(at..at, word.bytes()));
            }
            8 if inside => {
                let end = (at + 1 + with % 40).min(text.len());
                drop(text.splice(at..end, words[with % words.len()].bytes()));
            }
            _ => {}
        }
    }
    text
}
