//! One endpoint of the API: its path, what it needs, what it takes and gives, and its handler, declared together. The router, the
//! check of rights and the OpenAPI document are made from it.

use std::sync::Arc;

use axum::extract::rejection::RawPathParamsRejection;
use axum::extract::{RawPathParams, Request};
use axum::handler::Handler;
use axum::http::StatusCode;
use axum::middleware::{Next, from_fn};
use axum::response::IntoResponse as _;
use axum::routing::{MethodFilter, MethodRouter, on};
use contract::{Address, Right};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde_json::json;
use users::Principal;

use crate::problem::Problem;
use crate::server::Server;

/// The right that a request needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Needs {
    /// None, and nobody need be known.
    Nothing,
    /// To be known, whatever the rights.
    Known,
    /// This right at some telescope: what is about all of them.
    Anywhere(Right),
    /// This right at all telescopes: what is about who may what.
    Everywhere(Right),
    /// This right at the telescope that the path names.
    There(Right),
}

/// The verb of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verb {
    /// Reads.
    Get,
    /// Makes something, or orders.
    Post,
    /// Stores something under the name in the path.
    Put,
    /// Removes something.
    Delete,
}

impl Verb {
    /// As OpenAPI spells it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Get => "get",
            Self::Post => "post",
            Self::Put => "put",
            Self::Delete => "delete",
        }
    }

    const fn filter(self) -> MethodFilter {
        match self {
            Self::Get => MethodFilter::GET,
            Self::Post => MethodFilter::POST,
            Self::Put => MethodFilter::PUT,
            Self::Delete => MethodFilter::DELETE,
        }
    }
}

/// Makes the schema of a type.
pub type SchemaOf = fn(&mut SchemaGenerator) -> Schema;

/// One answer of an endpoint.
#[derive(Debug, Clone, Copy)]
pub struct Answer {
    /// Its status.
    pub status: u16,
    /// What it means.
    pub meaning: &'static str,
    /// Its media type, and the schema of a JSON one; absent where it has no body.
    pub content: Option<(&'static str, Option<SchemaOf>)>,
}

/// One endpoint.
pub struct Endpoint {
    /// The verb.
    pub verb: Verb,
    /// The path with its parameters in braces.
    pub path: &'static str,
    /// Its name for generated clients, unique.
    pub id: &'static str,
    /// What it does, in one sentence.
    pub summary: &'static str,
    /// The right that it needs.
    pub needs: Needs,
    /// Type of the parameters of its address.
    pub query: Option<SchemaOf>,
    /// Headers that it takes: name, meaning, and whether it must be there.
    pub headers: Vec<(&'static str, &'static str, bool)>,
    /// Type of the JSON that is sent to it.
    pub body: Option<SchemaOf>,
    /// Media type of another form of what is sent to it.
    pub body_media: Option<&'static str>,
    /// What it answers when all is well.
    pub answers: Vec<Answer>,
    handler: MethodRouter<Arc<Server>>,
}

impl Endpoint {
    fn new<H, T>(verb: Verb, path: &'static str, id: &'static str, needs: Needs, handler: H) -> Self
    where
        H: Handler<T, Arc<Server>>,
        T: 'static,
    {
        Self {
            verb,
            path,
            id,
            summary: "",
            needs,
            query: None,
            headers: vec![],
            body: None,
            body_media: None,
            answers: vec![],
            handler: on(verb.filter(), handler),
        }
    }

    /// One that reads.
    pub fn get<H: Handler<T, Arc<Server>>, T: 'static>(
        path: &'static str,
        id: &'static str,
        needs: Needs,
        handler: H,
    ) -> Self {
        Self::new(Verb::Get, path, id, needs, handler)
    }

    /// One that makes something, or orders.
    pub fn post<H: Handler<T, Arc<Server>>, T: 'static>(
        path: &'static str,
        id: &'static str,
        needs: Needs,
        handler: H,
    ) -> Self {
        Self::new(Verb::Post, path, id, needs, handler)
    }

    /// One that stores something under the name in its path.
    pub fn put<H: Handler<T, Arc<Server>>, T: 'static>(
        path: &'static str,
        id: &'static str,
        needs: Needs,
        handler: H,
    ) -> Self {
        Self::new(Verb::Put, path, id, needs, handler)
    }

    /// One that removes something.
    pub fn delete<H: Handler<T, Arc<Server>>, T: 'static>(
        path: &'static str,
        id: &'static str,
        needs: Needs,
        handler: H,
    ) -> Self {
        Self::new(Verb::Delete, path, id, needs, handler)
    }

    /// What it does, in one sentence.
    pub fn summary(self, summary: &'static str) -> Self {
        Self { summary, ..self }
    }

    /// The type of its address's parameters.
    pub fn query<T: JsonSchema>(self) -> Self {
        Self { query: Some(T::json_schema), ..self }
    }

    /// A header that it takes.
    pub fn header(mut self, name: &'static str, meaning: &'static str, is_required: bool) -> Self {
        self.headers.push((name, meaning, is_required));
        self
    }

    /// The type of the JSON that is sent to it.
    pub fn takes<T: JsonSchema>(self) -> Self {
        Self { body: Some(SchemaGenerator::subschema_for::<T>), ..self }
    }

    /// A media type other than JSON that it takes, too.
    pub fn takes_media(self, media_type: &'static str) -> Self {
        Self { body_media: Some(media_type), ..self }
    }

    /// It answers 200 with JSON of this type.
    pub fn gives<T: JsonSchema>(self, meaning: &'static str) -> Self {
        self.answers::<T>(StatusCode::OK, meaning)
    }

    /// It answers with this status and JSON of this type.
    pub fn answers<T: JsonSchema>(mut self, status: StatusCode, meaning: &'static str) -> Self {
        let content = Some(("application/json", Some(SchemaGenerator::subschema_for::<T> as SchemaOf)));
        self.answers.push(Answer { status: status.as_u16(), meaning, content });
        self
    }

    /// It answers 200 with bytes of this media type.
    pub fn gives_media(self, media_type: &'static str, meaning: &'static str) -> Self {
        self.answers_media(StatusCode::OK, media_type, meaning)
    }

    /// It answers with this status and bytes of this media type.
    pub fn answers_media(mut self, status: StatusCode, media_type: &'static str, meaning: &'static str) -> Self {
        self.answers.push(Answer { status: status.as_u16(), meaning, content: Some((media_type, None)) });
        self
    }

    /// It answers 304 without a body when the caller has what would be answered.
    pub fn revalidates(self) -> Self {
        self.header("If-None-Match", "The ETag of what you have.", false)
            .gives_nothing(StatusCode::NOT_MODIFIED, "What you have is right.")
    }

    /// It answers with this status and no body.
    pub fn gives_nothing(mut self, status: StatusCode, meaning: &'static str) -> Self {
        self.answers.push(Answer { status: status.as_u16(), meaning, content: None });
        self
    }

    /// The handler, behind the check of rights.
    pub fn into_route(self) -> (&'static str, MethodRouter<Arc<Server>>) {
        let needs = self.needs;
        type Params = Result<RawPathParams, RawPathParamsRejection>;
        let check = from_fn(move |params: Params, request: Request, next: Next| async move {
            let allowed = match &params {
                Ok(params) => authorize(needs, params, request.extensions().get::<Principal>()),
                Err(_) => Err(Problem::not_found("No such address: a part of it is no UTF-8.")),
            };
            match allowed {
                Ok(()) => next.run(request).await,
                Err(problem) => problem.into_response(),
            }
        });
        (self.path, self.handler.layer(check))
    }
}

/// May this caller do that there?
fn authorize(needs: Needs, params: &RawPathParams, caller: Option<&Principal>) -> Result<(), Problem> {
    if needs == Needs::Nothing {
        return Ok(());
    }
    let Some(caller) = caller else {
        return Err(Problem::unauthenticated("Sign in at POST /api/v1/login, or send `Authorization: Bearer TOKEN`."));
    };
    let part = |name: &str| params.iter().find(|(key, _)| *key == name).map(|(_, value)| value.to_owned());
    let (wanted, has, place) = match needs {
        Needs::Nothing | Needs::Known => return Ok(()),
        Needs::Anywhere(right) => (right, caller.right_anywhere(), "any telescope".to_owned()),
        Needs::Everywhere(right) => (right, caller.right_everywhere(), "all telescopes".to_owned()),
        Needs::There(right) => {
            let (site, telescope) = (part("site").unwrap_or_default(), part("telescope").unwrap_or_default());
            let place = format!("{site}/{telescope}");
            let address = Address::new(&site, &telescope)
                .map_err(|error| Problem::not_found(format!("No telescope {place} publishes on the bus: {error}.")))?;
            (right, caller.right_at(&address), place)
        }
    };
    if has >= Some(wanted) {
        return Ok(());
    }
    let has = has.map_or("none", Right::word);
    let detail = format!(
        "{} may not do this: it needs the right {wanted} at {place}; what this request proves has {has}.",
        caller.name
    );
    Err(Problem::forbidden(detail).with("required_right", json!(wanted)))
}
