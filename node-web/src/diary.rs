//! The last log lines of a telescope's nodes.

use std::collections::{BTreeMap, VecDeque};

use contract::BootId;
use contract::node::DiaryLine;
use serde::Serialize;
use units::Utc;

/// So many lines are kept per telescope.
const KEPT: usize = 500;

/// Nodes of one telescope; more are the invention of a faulty program.
const MOST_NODES: usize = 256;

/// One line with the node that wrote it.
#[derive(Debug, Clone, Serialize)]
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

/// A ring of lines, in the order of their arrival.
#[derive(Debug, Default)]
pub struct Diary {
    lines: VecDeque<Line>,
    newest: BTreeMap<String, (BootId, u64)>,
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
        if self.lines.len() >= KEPT {
            self.lines.pop_front();
        }
        self.lines.push_back(line);
        true
    }

    /// Lines after a number, oldest first.
    pub fn after(&self, number: u64) -> impl Iterator<Item = &Line> {
        let first = self.lines.partition_point(|line| line.number <= number);
        self.lines.range(first..)
    }
}

#[cfg(test)]
mod tests {
    use contract::node::Level;

    use super::*;

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
        assert_eq!(diary.after(0).count(), KEPT);
        assert_eq!(diary.after(698).map(|line| line.seq).collect::<Vec<_>>(), [698, 699]);
        assert_eq!(diary.after(700).count(), 0);
    }
}
