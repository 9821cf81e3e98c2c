//! Endpoints of schedules and drafts of them.

use axum::http::StatusCode;
use contract::Right::{Observer, Operator, Viewer};
use contract::observatory::{ActionKind, ScheduleFindings, SchedulePlan, ScheduleState, ScheduleVersion};
use serde_json::{Map, Value};

use super::endpoint::{Endpoint, Needs};
use crate::command_store::CommandState;
use crate::drafts::DraftSummary;
use crate::routes::parts;
use crate::schedules::{
    self, ActionsQuery, ActivateRequest, Draft, Forecast, JSONL, Revision, RevisionsQuery, ScheduleDifference,
    SimulateQuery,
};

/// The endpoints.
pub(super) fn endpoints() -> Vec<Endpoint> {
    const VIEW: Needs = Needs::There(Viewer);
    const OBSERVE: Needs = Needs::There(Observer);
    const IF_MATCH: &str = "If-Match";
    vec![
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/schedule", "schedule", VIEW, schedules::in_force)
            .summary("The rows of the schedule with their progress; with `Accept: application/jsonl` its text.")
            .gives::<parts::PartNow<ScheduleState>>("With its age; the ETag of the text is its `sha256`.")
            .gives_media(JSONL, "The text in force."),
        Endpoint::get(
            "/api/v1/telescopes/{site}/{telescope}/schedule/revisions",
            "schedule_revisions",
            VIEW,
            schedules::revisions,
        )
        .summary("The schedules that were in force, the newest first, as the observatory node stored them.")
        .query::<RevisionsQuery>()
        .gives::<Vec<ScheduleVersion>>("By whom, when and why."),
        Endpoint::get(
            "/api/v1/telescopes/{site}/{telescope}/schedule/revisions/{version}",
            "schedule_revision",
            VIEW,
            schedules::revision,
        )
        .summary("One of them; with `Accept: application/jsonl` its text alone.")
        .gives::<Revision>("With its text.")
        .gives_media(JSONL, "The text."),
        Endpoint::get(
            "/api/v1/telescopes/{site}/{telescope}/schedule/action-schemas",
            "action_schemas",
            VIEW,
            schedules::action_schemas,
        )
        .summary("The actions that the telescope knows: what they do, and a JSON Schema of the parameters with units.")
        .query::<ActionsQuery>()
        .gives::<Vec<ActionKind>>("The actions."),
        Endpoint::post(
            "/api/v1/telescopes/{site}/{telescope}/schedule/validate",
            "validate_schedule",
            OBSERVE,
            schedules::validate,
        )
        .summary("What is wrong with a schedule, by the observatory node; nothing is stored or changed.")
        .takes::<Vec<Map<String, Value>>>()
        .takes_media(JSONL)
        .gives::<ScheduleFindings>("The findings."),
        Endpoint::post(
            "/api/v1/telescopes/{site}/{telescope}/schedule/simulate",
            "simulate_schedule",
            OBSERVE,
            schedules::simulate,
        )
        .summary("What a schedule will do: the forecast of `starmesh plan`, by the observatory node; nothing moves.")
        .query::<SimulateQuery>()
        .takes::<Vec<Map<String, Value>>>()
        .takes_media(JSONL)
        .gives::<SchedulePlan>("Each row with its begin, end, frames, altitudes, and why it is at risk."),
        Endpoint::get("/api/v1/telescopes/{site}/{telescope}/forecast", "forecast", VIEW, schedules::forecast)
            .summary("What is left of the schedule in force, from now on under a good sky; made once for all readers.")
            .revalidates()
            .gives::<Forecast>("As of `simulate`, with the time at which it was made; the ETag changes with it."),
        Endpoint::get(
            "/api/v1/telescopes/{site}/{telescope}/schedule/drafts",
            "schedule_drafts",
            OBSERVE,
            schedules::list,
        )
        .summary("Drafts of schedules that this web node stores, by name.")
        .gives::<Vec<DraftSummary>>("The drafts, without their texts."),
        Endpoint::get(
            "/api/v1/telescopes/{site}/{telescope}/schedule/drafts/{draft}",
            "schedule_draft",
            OBSERVE,
            schedules::read,
        )
        .summary("A draft; with `Accept: application/jsonl` its text alone.")
        .gives::<Draft>("With its text and its ETag.")
        .gives_media(JSONL, "The text."),
        Endpoint::put(
            "/api/v1/telescopes/{site}/{telescope}/schedule/drafts/{draft}",
            "put_schedule_draft",
            OBSERVE,
            schedules::put,
        )
        .summary("Stores a draft, valid or not.")
        .header(IF_MATCH, "The ETag of the draft that it changes.", false)
        .header("If-None-Match", "*: the draft is new. One of the two is needed.", false)
        .takes::<Vec<Map<String, Value>>>()
        .takes_media(JSONL)
        .answers::<DraftSummary>(StatusCode::CREATED, "It is new.")
        .gives::<DraftSummary>("It was changed."),
        Endpoint::delete(
            "/api/v1/telescopes/{site}/{telescope}/schedule/drafts/{draft}",
            "remove_schedule_draft",
            OBSERVE,
            schedules::remove,
        )
        .summary("Removes a draft.")
        .header(IF_MATCH, "The ETag of the draft.", true)
        .gives_nothing(StatusCode::NO_CONTENT, "It is gone."),
        Endpoint::get(
            "/api/v1/telescopes/{site}/{telescope}/schedule/drafts/{draft}/diff",
            "schedule_draft_diff",
            OBSERVE,
            schedules::diff,
        )
        .summary("What would change if the draft were put in force now: rows that are new, gone or changed.")
        .gives::<ScheduleDifference>("The rows, in the order of the draft."),
        Endpoint::post(
            "/api/v1/telescopes/{site}/{telescope}/schedule/drafts/{draft}/activate",
            "activate_schedule_draft",
            Needs::There(Operator),
            schedules::activate,
        )
        .summary(
            "Puts a draft in force, as the order `put-schedule`; a draft with errors is refused with its findings.",
        )
        .header("Idempotency-Key", "A text of your own that is new for each command, at most 100 characters.", true)
        .header(IF_MATCH, "The ETag of the schedule in force that it replaces; * for whichever is.", true)
        .header("Prefer", "wait=N: answer when the command has ended, or after N seconds, at most 60.", false)
        .takes::<ActivateRequest>()
        .answers::<CommandState>(StatusCode::ACCEPTED, "The command."),
    ]
}
