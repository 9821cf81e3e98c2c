//! Addresses that scripts of Astra's users read, answered as they know them, for one telescope: `?telescope=` names it where
//! there are several. Newer programs use `/api/v1`.

mod past;
mod rows;
mod sky_now;

use std::sync::Arc;

use axum::extract::{Extension, State};
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse as _, Redirect, Response};
use contract::{Address, Right};
use schemars::JsonSchema;
use serde::Deserialize;
use users::Principal;

use crate::json_body::AskedFor;
use crate::problem::{Code, Problem};
use crate::server::Server;

pub use past::{GuidingQuery, LegacyCorrections, PolledDays, PollingQuery, guiding, polling};
pub use rows::{LegacyLine, LegacyLogQuery, LegacyRow, latest_image, log, schedule};
pub use sky_now::{LegacySky, sky_data};

/// So many telescopes are named where one of several has to be chosen.
const MOST_NAMED: usize = 20;

/// Which telescope.
#[derive(Debug, JsonSchema, Deserialize)]
pub struct LegacyQuery {
    /// As its id or as `site/telescope`; needed where there are several.
    pub telescope: Option<String>,
}

/// The telescope that is meant, where the caller may see it.
///
/// # Errors
/// Where there is none, where there are several, and where the caller has no right there.
pub fn the_telescope(server: &Server, caller: &Principal, name: Option<&str>) -> Result<Address, Problem> {
    // The same answer for every telescope that is named in full, whether it is there or not.
    let named = name.and_then(|name| name.split_once('/')).and_then(|(site, id)| Address::new(site, id).ok());
    if let Some(address) = named.filter(|address| caller.right_at(address).is_none()) {
        let detail = format!("{} may not do this: it needs the right viewer at {address}.", caller.name);
        return Err(Problem::forbidden(detail).with("required_right", serde_json::json!(Right::Viewer)));
    }
    let model = server.network.read();
    let is_meant = |address: &Address| match name {
        Some(name) => address.telescope.as_str() == name || address.to_string() == name,
        None => address.telescope.as_str() != Address::SHARED,
    };
    let found: Vec<&Address> =
        model.telescopes.keys().filter(|address| is_meant(address) && caller.right_at(address).is_some()).collect();
    match (found.as_slice(), name) {
        ([address], _) => Ok(Address::clone(address)),
        ([], Some(name)) => Err(Problem::not_found(format!("No telescope {name} publishes on the bus."))),
        ([], None) => Err(Problem::not_found("No telescope publishes on the bus that you may see.")),
        (several, _) => {
            let names: Vec<String> = several.iter().take(MOST_NAMED).map(ToString::to_string).collect();
            let more = if several.len() > MOST_NAMED { ", ..." } else { "" };
            let detail = format!(
                "There are several telescopes: ask with ?telescope=SITE/TELESCOPE, which may be {}{more}.",
                names.join(", ")
            );
            Err(Problem::malformed(detail).with("telescopes", serde_json::json!(names)))
        }
    }
}

/// Says where the newer answer is: a part of the telescope's.
pub fn instead(part: &str, address: &Address, response: Response) -> Response {
    succeeded_by(&format!("/api/v1/telescopes/{address}/{part}"), response)
}

/// Says where the newer answer is.
fn succeeded_by(path: &str, mut response: Response) -> Response {
    let headers = response.headers_mut();
    if let Ok(link) = format!("<{path}>; rel=\"successor-version\"").parse() {
        headers.insert(header::LINK, link);
    }
    headers.insert("deprecation", HeaderValue::from_static("true"));
    response
}

/// The picture of an all-sky camera, of which no node knows.
pub async fn all_sky(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    AskedFor(query): AskedFor<LegacyQuery>,
) -> Result<Response, Problem> {
    let address = the_telescope(&server, &caller, query.telescope.as_deref())?;
    let image = format!("/api/v1/telescopes/{address}/image.jpg");
    let detail = format!(
        "No node publishes the picture of an all-sky camera. The newest image of the telescope itself is at {image}, and its weather \
         at /api/v1/telescopes/{address}/devices."
    );
    Ok(succeeded_by(&image, Problem::not_found(detail).into_response()))
}

/// Astra's pages of a telescope: what they showed is on its page now; the page of all where there are several.
pub async fn page(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    AskedFor(query): AskedFor<LegacyQuery>,
) -> Result<Response, Problem> {
    let path = match the_telescope(&server, &caller, query.telescope.as_deref()) {
        Ok(address) => format!("/t/{address}"),
        Err(problem) if query.telescope.is_some() => return Err(problem),
        Err(_) => "/".to_owned(),
    };
    Ok(succeeded_by(&path, Redirect::temporary(&path).into_response()))
}

/// A toggle: two clicks, or two people, turn an intention around.
pub async fn robotic_switch() -> Problem {
    let detail =
        "A toggle is not answered any more: order `start` or `stop` at /api/v1/telescopes/SITE/TELESCOPE/commands.";
    Problem::new(Code::Gone, "This address is no longer answered", detail)
}

/// What watches over a telescope cannot be started or stopped.
pub async fn watchdog() -> Problem {
    let detail = "The watch over the weather runs as long as the observatory node does, and nobody starts or stops it. Alerts are \
                  acknowledged with the order `ack`, and one limit is passed over for a while with `override`, at \
                  /api/v1/telescopes/SITE/TELESCOPE/commands.";
    Problem::new(Code::Gone, "This address is no longer answered", detail)
}

/// A schedule is checked before it is put in force.
pub async fn new_schedule() -> Problem {
    let detail = "A schedule is put in force with the order `put-schedule` at /api/v1/telescopes/SITE/TELESCOPE/commands, which refuses \
                  one with errors and says what they are.";
    Problem::new(Code::Gone, "This address is no longer answered", detail)
}
