//! The past of a telescope, asked of its archive: frames by what they show, and properties drawn over any time.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use contract::archive::{ArchiveAnswer, ArchiveQuestion, Ask, BadSeriesName};
use contract::frame_search::{BadPlace, FrameSearch};
use contract::{Address, Key};
use schemars::JsonSchema;
use serde::Deserialize;
use units::Utc;

use crate::json_body::AskedFor;
use crate::problem::{Code, Problem};
use crate::routes::network::known;
use crate::server::Server;

/// The archive answers within this time, or the question was too large for it.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Rows of one answer.
const MOST_ROWS: u32 = 100_000;
/// Points of a property where the question does not name a number.
const USUAL_POINTS: u16 = 500;

/// Conditions on frames, as the query of an address.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FramesQuery {
    /// Such as 20261121: the day of its evening at the site.
    night: Option<String>,
    /// Name of the camera.
    camera: Option<String>,
    /// What the frame shows.
    object: Option<String>,
    /// Filter in the beam.
    filter: Option<String>,
    /// light, acquisition, bias, dark, flat, test, or any IMAGETYP keyword.
    image_type: Option<String>,
    /// What shows this place, as right ascension and declination in degrees (ICRS): 97.6366,29.6723.
    covers: Option<String>,
    /// At most so wide, arcsec.
    fwhm_max_arcsec: Option<f64>,
    /// At least so many stars.
    stars_min: Option<u16>,
    /// With the frames that calibrate them.
    #[serde(default)]
    with_calibration: bool,
    /// Exposed at this sky time or later.
    from_utc: Option<Utc>,
    /// Exposed before this sky time.
    to_utc: Option<Utc>,
    /// At most so many, the newest.
    #[schemars(range(max = 100_000))]
    limit: Option<u32>,
}

/// Frames that meet the conditions, the oldest first, then those that calibrate them.
pub async fn frames(
    State(server): State<Arc<Server>>,
    Path(telescope): Path<(String, String)>,
    AskedFor(query): AskedFor<FramesQuery>,
) -> Result<Response, Problem> {
    let covers = query.covers.as_deref().map(str::parse).transpose();
    let covers = covers.map_err(|error: BadPlace| Problem::malformed(format!("covers: {error}")))?;
    // The bus has no such number, and the archive would find frames of any width.
    if query.fwhm_max_arcsec.is_some_and(|most| !most.is_finite()) {
        return Err(Problem::malformed("fwhm_max_arcsec: expected a number of arcseconds, such as 2.5"));
    }
    let search = FrameSearch {
        night: query.night,
        camera: query.camera,
        object: query.object,
        filter: query.filter,
        image_type: query.image_type,
        covers,
        fwhm_max_arcsec: query.fwhm_max_arcsec,
        stars_min: query.stars_min.map(u32::from),
        with_calibration: query.with_calibration,
    };
    let ask = Ask::FindFrames(Box::new(search));
    let question = ArchiveQuestion { ask, from_utc: query.from_utc, to_utc: query.to_utc, limit: query.limit };
    ask_archive(&server, &telescope, &question).await
}

/// Properties over a time, as the query of an address.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeriesQuery {
    /// Such as `observingconditions/wx/WindGust`, several with a comma between them.
    properties: String,
    /// From this sky time on.
    from_utc: Option<Utc>,
    /// Before this sky time.
    to_utc: Option<Utc>,
    /// At most so many points of each.
    points: Option<u16>,
}

/// Properties drawn with few points, their extremes kept, gaps listed.
pub async fn series(
    State(server): State<Arc<Server>>,
    Path(telescope): Path<(String, String)>,
    AskedFor(query): AskedFor<SeriesQuery>,
) -> Result<Response, Problem> {
    let properties: Result<Vec<_>, _> = query.properties.split(',').map(str::parse).collect();
    let properties = properties.map_err(|error: BadSeriesName| Problem::malformed(format!("properties: {error}")))?;
    let ask = Ask::Series { properties, points: query.points.unwrap_or(USUAL_POINTS).into() };
    let question = ArchiveQuestion { ask, from_utc: query.from_utc, to_utc: query.to_utc, limit: None };
    ask_archive(&server, &telescope, &question).await
}

/// Asks the archive of a telescope.
///
/// # Errors
/// Where there is no such telescope, or its archive does not answer.
pub async fn ask_archive(
    server: &Server,
    (site, telescope): &(String, String),
    question: &ArchiveQuestion,
) -> Result<Response, Problem> {
    if question.limit.is_some_and(|limit| limit > MOST_ROWS) {
        return Err(Problem::malformed(format!("limit: expected at most {MOST_ROWS}.")));
    }
    let address = known(&server.network, site, telescope)?;
    let answer = asked(server, address, question).await?;
    Ok(([(header::CACHE_CONTROL, "no-store")], Json(answer)).into_response())
}

/// What the archive of a telescope answers.
///
/// # Errors
/// Where it does not answer.
pub async fn asked(server: &Server, address: Address, question: &ArchiveQuestion) -> Result<ArchiveAnswer, Problem> {
    let key = Key::History(address);
    server.bus.ask(&key, question, TIMEOUT).await.map_err(|error| {
        let detail = format!(
            "The archive of {} did not answer ({error}). Look whether its archive node runs, or ask for less.",
            key.address()
        );
        Problem::new(Code::Archive, "The archive does not answer", detail)
    })
}
