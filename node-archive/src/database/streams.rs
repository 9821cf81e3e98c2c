//! Which numbered samples of each publisher are stored, so that an archive that comes back knows what it lacks.

use std::collections::{BTreeMap, HashMap};

use bus::Gap;
use contract::{BootId, Key};
use rusqlite::{OptionalExtension as _, Transaction, params};
use units::Utc;

/// The addition of version 11. A stream is one incarnation of a publisher on one key: `first` to `whole_to` are the
/// sequence numbers of its samples that are all stored, or known to be lost; times are microseconds since 1970. The
/// view `gaps` has what is missing, and between which times: samples that are lost, and restarts of a publisher, of
/// which nobody knows whether it had published more. `telescope` is that of the archive, which may share the file.
pub(super) const SCHEMA: &str = "
CREATE TABLE streams (
    telescope TEXT NOT NULL, key TEXT NOT NULL, boot_id TEXT NOT NULL, first INTEGER NOT NULL, first_us INTEGER NOT NULL,
    whole_to INTEGER NOT NULL, whole_us INTEGER NOT NULL, PRIMARY KEY (telescope, key, boot_id)
) WITHOUT ROWID;
CREATE TABLE lost (
    telescope TEXT NOT NULL, key TEXT NOT NULL, boot_id TEXT NOT NULL, first INTEGER NOT NULL, last INTEGER NOT NULL,
    from_us INTEGER, to_us INTEGER, PRIMARY KEY (telescope, key, boot_id, first)
) WITHOUT ROWID;
CREATE VIEW gaps AS
    SELECT telescope, key, boot_id, 'lost' AS why, last - first + 1 AS samples, from_us, to_us FROM lost
    UNION ALL
    SELECT * FROM (
        SELECT telescope, key, boot_id, 'restart', NULL, whole_us AS from_us,
            lead(first_us) OVER (PARTITION BY telescope, key ORDER BY first_us) AS to_us
        FROM streams
    ) WHERE to_us > from_us;
";

/// Streams that are followed; a telescope has some hundred keys.
const MOST_STREAMS: usize = 4096;
/// Ranges of one stream; a publisher leaves few gaps, a stranger as many as it likes.
const MOST_RANGES: usize = 1024;

const PUT_STREAM: &str = "
INSERT INTO streams VALUES (?,?,?,?,?,?,?) ON CONFLICT (telescope, key, boot_id) DO UPDATE SET
    first = excluded.first, first_us = excluded.first_us, whole_to = excluded.whole_to, whole_us = excluded.whole_us
";
const FIND_STREAM: &str =
    "SELECT first, first_us, whole_to, whole_us FROM streams WHERE telescope = ? AND key = ? AND boot_id = ?";

type Origin = (Key, BootId);

/// Numbers that are stored or lost, by the first one of each range.
#[derive(Debug, Clone, Default, PartialEq)]
struct Ranges(BTreeMap<u64, Range>);

#[derive(Debug, Clone, Copy, PartialEq)]
struct Range {
    last: u64,
    from_us: i64,
    to_us: i64,
}

impl Ranges {
    /// Adds the numbers from `first` on; those that are there already stay.
    fn add(&mut self, first: u64, range: Range) {
        let mut new = range;
        let mut start = first;
        if let Some((before, known)) = self.0.range(..=first).next_back().map(|(before, known)| (*before, *known))
            && known.last.saturating_add(1) >= first
        {
            (start, new.from_us) = (before, known.from_us);
            if known.last >= new.last {
                return;
            }
        }
        while let Some((next, known)) = self.0.range(start..).next().map(|(next, known)| (*next, *known)) {
            if next > new.last.saturating_add(1) {
                break;
            }
            self.0.remove(&next);
            if known.last > new.last {
                (new.last, new.to_us) = (known.last, known.to_us);
            }
        }
        self.0.insert(start, new);
        if self.0.len() > MOST_RANGES {
            self.0.pop_last();
        }
    }

    /// The times of the nearest samples before and after some numbers.
    fn around(&self, first: u64, last: u64) -> (Option<i64>, Option<i64>) {
        let before = self.0.range(..first).next_back().map(|(_, range)| range.to_us);
        let after = self.0.range(last..).find(|(start, _)| **start > last).map(|(_, range)| range.from_us);
        (before, after)
    }
}

/// The writer's side: what is committed, and what the batch that is being written adds.
#[derive(Debug)]
pub(super) struct Streams {
    telescope: String,
    committed: HashMap<Origin, Ranges>,
    batch: HashMap<Origin, Ranges>,
}

impl Streams {
    /// Those of one telescope's archive.
    pub(super) fn of(telescope: &str) -> Self {
        Self { telescope: telescope.to_owned(), committed: HashMap::new(), batch: HashMap::new() }
    }

    /// Notes that a sample's rows are part of this batch.
    pub(super) fn store(
        &mut self,
        transaction: &Transaction<'_>,
        (key, boot_id, seq): (&Key, &BootId, u64),
        at: Utc,
    ) -> rusqlite::Result<()> {
        if let Some(ranges) = self.stream(transaction, key, boot_id)? {
            ranges.add(seq, Range { last: seq, from_us: at.micros(), to_us: at.micros() });
        }
        Ok(())
    }

    /// Writes what is lost for good.
    pub(super) fn lose(&mut self, transaction: &Transaction<'_>, gap: &Gap) -> rusqlite::Result<usize> {
        let telescope = self.telescope.clone();
        let Some(ranges) = self.stream(transaction, &gap.key, &gap.boot_id)? else { return Ok(0) };
        let (from_us, to_us) = ranges.around(gap.first, gap.last);
        let put = "INSERT INTO lost VALUES (?,?,?,?,?,?,?) ON CONFLICT DO NOTHING";
        let (first, last) = (gap.first as i64, gap.last as i64);
        let values = params![telescope, gap.key.to_string(), gap.boot_id.as_str(), first, last, from_us, to_us];
        transaction.prepare_cached(put)?.execute(values)?;
        // The stream is whole again after it, as far as it can be.
        let (from_us, to_us) = (from_us.or(to_us).unwrap_or_default(), to_us.or(from_us).unwrap_or_default());
        ranges.add(gap.first, Range { last: gap.last, from_us, to_us });
        Ok(0)
    }

    /// Writes how far the streams of the batch are whole, before it is committed.
    pub(super) fn write(&mut self, transaction: &Transaction<'_>) -> rusqlite::Result<()> {
        let mut put = transaction.prepare_cached(PUT_STREAM)?;
        for ((key, boot_id), ranges) in &self.batch {
            let Some((first, whole)) = ranges.0.first_key_value() else { continue };
            let (first, whole_to) = (*first as i64, whole.last as i64);
            let (key, boot_id) = (key.to_string(), boot_id.as_str());
            put.execute(params![self.telescope, key, boot_id, first, whole.from_us, whole_to, whole.to_us])?;
        }
        Ok(())
    }

    /// The batch is committed, or nothing of it is written.
    pub(super) fn end(&mut self, is_committed: bool) {
        let batch = std::mem::take(&mut self.batch);
        if is_committed {
            self.committed.extend(batch);
        }
    }

    fn stream(
        &mut self,
        transaction: &Transaction<'_>,
        key: &Key,
        boot_id: &BootId,
    ) -> rusqlite::Result<Option<&mut Ranges>> {
        let stream = (key.clone(), boot_id.clone());
        if !self.batch.contains_key(&stream) {
            let ranges = match self.committed.get(&stream) {
                Some(ranges) => ranges.clone(),
                None if self.committed.len() + self.batch.len() >= MOST_STREAMS => return Ok(None),
                None => find(transaction, &self.telescope, key, boot_id)?,
            };
            self.batch.insert(stream.clone(), ranges);
        }
        Ok(self.batch.get_mut(&stream))
    }
}

fn find(transaction: &Transaction<'_>, telescope: &str, key: &Key, boot_id: &BootId) -> rusqlite::Result<Ranges> {
    let of = params![telescope, key.to_string(), boot_id.as_str()];
    let row = transaction.prepare_cached(FIND_STREAM)?.query_row(of, |row| {
        let range = Range { last: row.get::<_, i64>(2)? as u64, from_us: row.get(1)?, to_us: row.get(3)? };
        Ok((row.get::<_, i64>(0)? as u64, range))
    });
    Ok(Ranges(row.optional()?.into_iter().collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(numbers: &[(u64, u64)]) -> Ranges {
        let mut ranges = Ranges::default();
        for (first, last) in numbers {
            ranges.add(*first, Range { last: *last, from_us: *first as i64, to_us: *last as i64 });
        }
        ranges
    }

    fn ranges(of: &Ranges) -> Vec<(u64, u64)> {
        of.0.iter().map(|(first, range)| (*first, range.last)).collect()
    }

    #[test]
    fn numbers_in_any_order_become_ranges_and_a_repeat_changes_nothing() {
        let all = of(&[(5, 5), (6, 6), (3, 3), (9, 9), (4, 4), (5, 5), (7, 8)]);
        assert_eq!(ranges(&all), [(3, 9)]);
        assert_eq!((all.0[&3].from_us, all.0[&3].to_us), (3, 9));
        assert_eq!(ranges(&of(&[(0, 3), (10, 12), (2, 11)])), [(0, 12)]);
        assert_eq!(ranges(&of(&[(0, 9), (3, 4)])), [(0, 9)]);
        let apart = of(&[(0, 3), (10, 12), (20, 20)]);
        assert_eq!((ranges(&apart), apart.around(4, 9)), (vec![(0, 3), (10, 12), (20, 20)], (Some(3), Some(10))));
        assert_eq!(of(&[(0, 3)]).around(4, 9), (Some(3), None));
        assert_eq!(ranges(&of(&[(u64::MAX, u64::MAX), (u64::MAX - 1, u64::MAX - 1)])), [(u64::MAX - 1, u64::MAX)]);
    }

    #[test]
    fn a_stranger_that_leaves_gaps_takes_no_memory() {
        let many: Vec<(u64, u64)> = (0..10_000).map(|number| (2 * number, 2 * number)).collect();
        assert_eq!(of(&many).0.len(), MOST_RANGES);
    }
}
