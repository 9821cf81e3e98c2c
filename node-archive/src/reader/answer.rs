//! Answers to questions about the past of a telescope.

use contract::CommandId;
use contract::archive::{ArchiveAnswer, ArchiveQuestion, ArchiveRow, Ask, MOST_PROPERTIES, PastAlert, SeriesName};
use contract::node::Level;
use report::events::AlertRecord;
use rusqlite::{Row, params};
use units::Utc;

use super::night::{ALERTS, alert};
use super::{Reader, json, time, unreadable};
use crate::database::{DatabaseError, stamp};

/// Rows of an answer where the question has no limit, and at most.
const USUAL_LIMIT: u32 = 1000;
const HIGHEST_LIMIT: u32 = 100_000;
/// Before and after all times that can be stored.
pub(super) const EVER: (&str, &str) = ("", "~");
/// A question about series that does not say from when on begins so much earlier than it ends.
const DAY_S: f64 = 86_400.0;

/// What an answer says that lacks what took too long to find.
const TOO_LONG: &str = "the archive stopped looking after some seconds; ask for a shorter time (from_utc, to_utc), for a night, or \
                        with more conditions";

impl Reader {
    /// Answers a question with the newest rows that fit, oldest first.
    pub fn answer(&self, question: &ArchiveQuestion, now: Utc) -> Result<ArchiveAnswer, DatabaseError> {
        let limit = question.limit.unwrap_or(USUAL_LIMIT).min(HIGHEST_LIMIT);
        let between = (question.from_utc, question.to_utc);
        let mut answer = match &question.ask {
            Ask::Series { properties, points } => self.drawn(properties, between, *points, now)?,
            Ask::FindFrames(search) => {
                let found = self.search(search, between, limit as usize)?;
                let rows = found.frames.into_iter().chain(found.calibrating);
                let rows = rows.map(|frame| ArchiveRow::FoundFrame(Box::new(frame))).collect();
                ArchiveAnswer { rows, truncated: found.has_more, cut: None }
            }
            Ask::FindLog(search) => {
                let (lines, truncated) = self.log(search, between, limit as usize)?;
                ArchiveAnswer { rows: lines, truncated, cut: None }
            }
            plain => {
                // One row more than requested shows that there are more.
                let mut rows = self.newest_rows(plain, between, limit + 1)?;
                let truncated = rows.len() > limit as usize;
                rows.truncate(limit as usize);
                rows.reverse();
                ArchiveAnswer { rows, truncated, cut: None }
            }
        };
        if self.is_cut() {
            answer.truncated = true;
            answer.cut = Some(TOO_LONG.to_owned());
        }
        Ok(answer)
    }

    fn drawn(
        &self,
        properties: &[SeriesName],
        (from, to): (Option<Utc>, Option<Utc>),
        points: u32,
        now: Utc,
    ) -> Result<ArchiveAnswer, DatabaseError> {
        let to = to.unwrap_or(now);
        let from = from.unwrap_or(to.plus_seconds(-DAY_S));
        let rows = self.series(properties, (from, to), points, now)?;
        let count = properties.len();
        let cut = (count > MOST_PROPERTIES).then(|| {
            format!(
                "of {count} properties the first {MOST_PROPERTIES} are answered; ask for the others in questions of their own"
            )
        });
        Ok(ArchiveAnswer { rows, truncated: cut.is_some(), cut })
    }

    /// The newest rows of a kind, the newest first.
    fn newest_rows(
        &self,
        ask: &Ask,
        (from_utc, to_utc): (Option<Utc>, Option<Utc>),
        most: u32,
    ) -> Result<Vec<ArchiveRow>, DatabaseError> {
        let from = from_utc.map_or(EVER.0.to_owned(), stamp);
        let to = to_utc.map_or(EVER.1.to_owned(), stamp);
        let of = params![from, to, self.telescope, most];
        match ask {
            Ask::Readings { kind, device, property } => {
                let property = SeriesName { kind: *kind, device: device.clone(), property: property.clone() };
                self.readings(&property, (from_utc, to_utc), most)
            }
            Ask::Frames => self.list(
                "SELECT date_obs, frame_id, camera_name, file, complete_hdr FROM images
                 WHERE date_obs >= ? AND date_obs < ? AND telescope IN (?, '') ORDER BY date_obs DESC LIMIT ?",
                of,
                |row| {
                    Ok(ArchiveRow::Frame {
                        id: CommandId(row.get(1)?),
                        at_utc: time(row, 0)?,
                        camera: row.get(2)?,
                        file: row.get(3)?,
                        header_complete: row.get(4)?,
                    })
                },
            ),
            Ask::Log => self.list(
                "SELECT datetime, level, node, message FROM log
                 WHERE datetime >= ? AND datetime < ? AND telescope IN (?, 'shared') ORDER BY datetime DESC LIMIT ?",
                of,
                log_line,
            ),
            Ask::Audit => self.list(
                "SELECT line FROM audit WHERE fault IS NULL AND datetime >= ?1 AND datetime < ?2
                 AND (instr(node, '/' || ?3 || '/') > 0 OR instr(node, '/shared/') > 0)
                 ORDER BY datetime DESC, rowid DESC LIMIT ?4",
                of,
                |row| Ok(ArchiveRow::Audit(Box::new(json(row, 0)?))),
            ),
            Ask::Corrections => self.list(
                "SELECT correction FROM guiding
                 WHERE datetime >= ? AND datetime < ? AND telescope = ? ORDER BY datetime DESC LIMIT ?",
                of,
                |row| Ok(ArchiveRow::Correction(Box::new(json(row, 0)?))),
            ),
            Ask::Alerts => {
                let sql = format!("{ALERTS} ORDER BY raised DESC, id DESC LIMIT ?4");
                self.list(&sql, of, |row| Ok(ArchiveRow::Alert(past_alert(row)?)))
            }
            // They have answers of their own.
            Ask::Series { .. } | Ask::FindFrames(_) | Ask::FindLog(_) => Ok(Vec::new()),
        }
    }
}

fn past_alert(row: &Row<'_>) -> rusqlite::Result<PastAlert> {
    let AlertRecord { id, priority, raised_utc, cleared_utc, cause, acknowledged_by } = alert(row)?;
    let priority = serde_json::from_value(priority.into()).map_err(|error| unreadable(1, error))?;
    Ok(PastAlert { id, priority, raised_utc, cleared_utc, cause, acknowledged_by })
}

pub(super) fn log_line(row: &Row<'_>) -> rusqlite::Result<ArchiveRow> {
    let level: String = row.get(1)?;
    let level = match level.as_str() {
        "error" => Level::Error,
        "warning" => Level::Warn,
        _ => Level::Info,
    };
    Ok(ArchiveRow::Log { at_utc: time(row, 0)?, level, node: row.get(2)?, message: row.get(3)? })
}
