//! The newest image of a telescope.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use contract::Address;
use schemars::JsonSchema;
use serde::Deserialize;

use crate::json_body::AskedFor;
use crate::problem::Problem;
use crate::server::Server;

/// The camera; where absent, the one of the newest image. `frame` only makes the address differ for browsers' caches.
#[derive(Debug, JsonSchema, Deserialize)]
pub struct PreviewQuery {
    /// Name of the camera; that of the newest image where absent.
    camera: Option<String>,
    /// Only makes the address differ, for browsers' caches.
    #[allow(dead_code, reason = "read by browsers alone")]
    frame: Option<String>,
}

/// The JPEG, under the id of its frame.
pub async fn image(
    State(server): State<Arc<Server>>,
    Path((site, telescope)): Path<(String, String)>,
    AskedFor(wanted): AskedFor<PreviewQuery>,
    headers: HeaderMap,
) -> Response {
    match Address::new(&site, &telescope) {
        Ok(address) => answer(&server, &address, wanted.camera.as_deref(), &headers),
        Err(error) => Problem::not_found(error.to_string()).into_response(),
    }
}

/// The newest image of a telescope, unless the caller has it.
pub fn answer(server: &Server, address: &Address, camera: Option<&str>, headers: &HeaderMap) -> Response {
    let Some(jpeg) = server.previews.newest(address, camera) else {
        return Problem::not_found(format!("No image of {address} was made yet.")).into_response();
    };
    let tag = format!("\"{}\"", jpeg.frame);
    let known = headers.get(header::IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == tag.as_bytes());
    let named = [(header::ETAG, tag), (header::CACHE_CONTROL, "no-cache".to_owned())];
    if known {
        return (StatusCode::NOT_MODIFIED, named).into_response();
    }
    (named, [(header::CONTENT_TYPE, "image/jpeg")], jpeg.bytes).into_response()
}
