//! The last log lines of a telescope's nodes.

use std::collections::BTreeMap;

use contract::BootId;
use contract::node::{DiaryLine, Level};
use schemars::JsonSchema;
use serde::Serialize;
use units::Utc;

use crate::ring::Ring;

/// So many lines are kept per telescope.
const MOST_STORED: usize = 500;

/// Nodes of one telescope; more are the invention of a faulty program.
const MOST_NODES: usize = 256;

/// One line with the node that wrote it.
#[derive(Debug, Clone, JsonSchema, Serialize)]
pub struct Line {
    /// Grows with each line of the whole network; gaps mean nothing.
    pub number: u64,
    /// Role and id of the node.
    pub node: String,
    /// Sky time of the line.
    pub at_utc: Utc,
    /// The node's incarnation.
    #[serde(skip)]
    pub boot_id: BootId,
    /// Its sequence number within that incarnation.
    #[serde(skip)]
    pub seq: u64,
    /// The line itself.
    #[serde(flatten)]
    pub line: DiaryLine,
}

/// The last lines, in the order of their arrival.
#[derive(Debug)]
pub struct Diary {
    lines: Ring<Line>,
    newest: BTreeMap<String, (BootId, u64)>,
    /// Number of the newest line of each level that is no longer here.
    forgotten: BTreeMap<Level, u64>,
}

impl Default for Diary {
    fn default() -> Self {
        Self { lines: Ring::of(MOST_STORED), newest: BTreeMap::new(), forgotten: BTreeMap::new() }
    }
}

impl Diary {
    /// Takes a line, unless it was written before (history and live lines may overlap).
    pub fn write(&mut self, line: Line) -> bool {
        let seen = self.newest.get(&line.node);
        if seen.is_some_and(|(boot_id, seq)| *boot_id == line.boot_id && line.seq <= *seq) {
            return false;
        }
        if seen.is_none() && self.newest.len() >= MOST_NODES {
            return false;
        }
        self.newest.insert(line.node.clone(), (line.boot_id.clone(), line.seq));
        if let Some((number, line)) = self.lines.push(line.number, line) {
            self.forgotten.insert(line.line.level, number);
        }
        true
    }

    /// Lines after a number, oldest first.
    pub fn after(&self, number: u64) -> impl Iterator<Item = &Line> {
        self.lines.after(number).map(|(_, line)| line)
    }

    /// The number of the newest line of this level, or of a more urgent one, that is no longer here; 0 while all are.
    pub fn forgotten(&self, level: Level) -> u64 {
        self.forgotten.range(..=level).map(|(_, number)| *number).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_another_level_is_not_missed() {
        let mut diary = Diary::default();
        for i in 0..700 {
            let mut line = line(i + 1, i);
            line.line.level = if i == 100 { Level::Warn } else { Level::Info };
            diary.write(line);
        }
        let forgotten = [Level::Error, Level::Warn, Level::Info].map(|level| diary.forgotten(level));
        assert_eq!(forgotten, [0, 101, 200]);
    }

    fn line(number: u64, seq: u64) -> Line {
        Line {
            number,
            node: "device/main".to_owned(),
            at_utc: Utc::EPOCH,
            boot_id: serde_json::from_str("\"b\"").unwrap(),
            seq,
            line: DiaryLine {
                level: Level::Info,
                target: String::new(),
                message: format!("{seq}"),
                fields: BTreeMap::new(),
            },
        }
    }

    #[test]
    fn old_lines_give_way_and_a_repeat_is_harmless() {
        let mut diary = Diary::default();
        for i in 0..700 {
            assert!(diary.write(line(i + 1, i)));
        }
        assert!(!diary.write(line(701, 699)));
        assert_eq!(diary.after(0).count(), MOST_STORED);
        assert_eq!(diary.after(698).map(|line| line.seq).collect::<Vec<_>>(), [698, 699]);
        assert_eq!((diary.after(700).count(), diary.forgotten(Level::Info)), (0, 200));
    }
}
