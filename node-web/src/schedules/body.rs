//! A schedule as it is sent: its text, or its rows as JSON.

use axum::extract::{FromRequest, Request};
use serde_json::{Map, Value};

use super::JSONL;
use crate::json_body::{bytes, content_type, read};
use crate::problem::{Code, Problem};

/// The longest text: what an order takes.
const MOST_BYTES: usize = 1_000_000;

/// The text of a schedule that was sent: as `application/jsonl` the text itself, comments included; as `application/json` a list
/// of rows, of which each becomes a line.
pub struct ScheduleBody(pub String);

impl<S: Sync> FromRequest<S> for ScheduleBody {
    type Rejection = Problem;

    async fn from_request(request: Request, _: &S) -> Result<Self, Problem> {
        let kind = content_type(request.headers()).unwrap_or_default();
        let is_text = kind == JSONL;
        if !is_text && kind != "application/json" {
            let detail =
                format!("Expected the text with Content-Type: {JSONL}, or a list of rows with application/json.");
            return Err(Problem::new(Code::UnsupportedMedia, "Send a schedule", detail));
        }
        let bytes = bytes(request, MOST_BYTES).await?;
        if is_text {
            let no_text = |fault: std::str::Utf8Error| {
                Problem::malformed(format!("The text is no UTF-8 from byte {} on.", fault.valid_up_to()))
            };
            return Ok(Self(std::str::from_utf8(&bytes).map_err(no_text)?.to_owned()));
        }
        let rows: Vec<Map<String, Value>> = read(&bytes)?;
        Ok(Self(rows.into_iter().map(|row| format!("{}\n", Value::Object(row))).collect()))
    }
}
