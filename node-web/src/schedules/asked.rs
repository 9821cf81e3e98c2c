//! What the observatory node is asked about schedules.

use std::time::Duration;

use contract::observatory::{
    Finding, ScheduleDraft, ScheduleFindings, SchedulePlan, SchedulePlanQuestion, ScheduleTextQuestion, ScheduleTexts,
};
use contract::{Address, Key, Payload};
use serde::de::DeserializeOwned;
use serde_json::json;
use tokio::sync::SemaphorePermit;

use crate::problem::{Code, Problem};
use crate::server::Server;

/// A text of thousands of rows needs some seconds.
const CHECKED_WITHIN: Duration = Duration::from_secs(15);
/// The observatory node gives a forecast up after 15 s; another question may be before it.
const PLANNED_WITHIN: Duration = Duration::from_secs(40);
const ANSWERED_WITHIN: Duration = Duration::from_secs(5);

/// The findings of a text.
///
/// # Errors
/// The observatory node does not answer.
pub async fn findings(server: &Server, address: &Address, text: &str) -> Result<ScheduleFindings, Problem> {
    let _place = place(server)?;
    let draft = ScheduleDraft { text: text.to_owned() };
    ask(server, address, &Key::ScheduleCheck(address.clone()), &draft, CHECKED_WITHIN).await
}

/// The forecast of a text.
///
/// # Errors
/// The text is refused, it takes too long, or the observatory node does not answer.
pub async fn plan(
    server: &Server,
    address: &Address,
    question: &SchedulePlanQuestion,
) -> Result<SchedulePlan, Problem> {
    let _place = place(server)?;
    let key = Key::SchedulePlan(address.clone());
    let plan: SchedulePlan = ask(server, address, &key, question, PLANNED_WITHIN).await?;
    if !plan.findings.is_empty() {
        return Err(refused(&plan.findings, plan.findings.len()));
    }
    match (&plan.night, &plan.problem) {
        (None, why) => {
            Err(Problem::invalid(format!("There is no forecast: {}.", why.as_deref().unwrap_or("no reason was given"))))
        }
        _ => Ok(plan),
    }
}

/// A text that is or was active, or the list of them.
///
/// # Errors
/// The observatory node does not answer.
pub async fn texts(
    server: &Server,
    address: &Address,
    question: &ScheduleTextQuestion,
) -> Result<ScheduleTexts, Problem> {
    ask(server, address, &Key::ScheduleTexts(address.clone()), question, ANSWERED_WITHIN).await
}

/// The text that was asked for with its hash.
///
/// # Errors
/// As of [`texts`]; 404 where there is none, 504 where there is one that cannot be had: an editor must not take that for none.
pub async fn text(
    server: &Server,
    address: &Address,
    version: Option<u64>,
) -> Result<(String, String, ScheduleTexts), Problem> {
    let question = ScheduleTextQuestion { version, ..ScheduleTextQuestion::default() };
    let mut found = texts(server, address, &question).await?;
    match (found.text.take(), found.sha256.take()) {
        (Some(text), Some(sha256)) => Ok((text, sha256, found)),
        _ => Err(match (found.problem, version) {
            (Some(why), _) => {
                Problem::new(Code::Observatory, "The schedule cannot be read", format!("{address}: {why}."))
            }
            (None, Some(version)) => Problem::not_found(format!("{address} had no version {version} of the schedule.")),
            (None, None) => Problem::not_found(format!("No schedule of {address} is in force.")),
        }),
    }
}

/// A text that is refused, with all findings.
pub fn refused(findings: &[Finding], errors: usize) -> Problem {
    let first = findings.iter().find(|finding| finding.severity == contract::observatory::Severity::Error);
    let first = first.map(|finding| format!(": {finding}")).unwrap_or_default();
    let detail = format!("The schedule is refused, {errors} errors{first}.");
    Problem::invalid(detail).with("errors", json!(findings))
}

/// Asks the observatory node.
///
/// # Errors
/// It does not answer.
pub async fn ask<Q: Payload, A: DeserializeOwned>(
    server: &Server,
    address: &Address,
    key: &Key,
    question: &Q,
    within: Duration,
) -> Result<A, Problem> {
    server.bus.ask(key, question, within).await.map_err(|error| {
        let detail = format!(
            "The observatory node of {address} did not answer: {error}. Nothing was changed; look whether it runs."
        );
        Problem::new(Code::Observatory, "The observatory node does not answer", detail)
    })
}

/// The observatory node works on one text at a time; a queue of them helps nobody.
fn place(server: &Server) -> Result<SemaphorePermit<'_>, Problem> {
    server.forecasts.try_acquire().map_err(|_| {
        let detail = "Other schedules are being checked or forecast at the moment; ask again in some seconds.";
        Problem::new(Code::Busy, "Busy", detail)
    })
}
