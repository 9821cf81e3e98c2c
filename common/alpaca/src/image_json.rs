//! JSON `imagearray`, the fall-back of cameras without ImageBytes: nested lists, columns first.

use std::fmt;

use contract::device::camera::Pixel;
use serde::de::{self, DeserializeSeed, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};

use crate::image::{Image, MAX_PIXELS, Shape};

/// Turns an `imagearray` answer into rows.
pub fn decode(body: &[u8], max_adu: Option<f64>) -> Result<Image, String> {
    let body = body.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(body);
    let end = body.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    let mut nest = Nest::default();
    let mut reader = serde_json::Deserializer::from_slice(&body[..end]);
    Envelope(&mut nest).deserialize(&mut reader).map_err(|error| format!("no imagearray: {error}"))?;
    let dimension = |depth: usize| nest.sizes.get(depth).copied().flatten().map_or(0, |size| size as i64);
    let shape = match nest.sizes.len() {
        2 => Shape::new([dimension(0), dimension(1), 1])?,
        3 => Shape::new([dimension(0), dimension(1), dimension(2)])?,
        depth => return Err(format!("imagearray of depth {depth}: expected 2 or 3")),
    };
    let values = nest.values;
    if values.len() != shape.pixels() {
        return Err(format!("imagearray has {} values: expected {}", values.len(), shape.pixels()));
    }
    let whole = values.iter().all(|value| value.fract() == 0.0 && value.abs() < 9e15);
    let pixel = if whole {
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Shape::pixel_for((low as i64, high as i64), max_adu.is_some_and(|max| max <= 65535.0))
    } else {
        Pixel::F64
    };
    let rows = match pixel {
        Pixel::U16 => shape.rows(|index| (values[index] as u16).to_le_bytes()),
        Pixel::I32 => shape.rows(|index| (values[index] as i32).to_le_bytes()),
        Pixel::F64 => shape.rows(|index| values[index].to_le_bytes()),
    };
    Ok(shape.image(pixel, rows))
}

/// The values in the order they came, and how long the lists of each depth are.
#[derive(Default)]
struct Nest {
    values: Vec<f64>,
    sizes: Vec<Option<usize>>,
}

/// The answer's object; only its `Value` is read.
struct Envelope<'a>(&'a mut Nest);

impl<'de> DeserializeSeed<'de> for Envelope<'_> {
    type Value = ();
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Envelope<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an Alpaca answer with a Value")
    }

    fn visit_map<M: MapAccess<'de>>(self, mut map: M) -> Result<(), M::Error> {
        while let Some(key) = map.next_key::<String>()? {
            if key.eq_ignore_ascii_case("Value") && self.0.values.is_empty() {
                map.next_value_seed(List { nest: self.0, depth: 0 })?;
            } else {
                map.next_value::<IgnoredAny>()?;
            }
        }
        Ok(())
    }
}

/// A list of lists, or of numbers.
struct List<'a> {
    nest: &'a mut Nest,
    depth: usize,
}

impl<'de> DeserializeSeed<'de> for List<'_> {
    type Value = ();
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl List<'_> {
    fn push<E: de::Error>(self, value: f64) -> Result<(), E> {
        if self.depth != self.nest.sizes.len() {
            return Err(E::custom("a number where a list was expected"));
        }
        if self.nest.values.len() as u64 >= MAX_PIXELS {
            return Err(E::custom("too many values"));
        }
        self.nest.values.push(value);
        Ok(())
    }
}

impl<'de> Visitor<'de> for List<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number or a list")
    }

    fn visit_seq<S: SeqAccess<'de>>(self, mut list: S) -> Result<(), S::Error> {
        let Self { nest, depth } = self;
        if nest.sizes.len() == depth {
            if depth == 3 || !nest.values.is_empty() {
                return Err(de::Error::custom("a list where a number was expected"));
            }
            nest.sizes.push(None);
        }
        let mut length = 0;
        while list.next_element_seed(List { nest: &mut *nest, depth: depth + 1 })?.is_some() {
            length += 1;
        }
        let size = &mut nest.sizes[depth];
        match *size {
            None => *size = Some(length),
            Some(first) if first == length => {}
            Some(first) => {
                let what = format!("its lists are of different length, such as {first} and {length} values");
                return Err(de::Error::custom(what));
            }
        }
        Ok(())
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<(), E> {
        self.push(value as f64)
    }

    fn visit_i64<E: de::Error>(self, value: i64) -> Result<(), E> {
        self.push(value as f64)
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<(), E> {
        self.push(value)
    }
}
