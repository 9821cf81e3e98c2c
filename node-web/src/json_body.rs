//! Bodies of JSON and the parameters of an address, whose faults are answered as problems in plain sentences.

use axum::body::{Bytes, to_bytes};
use axum::extract::{FromRequest, FromRequestParts, Query, Request};
use axum::http::{HeaderMap, header, request::Parts};
use serde::de::DeserializeOwned;
use users::Principal;

use crate::authentication::{Authentication, Credential};
use crate::in_words::in_words;
use crate::problem::{Code, Problem};

/// Names, passwords and lists of rights are short.
const SHORT: usize = 16 << 10;

/// A body of JSON of at most `MOST` bytes (16 KiB), as the type that the route expects.
pub struct JsonBody<T, const MOST: usize = SHORT>(pub T);

impl<T: DeserializeOwned, S: Sync, const MOST: usize> FromRequest<S> for JsonBody<T, MOST> {
    type Rejection = Problem;

    async fn from_request(request: Request, _: &S) -> Result<Self, Problem> {
        let kind = content_type(request.headers());
        let bytes = bytes(request, MOST).await?;
        if kind.as_deref().is_some_and(|kind| kind != "application/json" && !kind.ends_with("+json")) {
            return Err(Problem::new(
                Code::UnsupportedMedia,
                "Send JSON",
                "Expected the header Content-Type: application/json.",
            ));
        }
        read(&bytes).map(Self)
    }
}

/// JSON as the type that is expected.
///
/// # Errors
/// 400 where it is no JSON, 422 where it is other JSON.
pub fn read<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    let value = serde_json::from_slice::<serde_json::Value>(bytes).map_err(|fault| {
        let (line, column) = (fault.line(), fault.column());
        let detail = match std::str::from_utf8(bytes) {
            Ok("") => "The body is empty: expected JSON.".to_owned(),
            Ok(_) => format!(
                "The body is no JSON: {}",
                in_words(&format!("line {line}, column {column}"), &fault.to_string())
            ),
            Err(fault) => format!("The body is no UTF-8 from byte {} on: expected JSON in UTF-8.", fault.valid_up_to()),
        };
        Problem::malformed(detail)
    })?;
    serde_path_to_error::deserialize(&value).map_err(|fault| {
        let path = fault.path().to_string();
        let path = if path == "." { "" } else { &path };
        let message = in_words(path, &fault.inner().to_string());
        let place = message.split_once(": ").map_or("", |(place, _)| place);
        let pointer = match place.contains(' ') || place.is_empty() {
            true => "/".to_owned(),
            false => format!("/{}", place.replace('.', "/")),
        };
        Problem::invalid(message.clone())
            .with("errors", serde_json::json!([{ "pointer": pointer, "message": message }]))
    })
}

/// The whole body. It may be minutes on its way, so the caller's rights are looked at once more when it is there.
///
/// # Errors
/// It is larger, or the caller may do something else now than when the request began.
pub async fn bytes(request: Request, most: usize) -> Result<Bytes, Problem> {
    let extensions = request.extensions();
    let caller = extensions.get::<Authentication>().cloned().zip(extensions.get::<Credential>().cloned());
    let before = extensions.get::<Principal>().cloned();
    let too_large = |_| {
        Problem::new(Code::TooLarge, "The request is too large", format!("Expected a body of at most {most} bytes."))
    };
    let bytes = to_bytes(request.into_body(), most).await.map_err(too_large)?;
    match (caller, before) {
        (Some((authentication, credential)), Some(before))
            if authentication.principal(&credential).ok().as_ref() != Some(&before) =>
        {
            Err(Problem::unauthenticated("What you may do was changed while this request was on its way: ask again."))
        }
        _ => Ok(bytes),
    }
}

/// The media type of a body, without its parameters.
pub fn content_type(headers: &HeaderMap) -> Option<String> {
    let kind = headers.get(header::CONTENT_TYPE)?.to_str().unwrap_or_default();
    Some(kind.split(';').next().unwrap_or_default().trim().to_ascii_lowercase())
}

/// The parameters of an address, as the type that the route expects.
pub struct AskedFor<T>(pub T);

impl<T: DeserializeOwned, S: Sync> FromRequestParts<S> for AskedFor<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        Query::try_from_uri(&parts.uri).map(|Query(asked)| Self(asked)).map_err(|rejection| {
            let text = rejection.body_text();
            let fault = text.split_once("query string: ").map_or(text.as_str(), |(_, fault)| fault);
            let named = fault.split_once(": ").filter(|(place, _)| !place.contains([' ', '`']));
            let (place, fault) = named.unwrap_or(("", fault));
            Problem::malformed(in_words(place, fault))
        })
    }
}
