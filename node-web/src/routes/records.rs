//! What a telescope's nodes wrote down: the log, searched, the audit and the corrections of guiding, asked of its archive.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::response::Response;
use contract::archive::{ArchiveQuestion, Ask};
use contract::log_search::LogSearch;
use contract::node::Level;
use schemars::JsonSchema;
use serde::Deserialize;
use units::Utc;

use crate::json_body::AskedFor;
use crate::problem::Problem;
use crate::routes::history::ask_archive;
use crate::server::Server;

/// Which rows.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordsQuery {
    /// From this sky time on.
    from_utc: Option<Utc>,
    /// Before this sky time: to go back, ask again with the oldest time of the answer.
    to_utc: Option<Utc>,
    /// At most so many, the newest; 1000 where absent.
    #[schemars(range(max = 100_000))]
    limit: Option<u32>,
}

/// The longest text that is looked for, bytes.
const LONGEST_TEXT: usize = 200;

/// Which lines of the log.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogQuery {
    /// A part of what it says, at most 200 bytes; upper and lower case of ASCII letters are the same.
    text: Option<String>,
    /// At least so urgent: `warn` also finds errors.
    level: Option<Level>,
    /// Role and id of the node, such as `device/enclosure`; a role alone is each node of it.
    node: Option<String>,
    /// Half of the lines before this sky time, and half of them from it on.
    around_utc: Option<Utc>,
    /// The oldest lines instead of the newest, where they are more than the limit: to read on from `from_utc`.
    #[serde(default)]
    oldest: bool,
    /// From this sky time on.
    from_utc: Option<Utc>,
    /// Before this sky time: to go back, ask again with the oldest time of the answer.
    to_utc: Option<Utc>,
    /// At most so many; 1000 where absent. Lines of one instant are never parted: an answer may have some more.
    #[schemars(range(max = 100_000))]
    limit: Option<u32>,
}

/// Lines of the log, the oldest first.
pub async fn log(
    State(server): State<Arc<Server>>,
    Path(telescope): Path<(String, String)>,
    AskedFor(query): AskedFor<LogQuery>,
) -> Result<Response, Problem> {
    let LogQuery { text, level, node, around_utc, oldest, from_utc, to_utc, limit } = query;
    if let Some(text) = text.as_ref().filter(|text| text.len() > LONGEST_TEXT) {
        let bytes = text.len();
        return Err(Problem::malformed(format!("text: expected at most {LONGEST_TEXT} bytes, found {bytes}.")));
    }
    if around_utc.is_some() && oldest {
        return Err(Problem::malformed("oldest: expected no around_utc beside it, which takes both sides."));
    }
    let ask = Ask::FindLog(Box::new(LogSearch { text, level, node, around_utc, oldest }));
    ask_archive(&server, &telescope, &ArchiveQuestion { ask, from_utc, to_utc, limit }).await
}

/// Records of the audit, the oldest first.
pub async fn audit(
    State(server): State<Arc<Server>>,
    Path(telescope): Path<(String, String)>,
    AskedFor(query): AskedFor<RecordsQuery>,
) -> Result<Response, Problem> {
    ask(&server, &telescope, Ask::Audit, query).await
}

/// Corrections of the guide loop, the oldest first.
pub async fn corrections(
    State(server): State<Arc<Server>>,
    Path(telescope): Path<(String, String)>,
    AskedFor(query): AskedFor<RecordsQuery>,
) -> Result<Response, Problem> {
    ask(&server, &telescope, Ask::Corrections, query).await
}

async fn ask(
    server: &Server,
    telescope: &(String, String),
    ask: Ask,
    query: RecordsQuery,
) -> Result<Response, Problem> {
    let RecordsQuery { from_utc, to_utc, limit } = query;
    ask_archive(server, telescope, &ArchiveQuestion { ask, from_utc, to_utc, limit }).await
}
