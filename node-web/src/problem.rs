//! Errors of the API as RFC 9457 problem documents.

use std::time::Duration;

use axum::Json;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value, json};

/// Declares the kinds of problems, each with its word, its status and what it means to a program.
macro_rules! codes {
    ($($name:ident $word:literal $status:ident $meaning:literal)*) => {
        /// A kind of problem.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[allow(missing_docs, reason = "the table says what each means")]
        pub enum Code { $($name,)* }

        impl Code {
            /// All kinds.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// The last part of its type.
            pub const fn word(self) -> &'static str {
                match self { $(Self::$name => $word,)* }
            }

            /// Status of the answer.
            pub const fn status(self) -> StatusCode {
                match self { $(Self::$name => StatusCode::$status,)* }
            }

            /// What is wrong, and what to do.
            pub const fn meaning(self) -> &'static str {
                match self { $(Self::$name => $meaning,)* }
            }
        }
    };
}

codes! {
    Malformed "malformed" BAD_REQUEST "The request cannot be read."
    Unauthenticated "unauthenticated" UNAUTHORIZED "Sign in, or send a token."
    Forbidden "forbidden" FORBIDDEN "The right is missing, which `required_right` names, or the page is of another server."
    NotFound "not-found" NOT_FOUND "There is no such telescope, device, command or address."
    Method "method" METHOD_NOT_ALLOWED "Another verb is answered at this address."
    Conflict "conflict" CONFLICT "It is in the way of what is there already, such as a name that is taken."
    Refused "refused" CONFLICT "The observatory node refuses; `reason` is a word, `detail` a sentence."
    Gone "gone" GONE "An address of Astra that is no longer answered; `detail` names what is."
    FileAway "file-away" GONE "The archive stored the frame, and its file is not in its place any more: it was delivered and removed, or its disk is away."
    Precondition "precondition" PRECONDITION_FAILED "It is not what `If-Match` or `If-None-Match` names: somebody else changed it. Read it again."
    PreconditionRequired "precondition-required" PRECONDITION_REQUIRED "Send the ETag that you read in `If-Match`, or `If-None-Match: *` for something new."
    TooLarge "too-large" PAYLOAD_TOO_LARGE "The request is larger than anything that is taken here."
    UnsupportedMedia "unsupported-media" UNSUPPORTED_MEDIA_TYPE "Send JSON, and say so in `Content-Type`."
    Range "range" RANGE_NOT_SATISFIABLE "The file has no such bytes; `Content-Range` has its length."
    Misdirected "misdirected" MISDIRECTED_REQUEST "The name in `Host` is not one of this server; `web.public` lists them."
    Validation "validation" UNPROCESSABLE_ENTITY "It can be read, and something in it is wrong: `errors` has a pointer and a message for each."
    RateLimited "rate-limited" TOO_MANY_REQUESTS "Too many requests or logins; ask again after `retry_after_s`."
    Internal "internal" INTERNAL_SERVER_ERROR "This server failed, for instance at its users file; `detail` says at what."
    FileDamaged "file-damaged" BAD_GATEWAY "The frame's file is on the archive's disk and cannot be read as FITS; `detail` says why."
    Busy "busy" SERVICE_UNAVAILABLE "Too many pages are open, too many forecasts are made, or the archive answers other questions: ask again in some seconds."
    NotReady "not-ready" SERVICE_UNAVAILABLE "This server has received nothing from the bus yet."
    Archive "archive" GATEWAY_TIMEOUT "The archive node does not answer, or cannot read its database."
    Observatory "observatory" GATEWAY_TIMEOUT "The observatory node does not answer."
    CommandUnacknowledged "command-unacknowledged" GATEWAY_TIMEOUT "The observatory node did not answer: whether it was done is unknown, so look before you order again."
}

/// One problem, and the headers that its answer has.
#[derive(Debug, Clone)]
pub struct Problem {
    document: Box<ProblemDocument>,
    headers: Vec<(HeaderName, HeaderValue)>,
}

/// A problem as it is answered. Further members say more, such as `required_right`, `errors` or `reason`.
#[derive(Debug, Clone, JsonSchema, Serialize)]
#[schemars(rename = "Problem")]
pub struct ProblemDocument {
    /// Address of the kind of problem.
    #[serde(rename = "type")]
    kind: String,
    /// The kind in a few words.
    title: &'static str,
    /// Status of the answer.
    status: u16,
    /// What is wrong here, what was expected, and what to do.
    detail: String,
    /// The kind, for programs.
    code: &'static str,
    #[serde(flatten)]
    more: Map<String, Value>,
}

impl Problem {
    /// A problem with its kind, its title and the description of this case.
    pub fn new(code: Code, title: &'static str, detail: impl Into<String>) -> Self {
        let (kind, status) = (format!("/problems/{}", code.word()), code.status().as_u16());
        let document =
            ProblemDocument { kind, title, status, detail: detail.into(), code: code.word(), more: Map::new() };
        Self { document: Box::new(document), headers: vec![] }
    }

    /// There is no such thing.
    pub fn not_found(detail: impl Into<String>) -> Self {
        Self::new(Code::NotFound, "Not found", detail)
    }

    /// Nothing proves who asks, or no longer.
    pub fn unauthenticated(detail: impl Into<String>) -> Self {
        let problem = Self::new(Code::Unauthenticated, "Log in first", detail);
        problem.with_header(header::WWW_AUTHENTICATE, "Bearer realm=\"starmesh\"")
    }

    /// Somebody asks too often, and may ask again after a while.
    pub fn too_many(what: &str, wait: Duration) -> Self {
        let wait_s = (wait.as_secs_f64().ceil() as u64).max(1);
        let detail = format!("{what} Try again in {wait_s} s.");
        let problem = Self::new(Code::RateLimited, "Too many requests", detail);
        problem.with("retry_after_s", json!(wait_s)).with_header(header::RETRY_AFTER, &wait_s.to_string())
    }

    /// The caller may not.
    pub fn forbidden(detail: impl Into<String>) -> Self {
        Self::new(Code::Forbidden, "Not allowed", detail)
    }

    /// The request cannot be read.
    pub fn malformed(detail: impl Into<String>) -> Self {
        Self::new(Code::Malformed, "The request cannot be read", detail)
    }

    /// The request can be read, and what it says is wrong.
    pub fn invalid(detail: impl Into<String>) -> Self {
        Self::new(Code::Validation, "Something in the request is wrong", detail)
    }

    /// Something of this host failed.
    pub fn internal(why: &dyn std::fmt::Display) -> Self {
        tracing::error!(%why, "a request could not be answered");
        Self::new(Code::Internal, "Failed", why.to_string())
    }

    /// With a further member.
    pub fn with(mut self, name: &str, value: Value) -> Self {
        self.document.more.insert(name.to_owned(), value);
        self
    }

    /// With a header of the answer.
    pub fn with_header(mut self, name: HeaderName, value: &str) -> Self {
        if let Ok(value) = HeaderValue::from_str(value) {
            self.headers.push((name, value));
        }
        self
    }
}

impl Problem {
    /// What is answered, without its headers.
    pub fn document(&self) -> &ProblemDocument {
        &self.document
    }
}

impl ProblemDocument {
    /// What a record keeps of it. Of a request that is not as expected it has only the place: what stands there may be a
    /// password.
    pub fn for_record(&self) -> String {
        if ![Code::Malformed, Code::Validation].iter().any(|code| code.word() == self.code) {
            return self.detail.clone();
        }
        match self.more.get("errors").and_then(|errors| errors[0]["pointer"].as_str()) {
            Some(pointer) => format!("{}: {pointer}", self.title),
            None => self.title.to_owned(),
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.document.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let mut response = (status, Json(&self.document)).into_response();
        // For records of what was refused.
        response.extensions_mut().insert(*self.document);
        let kind = HeaderValue::from_static("application/problem+json");
        response.headers_mut().insert(header::CONTENT_TYPE, kind);
        response.headers_mut().extend(self.headers);
        response
    }
}
