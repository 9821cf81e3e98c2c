//! Hashes: how a record is sealed, how a line is proven, and whether it follows the one before. Pure.

use std::fmt;

use contract::audit::AuditRecord;
use serde_json::Value;
use sha2::{Digest as _, Sha256};

/// The hash that the first record of a chain has for the one before.
pub const NOTHING: &str = "0000000000000000000000000000000000000000000000000000000000000000";
/// The end of every line: the last field, whose 64 digits are not part of the hashed text.
const SEAL: &str = ",\"sha256\":\"";

/// The end of a chain, which the next record follows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Link {
    /// The chain.
    pub chain: String,
    /// Number of the last record.
    pub number: u64,
    /// Its hash.
    pub sha256: String,
}

/// A line whose own hash is right.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Proven {
    /// The record, as far as this version knows its fields.
    pub record: AuditRecord,
    /// The line, as it was written.
    pub line: String,
}

/// The fault of a record or of its place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Broken {
    /// The expected value.
    pub expected: String,
    /// The value that was found.
    pub found: String,
}

impl fmt::Display for Broken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "expected {}, found {}", self.expected, self.found)
    }
}

impl std::error::Error for Broken {}

fn broken<T>(expected: impl Into<String>, found: impl Into<String>) -> Result<T, Broken> {
    Err(Broken { expected: expected.into(), found: found.into() })
}

impl Proven {
    /// The place of this record in its chain.
    pub fn link(&self) -> Link {
        let AuditRecord { chain, number, sha256, .. } = &self.record;
        Link { chain: chain.clone(), number: *number, sha256: sha256.clone() }
    }

    /// Is this the record that follows `last`? After nothing a chain must begin.
    pub fn follows(&self, last: Option<&Link>) -> Result<(), Broken> {
        let AuditRecord { chain, number, previous, .. } = &self.record;
        let Some(last) = last.filter(|last| last.chain == *chain) else {
            // The end of an older chain has no meaning for a new one, which begins at 0.
            let begins = *number == 0 && previous == NOTHING;
            let expected = last.map_or("the beginning of a chain".to_owned(), |last| {
                format!("number {} of chain {}, or the beginning of another", last.number + 1, last.chain)
            });
            return if begins { Ok(()) } else { broken(expected, format!("number {number} of chain {chain}")) };
        };
        if *number != last.number + 1 {
            return broken(format!("number {}", last.number + 1), format!("number {number}"));
        }
        if *previous != last.sha256 {
            return broken(format!("previous {}", last.sha256), format!("previous {previous}"));
        }
        Ok(())
    }
}

/// Gives a record its place after `last`, or at the beginning of `chain`, and its hash; returns its line.
pub fn seal(mut record: AuditRecord, last: &Link) -> Result<Proven, serde_json::Error> {
    record.chain.clone_from(&last.chain);
    record.number = last.number.wrapping_add(1);
    record.previous.clone_from(&last.sha256);
    record.sha256 = String::new();
    let unsealed = serde_json::to_string(&record)?;
    let content = unsealed.strip_suffix(&format!("{SEAL}\"}}")).unwrap_or(&unsealed);
    record.sha256 = hash(content);
    let line = format!("{content}{SEAL}{}\"}}", record.sha256);
    Ok(Proven { record, line })
}

impl Link {
    /// The end before the first record of a new chain.
    pub fn beginning(chain: String) -> Self {
        // The number before 0.
        Self { chain, number: u64::MAX, sha256: NOTHING.to_owned() }
    }
}

/// The hash of a record whose text is `content` without the closing brace.
fn hash(content: &str) -> String {
    let mut sha = Sha256::new();
    sha.update(content);
    sha.update("}");
    sha.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Proves a line by its own hash: every byte of it must be as it was written.
pub fn prove(line: &str) -> Result<Proven, Broken> {
    let shown = || line.chars().take(80).collect::<String>();
    let Some((content, rest)) = line.rsplit_once(SEAL) else {
        return broken("a record with a hash at its end", format!("{:?}", shown()));
    };
    let Some(stated) = rest.strip_suffix("\"}").filter(|stated| stated.len() == 64) else {
        return broken("64 hexadecimal digits and the end of the record", format!("{rest:?}"));
    };
    let counted = hash(content);
    if counted != *stated {
        return broken(format!("sha256 {counted}"), format!("sha256 {stated}"));
    }
    match serde_json::from_str::<AuditRecord>(line) {
        Ok(record) if record.sha256 == *stated => Ok(Proven { record, line: line.to_owned() }),
        Ok(record) => broken(format!("sha256 {stated}"), format!("sha256 {}", record.sha256)),
        Err(error) => broken("a record of the audit", format!("{:?}: {error}", shown())),
    }
}

/// Proves a record as it was received from the bus, where its fields are in their order but its text is made anew.
pub fn prove_value(record: &Value) -> Result<Proven, Broken> {
    prove(&record.to_string())
}

#[cfg(test)]
#[path = "chain_tests.rs"]
mod tests;
