//! The audit: who ordered or moved what, in a chain of hashes that shows every later change.
//!
//! A record's `sha256` is taken of its compact JSON (no spaces, fields in the order below, absent ones left out) without
//! the field `sha256`. No number in it has a fraction, so any program writes the same bytes again.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::{BootId, CommandId, Payload, Reason};

/// A record as it is published on the bus; `R` is plain JSON for a reader that proves the hash.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct PublishedRecord<R> {
    /// The record.
    pub record: R,
}

impl<R: Payload> Payload for PublishedRecord<R> {
    const NAME: &'static str = R::NAME;
}

/// One record.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct AuditRecord {
    /// Names the chain; a new one begins where the old one is broken or lost.
    pub chain: String,
    /// Counts from 0 within the chain.
    pub number: u64,
    /// Sky time of the node that writes.
    pub at_utc: Utc,
    /// Time since its machine booted, ms.
    pub boot_time_ms: u64,
    /// Its incarnation.
    pub boot_id: BootId,
    /// Which node writes, such as `device/callisto/main`.
    pub node: String,
    /// Host that it runs on.
    pub host: String,
    /// The sender, as it signs: `observatory/callisto/main`, `web/ana`; `guard` for what the node does by itself,
    /// `audit` for notes of the audit about itself.
    pub from: String,
    /// Host of the node that asked, where it is known.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub from_host: String,
    /// The command or order; empty where there was none, or where it could not be read.
    #[serde(default, skip_serializing_if = "CommandId::is_empty")]
    pub id: CommandId,
    /// The device, such as `dome/roof`, or the user, such as `user/ana`; empty for an order.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub device: String,
    /// What was asked, such as `open_shutter`.
    pub verb: String,
    /// With which parameters, as JSON; a long text is cut.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub parameters: String,
    /// Fencing token that the command carried.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub token: Option<u64>,
    /// Why, in the words of who asked.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// What became of it.
    pub outcome: AuditOutcome,
    /// `sha256` of the record before; 64 zeros for the first of a chain.
    pub previous: String,
    /// SHA-256 of this record, as the head of this module describes.
    pub sha256: String,
}

impl Payload for AuditRecord {
    const NAME: &'static str = "node.audit";
}

/// What became of a command or an order.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case")]
pub enum AuditOutcome {
    /// It was taken; how it ended is a later record with the same id.
    Accepted,
    /// It was not taken.
    Refused {
        /// For programs.
        reason: Reason,
        /// For people.
        detail: String,
    },
    /// The lease was granted.
    Granted {
        /// The fencing token.
        granted_token: u64,
    },
    /// It ended as asked.
    Done,
    /// It ended otherwise.
    Failed {
        /// Why.
        detail: String,
    },
    /// Another command took its place.
    Superseded {
        /// Its id.
        by: CommandId,
    },
    /// A note of the audit about itself.
    Noted {
        /// What.
        detail: String,
    },
    /// The disk did not take the audit: records are missing here.
    Lost {
        /// How many.
        missing: u64,
    },
}

impl AuditOutcome {
    /// The word, as it stands in JSON.
    pub const fn word(&self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Refused { .. } => "refused",
            Self::Granted { .. } => "granted",
            Self::Done => "done",
            Self::Failed { .. } => "failed",
            Self::Superseded { .. } => "superseded",
            Self::Noted { .. } => "noted",
            Self::Lost { .. } => "lost",
        }
    }
}

/// Asks a node for the records of its own file.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct AuditQuestion {
    /// Those after the record with this hash; from the first on where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after_sha256: Option<String>,
    /// At most so many; 500 where absent, and at most.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<u32>,
}

impl Payload for AuditQuestion {
    const NAME: &'static str = "audit.question";
}

/// The records, the oldest first.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct AuditAnswer<R> {
    /// The records.
    pub records: Vec<R>,
    /// There are more after these.
    pub more: bool,
    /// False where the node has no record with the hash that was named: then there are none in the answer either.
    pub known: bool,
}

impl<R: Payload> Payload for AuditAnswer<R> {
    const NAME: &'static str = "audit.answer";
}
