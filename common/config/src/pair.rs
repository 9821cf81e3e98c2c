//! Two numbers in square brackets, and never a third.

use std::fmt;

use serde::de::{self, Deserialize, Deserializer, SeqAccess, Visitor};

/// Two numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pair(pub [f64; 2]);

impl<'de> Deserialize<'de> for Pair {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(Numbers).map(Self)
    }
}

/// For `deserialize_with`.
pub(crate) fn pair<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 2], D::Error> {
    deserializer.deserialize_seq(Numbers)
}

/// The same for a key that may be absent.
pub(crate) fn some_pair<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; 2]>, D::Error> {
    pair(deserializer).map(Some)
}

struct Numbers;

impl<'de> Visitor<'de> for Numbers {
    type Value = [f64; 2];

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an array of length 2")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<[f64; 2], A::Error> {
        let (mut pair, mut count) = ([0.0; 2], 0);
        while let Some(number) = list.next_element::<f64>()? {
            if let Some(place) = pair.get_mut(count) {
                *place = number;
            }
            count += 1;
        }
        if count == 2 { Ok(pair) } else { Err(de::Error::invalid_length(count, &self)) }
    }
}
