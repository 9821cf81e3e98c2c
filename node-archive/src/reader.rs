//! Asks the database; a reader never waits for the writer.

use std::path::{Path, PathBuf};

use audit::Link;
use contract::archive::{Answer, Ask, Question, Row};
use contract::node::Level;
use contract::{CommandId, Device, Scalar};
use rusqlite::config::DbConfig;
use rusqlite::{Connection, OpenFlags, OptionalExtension as _, params};
use units::Utc;

use crate::database::{DatabaseError, StoredFacts, StoredImage, stamp};
use crate::header::Around;
use crate::interpolate::Sample;

/// Rows of an answer where the question has no limit, and at most.
const USUAL_LIMIT: u32 = 1000;
const HIGHEST_LIMIT: u32 = 100_000;
/// Before and after all times that can be stored.
const EVER: (&str, &str) = ("", "~");

/// A read-only connection.
pub struct Reader {
    connection: Connection,
    path: PathBuf,
}

impl Reader {
    /// Opens a database that exists.
    pub fn open(path: &Path) -> Result<Self, DatabaseError> {
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let failed = |source| DatabaseError::Sqlite { what: "open", file: path.to_owned(), source };
        let connection = Connection::open_with_flags(path, flags).map_err(failed)?;
        connection.busy_timeout(std::time::Duration::from_secs(5)).map_err(failed)?;
        // Without this a statement is planned again at each use, which costs more than its rows.
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_QPSG, true).map_err(failed)?;
        connection.set_prepared_statement_cache_capacity(32);
        Ok(Self { connection, path: path.to_owned() })
    }

    /// Holds the database as it is now until the snapshot is dropped; many questions cost less under one.
    pub fn snapshot(&self) -> Result<rusqlite::Transaction<'_>, DatabaseError> {
        self.connection.unchecked_transaction().map_err(|source| self.failed(source))
    }

    /// The polls of a property around an instant.
    pub fn around(&self, device: &Device, property: &str, at: Utc) -> Result<Around, DatabaseError> {
        let find = |sql: &str| {
            let mut statement = self.connection.prepare_cached(sql)?;
            let (kind, telescope) = (device.kind.ascom(), device.address.telescope.as_str());
            let key = params![kind, device.name.as_str(), property, stamp(at), telescope];
            let row = statement.query_row(key, |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)));
            row.optional().map(|row| row.and_then(|(value, value_type, at)| sample(value, value_type, at)))
        };
        let key = "FROM polling WHERE device_type = ?1 AND device_name = ?2 AND device_command = ?3";
        let values = "SELECT device_value, value_type, datetime";
        let told = "AND telescope = ?5 AND device_value IS NOT NULL ORDER BY datetime";
        let look = || -> rusqlite::Result<Around> {
            let before = find(&format!("{values} {key} AND datetime < ?4 {told} DESC LIMIT 1"))?;
            let after = find(&format!("{values} {key} AND datetime >= ?4 {told} LIMIT 1"))?;
            let heard_since = after.is_some()
                || self
                    .connection
                    .prepare_cached(&format!("SELECT 1 {key} AND datetime >= ?4 AND telescope = ?5 LIMIT 1"))?
                    .exists(params![
                        device.kind.ascom(),
                        device.name.as_str(),
                        property,
                        stamp(at),
                        device.address.telescope.as_str()
                    ])?;
            Ok(Around { before, after, heard_since })
        };
        look().map_err(|source| self.failed(source))
    }

    /// Images whose headers are not complete, the oldest first.
    pub fn incomplete(&self, limit: u32) -> Result<Vec<StoredImage>, DatabaseError> {
        self.images("WHERE complete_hdr = 0 ORDER BY date_obs LIMIT ?1", params![limit])
    }

    /// The image of a frame, once it is stored.
    pub fn image(&self, frame: &CommandId) -> Result<Option<StoredImage>, DatabaseError> {
        Ok(self.images("WHERE frame_id = ?1", params![frame.0])?.pop())
    }

    /// Hands over the file of each image that is stored, relative to the folder of images.
    pub fn each_file(&self, mut take: impl FnMut(&str)) -> Result<(), DatabaseError> {
        let mut look = || -> rusqlite::Result<()> {
            let mut statement = self.connection.prepare("SELECT file FROM images")?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                take(row.get_ref(0)?.as_str()?);
            }
            Ok(())
        };
        look().map_err(|source| self.failed(source))
    }

    /// How many images are stored, and how many of them have complete headers.
    pub fn image_counts(&self) -> Result<(i64, i64), DatabaseError> {
        let counted = self.connection.query_row("SELECT count(*), total(complete_hdr) FROM images", [], |row| {
            Ok((row.get(0)?, row.get::<_, f64>(1)? as i64))
        });
        counted.map_err(|source| self.failed(source))
    }

    /// The facts that were measured on a frame.
    pub fn facts(&self, frame: &CommandId) -> Result<Option<StoredFacts>, DatabaseError> {
        let sql = "SELECT facts, datetime, boot_id, seq FROM facts WHERE frame_id = ?";
        let look = || self.connection.prepare_cached(sql)?.query_row([&frame.0], facts).optional();
        look().map_err(|source| self.failed(source))
    }

    /// Images with complete headers whose facts are not in them, because they came later.
    pub fn late_facts(&self, limit: u32) -> Result<Vec<(StoredImage, StoredFacts)>, DatabaseError> {
        let late = "JOIN facts USING (frame_id) WHERE in_header = 0 AND complete_hdr = 1 LIMIT ?1";
        let mut found = Vec::new();
        for image in self.images(late, params![limit])? {
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
        let look = || -> rusqlite::Result<Vec<(String, String)>> {
            let mut statement = self.connection.prepare("SELECT node, line FROM audit ORDER BY node, rowid")?;
            statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?.collect()
        };
        look().map_err(|source| self.failed(source))
    }

    /// Answers a question about the past with the newest rows that fit, oldest first.
    pub fn answer(&self, question: &Question) -> Result<Answer, DatabaseError> {
        let limit = question.limit.unwrap_or(USUAL_LIMIT).min(HIGHEST_LIMIT);
        let from = question.from_utc.map_or(EVER.0.to_owned(), stamp);
        let to = question.to_utc.map_or(EVER.1.to_owned(), stamp);
        // One row more than requested shows that there are more.
        let more = limit + 1;
        let rows = match &question.ask {
            Ask::Readings { kind, device, property } => self.rows(
                "SELECT datetime, device_value, value_type FROM polling WHERE device_type = ? AND device_name = ?
                 AND device_command = ? AND datetime >= ? AND datetime < ? ORDER BY datetime DESC LIMIT ?",
                params![kind.ascom(), device, property, from, to, more],
                |row| {
                    let value: Option<String> = row.get(1)?;
                    let value_type: String = row.get(2)?;
                    Ok(Row::Reading { at_utc: time(row, 0)?, value: value.and_then(|text| parse(&text, &value_type)) })
                },
            ),
            Ask::Frames => self.rows(
                "SELECT date_obs, frame_id, camera_name, file, complete_hdr FROM images
                 WHERE date_obs >= ? AND date_obs < ? ORDER BY date_obs DESC LIMIT ?",
                params![from, to, more],
                |row| {
                    Ok(Row::Frame {
                        id: CommandId(row.get(1)?),
                        at_utc: time(row, 0)?,
                        camera: row.get(2)?,
                        file: row.get(3)?,
                        header_complete: row.get(4)?,
                    })
                },
            ),
            Ask::Log => self.rows(
                "SELECT datetime, level, node, message FROM log WHERE datetime >= ? AND datetime < ?
                 ORDER BY datetime DESC LIMIT ?",
                params![from, to, more],
                |row| {
                    let level: String = row.get(1)?;
                    let level = match level.as_str() {
                        "error" => Level::Error,
                        "warning" => Level::Warn,
                        _ => Level::Info,
                    };
                    Ok(Row::Log { at_utc: time(row, 0)?, level, node: row.get(2)?, message: row.get(3)? })
                },
            ),
            Ask::Audit => self.rows(
                "SELECT line FROM audit WHERE fault IS NULL AND datetime >= ? AND datetime < ?
                 ORDER BY datetime DESC, rowid DESC LIMIT ?",
                params![from, to, more],
                |row| {
                    let line: String = row.get(0)?;
                    let record = serde_json::from_str(&line).map_err(|error| {
                        rusqlite::Error::FromSqlConversionFailure(0, rusqlite::types::Type::Text, Box::new(error))
                    })?;
                    Ok(Row::Audit(Box::new(record)))
                },
            ),
        };
        let mut rows = rows?;
        let truncated = rows.len() > limit as usize;
        rows.truncate(limit as usize);
        rows.reverse();
        Ok(Answer { rows, truncated })
    }

    fn rows(
        &self,
        sql: &str,
        params: &[&dyn rusqlite::ToSql],
        read: impl FnMut(&rusqlite::Row<'_>) -> rusqlite::Result<Row>,
    ) -> Result<Vec<Row>, DatabaseError> {
        let look = || -> rusqlite::Result<Vec<Row>> {
            self.connection.prepare_cached(sql)?.query_map(params, read)?.collect()
        };
        look().map_err(|source| self.failed(source))
    }

    /// The images that were begun last, the newest first.
    pub fn newest_images(&self, limit: u32) -> Result<Vec<StoredImage>, DatabaseError> {
        self.images("ORDER BY date_obs DESC LIMIT ?1", params![limit])
    }

    /// Lines of the nodes' diaries that begin so, the newest of them, in the order of time.
    pub fn diary(&self, begins: &str, limit: u32) -> Result<Vec<(Utc, String)>, DatabaseError> {
        let sql = "SELECT datetime, message FROM log WHERE substr(message, 1, ?1) = ?2 ORDER BY datetime DESC LIMIT ?3";
        let look = || -> rusqlite::Result<Vec<(Utc, String)>> {
            let mut statement = self.connection.prepare(sql)?;
            let letters = i64::try_from(begins.chars().count()).unwrap_or(i64::MAX);
            let found = statement.query_map(params![letters, begins, limit], |row| Ok((time(row, 0)?, row.get(1)?)))?;
            found.collect()
        };
        let mut lines = look().map_err(|source| self.failed(source))?;
        lines.reverse();
        Ok(lines)
    }

    fn images(&self, condition: &str, params: &[&dyn rusqlite::ToSql]) -> Result<Vec<StoredImage>, DatabaseError> {
        let sql = format!("SELECT frame, filename, file, bytes, stored FROM images {condition}");
        let look = || -> rusqlite::Result<Vec<StoredImage>> {
            let mut statement = self.connection.prepare_cached(&sql)?;
            let images = statement.query_map(params, |row| {
                let json: String = row.get(0)?;
                let frame = serde_json::from_str(&json).map_err(|e| {
                    rusqlite::Error::FromSqlConversionFailure(0, rusqlite::types::Type::Text, Box::new(e))
                })?;
                let path: String = row.get(1)?;
                let bytes: i64 = row.get(3)?;
                Ok(StoredImage {
                    frame,
                    path: path.into(),
                    file: row.get(2)?,
                    bytes: bytes.unsigned_abs(),
                    stored: time(row, 4)?,
                })
            })?;
            images.collect()
        };
        look().map_err(|source| self.failed(source))
    }

    fn failed(&self, source: rusqlite::Error) -> DatabaseError {
        DatabaseError::Sqlite { what: "ask", file: self.path.clone(), source }
    }
}

fn facts(row: &rusqlite::Row<'_>) -> rusqlite::Result<StoredFacts> {
    let (json, boot_id, seq): (String, String, i64) = (row.get(0)?, row.get(2)?, row.get(3)?);
    let read = |error| rusqlite::Error::FromSqlConversionFailure(0, rusqlite::types::Type::Text, Box::new(error));
    let boot_id = serde_json::from_value(boot_id.into()).map_err(read)?;
    let facts = serde_json::from_str(&json).map_err(read)?;
    Ok(StoredFacts { facts, at: time(row, 1)?, said: (boot_id, seq.unsigned_abs()) })
}

fn time(row: &rusqlite::Row<'_>, column: usize) -> rusqlite::Result<Utc> {
    let text: String = row.get(column)?;
    text.parse().map_err(|error: units::BadTime| {
        rusqlite::Error::FromSqlConversionFailure(column, rusqlite::types::Type::Text, Box::new(error))
    })
}

fn sample(value: String, value_type: String, at: String) -> Option<Sample> {
    Some(Sample { at: at.parse().ok()?, value: parse(&value, &value_type)? })
}

/// A value as it was before it became text.
fn parse(text: &str, value_type: &str) -> Option<Scalar> {
    Some(match value_type {
        "bool" => Scalar::Bool(text == "True"),
        "int" => Scalar::Int(text.parse().ok()?),
        "float" => Scalar::Float(text.parse().ok()?),
        "list" => serde_json::from_str(text).ok()?,
        _ => Scalar::Text(text.to_owned()),
    })
}
