//! Looks for lines of the log.

use contract::archive::ArchiveRow;
use contract::log_search::LogSearch;
use contract::node::Level;
use rusqlite::params;
use units::Utc;

use super::Reader;
use super::answer::{EVER, log_line};
use crate::database::{DatabaseError, stamp};

const LINES: &str = "SELECT datetime, level, node, message FROM log
    WHERE datetime >= ?1 AND datetime < ?2 AND telescope IN (?3, 'shared')
    AND (?4 IS NULL OR instr(lower(message), lower(?4)) > 0)
    AND (?5 = 'info' OR level = 'error' OR level = ?5)
    AND (?6 IS NULL OR node = ?6 OR substr(node, 1, length(?6) + 1) = ?6 || '/')
    ORDER BY datetime";

/// The lines, oldest first, and whether there are more.
type FoundLines = (Vec<ArchiveRow>, bool);

impl Reader {
    /// Lines that meet all conditions, oldest first, and whether there are more than `limit` of them.
    pub(super) fn log(
        &self,
        search: &LogSearch,
        (from, to): (Option<Utc>, Option<Utc>),
        limit: usize,
    ) -> Result<FoundLines, DatabaseError> {
        let Some(at) = search.around_utc else {
            return self.lines(search, (from, to), limit, !search.oldest);
        };
        let before = to.map_or(at, |to| to.min(at));
        let after = from.map_or(at, |from| from.max(at));
        let (mut lines, more_before) = self.lines(search, (from, Some(before)), limit / 2, true)?;
        let (later, more_after) = self.lines(search, (Some(after), to), limit - limit / 2, false)?;
        lines.extend(later);
        Ok((lines, more_before || more_after))
    }

    /// From one end of a time. Lines of one instant are not parted: who reads on from the last line misses none.
    fn lines(
        &self,
        search: &LogSearch,
        (from, to): (Option<Utc>, Option<Utc>),
        limit: usize,
        newest: bool,
    ) -> Result<FoundLines, DatabaseError> {
        let from = from.map_or(EVER.0.to_owned(), stamp);
        let to = to.map_or(EVER.1.to_owned(), stamp);
        let level = match search.level {
            Some(Level::Error) => "error",
            Some(Level::Warn) => "warning",
            Some(Level::Info) | None => "info",
        };
        let order = if newest { " DESC, rowid DESC" } else { ", rowid" };
        let (mut lines, mut has_more, mut last) = (Vec::new(), false, String::new());
        self.each_row(
            &format!("{LINES}{order}"),
            params![from, to, self.telescope, search.text, level, search.node],
            |row| {
                let at = row.get_ref(0)?.as_str()?;
                has_more = lines.len() >= limit && at != last;
                if !has_more {
                    at.clone_into(&mut last);
                    lines.push(log_line(row)?);
                }
                Ok(!has_more)
            },
        )?;
        if newest {
            lines.reverse();
        }
        Ok((lines, has_more))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use bus::Clock;
    use contract::BootId;
    use contract::archive::{ArchiveQuestion, Ask};
    use node::NodeAlerts;

    use super::*;
    use crate::database::{Database, Write};

    fn at(second: f64) -> Utc {
        "2026-11-21T03:00:00Z".parse::<Utc>().unwrap().plus_seconds(second)
    }

    /// A line a second for ten seconds, of which the fourth and the fifth are of one instant.
    async fn filled(folder: &Path) -> Database {
        let alerts = NodeAlerts::new(Clock::machine_clock());
        let (database, _writer) = Database::open(&folder.join("archive.db"), "callisto", alerts).unwrap();
        let boot_id = BootId::fresh();
        let line = |seq: u64| {
            let (level, node) = match seq {
                2 => (Level::Error, "device/enclosure"),
                3 | 7 => (Level::Warn, "device/main"),
                8 => (Level::Info, "devices/x"),
                _ => (Level::Info, "observatory/main"),
            };
            Write::Log {
                telescope: if seq == 9 { "shared" } else { "callisto" }.to_owned(),
                node: node.to_owned(),
                target: String::new(),
                level,
                message: format!("the 50%_Shutter, line {seq}"),
                at: at(if seq == 4 { 3.0 } else { seq as f64 }),
                origin: (boot_id.clone(), seq),
            }
        };
        database.commit((0..10).map(line).collect()).await.unwrap();
        database
    }

    fn found(path: &Path, search: LogSearch, between: (Option<Utc>, Option<Utc>), limit: u32) -> (Vec<u64>, bool) {
        let ask = Ask::FindLog(Box::new(search));
        let question = ArchiveQuestion { ask, from_utc: between.0, to_utc: between.1, limit: Some(limit) };
        let answer = Reader::open(path, "callisto").unwrap().answer(&question, at(100.0)).unwrap();
        let number = |row| match row {
            ArchiveRow::Log { message, .. } => message.rsplit(' ').next().unwrap().parse().unwrap(),
            other => panic!("{other:?}"),
        };
        (answer.rows.into_iter().map(number).collect(), answer.truncated)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn lines_are_found_by_what_they_say_how_urgent_they_are_and_who_wrote_them() {
        let folder = tempfile::tempdir().unwrap();
        let database = filled(folder.path()).await;
        let all = |search: LogSearch| found(database.path(), search, (None, None), 100).0;
        let text = |text: &str| LogSearch { text: Some(text.to_owned()), ..LogSearch::default() };
        let node = |node: &str| LogSearch { node: Some(node.to_owned()), ..LogSearch::default() };
        let level = |level| LogSearch { level: Some(level), ..LogSearch::default() };
        assert_eq!(all(LogSearch::default()), (0..10).collect::<Vec<_>>());
        assert_eq!(all(text("SHUTTER, LINE 3")), [3]);
        assert_eq!(all(text("50%_s")).len(), 10, "no sign stands for others");
        assert!(all(text("5__")).is_empty() && all(text("'; DROP TABLE log; --")).is_empty());
        assert_eq!(all(level(Level::Warn)), [2, 3, 7]);
        assert_eq!(all(level(Level::Error)), [2]);
        assert_eq!(all(level(Level::Info)).len(), 10);
        assert_eq!((all(node("device")), all(node("device/main"))), (vec![2, 3, 7], vec![3, 7]));
        assert!(all(node("device/")).is_empty() && all(node("%")).is_empty());
        assert_eq!(all(LogSearch { level: Some(Level::Error), ..node("device/main") }), [0; 0]);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn page_by_page_no_line_is_missed_and_none_comes_twice() {
        let folder = tempfile::tempdir().unwrap();
        let database = filled(folder.path()).await;
        let path = database.path();
        let (newest, oldest) = (LogSearch::default, || LogSearch { oldest: true, ..LogSearch::default() });
        // Lines 3 and 4 are of one instant.
        assert_eq!(found(path, newest(), (None, None), 6), (vec![3, 4, 5, 6, 7, 8, 9], true));
        assert_eq!(found(path, newest(), (None, Some(at(3.0))), 6), (vec![0, 1, 2], false));
        assert_eq!(found(path, oldest(), (None, None), 4), (vec![0, 1, 2, 3, 4], true));
        assert_eq!(found(path, oldest(), (Some(at(3.000_001)), None), 4), (vec![5, 6, 7, 8], true));
        assert!(!found(path, newest(), (None, None), 10).1);
        let around = |second| LogSearch { around_utc: Some(at(second)), ..LogSearch::default() };
        let all_around = |second, limit| found(path, around(second), (None, None), limit);
        assert_eq!(all_around(5.0, 4), (vec![3, 4, 5, 6], true));
        assert_eq!(all_around(5.0, 100), ((0..10).collect(), false));
        assert_eq!(all_around(-1.0, 4), (vec![0, 1], true));
        assert_eq!(all_around(100.0, 4), (vec![8, 9], true));
        let inside = found(path, around(5.0), (Some(at(5.0)), Some(at(7.0))), 100);
        assert_eq!(inside, (vec![5, 6], false));
        assert_eq!(found(path, newest(), (None, None), 0), (vec![], true));
    }
}
