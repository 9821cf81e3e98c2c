//! The API: every endpoint with its documentation and the right it needs, in one table.

mod astra;
mod document_page;
mod endpoint;
mod openapi;
mod push;
mod schedules;

use std::sync::Arc;

use axum::Json;
use axum::Router;
use axum::extract::{Path, State};
use axum::http::header;
use axum::response::{IntoResponse as _, Redirect, Response};
use axum::routing::get;
use contract::Part;
use contract::Right::{Engineer, Observer, Operator, Viewer};
use contract::archive::ArchiveAnswer;
use contract::archived_frame::{FrameDetails, FrameHeader, FramePixels};
use contract::observatory::{
    FocusState, GuidingState, NightState, OperatorOrders, OpticsState, PointingState, SafetyState,
};
use serde_json::Value;

use crate::command_store::CommandState;
use crate::commands::{self, CommandRequest, CommandsQuery, OrderOffered};
use crate::problem::{Code, Problem};
use crate::routes::{
    frames, health, heartbeat, history, legacy, login, metrics, network, parts, preview, records, reports, sessions,
    sky, test_messages, tokens, users,
};
use crate::server::Server;
use crate::socket;
use axum::http::StatusCode;
use endpoint::{Endpoint, Needs, Verb};

/// An endpoint that reads one part of what the observatory node publishes.
macro_rules! part {
    ($word:literal, $payload:ty, $part:expr, $summary:literal) => {
        Endpoint::get(
            concat!("/api/v1/telescopes/{site}/{telescope}/", $word),
            $word,
            Needs::There(Viewer),
            async |State(server): State<Arc<Server>>, Path(telescope): Path<(String, String)>| {
                parts::part::<$payload>(&server, &telescope, $part)
            },
        )
        .summary($summary)
        .gives::<parts::PartNow<$payload>>("With its age.")
    };
}

/// Every endpoint, in the order of the document.
fn endpoints() -> Vec<Endpoint> {
    [general(), push::endpoints(), schedules::endpoints()].into_iter().flatten().collect()
}

/// All others.
fn general() -> Vec<Endpoint> {
    const TELESCOPE: Needs = Needs::There(Viewer);
    const ENGINEER: Needs = Needs::Everywhere(Engineer);
    vec![
        Endpoint::get("/healthz", "health", Needs::Nothing, health::healthz)
            .summary("Is this node alive?")
            .gives::<health::Health>("It is."),
        Endpoint::get("/readyz", "ready", Needs::Nothing, health::readyz)
            .summary("Has this node received anything to show? 503 before.")
            .gives::<health::Health>("It has."),
        Endpoint::get("/version", "version", Needs::Nothing, health::version)
            .summary("The version of the software.")
            .gives::<health::Version>("The version."),
        Endpoint::post("/api/v1/login", "log_in", Needs::Nothing, login::log_in)
            .summary("Begins a session: the answer sets its cookie.")
            .takes::<login::LoginRequest>()
            .gives::<login::Me>("The user, and what it may do."),
        Endpoint::post("/api/v1/logout", "log_out", Needs::Known, login::log_out)
            .summary("Ends the session of this request.")
            .gives_nothing(StatusCode::NO_CONTENT, "It has ended."),
        Endpoint::get("/api/v1/me", "me", Needs::Known, login::me)
            .summary("The caller, and what it may do.")
            .gives::<login::Me>("The user, and what it may do."),
        Endpoint::put("/api/v1/me/password", "change_own_password", Needs::Known, users::own_password)
            .summary("Gives the caller another password, by the old one; all their sessions end, this one too.")
            .takes::<users::OwnPassword>()
            .gives_nothing(StatusCode::NO_CONTENT, "Log in with the new one."),
        Endpoint::post("/api/v1/ws-ticket", "ws_ticket", Needs::Known, login::ws_ticket)
            .summary("A ticket that opens one socket, as /api/v1/ws?ticket=...")
            .gives::<login::SocketTicket>("The ticket."),
        Endpoint::get("/api/v1/sessions", "sessions", Needs::Known, sessions::list)
            .summary("Sessions of the caller; for an engineer of all telescopes those of everybody.")
            .gives::<sessions::SessionList>("The sessions."),
        Endpoint::delete("/api/v1/sessions/{id}", "end_session", Needs::Known, sessions::end)
            .summary("Ends a session.")
            .gives_nothing(StatusCode::NO_CONTENT, "It has ended."),
        Endpoint::get("/api/v1/tokens", "tokens", Needs::Known, tokens::list)
            .summary("Tokens of the caller, without their secrets; for an engineer of all telescopes those of everybody.")
            .gives::<tokens::TokenList>("The tokens."),
        Endpoint::post("/api/v1/tokens", "add_token", Needs::Known, tokens::add)
            .summary("Makes a token for a program; its secret is in this answer alone.")
            .takes::<tokens::NewToken>()
            .answers::<tokens::MadeToken>(StatusCode::CREATED, "The token."),
        Endpoint::delete("/api/v1/tokens/{name}", "remove_token", Needs::Known, tokens::remove)
            .summary("Removes a token: it is refused from now on.")
            .gives_nothing(StatusCode::NO_CONTENT, "It is gone."),
        Endpoint::get("/api/v1/users", "users", ENGINEER, users::list)
            .summary("All users with their rights, and whether they are logged in.")
            .gives::<users::UserList>("The users."),
        Endpoint::put("/api/v1/users/{name}", "put_user", ENGINEER, users::put)
            .summary("Makes a user, or gives one other rights or another password. Rights count from the next request on; another password ends the user's sessions.")
            .header("If-None-Match", "*: only make a new user, and change none.", false)
            .takes::<users::UserChange>()
            .gives::<users::UserItem>("The user is changed.")
            .answers::<users::UserItem>(StatusCode::CREATED, "The user is made."),
        Endpoint::delete("/api/v1/users/{name}", "remove_user", ENGINEER, users::remove)
            .summary("Removes a user, with all sessions and tokens.")
            .gives_nothing(StatusCode::NO_CONTENT, "The user is gone."),
        Endpoint::get("/api/v1/network", "network", Needs::Anywhere(Viewer), network::network)
            .summary("All telescopes in short, with their nodes.")
            .gives::<network::NetworkAnswer>("The network."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}", "telescope", TELESCOPE, network::telescope)
            .summary("Everything that is known of a telescope: the newest payload of each key, and the last lines of its log.")
            .gives::<network::TelescopeAnswer>("The telescope."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/sky", "sky", TELESCOPE, sky::sky)
            .summary("Where it stands, and the sky above it: twilights, Sun, Moon, sidereal time, horizon.")
            .query::<sky::SkyQuery>()
            .gives::<sky::SkyAt>("The sky."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/image.jpg", "newest_image", TELESCOPE, preview::image)
            .summary("The newest image, made for eyes.")
            .query::<preview::PreviewQuery>()
            .gives_media("image/jpeg", "The image; its ETag is the id of its frame."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/frames", "frames", TELESCOPE, history::frames)
            .summary("Frames that meet all conditions, the oldest first, asked of the telescope's archive.")
            .query::<history::FramesQuery>()
            .gives::<ArchiveAnswer>("The frames."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/frames/{id}", "frame", TELESCOPE, frames::one)
            .summary("One frame with everything that was measured on it.")
            .gives::<FrameDetails>("The frame."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/frames/{id}/header", "frame_header", TELESCOPE, frames::file::header)
            .summary("Every card of the frame's file, in order.")
            .query::<frames::file::HeaderQuery>()
            .revalidates()
            .gives::<FrameHeader>("The cards; the ETag is the version of the file."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/frames/{id}/file", "frame_file", TELESCOPE, frames::file::file)
            .summary("The FITS file as the archive stores it.")
            .header("Range", "One range of bytes, such as bytes=0-2879.", false)
            .header("If-Range", "The ETag of the version that the range continues; of another version the whole file comes.", false)
            .revalidates()
            .gives_media("application/fits", "The file.")
            .answers_media(StatusCode::PARTIAL_CONTENT, "application/fits", "The range."),
        Endpoint::get(
            "/api/v1/telescopes/{site}/{telescope}/frames/{id}/preview",
            "frame_preview",
            TELESCOPE,
            frames::pictures::preview,
        )
        .summary("The frame, made for eyes.")
        .query::<frames::pictures::PictureQuery>()
        .revalidates()
        .gives_media("image/jpeg", "The picture; the first row of the file is the upper one."),
        Endpoint::get(
            "/api/v1/telescopes/{site}/{telescope}/frames/{id}/tiles/{z}/{x}/{y}",
            "frame_tile",
            TELESCOPE,
            frames::pictures::tile,
        )
        .summary("A tile of at most 256 x 256 numbers of 16 bits, the lower byte first, row by row from the first row.")
        .revalidates()
        .gives_media(
            "application/octet-stream",
            "The numbers. Headers: Tile-Width and Tile-Height; a value is Tile-Zero + Tile-Scale x number; Tile-Blank is the number \
             without a value; Tile-Highest-Z the level of single pixels.",
        ),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/frames/{id}/pixels", "frame_pixels", TELESCOPE, frames::pictures::pixels)
            .summary("Values of pixels of a frame, at most 65,536.")
            .query::<frames::pictures::PixelsQuery>()
            .revalidates()
            .gives::<FramePixels>("The values, row by row."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/cameras/{camera}/latest", "latest_frame", TELESCOPE, frames::latest)
            .summary("The newest stored frame of a camera.")
            .gives::<FrameDetails>("The frame."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/nights/{night}/report", "night_report", TELESCOPE, reports::report)
            .summary("The report of a night until now: where the time went, targets, alerts, orders.")
            .header("Accept", "text/html for the page.", false)
            .gives::<Value>("The report.")
            .gives_media("text/html", "The report as a page."),
        Endpoint::get(
            "/api/v1/telescopes/{site}/{telescope}/nights/{night}/report.html",
            "night_report_page",
            TELESCOPE,
            reports::page,
        )
        .summary("The report of a night as a page.")
        .gives_media("text/html", "The report."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/nights/{night}/alerts", "night_alerts", TELESCOPE, reports::alerts)
            .summary("Alerts that stood in a night, also those that are over, in the order in which they were raised.")
            .gives::<ArchiveAnswer>("The alerts."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/series", "series", TELESCOPE, history::series)
            .summary("Properties over any time, drawn with few points; extremes are kept and gaps listed.")
            .query::<history::SeriesQuery>()
            .gives::<ArchiveAnswer>("The series."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/log", "log", TELESCOPE, records::log)
            .summary("Lines of the log of all its nodes that meet all conditions, the oldest first, asked of its archive.")
            .query::<records::LogQuery>()
            .gives::<ArchiveAnswer>("The lines."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/audit", "audit", Needs::There(Engineer), records::audit)
            .summary("Records of what was ordered and moved, the oldest first, asked of its archive.")
            .query::<records::RecordsQuery>()
            .gives::<ArchiveAnswer>("The records."),
        Endpoint::get(
            "/api/v1/telescopes/{site}/{telescope}/guiding/corrections",
            "guiding_corrections",
            TELESCOPE,
            records::corrections,
        )
        .summary("Corrections of the guide loop, the oldest first, asked of its archive.")
        .query::<records::RecordsQuery>()
        .gives::<ArchiveAnswer>("The corrections."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/devices", "devices", TELESCOPE, parts::devices)
            .summary("Its devices with their states and what they can do.")
            .gives::<Vec<parts::DeviceNow>>("The devices."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/devices/{kind}/{name}", "device", TELESCOPE, parts::device)
            .summary("One device.")
            .gives::<parts::DeviceNow>("The device."),
        part!("safety", SafetyState, Part::Safety, "The verdict, its reasons, and every input with its age."),
        part!("night", NightState, Part::Night, "Posture, the robotic switch, and the actions under way."),
        part!("guiding", GuidingState, Part::Guiding, "The guide loop."),
        part!("focus", FocusState, Part::Focus, "The focus run with its points, and the best known positions."),
        part!("pointing", PointingState, Part::Pointing, "How far from its targets it points, and the pointing models."),
        part!("optics", OpticsState, Part::Optics, "Scale, orientation and zero points, as learned from solved frames."),
        part!("operator-orders", OperatorOrders, Part::OperatorOrders, "What people have ordered and what still holds."),
        Endpoint::get("/api/v1/alerts", "alerts", Needs::Anywhere(Viewer), parts::alerts)
            .summary("Alerts of all telescopes: those that need somebody first, and those whose cause is gone last.")
            .query::<parts::AlertsQuery>()
            .gives::<Vec<parts::AlertOfTelescope>>("The alerts."),
        Endpoint::post("/api/v1/alerts/test", "test_alerts", Needs::Anywhere(Operator), test_messages::send)
            .summary("Sends a message that says that it is a test to everybody who gets alerts of this server's telescope; at most each 10 s.")
            .gives::<test_messages::TestMessages>("What came of each message."),
        Endpoint::get(
            "/api/v1/telescopes/{site}/{telescope}/commands/catalog",
            "command_catalog",
            TELESCOPE,
            commands::catalog,
        )
        .summary("What may be ordered of a telescope: parameters, the right it needs, and what stands against it now.")
        .gives::<Vec<OrderOffered>>("Every order."),
        Endpoint::post(
            "/api/v1/telescopes/{site}/{telescope}/commands",
            "give_command",
            Needs::There(Observer),
            commands::give,
        )
        .summary("Orders something of a telescope. The same key and body again gives the same command, and acts once.")
        .header("Idempotency-Key", "A text of your own that is new for each command, at most 100 characters.", true)
        .header("Prefer", "wait=N: answer when the command has ended, or after N seconds, at most 60.", false)
        .takes::<CommandRequest>()
        .answers::<CommandState>(StatusCode::ACCEPTED, "It was accepted, or its outcome is not known yet."),
        Endpoint::get("/api/v1/commands", "commands", Needs::Anywhere(Viewer), commands::list)
            .summary("Commands that this web node took, the newest first.")
            .query::<CommandsQuery>()
            .gives::<Vec<CommandState>>("The commands."),
        Endpoint::get("/api/v1/commands/{id}", "command", Needs::Anywhere(Viewer), commands::one)
            .summary("What became of a command.")
            .gives::<CommandState>("The command."),
        Endpoint::get("/metrics", "metrics", Needs::Anywhere(Viewer), metrics::metrics)
            .summary("The network for Prometheus; what is stale is absent.")
            .gives_media("text/plain", "Prometheus's text format."),
        Endpoint::get("/api/heartbeat", "heartbeat", Needs::Anywhere(Viewer), heartbeat::heartbeat)
            .summary("The document that monitoring scripts know from Astra; a silent telescope is not `error_free`.")
            .query::<heartbeat::HeartbeatQuery>()
            .gives::<Value>("`{status, message, data}`."),
        Endpoint::get("/api/schedule", "legacy_schedule", Needs::Anywhere(Viewer), legacy::schedule)
            .summary("The rows of the schedule as Astra answered them.")
            .query::<legacy::LegacyQuery>()
            .gives::<Vec<legacy::LegacyRow>>("The rows."),
        Endpoint::get("/api/log", "legacy_log", Needs::Anywhere(Viewer), legacy::log)
            .summary("The last lines of the log as Astra answered them.")
            .query::<legacy::LegacyLogQuery>()
            .gives::<Vec<legacy::LegacyLine>>("The lines, the oldest first."),
        Endpoint::get("/api/latest_image_preview", "legacy_image", Needs::Anywhere(Viewer), legacy::latest_image)
            .summary("The newest image, at Astra's address.")
            .query::<legacy::LegacyQuery>()
            .gives_media("image/jpeg", "The image."),
        Endpoint::post("/api/roboticswitch", "legacy_robotic_switch", Needs::Anywhere(Operator), legacy::robotic_switch)
            .summary("Astra's toggle: always 410, with what to use instead.")
            .gives_nothing(StatusCode::GONE, "It is no longer answered."),
    ]
    .into_iter()
    .chain(astra::reads())
    .chain(astra::orders())
    .collect()
}

/// All endpoints, the socket, and the documents about them.
pub fn router() -> Router<Arc<Server>> {
    let document = Arc::new(openapi::document(&endpoints(), env!("CARGO_PKG_VERSION")));
    let page = document_page::html(&document);
    let mut router = Router::new();
    for (path, route) in endpoints().into_iter().map(Endpoint::into_route) {
        router = router.route(path, route);
    }
    router
        .route("/api/v1/ws", get(socket::open))
        .route("/ws", get(socket::open_tables))
        .route("/ws/log", get(socket::open_log))
        .route("/fits_explorer/", get(legacy::page))
        .route("/api/openapi.json", get(async move || Json(Value::clone(&document))))
        .route("/api/asyncapi.json", get(async || Json(contract::async_api::document(env!("CARGO_PKG_VERSION")))))
        .route("/api/socket.json", get(async || Json(socket::document(env!("CARGO_PKG_VERSION")))))
        .route("/problems/{code}", get(problem))
        .route("/api/docs", get(async move || html(page)))
}

/// What is answered next to the endpoints.
const DOCUMENTS: [&str; 5] = ["/api/v1/ws", "/api/openapi.json", "/api/asyncapi.json", "/api/socket.json", "/api/docs"];

/// Paths of all that may be read, each parameter as `{name}`.
pub fn readable_paths() -> Vec<&'static str> {
    let read = endpoints().into_iter().filter(|endpoint| endpoint.verb == Verb::Get).map(|endpoint| endpoint.path);
    read.chain(DOCUMENTS).collect()
}

/// Leads from the type of a problem to what it means.
async fn problem(Path(word): Path<String>) -> Result<Redirect, Problem> {
    match Code::ALL.iter().find(|code| code.word() == word) {
        Some(code) => Ok(Redirect::to(&format!("/api/docs#problem-{}", code.word()))),
        None => Err(Problem::not_found(format!("{word:?} is no kind of problem; /api/docs lists them."))),
    }
}

fn html(page: String) -> Response {
    ([(header::CONTENT_TYPE, "text/html; charset=utf-8")], page).into_response()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn each_endpoint_is_named_once_and_described() {
        let endpoints = endpoints();
        let ids: BTreeSet<&str> = endpoints.iter().map(|endpoint| endpoint.id).collect();
        assert_eq!(ids.len(), endpoints.len());
        for endpoint in &endpoints {
            assert!(endpoint.summary.ends_with(['.', '?']) && !endpoint.answers.is_empty(), "{}", endpoint.path);
            let is_of_telescope = endpoint.path.contains("{telescope}");
            assert!(is_of_telescope == matches!(endpoint.needs, Needs::There(_)), "{}", endpoint.path);
        }
    }
}
