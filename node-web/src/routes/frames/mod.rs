//! Frames that the archive stores, each by its id: what is known of it, its header and file ([`file`]), pictures and values of
//! its pixels ([`pictures`]). All is asked of the telescope's archive, which has the files.

pub mod file;
pub mod pictures;

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bus::AskError;
use contract::archive::{ArchiveAnswer, ArchiveQuestion, ArchiveRow, Ask};
use contract::archived_frame::{ArchiveRefusal, FrameAnswer, FrameAsk, FrameGiven, FrameQuestion, NotGiven};
use contract::frame_search::FrameSearch;
use contract::{CommandId, Key};

use crate::problem::{Code, Problem};
use crate::routes::network::known;
use crate::server::Server;

/// The archive answers within this time.
pub const TIMEOUT: Duration = Duration::from_secs(10);
/// A client of a busy archive asks again after so long, s.
const RETRY_AFTER_S: &str = "5";
/// What never changes: the pixels of a frame.
const IMMUTABLE: &str = "private, max-age=31536000, immutable";
/// What may change: the header of a file is completed. The client asks whether its copy is still right.
const REVALIDATED: &str = "private, no-cache";

/// The telescope and the frame that an address names.
pub type FramePath = Path<(String, String, String)>;

/// One frame with what was measured.
pub async fn one(
    State(server): State<Arc<Server>>,
    Path((site, telescope, id)): FramePath,
) -> Result<Response, Problem> {
    match ask(&server, (&site, &telescope, &id), FrameAsk::About).await? {
        FrameGiven::About(details) => Ok(([(header::CACHE_CONTROL, "no-store")], Json(details)).into_response()),
        _ => Err(strange()),
    }
}

/// The newest frame of a camera.
pub async fn latest(
    State(server): State<Arc<Server>>,
    Path((site, telescope, camera)): FramePath,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let search = FrameSearch { camera: Some(camera.clone()), ..FrameSearch::default() };
    let ask_for = Ask::FindFrames(Box::new(search));
    let question = ArchiveQuestion { ask: ask_for, from_utc: None, to_utc: None, limit: Some(1) };
    let answer: Result<ArchiveAnswer, _> = server.bus.ask(&Key::History(address), &question, TIMEOUT).await;
    let answer = answer.map_err(|error| silent(&site, &telescope, &error))?;
    match answer.rows.last() {
        Some(ArchiveRow::FoundFrame(frame)) => one(State(server), Path((site, telescope, frame.id.0.clone()))).await,
        _ if answer.cut.is_some() => Err(busy("the archive did not look at all frames")),
        _ => Err(Problem::not_found(format!("No frame of a camera {camera:?} of {site}/{telescope} is stored."))),
    }
}

/// Asks the archive about a frame.
async fn ask(server: &Server, (site, telescope, id): (&str, &str, &str), ask: FrameAsk) -> Result<FrameGiven, Problem> {
    let address = known(&server.network, site, telescope)?;
    let frame =
        CommandId::try_from(id.to_owned()).map_err(|error| Problem::not_found(format!("No such frame: {error}.")))?;
    let question = FrameQuestion { frame, ask };
    let answer: Result<FrameAnswer, _> = server.bus.ask(&Key::ArchivedFrame(address), &question, TIMEOUT).await;
    match answer.map_err(|error| silent(site, telescope, &error))?.gives {
        FrameGiven::Refused(refusal) => Err(problem(&refusal)),
        given => Ok(given),
    }
}

/// The archive is away.
pub fn silent(site: &str, telescope: &str, error: &AskError) -> Problem {
    let detail = format!(
        "The archive of {site}/{telescope} did not answer ({error}). Look whether its archive node runs, or ask again."
    );
    Problem::new(Code::Archive, "The archive does not answer", detail)
}

/// What an archive does not give, as a problem.
pub fn problem(refusal: &ArchiveRefusal) -> Problem {
    let detail = format!("{}.", refusal.detail.trim_end_matches('.'));
    match refusal.reason {
        NotGiven::Unknown => Problem::not_found(detail),
        NotGiven::FileAway => Problem::new(Code::FileAway, "The file is away", detail),
        NotGiven::FileDamaged => Problem::new(Code::FileDamaged, "The file cannot be read", detail),
        NotGiven::OutOfRange | NotGiven::TooLarge => Problem::invalid(detail),
        NotGiven::Busy => busy(&detail),
        NotGiven::Malformed => {
            Problem::invalid(format!("{detail} The archive node may be older than this web node: update it."))
        }
        NotGiven::Failed => Problem::new(Code::Archive, "The archive failed", detail),
    }
}

fn busy(detail: &str) -> Problem {
    Problem::new(Code::Busy, "The archive is busy", detail).with_header(header::RETRY_AFTER, RETRY_AFTER_S)
}

/// The archive answered another question than the one that was asked.
fn strange() -> Problem {
    Problem::new(
        Code::Archive,
        "The archive failed",
        "The archive answered another question than the one that was asked.",
    )
}

/// Has the caller what this tag names?
fn has(headers: &HeaderMap, tag: &str) -> bool {
    let known = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|known| known.to_str().ok());
    let mut tags = known.flat_map(|known| known.split(',')).map(|known| known.trim());
    // Weak comparison, which is enough for what is not changed (RFC 9110, section 13.1.2).
    tags.any(|known| known == "*" || known.strip_prefix("W/").unwrap_or(known) == tag)
}

/// The caller has it.
fn not_modified(tag: &str, caching: &str) -> Response {
    (StatusCode::NOT_MODIFIED, [(header::ETAG, tag), (header::CACHE_CONTROL, caching)]).into_response()
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    #[test]
    fn a_caller_has_what_one_of_its_tags_names() {
        let of = |text: &str| HeaderMap::from_iter([(header::IF_NONE_MATCH, HeaderValue::from_str(text).unwrap())]);
        assert!(has(&of("\"a\""), "\"a\"") && has(&of("\"b\", W/\"a\""), "\"a\"") && has(&of("*"), "\"a\""));
        assert!(!has(&of("\"b\""), "\"a\"") && !has(&of("a"), "\"a\"") && !has(&HeaderMap::new(), "\"a\""));
    }
}
