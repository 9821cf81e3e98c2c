//! Asks the database; a reader never waits for the writer.

mod answer;
mod log;
mod night;
mod search;
mod telemetry;

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use audit::Link;
use contract::device::camera::Frame;
use contract::{BootId, CommandId, Key};
use rusqlite::config::DbConfig;
use rusqlite::{Connection, ErrorCode, OptionalExtension as _, Row, params};
use serde::de::DeserializeOwned;
use units::Utc;

pub use search::{FoundFrames, IMAGE_TYPES};

use crate::database::{DatabaseError, StoredFacts, StoredImage, holding, read_only, stamp};
use crate::night::NightFrame;

/// What [`image`] reads, and whether the header is complete.
const IMAGES: &str = "SELECT file, frame, bytes, stored, complete_hdr FROM images";
/// Steps of SQLite's machine between two looks at the clock: some 0.1 ms.
const STEPS_BETWEEN_LOOKS: i32 = 10_000;

/// A read-only connection that sees what one telescope has, and what has no known owner: rows that an older Starmesh wrote
/// into a database of several telescopes.
pub struct Reader {
    connection: Connection,
    path: PathBuf,
    telescope: String,
    is_over: Option<IsOver>,
    is_cut: Cell<bool>,
}

/// A frame by which a telescope was held.
#[derive(Debug, Clone, PartialEq)]
pub struct GuidedFrame {
    /// Its id.
    pub id: String,
    /// The camera that guided.
    pub camera: String,
    /// Its binning; absent where the frame is not stored.
    pub bin: Option<u32>,
    /// How far its stars were from those of the reference, px of the frame.
    pub off_px: f64,
}

/// Is there no time left to look?
type IsOver = Arc<dyn Fn() -> bool + Send + Sync>;

impl Reader {
    /// Opens a database that exists, for the rows of a telescope.
    pub fn open(path: &Path, telescope: &str) -> Result<Self, DatabaseError> {
        let failed = |source| DatabaseError::Sqlite { what: "open", file: path.to_owned(), source };
        let connection = read_only(path).map_err(failed)?;
        // Without this a statement is planned again at each use, which costs more than its rows.
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_QPSG, true).map_err(failed)?;
        connection.set_prepared_statement_cache_capacity(32);
        let (path, telescope) = (path.to_owned(), telescope.to_owned());
        Ok(Self { connection, path, telescope, is_over: None, is_cut: Cell::new(false) })
    }

    /// A reader that stops looking at an instant: what it had found until then is then all, and [`Self::is_cut`].
    pub fn until(self, deadline: Instant) -> Result<Self, DatabaseError> {
        self.while_not(move || Instant::now() >= deadline)
    }

    /// As [`Self::until`], for any sign that time is over.
    fn while_not(mut self, is_over: impl Fn() -> bool + Send + Sync + 'static) -> Result<Self, DatabaseError> {
        let is_over: IsOver = Arc::new(is_over);
        let looked = is_over.clone();
        let set = self.connection.progress_handler(STEPS_BETWEEN_LOOKS, Some(move || looked()));
        set.map_err(|source| self.failed(source))?;
        self.is_over = Some(is_over);
        Ok(self)
    }

    /// Time was over before everything was looked at.
    pub fn is_cut(&self) -> bool {
        self.is_cut.get()
    }

    /// Holds the database as it is now until the snapshot is dropped; many questions cost less under one.
    pub fn snapshot(&self) -> Result<rusqlite::Transaction<'_>, DatabaseError> {
        self.connection.unchecked_transaction().map_err(|source| self.failed(source))
    }

    /// Images whose headers are not complete, the oldest first.
    pub fn incomplete(&self, limit: u32) -> Result<Vec<StoredImage>, DatabaseError> {
        self.images(
            "WHERE complete_hdr = 0 AND telescope IN (?1, '') ORDER BY date_obs LIMIT ?2",
            params![self.telescope, limit],
        )
    }

    /// The image of a frame, once it is stored.
    pub fn image(&self, frame: &CommandId) -> Result<Option<StoredImage>, DatabaseError> {
        Ok(self.images("WHERE frame_id = ?1", params![frame.0])?.pop())
    }

    /// Hands over the file of each image that is stored: relative to the folder of images, of another telescope its whole path.
    pub fn each_file(&self, mut take: impl FnMut(&str)) -> Result<(), DatabaseError> {
        let sql = "SELECT iif(telescope IN (?1, ''), file, filename) FROM images";
        self.each_row(sql, params![self.telescope], |row| {
            take(row.get_ref(0)?.as_str()?);
            Ok(true)
        })
    }

    /// How many images are stored, and how many of them have complete headers.
    pub fn image_counts(&self) -> Result<(i64, i64), DatabaseError> {
        let sql = "SELECT count(*), total(complete_hdr) FROM images WHERE telescope IN (?1, '')";
        let counted =
            self.connection.query_row(sql, [&self.telescope], |row| Ok((row.get(0)?, row.get::<_, f64>(1)? as i64)));
        counted.map_err(|source| self.failed(source))
    }

    /// Of the newest streams of samples: incarnation, key, and the first and the last number of those that are stored.
    pub fn streams(&self) -> Result<Vec<(BootId, Key, u64, u64)>, DatabaseError> {
        let sql = "SELECT boot_id, key, first, whole_to FROM streams WHERE telescope = ?
            ORDER BY whole_us DESC LIMIT 4096";
        let look = || -> rusqlite::Result<Vec<(String, String, i64, i64)>> {
            let mut statement = self.connection.prepare(sql)?;
            statement
                .query_map([&self.telescope], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)))?
                .collect()
        };
        let rows = look().map_err(|source| self.failed(source))?;
        let stream = |(boot_id, key, first, last): (String, String, i64, i64)| {
            Some((BootId::try_from(boot_id).ok()?, Key::parse(&key)?, first as u64, last as u64))
        };
        Ok(rows.into_iter().filter_map(stream).collect())
    }

    /// Days of which polled values are kept.
    pub fn days_of_values(&self) -> Result<u32, DatabaseError> {
        let counted = self.connection.query_row("SELECT count(*) FROM days", [], |row| row.get(0));
        counted.map_err(|source| self.failed(source))
    }

    /// The facts that were measured on a frame.
    pub fn facts(&self, frame: &CommandId) -> Result<Option<StoredFacts>, DatabaseError> {
        let sql = "SELECT facts, datetime, boot_id, seq FROM facts WHERE frame_id = ?";
        let look = || self.connection.prepare_cached(sql)?.query_row([&frame.0], facts).optional();
        look().map_err(|source| self.failed(source))
    }

    /// The guided frames by which a telescope was held during the exposure of a frame: of one camera.
    pub fn guided_frames(&self, telescope: &str, frame: &Frame) -> Result<Vec<GuidedFrame>, DatabaseError> {
        Ok(self.guided_frames_of(telescope, &[frame])?.into_iter().map(|(_, guided)| guided).collect())
    }

    /// The same of several frames in one question, each with the place in the list of the frame that it held, in the order
    /// of the list.
    fn guided_frames_of(&self, telescope: &str, frames: &[&Frame]) -> Result<Vec<(usize, GuidedFrame)>, DatabaseError> {
        let sql = concat!(
            "SELECT held.frame_id AS place, guide_id, camera, shift_x, shift_y,
                iif(json_valid(images.frame), json_extract(images.frame, '$.bin'), NULL) AS bin FROM (",
            holding!(
                "(SELECT key AS frame_id, ?1 AS telescope, value ->> 0 AS camera_name, value ->> 1 AS begins,
                    value ->> 2 AS ends FROM json_each(?2))"
            ),
            ") AS held LEFT JOIN images ON images.frame_id = guide_id ORDER BY place, guide_id"
        );
        let span = |frame: &&Frame| {
            let ends = frame.started_utc.plus_seconds(frame.exposure_s);
            serde_json::json!([frame.camera, stamp(frame.started_utc), stamp(ends)])
        };
        let spans = serde_json::Value::from_iter(frames.iter().map(span)).to_string();
        self.list(sql, params![telescope, spans], |row| {
            let (x_px, y_px): (f64, f64) = (row.get("shift_x")?, row.get("shift_y")?);
            let (id, camera, bin) = (row.get("guide_id")?, row.get("camera")?, row.get("bin")?);
            Ok((row.get::<_, u32>("place")? as usize, GuidedFrame { id, camera, bin, off_px: x_px.hypot(y_px) }))
        })
    }

    /// Whether guiding looked at a frame of a telescope that was in the middle of its exposure in a span of time.
    pub fn is_guided(&self, telescope: &str, (from, to): (Utc, Utc)) -> Result<bool, DatabaseError> {
        let sql = "SELECT EXISTS (SELECT 1 FROM guiding WHERE datetime >= ? AND datetime <= ? AND telescope = ?)";
        Ok(self.list(sql, params![stamp(from), stamp(to), telescope], |row| row.get::<_, bool>(0))?.contains(&true))
    }

    /// Images with complete headers whose facts are not in them, because they came later.
    pub fn late_facts(&self, limit: u32) -> Result<Vec<(StoredImage, StoredFacts)>, DatabaseError> {
        let late = "JOIN facts USING (frame_id)
                    WHERE in_header = 0 AND complete_hdr = 1 AND images.telescope IN (?1, '') LIMIT ?2";
        let mut found = Vec::new();
        for image in self.images(late, params![self.telescope, limit])? {
            let facts = self.facts(&image.frame.id)?;
            found.extend(facts.map(|facts| (image, facts)));
        }
        Ok(found)
    }

    /// The name that a frame's file was about to get, relative to the folder of images, when a kill came.
    pub fn writing(&self, frame: &CommandId) -> Result<Option<String>, DatabaseError> {
        let found =
            self.connection.query_row("SELECT file FROM writing WHERE frame_id = ?", [&frame.0], |row| row.get(0));
        found.optional().map_err(|source| self.failed(source))
    }

    /// The end of a node's audit as it was stored last.
    pub fn audit_end(&self, node: &str) -> Result<Option<Link>, DatabaseError> {
        let sql = "SELECT chain, number, sha256 FROM audit WHERE node = ? ORDER BY rowid DESC LIMIT 1";
        let found = self.connection.query_row(sql, [node], |row| {
            let number: i64 = row.get(1)?;
            Ok(Link { chain: row.get(0)?, number: number.unsigned_abs(), sha256: row.get(2)? })
        });
        found.optional().map_err(|source| self.failed(source))
    }

    /// Every record of the audit as its node wrote it, with the node, by node in the order of storing.
    pub fn audit_lines(&self) -> Result<Vec<(String, String)>, DatabaseError> {
        self.list("SELECT node, line FROM audit ORDER BY node, rowid", params![], |row| Ok((row.get(0)?, row.get(1)?)))
    }

    /// The frames whose exposures began in a span of time, the oldest first.
    ///
    /// # Errors
    /// The database cannot be read, or one of them cannot: a night is not handed over without it.
    pub fn frames(&self, from: Utc, to: Utc) -> Result<Vec<NightFrame>, DatabaseError> {
        let mut unreadable = Unreadable::new();
        let frames = self.readable_frames((from, to), &mut unreadable)?;
        unreadable.into_iter().next().map_or(Ok(frames), |(_, error)| Err(self.failed(error)))
    }

    /// The same, without those that cannot be read.
    fn readable_frames(
        &self,
        (from, to): (Utc, Utc),
        unreadable: &mut Unreadable,
    ) -> Result<Vec<NightFrame>, DatabaseError> {
        let _snapshot = self.snapshot()?;
        let sql =
            format!("{IMAGES} WHERE date_obs >= ?1 AND date_obs < ?2 AND telescope IN (?3, '') ORDER BY date_obs");
        let of = params![stamp(from), stamp(to), self.telescope];
        let images = self.readable(("the frame", &sql), of, unreadable, |row| Ok((image(row)?, row.get(4)?)))?;
        let mut frames = Vec::with_capacity(images.len());
        for (image, is_complete) in images {
            let facts = match self.facts(&image.frame.id) {
                Err(DatabaseError::Sqlite { source, .. }) if is_unreadable(&source) => {
                    unreadable.push((format!("the facts of the frame {}", image.file), source));
                    None
                }
                facts => facts?.map(|stored| stored.facts),
            };
            frames.push(NightFrame { image, is_complete, facts });
        }
        Ok(frames)
    }

    /// How many frames began in a span of time.
    pub fn count_frames(&self, from: Utc, to: Utc) -> Result<u64, DatabaseError> {
        let sql = "SELECT count(*) FROM images WHERE date_obs >= ?1 AND date_obs < ?2 AND telescope IN (?3, '')";
        let of = params![stamp(from), stamp(to), self.telescope];
        let counted = self.connection.query_row(sql, of, |row| row.get::<_, i64>(0));
        counted.map(i64::unsigned_abs).map_err(|source| self.failed(source))
    }

    /// When the first and the last stored frame began; absent where there is none.
    pub fn span_of_frames(&self) -> Result<Option<(Utc, Utc)>, DatabaseError> {
        let look = || {
            let sql = "SELECT min(date_obs), max(date_obs) FROM images WHERE telescope IN (?1, '')";
            self.connection.query_row(sql, [&self.telescope], |row| {
                let has_any = row.get_ref(0)? != rusqlite::types::ValueRef::Null;
                has_any.then(|| Ok((time(row, 0)?, time(row, 1)?))).transpose()
            })
        };
        look().map_err(|source| self.failed(source))
    }

    /// The images that were begun last, the newest first.
    pub fn newest_images(&self, limit: u32) -> Result<Vec<StoredImage>, DatabaseError> {
        self.images("WHERE telescope IN (?1, '') ORDER BY date_obs DESC LIMIT ?2", params![self.telescope, limit])
    }

    /// Lines of the nodes' diaries that begin so, the newest of them, in the order of time.
    pub fn diary(&self, begins: &str, limit: u32) -> Result<Vec<(Utc, String)>, DatabaseError> {
        let sql = "SELECT datetime, message FROM log WHERE substr(message, 1, ?1) = ?2 AND telescope IN (?3, 'shared')
                   ORDER BY datetime DESC LIMIT ?4";
        let letters = i64::try_from(begins.chars().count()).unwrap_or(i64::MAX);
        let mut lines =
            self.list(sql, params![letters, begins, self.telescope, limit], |row| Ok((time(row, 0)?, row.get(1)?)))?;
        lines.reverse();
        Ok(lines)
    }

    fn images(&self, condition: &str, params: &[&dyn rusqlite::ToSql]) -> Result<Vec<StoredImage>, DatabaseError> {
        self.list(&format!("{IMAGES} {condition}"), params, image)
    }

    /// Every row that a question gives.
    fn list<T>(
        &self,
        sql: &str,
        params: &[&dyn rusqlite::ToSql],
        mut read: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Vec<T>, DatabaseError> {
        let mut found = Vec::new();
        self.each_row(sql, params, |row| {
            found.push(read(row)?);
            Ok(true)
        })?;
        Ok(found)
    }

    /// Every row that can be read; the others are named by their first column.
    fn readable<T>(
        &self,
        (what, sql): (&str, &str),
        params: &[&dyn rusqlite::ToSql],
        unreadable: &mut Unreadable,
        mut read: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Vec<T>, DatabaseError> {
        let mut found = Vec::new();
        self.each_row(sql, params, |row| {
            match read(row) {
                Ok(one) => found.push(one),
                Err(error) if is_unreadable(&error) => {
                    unreadable.push((format!("{what} {}", row.get::<_, String>(0).unwrap_or_default()), error));
                }
                Err(error) => return Err(error),
            }
            Ok(true)
        })?;
        Ok(found)
    }

    /// Hands over row by row, until `take` returns false or time is over.
    fn each_row(
        &self,
        sql: &str,
        params: &[&dyn rusqlite::ToSql],
        mut take: impl FnMut(&Row<'_>) -> rusqlite::Result<bool>,
    ) -> Result<(), DatabaseError> {
        let mut look = || -> rusqlite::Result<()> {
            let mut statement = self.connection.prepare_cached(sql)?;
            let mut rows = statement.query(params)?;
            while let Some(row) = rows.next()? {
                // What is done with a row may take longer than to find it.
                if self.is_over.as_ref().is_some_and(|is_over| is_over()) {
                    self.is_cut.set(true);
                    break;
                }
                if !take(row)? {
                    break;
                }
            }
            Ok(())
        };
        match look() {
            Err(error) if error.sqlite_error_code() == Some(ErrorCode::OperationInterrupted) => {
                self.is_cut.set(true);
                Ok(())
            }
            looked => looked.map_err(|source| self.failed(source)),
        }
    }

    fn failed(&self, source: rusqlite::Error) -> DatabaseError {
        DatabaseError::Sqlite { what: "ask", file: self.path.clone(), source }
    }
}

fn facts(row: &Row<'_>) -> rusqlite::Result<StoredFacts> {
    let (boot_id, seq): (String, i64) = (row.get(2)?, row.get(3)?);
    let boot_id = serde_json::from_value(boot_id.into()).map_err(|error| unreadable(2, error))?;
    Ok(StoredFacts { facts: json(row, 0)?, at: time(row, 1)?, origin: (boot_id, seq.unsigned_abs()) })
}

/// Rows that cannot be read: which, and why.
type Unreadable = Vec<(String, rusqlite::Error)>;

/// The row is there, and something in it is not as this program writes it.
fn is_unreadable(error: &rusqlite::Error) -> bool {
    use rusqlite::Error::{FromSqlConversionFailure, IntegralValueOutOfRange, InvalidColumnType};
    matches!(error, FromSqlConversionFailure(..) | IntegralValueOutOfRange(..) | InvalidColumnType(..))
}

fn image(row: &Row<'_>) -> rusqlite::Result<StoredImage> {
    let bytes: i64 = row.get(2)?;
    Ok(StoredImage { file: row.get(0)?, frame: json(row, 1)?, bytes: bytes.unsigned_abs(), stored: time(row, 3)? })
}

fn json<T: DeserializeOwned>(row: &Row<'_>, column: usize) -> rusqlite::Result<T> {
    serde_json::from_str(row.get_ref(column)?.as_str()?).map_err(|error| unreadable(column, error))
}

fn unreadable(column: usize, error: impl std::error::Error + Send + Sync + 'static) -> rusqlite::Error {
    rusqlite::Error::FromSqlConversionFailure(column, rusqlite::types::Type::Text, Box::new(error))
}

fn time(row: &Row<'_>, column: usize) -> rusqlite::Result<Utc> {
    let text: String = row.get(column)?;
    text.parse().map_err(|error: units::BadTime| unreadable(column, error))
}
