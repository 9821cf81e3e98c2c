//! Publishes the findings of the active schedule, and answers on the bus what is wrong with any other.

use std::sync::Arc;
use std::time::Duration;

use bus::Service;
use contract::Key;
use contract::observatory::{Check, ScheduleDraft, ScheduleFindings};
use schedule::Position;
use schedule::fault::{error, in_order};
use schedule::validate::{survey, validate};
use tokio::sync::watch;

use super::ScheduleFile;
use super::file::{Loaded, known};
use crate::night::PublishedNight;

/// So many findings are published of the active schedule, every 10 s.
const MOST_LISTED: usize = 100;
/// How often the task checks whether a wheel reports other filters, machine time.
const LOOK: Duration = Duration::from_secs(10);

/// Publishes the findings of the active schedule, at each version and whenever a wheel reports other filters.
pub async fn keep_surveying(
    file: Arc<ScheduleFile>,
    night: Arc<PublishedNight>,
    mut loaded: watch::Receiver<Loaded>,
) -> anyhow::Result<()> {
    let (mut revision, mut taken_at, mut held_before) = (0, file.authority.node.bus.clock().utc(), None);
    loop {
        let newest = loaded.borrow_and_update().clone();
        let here = file.clone();
        let now_known = tokio::task::spawn_blocking(move || known(&here)).await?;
        let is_new = newest.revision != revision;
        if is_new {
            // Windows that pass while it is worked through are no finding.
            (revision, taken_at) = (newest.revision, file.authority.node.bus.clock().utc());
        }
        // Filters that a wheel reports later, and names that are found later.
        let changing = (now_known.filters.clone(), now_known.names.clone());
        if newest.revision > 0 && (is_new || held_before.as_ref() != Some(&changing)) {
            held_before = Some(changing);
            let held = now_known.at(taken_at);
            let (mut findings, unchecked) = tokio::task::spawn_blocking(move || survey(&newest.rows, &held)).await?;
            let (errors, warnings) = in_order(&mut findings, MOST_LISTED);
            if let Some(first) = findings.first() {
                tracing::warn!(errors, warnings, %first, "rows of the schedule are at risk");
            }
            unchecked.iter().for_each(|what| tracing::info!(what, "of the schedule not checked"));
            night.schedule(|schedule| schedule.findings = findings);
        }
        tokio::select! {
            changed = loaded.changed() => changed?,
            () = tokio::time::sleep(LOOK) => {}
        }
    }
}

/// Answers what is wrong with a schedule. One question at a time has the `turn`: the other core is for the night.
pub async fn serve(file: &Arc<ScheduleFile>, turn: &Arc<tokio::sync::Mutex<()>>) -> anyhow::Result<Service> {
    let (at, turn) = (file.clone(), turn.clone());
    let key = Key::ScheduleCheck(file.authority.node.config.address());
    let service = file.authority.node.bus.serve(&key, move |asked: Result<ScheduleDraft, String>| {
        let (file, turn) = (at.clone(), turn.clone());
        async move {
            let draft = match asked {
                Ok(draft) => draft,
                Err(why) => return unreadable(&format!("the question is no schedule.draft: {why}")),
            };
            let _turn = turn.lock().await;
            let check = move || validate(&draft.text, &known(&file).at(file.authority.node.bus.clock().utc()));
            let found = tokio::task::spawn_blocking(check).await;
            found.unwrap_or_else(|lost| unreadable(&format!("the check was lost: {lost}")))
        }
    });
    Ok(service.await?)
}

fn unreadable(why: &str) -> ScheduleFindings {
    let finding = error(Check::Syntax, Position { line: 1, column: 1 }, None, why);
    ScheduleFindings { valid: false, rows: 0, errors: 1, warnings: 0, findings: vec![finding], unchecked: Vec::new() }
}
