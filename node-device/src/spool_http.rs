//! Serves the spool's pixels by HTTP, with range requests, to those who know a frame's token.

use std::io::SeekFrom;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use local_http::{Limits, Room};
use node::Stop;
use serde::Deserialize;
use tokio::io::{AsyncReadExt as _, AsyncSeekExt as _};
use tokio::net::TcpListener;
use tokio_util::io::ReaderStream;

use crate::spool::Spool;

#[derive(Deserialize)]
struct Token {
    #[serde(default)]
    token: String,
}

/// An archive, an observatory and a web node fetch a few frames at a time. Strangers may connect, too, and must not
/// fill this process, which may hold a guard.
const LIMITS: Limits = Limits {
    room: Room { total: 128, per_address: 48, trusted: 48 },
    header: Duration::from_secs(5),
    // A download that is cut is asked for again, from where it ended.
    total: Duration::from_secs(900),
};

/// Serves until `stop` is set.
pub async fn serve(listener: TcpListener, spool: Arc<Spool>, stop: Stop) {
    local_http::serve(listener, router(spool), LIMITS, async move { stop.wait().await }).await;
}

/// The routes.
pub fn router(spool: Arc<Spool>) -> Router {
    Router::new().route("/frame/{id}", get(frame)).with_state(spool)
}

async fn frame(
    State(spool): State<Arc<Spool>>,
    Path(id): Path<String>,
    Query(Token { token }): Query<Token>,
    headers: HeaderMap,
) -> Response {
    // An unknown frame and a wrong token look the same.
    let Some((path, length)) = spool.pixels(&id, &token) else { return StatusCode::NOT_FOUND.into_response() };
    let asked = headers.get(header::RANGE).and_then(|value| value.to_str().ok());
    let asked = asked.map_or(RequestedRange::Whole, |range| parse(range, length));
    let part = match asked {
        RequestedRange::Whole => Part { first: 0, length },
        RequestedRange::Part(part) => part,
        RequestedRange::Outside => {
            let range = format!("bytes */{length}");
            return (StatusCode::RANGE_NOT_SATISFIABLE, [(header::CONTENT_RANGE, range)]).into_response();
        }
    };
    let opened = async {
        let mut file = tokio::fs::File::open(&path).await?;
        file.seek(SeekFrom::Start(part.first)).await?;
        std::io::Result::Ok(file.take(part.length))
    };
    let Ok(file) = opened.await else { return StatusCode::NOT_FOUND.into_response() };
    let body = Body::from_stream(ReaderStream::with_capacity(file, 256 << 10));
    let mut response = Response::builder()
        .header(header::CONTENT_TYPE, "application/octet-stream")
        .header(header::ACCEPT_RANGES, "bytes")
        .header(header::CONTENT_LENGTH, part.length);
    if asked != RequestedRange::Whole {
        let last = part.first + part.length - 1;
        response = response
            .status(StatusCode::PARTIAL_CONTENT)
            .header(header::CONTENT_RANGE, format!("bytes {}-{last}/{length}", part.first));
    }
    response.body(body).unwrap_or_else(|_| StatusCode::INTERNAL_SERVER_ERROR.into_response())
}

/// What a `Range` header asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum RequestedRange {
    /// Everything, or something that this server does not do.
    Whole,
    /// One part.
    Part(Part),
    /// A part that the frame does not have.
    Outside,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Part {
    first: u64,
    length: u64,
}

fn parse(range: &str, length: u64) -> RequestedRange {
    // Several ranges, other units and nonsense are answered with the whole, as RFC 9110 allows.
    let Some((first, last)) = range.trim().strip_prefix("bytes=").and_then(|range| range.split_once('-')) else {
        return RequestedRange::Whole;
    };
    match (first.trim().parse::<u64>(), last.trim().parse::<u64>()) {
        (Ok(first), Ok(last)) if first > last => RequestedRange::Whole,
        (Ok(first), _) if first >= length => RequestedRange::Outside,
        (Ok(first), Ok(last)) => RequestedRange::Part(Part { first, length: last.min(length - 1) - first + 1 }),
        (Ok(first), Err(_)) if last.trim().is_empty() => RequestedRange::Part(Part { first, length: length - first }),
        (Err(_), Ok(0)) if first.trim().is_empty() => RequestedRange::Outside,
        (Err(_), Ok(count)) if first.trim().is_empty() && length > 0 => {
            let count = count.min(length);
            RequestedRange::Part(Part { first: length - count, length: count })
        }
        _ => RequestedRange::Whole,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(first: u64, length: u64) -> RequestedRange {
        RequestedRange::Part(Part { first, length })
    }

    #[test]
    fn single_ranges_are_read_as_rfc_9110_defines() {
        for (range, expected) in [
            ("bytes=0-9", part(0, 10)),
            ("bytes=90-", part(90, 10)),
            ("bytes=90-1000", part(90, 10)),
            ("bytes=-10", part(90, 10)),
            ("bytes=-1000", part(0, 100)),
            ("bytes=100-", RequestedRange::Outside),
            ("bytes=-0", RequestedRange::Outside),
            ("bytes=9-0", RequestedRange::Whole),
            ("bytes=0-1,5-6", RequestedRange::Whole),
            ("bytes=x-", RequestedRange::Whole),
            ("lines=0-1", RequestedRange::Whole),
            ("", RequestedRange::Whole),
        ] {
            assert_eq!(parse(range, 100), expected, "{range}");
        }
    }
}
