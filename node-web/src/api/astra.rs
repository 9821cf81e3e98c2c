//! Endpoints at the addresses that Astra answered.

use axum::http::StatusCode;
use contract::Right::{Observer, Operator, Viewer};

use super::endpoint::{Endpoint, Needs};
use crate::commands;
use crate::routes::legacy;

/// What else Astra answered, at its addresses.
pub(super) fn reads() -> Vec<Endpoint> {
    const ANYWHERE: Needs = Needs::Anywhere(Viewer);
    vec![
        Endpoint::get("/api/db/polling/{device_type}", "legacy_polling", ANYWHERE, legacy::polling)
            .summary("Polled numbers of one kind of device, a row per minute, as Astra answered them.")
            .query::<legacy::PollingQuery>()
            .gives::<legacy::PolledDays>("The rows, the oldest first, and the newest values."),
        Endpoint::get("/api/db/guiding", "legacy_guiding", ANYWHERE, legacy::guiding)
            .summary("Corrections of the guide loop as Astra answered them.")
            .query::<legacy::GuidingQuery>()
            .gives::<legacy::LegacyCorrections>("The corrections, the oldest first."),
        Endpoint::get("/api/sky_data", "legacy_sky", ANYWHERE, legacy::sky_data)
            .summary("Where the Sun, the Moon and the planets stand above the site, as Astra answered it.")
            .query::<legacy::LegacyQuery>()
            .gives::<legacy::LegacySky>("The site and the bodies."),
        Endpoint::get("/api/allsky/latest", "legacy_all_sky", ANYWHERE, legacy::all_sky)
            .summary("Astra's picture of an all-sky camera: always 404, with what is there instead.")
            .query::<legacy::LegacyQuery>()
            .gives_nothing(StatusCode::NOT_FOUND, "There is none."),
        Endpoint::get("/schedule", "legacy_schedule_page", ANYWHERE, legacy::page)
            .summary("Leads to the page of the telescope.")
            .query::<legacy::LegacyQuery>()
            .gives_nothing(StatusCode::TEMPORARY_REDIRECT, "The page."),
        Endpoint::get("/fits_explorer", "legacy_frames_page", ANYWHERE, legacy::page)
            .summary("Leads to the page of the telescope.")
            .query::<legacy::LegacyQuery>()
            .gives_nothing(StatusCode::TEMPORARY_REDIRECT, "The page."),
    ]
}

/// What Astra could be ordered, at its addresses.
pub(super) fn orders() -> Vec<Endpoint> {
    let gone = |path, id| {
        let endpoint = match id {
            "legacy_edit_schedule" | "legacy_upload_schedule" => {
                Endpoint::post(path, id, Needs::Anywhere(Operator), legacy::new_schedule)
            }
            _ => Endpoint::post(path, id, Needs::Anywhere(Operator), legacy::watchdog),
        };
        endpoint
            .summary("An order of Astra: always 410, with what to use instead.")
            .gives_nothing(StatusCode::GONE, "It is no longer answered.")
    };
    let order = |endpoint: Endpoint, summary| {
        endpoint
            .summary(summary)
            .query::<legacy::LegacyQuery>()
            .header(
                "Idempotency-Key",
                "A repeat with the same text acts once; without it each request is an order of its own.",
                false,
            )
            .header("Prefer", "wait=N: answer when the command has ended, or after N seconds, at most 60.", false)
            .gives::<commands::LegacyOrdered>("It was accepted; `command_id` follows it at /api/v1/commands/ID.")
    };
    let (observer, operator) = (Needs::Anywhere(Observer), Needs::Anywhere(Operator));
    vec![
        order(
            Endpoint::post("/api/close", "legacy_close", observer, commands::legacy_close),
            "The order `close`, at Astra's address; the answer does not wait for the dome.",
        ),
        order(
            Endpoint::post("/api/cool_camera/{device_name}", "legacy_cool", operator, commands::legacy_cool),
            "The order `cool` for one camera, at Astra's address.",
        ),
        order(
            Endpoint::post("/api/complete_headers", "legacy_complete_headers", operator, commands::legacy_headers),
            "The order `complete-headers`, at Astra's address.",
        ),
        order(
            Endpoint::post("/api/startschedule", "legacy_start", operator, commands::legacy_start),
            "The order `start`, at Astra's address.",
        ),
        order(
            Endpoint::post("/api/stopschedule", "legacy_stop", operator, commands::legacy_stop),
            "The order `stop`, at Astra's address: here it also closes.",
        ),
        gone("/api/startwatchdog", "legacy_start_watchdog"),
        gone("/api/stopwatchdog", "legacy_stop_watchdog"),
        gone("/api/editschedule", "legacy_edit_schedule"),
        gone("/api/uploadschedule", "legacy_upload_schedule"),
    ]
}
