//! Where findings about a configuration are gathered, each with the line of the key that it is about.

use std::collections::BTreeSet;

use contract::observatory::Severity;

use crate::document::Document;
use crate::fault::Fault;

/// What was found so far.
pub(crate) struct Findings<'a> {
    document: &'a Document<'a>,
    spoilt: BTreeSet<String>,
    found: Vec<Fault>,
}

impl<'a> Findings<'a> {
    /// On top of what the reading found; paths in `spoilt` are not spoken of again.
    pub fn new(document: &'a Document<'a>, spoilt: BTreeSet<String>, found: Vec<Fault>) -> Self {
        Self { document, spoilt, found }
    }

    /// Something that refuses the file, at a path such as `camera[0].flats`.
    pub fn error(&mut self, path: &str, what: String) {
        self.add(path, Severity::Error, what);
    }

    /// Something that a person should know.
    pub fn warning(&mut self, path: &str, what: String) {
        self.add(path, Severity::Warning, what);
    }

    /// A fault within a block, reported in words that begin with its key: `limits.altitude_min_deg = 99: expected ...`.
    pub fn block(&mut self, path: &str, shown: &str, fault: &str) {
        let key = fault.split([' ', ':', '=']).next().unwrap_or_default();
        let path = if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
        self.error(&path, format!("{shown}{fault}"));
    }

    /// A fault of a value that stands in quotes somewhere.
    pub fn quoted(&mut self, quoted: &str, fault: String) {
        match self.document.line_with(quoted) {
            Some((line, column)) if !quoted.is_empty() => {
                self.found.push(Fault { line, column, severity: Severity::Error, what: fault });
            }
            _ => self.block("", "", &fault),
        }
    }

    fn add(&mut self, path: &str, severity: Severity, what: String) {
        let is_spoilt = |spoilt: &String| {
            path.strip_prefix(spoilt.as_str()).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
        };
        if self.spoilt.iter().any(is_spoilt) || what.contains("stand-in") {
            return;
        }
        let (line, column) = self.document.line_of(path);
        let fault = Fault { line, column, severity, what };
        if !self.found.contains(&fault) {
            self.found.push(fault);
        }
    }

    /// Is something that stands in this path, or the path itself, at fault already?
    pub fn is_spoilt_within(&self, path: &str) -> bool {
        let within = |spoilt: &String| {
            spoilt.strip_prefix(path).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
        };
        self.spoilt.iter().any(within)
    }

    /// The line of a path, for words about two places.
    pub fn line_of(&self, path: &str) -> usize {
        self.document.line_of(path).0
    }

    /// All of it, in the order of the file.
    pub fn into_faults(self) -> Vec<Fault> {
        let mut found = self.found;
        found.sort_by_key(|fault| (fault.line, fault.column));
        found
    }
}
