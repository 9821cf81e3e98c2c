//! The header of a frame's file, and the file itself: passed on piece by piece as the caller takes it, so that a file of any
//! size needs the memory of one piece.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use contract::Address;
use contract::archived_frame::{
    FilePiece, FrameAnswer, FrameAsk, FrameGiven, FrameQuestion, MOST_PIECE_BYTES, NotGiven,
};
use contract::{CommandId, Key};
use futures_util::stream::try_unfold;
use schemars::JsonSchema;
use serde::Deserialize;

use super::{FramePath, REVALIDATED, TIMEOUT, ask, has, not_modified, strange};
use crate::json_body::AskedFor;
use crate::problem::{Code, Problem};
use crate::routes::network::known;
use crate::server::Server;

/// A piece that a busy archive does not give is asked for again so often, after so long.
const TRIES: u32 = 5;
const PAUSE: Duration = Duration::from_millis(500);

/// The part of a file whose header is meant.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeaderQuery {
    /// Only this part of the file, from 1; all where absent.
    #[schemars(range(min = 1))]
    hdu: Option<u32>,
}

/// The cards of a file.
pub async fn header(
    State(server): State<Arc<Server>>,
    Path((site, telescope, id)): FramePath,
    AskedFor(query): AskedFor<HeaderQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if query.hdu == Some(0) {
        return Err(Problem::malformed("hdu: the first header is HDU 1."));
    }
    match ask(&server, (&site, &telescope, &id), FrameAsk::Header { hdu: query.hdu }).await? {
        FrameGiven::Header(found) => {
            let part = query.hdu.map(|hdu| format!("-{hdu}")).unwrap_or_default();
            let tag = format!("\"{}{part}\"", found.version);
            if has(&headers, &tag) {
                return Ok(not_modified(&tag, REVALIDATED));
            }
            let named = [(header::ETAG, tag), (header::CACHE_CONTROL, REVALIDATED.to_owned())];
            Ok((named, Json(found)).into_response())
        }
        _ => Err(strange()),
    }
}

/// The file as it is stored.
pub async fn file(
    State(server): State<Arc<Server>>,
    Path((site, telescope, id)): FramePath,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let begin = FrameAsk::Bytes { from: 0, most: 0 };
    let FrameGiven::Bytes(about) = ask(&server, (&site, &telescope, &id), begin).await? else { return Err(strange()) };
    let tag = format!("\"{}\"", about.version);
    if has(&headers, &tag) {
        return Ok(not_modified(&tag, REVALIDATED));
    }
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    // A range of another version than the caller has would not fit to its beginning.
    let is_of_this = text(header::IF_RANGE).is_none_or(|version| version == tag);
    let range = text(header::RANGE).filter(|_| is_of_this).and_then(|range| range_of(range, about.file_bytes));
    let (status, from, end) = match range {
        None => (StatusCode::OK, 0, about.file_bytes),
        Some(Some((from, end))) => (StatusCode::PARTIAL_CONTENT, from, end),
        Some(None) => {
            let detail = format!("The file has {} bytes, and none of them is in the range.", about.file_bytes);
            let problem = Problem::new(Code::Range, "No such bytes", detail);
            return Err(problem.with_header(header::CONTENT_RANGE, &format!("bytes */{}", about.file_bytes)));
        }
    };
    let mut named = vec![
        (header::ETAG, tag),
        (header::CACHE_CONTROL, REVALIDATED.to_owned()),
        (header::CONTENT_TYPE, "application/fits".to_owned()),
        (header::CONTENT_LENGTH, (end - from).to_string()),
        (header::ACCEPT_RANGES, "bytes".to_owned()),
        (header::CONTENT_DISPOSITION, disposition(&about.name)),
    ];
    if status == StatusCode::PARTIAL_CONTENT {
        named.push((header::CONTENT_RANGE, format!("bytes {from}-{}/{}", end - 1, about.file_bytes)));
    }
    let body = pieces(server, address, CommandId(id), (from, end), about.version);
    let mut response = (status, body).into_response();
    for (name, value) in named {
        if let Ok(value) = value.parse() {
            response.headers_mut().insert(name, value);
        }
    }
    Ok(response)
}

/// The bytes as a body; the connection breaks where they do not come, so that nobody takes half a file for a whole one.
fn pieces(server: Arc<Server>, address: Address, frame: CommandId, (from, end): (u64, u64), version: String) -> Body {
    let stream = try_unfold(from, move |from| {
        let (server, key) = (server.clone(), Key::ArchivedFrame(address.clone()));
        let (frame, version) = (frame.clone(), version.clone());
        async move {
            if from >= end {
                return Ok(None);
            }
            let most = u32::try_from(end - from).unwrap_or(u32::MAX).min(MOST_PIECE_BYTES);
            let question = FrameQuestion { frame, ask: FrameAsk::Bytes { from, most } };
            match piece(&server, &key, &question).await {
                Ok(piece) if piece.version == version && piece.from == from && !piece.bytes.0.is_empty() => {
                    let next = from + piece.bytes.0.len() as u64;
                    Ok(Some((Bytes::from(piece.bytes.0), next)))
                }
                Ok(_) => Err("the file was changed while it was sent".to_owned()),
                Err(why) => Err(why),
            }
        }
    });
    Body::from_stream(stream)
}

async fn piece(server: &Server, key: &Key, question: &FrameQuestion) -> Result<FilePiece, String> {
    let mut tries = 1;
    loop {
        let answer: Result<FrameAnswer, _> = server.bus.ask(key, question, TIMEOUT).await;
        match answer.map_err(|error| error.to_string())?.gives {
            FrameGiven::Bytes(piece) => return Ok(piece),
            FrameGiven::Refused(refusal) if refusal.reason == NotGiven::Busy && tries < TRIES => {
                tries += 1;
                tokio::time::sleep(PAUSE).await;
            }
            FrameGiven::Refused(refusal) => return Err(refusal.detail),
            _ => return Err("the archive answered another question".to_owned()),
        }
    }
}

/// The bytes of one range, the end not included; `Some(None)` where the file has none of them, `None` where the header is
/// none that is answered with a part (several ranges, other units): the whole file may be sent then (RFC 9110, section 14.2).
fn range_of(text: &str, length: u64) -> Option<Option<(u64, u64)>> {
    let (first, last) = text.trim().strip_prefix("bytes=")?.split_once('-')?;
    let number = |text: &str| {
        let text = text.trim();
        (!text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())).then(|| text.parse().unwrap_or(u64::MAX))
    };
    if first.trim().is_empty() {
        let count = number(last)?.min(length);
        return Some((count > 0).then_some((length - count, length)));
    }
    let first = number(first)?;
    let last = if last.trim().is_empty() { u64::MAX } else { number(last)? };
    if last < first {
        return None;
    }
    Some((first < length).then(|| (first, last.saturating_add(1).min(length))))
}

/// The file's own name, in both forms that browsers read (RFC 6266).
fn disposition(name: &str) -> String {
    let plain: String =
        name.chars().map(|c| if matches!(c, ' '..='~') && !matches!(c, '"' | '\\' | '%') { c } else { '_' }).collect();
    let encoded: String = name
        .bytes()
        .map(|byte| match byte {
            b'0'..=b'9' | b'A'..=b'Z' | b'a'..=b'z' | b'.' | b'_' | b'-' => char::from(byte).to_string(),
            _ => format!("%{byte:02X}"),
        })
        .collect();
    format!("attachment; filename=\"{plain}\"; filename*=UTF-8''{encoded}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_is_one_part_of_the_file_or_none() {
        let of = |text| range_of(text, 100);
        assert_eq!(of("bytes=0-9"), Some(Some((0, 10))));
        assert_eq!(of("bytes=90-"), Some(Some((90, 100))));
        assert_eq!(of("bytes=-10"), Some(Some((90, 100))));
        assert_eq!(of("bytes=-1000"), Some(Some((0, 100))));
        assert_eq!(of("bytes=50-99999999999999999999999"), Some(Some((50, 100))));
        for beyond in ["bytes=100-", "bytes=100-200", "bytes=-0", "bytes=99999999999999999999999-"] {
            assert_eq!(of(beyond), Some(None), "{beyond}");
        }
        for other in ["bytes=5-1", "bytes=0-1,5-9", "lines=0-1", "bytes=a-b", "bytes=--1", "bytes=-", "bytes=+1-2", ""]
        {
            assert_eq!(of(other), None, "{other}");
        }
        assert_eq!(range_of("bytes=0-", 0), Some(None));
    }

    #[test]
    fn a_name_with_odd_letters_stays_one_value_of_a_header() {
        assert_eq!(
            disposition("caf\u{e9} \"x\"\r\n.fits"),
            "attachment; filename=\"caf_ _x___.fits\"; filename*=UTF-8''caf%C3%A9%20%22x%22%0D%0A.fits"
        );
    }
}
