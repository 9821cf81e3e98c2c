//! Why a schedule is refused, and the making of findings.

use contract::observatory::{Check, Finding, Fix, Severity};

use crate::written::Position;

/// So many findings of a file are reported; nobody reads more.
pub(super) const MOST_FINDINGS: usize = 200;
/// So many are in one message.
const IN_WORDS: usize = 5;

/// Why a schedule is refused: all faults of it, in the order of the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// At least one.
    pub findings: Vec<Finding>,
}

impl Fault {
    /// The faults, without places.
    pub fn words(&self) -> String {
        self.findings.iter().map(Finding::words).collect::<Vec<_>>().join("; ")
    }
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (index, finding) in self.findings.iter().take(IN_WORDS).enumerate() {
            write!(f, "{}{finding}", if index == 0 { "" } else { "; " })?;
        }
        match self.findings.len().saturating_sub(IN_WORDS) {
            0 => Ok(()),
            more => write!(f, "; and {more} more"),
        }
    }
}

impl std::error::Error for Fault {}

/// A finding that refuses a file.
pub fn error(check: Check, at: Position, field: Option<&str>, what: impl Into<String>) -> Finding {
    let Position { line, column } = at;
    let (field, what) = (field.map(|field| cut(field.to_owned(), 64)), cut(what.into(), 400));
    Finding { severity: Severity::Error, check, line, column, field, what, right: None, fix: None }
}

/// A quoted text may be of any length; a message is limited.
fn cut(mut text: String, most_chars: usize) -> String {
    if let Some((end, _)) = text.char_indices().nth(most_chars) {
        text.truncate(end);
        text.push_str(" ...");
    }
    text
}

/// A finding that puts a row at risk.
pub fn warning(check: Check, at: Position, field: Option<&str>, what: impl Into<String>) -> Finding {
    Finding { severity: Severity::Warning, ..error(check, at, field, what) }
}

/// Adds the right value to a finding.
pub(super) trait Right {
    /// Adds it in words.
    fn right(self, right: impl Into<String>) -> Self;
    /// Adds the change of the text that makes it so.
    fn fix(self, fix: Option<Fix>) -> Self;
}

impl Right for Finding {
    fn right(self, right: impl Into<String>) -> Self {
        Self { right: Some(right.into()), ..self }
    }

    fn fix(self, fix: Option<Fix>) -> Self {
        Self { fix, ..self }
    }
}

/// In the order of the file; where there are more than `most`, errors go before warnings. Returns how many errors and
/// warnings there were.
pub fn in_order(findings: &mut Vec<Finding>, most: usize) -> (u32, u32) {
    let errors = findings.iter().filter(|finding| finding.severity == Severity::Error).count();
    let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    let counts = (count(errors), count(findings.len() - errors));
    if findings.len() > most {
        findings.sort_by_key(|finding| (finding.severity, finding.line, finding.column));
        findings.truncate(most);
    }
    findings.sort_by_key(|finding| (finding.line, finding.column, finding.severity));
    counts
}
