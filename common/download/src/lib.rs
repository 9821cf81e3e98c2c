//! Fetches a frame's pixels from the spool of its device node, and proves that they are those announced.
//!
//! The archive stores them, the observatory measures them; each node fetches them by itself, and neither waits for the
//! other. One buffer is taken, as large as announced; it grows no further, whatever the spool sends. A spool that sends
//! a few bytes now and then ends at the frame's total time ([`longest`]).
//!
//! # Invariants
//!
//! - Pixels whose hash is not the announced one are never returned: `wrong_pixels_are_never_taken`.
//! - A download ends within the frame's total time, however slow the spool is:
//!   `a_spool_that_dribbles_ends_at_the_total_time`.

use std::time::Duration;

use contract::device::camera::Frame;
use futures_util::StreamExt as _;
use reqwest::StatusCode;
use reqwest::header::{CONTENT_RANGE, RANGE};
use sha2::{Digest, Sha256};

/// A frame larger than this is a mistake; the largest sensors in use make 0.6 GB.
const LARGEST: u64 = 2 << 30;
/// A connection that brings nothing for so long is taken up again.
const STALL: Duration = Duration::from_secs(10);
/// After so many interruptions without a single new byte the attempt ends.
const TRIES: u32 = 5;
/// The total time of a frame: this, and what its bytes need over the slowest link that is still of use.
const LEAST_TOTAL: Duration = Duration::from_secs(60);
/// Bytes per second of that link.
const SLOWEST_LINK: u64 = 250_000;

/// The pixels could not be had, or are not those announced.
#[derive(Debug, thiserror::Error)]
pub enum FetchError {
    /// The announcement contradicts itself.
    #[error("frame {id} is announced as {width} x {height} x {planes} pixels in {bytes} bytes, which cannot be")]
    Announcement {
        /// Which frame.
        id: String,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Planes.
        planes: u32,
        /// Bytes.
        bytes: u64,
    },
    /// There is no memory for the pixels.
    #[error("there is no memory for the {bytes} bytes of frame {id}")]
    Memory {
        /// Which frame.
        id: String,
        /// Bytes that were announced.
        bytes: u64,
    },
    /// The spool answered with an error.
    #[error("the spool answers HTTP {status} for frame {id}")]
    Status {
        /// Which frame.
        id: String,
        /// The answer.
        status: StatusCode,
    },
    /// The connection broke again and again.
    #[error("frame {id} stopped after {got} of {bytes} bytes: {cause}")]
    Broken {
        /// Which frame.
        id: String,
        /// Bytes that came.
        got: usize,
        /// Bytes that were announced.
        bytes: u64,
        /// The last error.
        cause: String,
    },
    /// The frame's total time has run out.
    #[error("frame {id} brought {got} of {bytes} bytes in {limit_s} s; a link that is of use brings 250 kB/s")]
    Slow {
        /// Which frame.
        id: String,
        /// Bytes that came.
        got: usize,
        /// Bytes that were announced.
        bytes: u64,
        /// Its total time.
        limit_s: u64,
    },
    /// The hash is another one.
    #[error("the pixels of frame {id} have the hash {got}, announced was {announced}")]
    Hash {
        /// Which frame.
        id: String,
        /// The hash of the received pixels.
        got: String,
        /// The hash in the announcement.
        announced: String,
    },
}

/// Whether the size of an announced frame agrees with its shape, and is one that a camera can have.
pub fn check(frame: &Frame) -> Result<(), FetchError> {
    let shape = [frame.width_px, frame.height_px, frame.planes.max(1)].map(u64::from);
    let pixels = shape.into_iter().try_fold(1_u64, u64::checked_mul);
    let bytes = pixels.and_then(|pixels| pixels.checked_mul(frame.pixel.bytes() as u64));
    match bytes {
        Some(bytes) if bytes == frame.bytes && bytes > 0 && bytes <= LARGEST => Ok(()),
        _ => Err(FetchError::Announcement {
            id: frame.id.0.clone(),
            width: frame.width_px,
            height: frame.height_px,
            planes: frame.planes,
            bytes: frame.bytes,
        }),
    }
}

/// The total time that a frame of so many bytes may take, connection and interruptions included.
pub fn longest(bytes: u64) -> Duration {
    LEAST_TOTAL + Duration::from_secs(bytes / SLOWEST_LINK)
}

/// Fetches the pixels as the spool has them: rows from the first, little endian. A connection that breaks is taken up
/// where it ended. The whole takes at most [`longest`]. Needs a runtime of several threads.
///
/// # Errors
/// [`FetchError`] when the announcement contradicts itself, the spool refuses or is too slow, the connection breaks
/// again and again, or the pixels have another hash than announced.
pub async fn fetch(client: &reqwest::Client, frame: &Frame) -> Result<Vec<u8>, FetchError> {
    fetch_within(client, frame, longest(frame.bytes)).await
}

async fn fetch_within(client: &reqwest::Client, frame: &Frame, limit: Duration) -> Result<Vec<u8>, FetchError> {
    check(frame)?;
    let mut pixels: Vec<u8> = pages::with_room(usize::try_from(frame.bytes).unwrap_or(usize::MAX));
    if (pixels.capacity() as u64) < frame.bytes {
        return Err(FetchError::Memory { id: frame.id.0.clone(), bytes: frame.bytes });
    }
    let fetched = tokio::time::timeout(limit, fetch_all(client, frame, &mut pixels)).await;
    fetched.unwrap_or_else(|_| {
        let (id, got) = (frame.id.0.clone(), pixels.len());
        Err(FetchError::Slow { id, got, bytes: frame.bytes, limit_s: limit.as_secs() })
    })?;
    let got = tokio::task::block_in_place(|| hash(&pixels));
    if !got.eq_ignore_ascii_case(&frame.sha256) {
        return Err(FetchError::Hash { id: frame.id.0.clone(), got, announced: frame.sha256.clone() });
    }
    Ok(pixels)
}

async fn fetch_all(client: &reqwest::Client, frame: &Frame, pixels: &mut Vec<u8>) -> Result<(), FetchError> {
    let mut interruptions = 0;
    while (pixels.len() as u64) < frame.bytes {
        let before = pixels.len();
        let cause = match more(client, frame, pixels).await {
            Ok(()) => "the connection ended early".to_owned(),
            Err(More::Status(status)) => return Err(FetchError::Status { id: frame.id.0.clone(), status }),
            Err(More::Broken(cause)) => cause,
        };
        interruptions = if pixels.len() > before { 0 } else { interruptions + 1 };
        if interruptions >= TRIES {
            let (id, got) = (frame.id.0.clone(), pixels.len());
            return Err(FetchError::Broken { id, got, bytes: frame.bytes, cause });
        }
        if (pixels.len() as u64) < frame.bytes {
            tokio::time::sleep(Duration::from_millis(100) * interruptions).await;
        }
    }
    Ok(())
}

/// SHA-256 in lower-case hex.
pub fn hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

enum More {
    Status(StatusCode),
    Broken(String),
}

/// One request for the bytes that are still missing.
async fn more(client: &reqwest::Client, frame: &Frame, pixels: &mut Vec<u8>) -> Result<(), More> {
    let broken = |error: reqwest::Error| More::Broken(error.without_url().to_string());
    let mut request = client.get(&frame.url);
    if !pixels.is_empty() {
        request = request.header(RANGE, format!("bytes={}-", pixels.len()));
    }
    let answer = tokio::time::timeout(STALL, request.send()).await;
    let answer = answer.map_err(|_| More::Broken("no answer".to_owned()))?.map_err(broken)?;
    match answer.status() {
        // The whole again: a server that knows no ranges.
        StatusCode::OK => pixels.clear(),
        StatusCode::PARTIAL_CONTENT => {
            let start = format!("bytes {}-", pixels.len());
            let range = answer.headers().get(CONTENT_RANGE).and_then(|range| range.to_str().ok());
            if !range.is_some_and(|range| range.starts_with(&start)) {
                pixels.clear();
                return Err(More::Broken(format!("another range than asked for: {range:?}")));
            }
        }
        status => return Err(More::Status(status)),
    }
    let mut body = answer.bytes_stream();
    loop {
        let chunk = tokio::time::timeout(STALL, body.next()).await;
        let Some(chunk) = chunk.map_err(|_| More::Broken("nothing came for 10 s".to_owned()))? else { return Ok(()) };
        let chunk = chunk.map_err(broken)?;
        if pixels.len() as u64 + chunk.len() as u64 > frame.bytes {
            pixels.clear();
            return Err(More::Broken("more bytes than announced".to_owned()));
        }
        pixels.extend_from_slice(&chunk);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use axum::http::{HeaderMap, HeaderValue};
    use axum::response::IntoResponse as _;
    use contract::CommandId;
    use contract::device::camera::{Pixel, Purpose};
    use units::Utc;

    use super::*;

    const PIXELS: &[u8] = &[7; 600];

    fn frame(url: String) -> Frame {
        Frame {
            id: CommandId("f".to_owned()),
            camera: "andor".to_owned(),
            purpose: Purpose::default(),
            width_px: 30,
            height_px: 10,
            planes: 1,
            pixel: Pixel::U16,
            bin: 1,
            origin_px: [0, 0],
            started_utc: Utc::EPOCH,
            exposure_s: 1.0,
            url,
            bytes: 600,
            sha256: hash(PIXELS),
            readings: BTreeMap::new(),
        }
    }

    /// A spool that answers the nth request with the result of `answer`.
    async fn spool<F>(answer: F) -> (String, Arc<AtomicUsize>)
    where
        F: Fn(usize, Option<String>) -> (StatusCode, HeaderMap, Vec<u8>) + Clone + Send + Sync + 'static,
    {
        let count = Arc::new(AtomicUsize::new(0));
        let counted = count.clone();
        let serve = move |headers: HeaderMap| {
            let range = headers.get(RANGE).and_then(|range| range.to_str().ok()).map(str::to_owned);
            let answer = answer(counted.fetch_add(1, Ordering::SeqCst), range);
            async move { answer.into_response() }
        };
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}/", listener.local_addr().unwrap());
        tokio::spawn(
            async move { axum::serve(listener, axum::Router::new().route("/", axum::routing::get(serve))).await },
        );
        (url, count)
    }

    fn ranged(range: &str) -> HeaderMap {
        HeaderMap::from_iter([(CONTENT_RANGE, HeaderValue::from_str(range).unwrap())])
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn short_answers_are_taken_up_where_they_ended() {
        let (url, count) = spool(|n, range| match n {
            0 => (StatusCode::OK, HeaderMap::new(), PIXELS[..100].to_vec()),
            1 => {
                assert_eq!(range.as_deref(), Some("bytes=100-"));
                (StatusCode::PARTIAL_CONTENT, ranged("bytes 100-299/600"), PIXELS[100..300].to_vec())
            }
            // Another range than asked for: begin again.
            2 => (StatusCode::PARTIAL_CONTENT, ranged("bytes 0-9/600"), PIXELS[..10].to_vec()),
            // A server that knows no ranges.
            _ => (StatusCode::OK, HeaderMap::new(), PIXELS.to_vec()),
        })
        .await;
        assert_eq!(fetch(&reqwest::Client::new(), &frame(url)).await.unwrap(), PIXELS);
        assert_eq!(count.load(Ordering::SeqCst), 4);
    }

    #[test]
    fn a_frame_has_a_total_time_that_a_usable_link_keeps() {
        assert_eq!(longest(0), Duration::from_secs(60));
        // A guide camera's frame, a full frame, and the largest that is taken.
        assert_eq!(longest(600_000), Duration::from_secs(62));
        assert_eq!(longest(32 << 20), Duration::from_secs(194));
        assert!(longest(LARGEST) < Duration::from_secs(3 * 3600));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_spool_that_dribbles_ends_at_the_total_time() {
        let dribble = || async {
            let one_byte = futures_util::stream::repeat(()).then(|()| async {
                tokio::time::sleep(Duration::from_millis(500)).await;
                Ok::<_, std::io::Error>(axum::body::Bytes::from_static(&[7]))
            });
            axum::body::Body::from_stream(one_byte).into_response()
        };
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}/", listener.local_addr().unwrap());
        let app = axum::Router::new().route("/", axum::routing::get(dribble));
        tokio::spawn(async move { axum::serve(listener, app).await });
        // Real clocks: the bytes come through a real socket; 600 of them would take 300 s.
        let (frame, client) = (frame(url), reqwest::Client::new());
        let slow = fetch_within(&client, &frame, Duration::from_secs(1)).await.unwrap_err();
        assert!(matches!(slow, FetchError::Slow { bytes: 600, got: ..600, limit_s: 1, .. }), "{slow}");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn wrong_pixels_are_never_taken() {
        let ok = |bytes: Vec<u8>| (StatusCode::OK, HeaderMap::new(), bytes);
        let client = reqwest::Client::new();
        let (url, _) = spool(move |_, _| ok(vec![8; 600])).await;
        assert!(matches!(fetch(&client, &frame(url)).await, Err(FetchError::Hash { .. })));
        let (url, _) = spool(move |_, _| ok(vec![7; 601])).await;
        assert!(matches!(fetch(&client, &frame(url)).await, Err(FetchError::Broken { .. })));
        let (url, count) = spool(move |_, _| ok(Vec::new())).await;
        assert!(matches!(fetch(&client, &frame(url)).await, Err(FetchError::Broken { got: 0, .. })));
        assert_eq!(count.load(Ordering::SeqCst), TRIES as usize);
        let (url, _) = spool(|_, _| (StatusCode::FORBIDDEN, HeaderMap::new(), Vec::new())).await;
        let refused = fetch(&client, &frame(url)).await;
        assert!(matches!(refused, Err(FetchError::Status { status: StatusCode::FORBIDDEN, .. })));
        let contradiction = Frame { bytes: 599, ..frame(String::new()) };
        assert!(matches!(fetch(&client, &contradiction).await, Err(FetchError::Announcement { .. })));
    }
}
