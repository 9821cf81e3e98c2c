//! Pictures, tiles and values of a frame's pixels. The pixels of a frame never change, so each answer may be stored for ever,
//! and a caller that has it is answered without a question to the archive.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use contract::archived_frame::{
    FrameAsk, FrameGiven, LEAST_PICTURE_PX, MOST_PICTURE_PX, MOST_PIXELS, PictureWanted, Stretch,
};
use schemars::JsonSchema;
use serde::Deserialize;
use sha2::{Digest as _, Sha256};

use super::{FramePath, IMMUTABLE, ask, has, not_modified, strange};
use crate::json_body::AskedFor;
use crate::problem::Problem;
use crate::routes::network::known;
use crate::server::Server;

/// The longest side where the question does not name it.
const USUAL_PX: u32 = 1024;
/// Raised when the same question is answered by another picture: then what browsers have is asked for again.
const DRAWING: u32 = 1;

/// How a picture shall look.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PictureQuery {
    /// Longest side, px; 1024 where absent. A smaller frame keeps its size.
    #[schemars(range(min = 16, max = 2048))]
    size: Option<u32>,
    /// How counts between black and white become grey; asinh where absent.
    stretch: Option<Stretch>,
    /// The count (ADU) that is black; chosen from the picture where absent.
    lo: Option<f64>,
    /// The count (ADU) that is white; chosen from the picture where absent.
    hi: Option<f64>,
    /// Stars are black.
    #[serde(default)]
    invert: bool,
}

/// A JPEG of a frame.
pub async fn preview(
    State(server): State<Arc<Server>>,
    Path((site, telescope, id)): FramePath,
    AskedFor(query): AskedFor<PictureQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let wanted = PictureWanted {
        longest_px: query.size.unwrap_or(USUAL_PX),
        stretch: query.stretch.unwrap_or_default(),
        low_adu: query.lo,
        high_adu: query.hi,
        inverted: query.invert,
    };
    if !(LEAST_PICTURE_PX..=MOST_PICTURE_PX).contains(&wanted.longest_px) {
        return Err(Problem::malformed(format!("size: expected {LEAST_PICTURE_PX} to {MOST_PICTURE_PX} px.")));
    }
    // The bus has no such numbers.
    if [query.lo, query.hi].iter().flatten().any(|limit| !limit.is_finite()) {
        return Err(Problem::malformed("lo, hi: expected counts in ADU, such as 812.5."));
    }
    if let (Some(low), Some(high)) = (query.lo, query.hi)
        && low >= high
    {
        return Err(Problem::malformed(format!("lo, hi: black at {low} is not below white at {high}.")));
    }
    let place = (&*site, &*telescope, &*id);
    let what = FrameAsk::Picture(wanted);
    let given = match given(&server, place, what, &headers).await? {
        Given::Known(response) => return Ok(response),
        Given::New(tag, given) => (tag, given),
    };
    let (tag, FrameGiven::Picture(picture)) = given else { return Err(strange()) };
    let named = [(header::ETAG, tag), (header::CACHE_CONTROL, IMMUTABLE.to_owned())];
    Ok((named, [(header::CONTENT_TYPE, "image/jpeg")], picture.bytes.0).into_response())
}

/// The address of a tile.
pub type TilePath = Path<(String, String, String, String, String, String)>;

/// A tile of a frame.
pub async fn tile(
    State(server): State<Arc<Server>>,
    Path((site, telescope, id, z, x, y)): TilePath,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let number = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit()).then(|| text.parse().ok()).flatten();
    let (Some(z), Some(x), Some(y)) = (number(&z), number(&x), number(&y)) else {
        return Err(Problem::not_found(format!("{z}/{x}/{y} is no tile; expected three numbers, such as 0/0/0.")));
    };
    let given = match given(&server, (&site, &telescope, &id), FrameAsk::Tile { z, x, y }, &headers).await? {
        Given::Known(response) => return Ok(response),
        Given::New(tag, given) => (tag, given),
    };
    let (tag, FrameGiven::Tile(tile)) = given else { return Err(strange()) };
    let named = [
        (header::ETAG, tag),
        (header::CACHE_CONTROL, IMMUTABLE.to_owned()),
        (header::CONTENT_TYPE, "application/octet-stream".to_owned()),
    ];
    let mut response = (named, tile.bytes.0).into_response();
    for (name, value) in [
        ("tile-width", Some(tile.width_px.to_string())),
        ("tile-height", Some(tile.height_px.to_string())),
        ("tile-zero", Some(tile.zero.to_string())),
        ("tile-scale", Some(tile.scale.to_string())),
        ("tile-blank", tile.blank.map(|blank| blank.to_string())),
        ("tile-highest-z", Some(tile.highest_z.to_string())),
    ] {
        if let Some(value) = value.and_then(|value| HeaderValue::try_from(value).ok()) {
            response.headers_mut().insert(HeaderName::from_static(name), value);
        }
    }
    Ok(response)
}

/// Which pixels.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PixelsQuery {
    /// First column, from 0: the first pixel of the file is 0, 0 (in FITS 1, 1).
    x: u32,
    /// First row, from 0.
    y: u32,
    /// Columns.
    #[schemars(range(min = 1, max = 65536))]
    w: u32,
    /// Rows; together at most 65,536 values.
    #[schemars(range(min = 1, max = 65536))]
    h: u32,
}

/// Values of pixels.
pub async fn pixels(
    State(server): State<Arc<Server>>,
    Path((site, telescope, id)): FramePath,
    AskedFor(query): AskedFor<PixelsQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let PixelsQuery { x, y, w, h } = query;
    let count = u64::from(w) * u64::from(h);
    if count == 0 || count > MOST_PIXELS {
        return Err(Problem::malformed(format!("w, h: {w} x {h} values; expected 1 to {MOST_PIXELS}.")));
    }
    let what = FrameAsk::Pixels { x, y, width_px: w, height_px: h };
    let given = match given(&server, (&site, &telescope, &id), what, &headers).await? {
        Given::Known(response) => return Ok(response),
        Given::New(tag, given) => (tag, given),
    };
    let (tag, FrameGiven::Pixels(pixels)) = given else { return Err(strange()) };
    let named = [(header::ETAG, tag), (header::CACHE_CONTROL, IMMUTABLE.to_owned())];
    Ok((named, Json(pixels)).into_response())
}

/// What is given of a frame's pixels.
enum Given {
    /// The caller has it.
    Known(Response),
    /// Under a tag.
    New(String, FrameGiven),
}

async fn given(
    server: &Server,
    (site, telescope, id): (&str, &str, &str),
    what: FrameAsk,
    headers: &HeaderMap,
) -> Result<Given, Problem> {
    known(&server.network, site, telescope)?;
    let question = format!("{DRAWING} {site}/{telescope} {id} {what:?}");
    let hash: String = Sha256::digest(question.as_bytes()).iter().take(12).map(|byte| format!("{byte:02x}")).collect();
    let tag = format!("\"{hash}\"");
    if has(headers, &tag) {
        return Ok(Given::Known(not_modified(&tag, IMMUTABLE)));
    }
    Ok(Given::New(tag, ask(server, (site, telescope, id), what).await?))
}
