//! The newest image of a telescope.

use std::sync::Arc;

use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use contract::Address;
use serde::Deserialize;

use crate::problem::Problem;
use crate::server::Server;

/// The camera; where absent, the one of the newest image. `frame` only makes the address differ for browsers' caches.
#[derive(Debug, Deserialize)]
pub struct Wanted {
    camera: Option<String>,
}

/// The JPEG, under the id of its frame.
pub async fn image(
    State(server): State<Arc<Server>>,
    Path((site, telescope)): Path<(String, String)>,
    Query(wanted): Query<Wanted>,
    headers: HeaderMap,
) -> Response {
    let jpeg = Address::new(&site, &telescope)
        .ok()
        .and_then(|address| server.previews.newest(&address, wanted.camera.as_deref()));
    let Some(jpeg) = jpeg else {
        return Problem::not_found(format!("No image of {site}/{telescope} was made yet.")).into_response();
    };
    let tag = format!("\"{}\"", jpeg.frame);
    let known = headers.get(header::IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == tag.as_bytes());
    let named = [(header::ETAG, tag), (header::CACHE_CONTROL, "no-cache".to_owned())];
    if known {
        return (StatusCode::NOT_MODIFIED, named).into_response();
    }
    (named, [(header::CONTENT_TYPE, "image/jpeg")], jpeg.bytes).into_response()
}
