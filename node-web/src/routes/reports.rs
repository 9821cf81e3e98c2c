//! The report of a night, and its alerts alone, by the telescope's archive.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use contract::Key;
use contract::archive::{ArchiveQuestion, Ask};
use contract::archived_frame::{ReportAnswer, ReportForm, ReportGiven, ReportQuestion};
use sky::NightDate;
use units::Angle;

use crate::problem::Problem;
use crate::routes::frames::{FramePath, TIMEOUT, problem, silent};
use crate::routes::history::ask_archive;
use crate::routes::network::known;
use crate::server::Server;

/// The page brings its own style and draws in itself; it loads nothing and runs nothing.
const PAGE_POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; \
                           frame-ancestors 'none'; sandbox";

/// As JSON, or as a page for who prefers HTML.
pub async fn report(server: State<Arc<Server>>, path: FramePath, headers: HeaderMap) -> Result<Response, Problem> {
    let accepted = headers.get(header::ACCEPT).and_then(|accepted| accepted.to_str().ok()).unwrap_or_default();
    let at = |word: &str| accepted.find(word);
    let is_page = at("text/html").is_some_and(|html| at("application/json").is_none_or(|json| html < json));
    let mut response = ask(server, path, if is_page { ReportForm::Html } else { ReportForm::Json }).await?;
    response.headers_mut().insert(header::VARY, header::HeaderValue::from_static("Accept"));
    Ok(response)
}

/// As a page.
pub async fn page(server: State<Arc<Server>>, path: FramePath) -> Result<Response, Problem> {
    ask(server, path, ReportForm::Html).await
}

/// The alerts that stood in a night, as the report has them.
pub async fn alerts(
    State(server): State<Arc<Server>>,
    Path((site, telescope, night)): FramePath,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let date = date(&night)?;
    // As the summary names the night of now; where no place is known, the page counts nights by UTC.
    let place = server.network.read().place(&address);
    let longitude = place.map_or(Angle::from_degrees(0.0), |(place, _)| place.longitude_east());
    let (from_utc, to_utc) = (Some(date.noon(longitude)), Some(date.next().noon(longitude)));
    let question = ArchiveQuestion { ask: Ask::Alerts, from_utc, to_utc, limit: None };
    ask_archive(&server, &(site, telescope), &question).await
}

/// The night of an address, such as `20261121` or `2026-11-21`.
fn date(night: &str) -> Result<NightDate, Problem> {
    night.replace('-', "").parse().map_err(|_| {
        Problem::not_found(format!("{night:?} is no night; expected the date of its evening, such as 20261121."))
    })
}

async fn ask(
    State(server): State<Arc<Server>>,
    Path((site, telescope, night)): FramePath,
    form: ReportForm,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let question = ReportQuestion { night: date(&night)?.to_string(), form };
    let answer: Result<ReportAnswer, _> = server.bus.ask(&Key::NightReport(address), &question, TIMEOUT).await;
    let text = match answer.map_err(|error| silent(&site, &telescope, &error))?.gives {
        ReportGiven::Report(text) => text,
        ReportGiven::Refused(refusal) => return Err(problem(&refusal)),
    };
    let named = match form {
        ReportForm::Json => vec![(header::CONTENT_TYPE, "application/json")],
        ReportForm::Html => {
            vec![(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CONTENT_SECURITY_POLICY, PAGE_POLICY)]
        }
    };
    let mut response = ([(header::CACHE_CONTROL, "no-store")], text).into_response();
    for (name, value) in named {
        response.headers_mut().insert(name, header::HeaderValue::from_static(value));
    }
    Ok(response)
}
