//! One form of errors: what a library answers as plain text, such as a path that is no UTF-8, is answered as a problem.

use axum::body::to_bytes;
use axum::extract::Request;
use axum::http::{StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};

use crate::in_words::in_words;
use crate::problem::{Code, Problem};

/// The sentence of a library is short.
const MOST_BYTES: usize = 16 << 10;

/// Answers as a problem what is an error and no document of ours.
pub async fn plain_errors_are_problems(request: Request, next: Next) -> Response {
    let response = next.run(request).await;
    let status = response.status();
    if !(status.is_client_error() || status.is_server_error()) {
        return response;
    }
    let kind = response.headers().get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
    if !kind.is_empty() && !kind.starts_with("text/plain") {
        return response;
    }
    let text = to_bytes(response.into_body(), MOST_BYTES).await.unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    let detail = if text.is_empty() { format!("{status}.") } else { in_words("", &text) };
    let code = match status {
        StatusCode::NOT_FOUND => Code::NotFound,
        StatusCode::METHOD_NOT_ALLOWED => Code::Method,
        StatusCode::PAYLOAD_TOO_LARGE => Code::TooLarge,
        StatusCode::UNSUPPORTED_MEDIA_TYPE => Code::UnsupportedMedia,
        StatusCode::UNPROCESSABLE_ENTITY => Code::Validation,
        _ if status.is_server_error() => Code::Internal,
        _ => Code::Malformed,
    };
    Problem::new(code, "The request cannot be answered", detail).into_response()
}
