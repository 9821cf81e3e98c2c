//! Which path is answered by which route.

use std::sync::Arc;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{Method, Uri};
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::get;

use crate::addresses::NETWORK_PAGES;
use crate::api;
use crate::authentication::{Authentication, authenticate};
use crate::gate::{Gate, guard};
use crate::plain_errors::plain_errors_are_problems;
use crate::problem::{Code, Problem};
use crate::routes::{lite, page};
use crate::server::Server;
use crate::user_audit::note_refused_changes;

/// The longest body of a request: a schedule.
const LONGEST_BODY: usize = 2 << 20;

/// All routes, behind the check of access (`Gate`) and the question who asks (`authentication`).
pub fn router(server: Arc<Server>, gate: Gate, authentication: Authentication) -> Router {
    let pages = NETWORK_PAGES.iter().fold(Router::new(), |router, path| router.route(path, get(page::index)));
    Router::new()
        .merge(pages)
        .route("/t/{site}/{telescope}", get(page::index))
        .route("/t/{site}/{telescope}/{*page}", get(page::index))
        .route("/lite", get(lite::lite))
        .route("/assets/{*name}", get(page::asset))
        .route("/favicon.ico", get(page::favicon))
        .merge(api::router())
        .fallback(nothing_here)
        .method_not_allowed_fallback(other_method)
        .with_state(server.clone())
        .layer(DefaultBodyLimit::max(LONGEST_BODY))
        .layer(from_fn_with_state(server, note_refused_changes))
        .layer(from_fn_with_state(authentication, authenticate))
        .layer(from_fn(plain_errors_are_problems))
        .layer(from_fn_with_state(Arc::new(gate), guard))
}

async fn nothing_here(uri: Uri) -> Problem {
    Problem::not_found(format!("There is nothing at {}.", uri.path()))
}

async fn other_method(method: Method, uri: Uri) -> Problem {
    let detail = format!("{method} is not answered at {}; see /api/docs.", uri.path());
    Problem::new(Code::Method, "Another method is expected", detail)
}
