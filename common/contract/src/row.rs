//! What the table of the bus declares of each topic.

use std::fmt;
use std::time::Duration;

use schemars::{JsonSchema as _, Schema, SchemaGenerator};
use serde_json::Value;

use crate::{Kind, Payload, Stamped};

/// The row of one topic.
#[derive(Debug, Clone, Copy)]
pub struct TopicRow {
    /// The chunks of its keys after site and telescope.
    pub pieces: &'static [Piece],
    /// What it is for, in one sentence.
    pub meaning: &'static str,
    /// When a sample is published.
    pub rate: Rate,
    /// How zenoh carries it.
    pub carried: Carried,
    /// Its one writer; of a query, who asks.
    pub writer: &'static str,
    /// The readers; of a query, the node that answers.
    pub reader: &'static str,
    /// The types of its payloads: the published one, or those of a question and its answer. The kind of device counts
    /// only where the keys name a device.
    pub payloads: fn(Kind) -> Vec<PayloadType>,
}

/// One chunk of a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Piece {
    /// Always this word.
    Word(&'static str),
    /// The word of one part of the observatory node.
    Part(&'static str),
    /// The kind of a device, one of these.
    Kind(&'static [Kind]),
    /// A name; the text meaning of what.
    Name(&'static str),
    /// The role of a node.
    Role,
}

/// When samples of a topic are published.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rate {
    /// Every so many seconds.
    Every(u32),
    /// On change, and every so many seconds.
    OnChangeAndEvery(u32),
    /// Of a device: each state names its own period.
    AtEveryPoll,
    /// Once per event.
    Event,
    /// Once per event, when the event is on the node's disk.
    EventOnDisk,
    /// When somebody asks.
    WhenAsked,
    /// As long as the session lasts.
    WhileConnected,
}

impl Rate {
    /// The longest time between two samples; `None` for what is not repeated, and for what names its own period.
    pub fn period(self) -> Option<Duration> {
        match self {
            Self::Every(seconds) | Self::OnChangeAndEvery(seconds) => Some(Duration::from_secs(seconds.into())),
            Self::AtEveryPoll | Self::Event | Self::EventOnDisk | Self::WhenAsked | Self::WhileConnected => None,
        }
    }
}

impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Every(seconds) => write!(f, "every {seconds} s"),
            Self::OnChangeAndEvery(seconds) => write!(f, "on change, and every {seconds} s"),
            Self::AtEveryPoll => f.write_str("at every poll and change, at least every `period_s` (1 to 5 s)"),
            Self::Event => f.write_str("event"),
            Self::EventOnDisk => f.write_str("event, once it is on the node's disk"),
            Self::WhenAsked => f.write_str("when asked"),
            Self::WhileConnected => f.write_str("while connected"),
        }
    }
}

/// How zenoh carries the samples of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carried {
    /// A level: each sample is complete, and the newest is enough; so many are stored for a reader that was cut off.
    State(usize),
    /// A level of a device: its states of ten minutes and more are stored, how many depends on its poll period.
    Telemetry,
    /// Must overtake everything else.
    Urgent,
    /// Must arrive, late if need be: so many are stored for a reader that was cut off.
    Event(usize),
    /// Answered at once, else its outcome is unknown.
    Query,
    /// Answered with much, behind everything else on the link.
    LargeAnswers,
    /// Shows that a session lives.
    Token,
}

impl fmt::Display for Carried {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::State(stored) => write!(f, "drop, advanced publisher with cache {stored}; answers a plain `get`"),
            Self::Telemetry => {
                f.write_str("drop, advanced publisher with a cache of `spool.hold_min` (15 min); answers a plain `get`")
            }
            Self::Urgent => f.write_str("drop, real-time priority, express"),
            Self::Event(stored) => write!(f, "drop, advanced publisher with cache {stored}, recovery"),
            Self::Query => f.write_str("query, interactive priority, express"),
            Self::LargeAnswers => f.write_str("query, low priority"),
            Self::Token => f.write_str("liveliness token, no payload"),
        }
    }
}

/// A type of payload, with its decoder.
#[derive(Debug, Clone, Copy)]
pub struct PayloadType {
    /// [`Payload::NAME`].
    pub name: &'static str,
    /// Travels in the envelope [`Stamped`]; questions and answers have none.
    pub is_published: bool,
    /// Decodes what travels, envelope included, and encodes it again.
    pub again: fn(&[u8]) -> Result<Value, serde_json::Error>,
    /// Decodes a payload without its envelope; the error is why it is none of this type.
    pub check: fn(&Value) -> Result<(), serde_json::Error>,
    /// The JSON Schema of what travels, envelope included.
    pub schema: fn(&mut SchemaGenerator) -> Schema,
}

impl PayloadType {
    pub(crate) fn published<T: Payload>() -> Self {
        let (again, check, schema) = (again::<Stamped<T>>, check::<T>, Stamped::<T>::json_schema);
        Self { name: T::NAME, is_published: true, again, check, schema }
    }

    pub(crate) fn asked<T: Payload>() -> Self {
        let (again, check, schema) = (again::<T>, check::<T>, T::json_schema);
        Self { name: T::NAME, is_published: false, again, check, schema }
    }
}

fn again<T: serde::Serialize + serde::de::DeserializeOwned>(bytes: &[u8]) -> Result<Value, serde_json::Error> {
    serde_json::from_slice::<T>(bytes).and_then(serde_json::to_value)
}

fn check<T: Payload>(body: &Value) -> Result<(), serde_json::Error> {
    T::deserialize(body).map(drop)
}
