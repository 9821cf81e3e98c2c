//! What a telescope's nodes wrote down: the log, the audit and the corrections of guiding, asked of its archive.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::response::Response;
use contract::archive::{ArchiveQuestion, Ask};
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

/// Lines of the log, the oldest first.
pub async fn log(
    State(server): State<Arc<Server>>,
    Path(telescope): Path<(String, String)>,
    AskedFor(query): AskedFor<RecordsQuery>,
) -> Result<Response, Problem> {
    ask(&server, &telescope, Ask::Log, query).await
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
