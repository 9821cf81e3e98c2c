//! The tables, and how each thing becomes a row of one.

use contract::Scalar;
use contract::device::camera::Frame;
use contract::node::Level;
use rusqlite::{Transaction, params};
use units::Utc;

use super::Write;

/// The predecessor's tables with its columns first. Uniqueness makes a repeated message harmless.
pub(super) const SCHEMA: &str = "
CREATE TABLE polling (
    device_type TEXT NOT NULL, device_name TEXT NOT NULL, device_command TEXT NOT NULL,
    device_value TEXT, datetime TEXT NOT NULL,
    value_type TEXT NOT NULL, no_data TEXT, telescope TEXT NOT NULL, boot_id TEXT NOT NULL, seq INTEGER NOT NULL,
    UNIQUE (device_type, device_name, device_command, datetime, telescope)
);
CREATE TABLE images (
    filename TEXT NOT NULL, camera_name TEXT NOT NULL, complete_hdr INTEGER NOT NULL, date_obs TEXT NOT NULL,
    frame_id TEXT NOT NULL UNIQUE, file TEXT NOT NULL, sha256 TEXT NOT NULL, bytes INTEGER NOT NULL,
    stored TEXT NOT NULL, frame TEXT NOT NULL
);
CREATE INDEX images_incomplete ON images (date_obs) WHERE complete_hdr = 0;
CREATE INDEX images_date ON images (date_obs);
CREATE TABLE writing (frame_id TEXT PRIMARY KEY, file TEXT NOT NULL);
CREATE TABLE log (
    datetime TEXT NOT NULL, level TEXT NOT NULL, message TEXT NOT NULL,
    node TEXT NOT NULL, target TEXT NOT NULL, telescope TEXT NOT NULL, boot_id TEXT NOT NULL, seq INTEGER NOT NULL,
    UNIQUE (boot_id, seq, node)
);
CREATE INDEX log_date ON log (datetime);
";

/// What version 2 adds. A record counts once; two that claim one place in a chain are both kept, as evidence.
pub(super) const AUDIT: &str = "
CREATE TABLE audit (
    node TEXT NOT NULL, chain TEXT NOT NULL, number INTEGER NOT NULL, datetime TEXT,
    who TEXT NOT NULL, device TEXT NOT NULL, verb TEXT NOT NULL, token INTEGER, outcome TEXT NOT NULL,
    line TEXT NOT NULL, sha256 TEXT NOT NULL, fault TEXT,
    UNIQUE (node, chain, number, sha256)
);
CREATE INDEX audit_date ON audit (datetime);
";

/// Writes one thing; returns how many rows were new.
pub(super) fn write(transaction: &Transaction<'_>, write: &Write) -> rusqlite::Result<usize> {
    match write {
        Write::Reading { device, property, value, at, said: (boot_id, seq) } => {
            let (value_type, text, no_data) = match value {
                Ok(value) => (type_of(value), Some(to_text(value)), None),
                Err(reason) => ("none", None, Some(reason)),
            };
            transaction
                .prepare_cached("INSERT INTO polling VALUES (?,?,?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING")?
                .execute(params![
                    device.kind.ascom(),
                    device.name.as_str(),
                    property,
                    text,
                    stamp(*at),
                    value_type,
                    no_data,
                    device.address.telescope.as_str(),
                    boot_id.as_str(),
                    *seq as i64,
                ])
        }
        Write::Log { telescope, node, target, level, message, at, said: (boot_id, seq) } => {
            let level = match level {
                Level::Error => "error",
                Level::Warn => "warning",
                Level::Info => "info",
            };
            transaction
                .prepare_cached("INSERT INTO log VALUES (?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING")?
                .execute(params![stamp(*at), level, message, node, target, telescope, boot_id.as_str(), *seq as i64])
        }
        Write::Writing { frame, file } => transaction
            .prepare_cached("INSERT OR REPLACE INTO writing VALUES (?,?)")?
            .execute(params![frame.0, file])
            .map(|_| 0),
        Write::Stored(image) => {
            // the token in the URL opens the frame in the spool and is nobody else's business
            let frame = Frame { url: String::new(), ..image.frame.clone() };
            let json =
                serde_json::to_string(&frame).map_err(|e| rusqlite::Error::ToSqlConversionFailure(Box::new(e)))?;
            transaction.prepare_cached("DELETE FROM writing WHERE frame_id = ?")?.execute([&frame.id.0])?;
            transaction
                .prepare_cached("INSERT INTO images VALUES (?,?,0,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING")?
                .execute(params![
                    image.path.to_string_lossy(),
                    frame.camera,
                    stamp(frame.started_utc),
                    frame.id.0,
                    image.file,
                    frame.sha256,
                    image.bytes as i64,
                    stamp(image.stored),
                    json,
                ])
        }
        Write::Audit(record) => transaction
            .prepare_cached("INSERT INTO audit VALUES (?,?,?,?,?,?,?,?,?,?,?,?) ON CONFLICT DO NOTHING")?
            .execute(params![
                record.node,
                record.chain,
                record.number,
                record.at.map(stamp),
                record.from,
                record.device,
                record.verb,
                record.token,
                record.outcome,
                record.line,
                record.sha256,
                record.fault,
            ]),
        Write::Complete(frame) => transaction
            .prepare_cached("UPDATE images SET complete_hdr = 1 WHERE frame_id = ?")?
            .execute([&frame.0])
            .map(|_| 0),
    }
}

/// A time as the predecessor's tables have it, which sorts as text.
pub fn stamp(at: Utc) -> String {
    at.strftime("%Y-%m-%d %H:%M:%S.%6f")
}

fn type_of(value: &Scalar) -> &'static str {
    match value {
        Scalar::Bool(_) => "bool",
        Scalar::Int(_) => "int",
        Scalar::Float(_) => "float",
        Scalar::Text(_) => "text",
        Scalar::List(_) => "list",
    }
}

fn to_text(value: &Scalar) -> String {
    match value {
        Scalar::Bool(true) => "True".to_owned(),
        Scalar::Bool(false) => "False".to_owned(),
        Scalar::Float(number) => format!("{number:?}"),
        Scalar::Int(_) | Scalar::Text(_) => value.to_string(),
        Scalar::List(_) => serde_json::to_string(value).unwrap_or_default(),
    }
}
