//! Publishes the findings of the active schedule, and answers on the bus what is wrong with any other.

use std::sync::Arc;
use std::time::Duration;

use bus::Service;
use contract::Key;
use contract::observatory::{Check, ScheduleDraft, ScheduleFindings};
use schedule::Position;
use schedule::fault::{error, in_order};
use schedule::validate::{Known, survey, validate};
use tokio::sync::watch;

use super::file::Loaded;
use crate::control_room::ControlRoom;

/// So many findings are published of the active schedule, every 10 s.
const MOST_SHOWN: usize = 100;
/// How often the task checks whether a wheel reports other filters, machine time.
const LOOK: Duration = Duration::from_secs(10);

/// What is known now: the configuration with its horizon files, and the filters that the wheels report. Reads files.
pub fn known(room: &ControlRoom) -> Known {
    let mut known = Known::of(room.node.config.clone()).with_names(room.names.borrow().clone());
    for wheel in &room.rig.wheels {
        if let Some(can) = wheel.instrument.can() {
            known = known.with_filters(&wheel.instrument.device.name, can.names);
        }
    }
    known
}

/// Publishes the findings of the active schedule, at each version and whenever a wheel reports other filters.
pub async fn keep_surveying(room: Arc<ControlRoom>, mut loaded: watch::Receiver<Loaded>) -> anyhow::Result<()> {
    let (mut revision, mut taken_at, mut held_before) = (0, room.node.bus.clock().utc(), None);
    loop {
        let newest = loaded.borrow_and_update().clone();
        let here = room.clone();
        let now_known = tokio::task::spawn_blocking(move || known(&here)).await?;
        let is_new = newest.revision != revision;
        if is_new {
            // Windows that pass while it is worked through are no finding.
            (revision, taken_at) = (newest.revision, room.node.bus.clock().utc());
        }
        // Filters that a wheel reports later, and names that are found later.
        let changing = (now_known.filters.clone(), now_known.names.clone());
        if newest.revision > 0 && (is_new || held_before.as_ref() != Some(&changing)) {
            held_before = Some(changing);
            let held = now_known.at(taken_at);
            let (mut findings, unchecked) = tokio::task::spawn_blocking(move || survey(&newest.rows, &held)).await?;
            let (errors, warnings) = in_order(&mut findings, MOST_SHOWN);
            if let Some(first) = findings.first() {
                tracing::warn!(errors, warnings, %first, "rows of the schedule are at risk");
            }
            unchecked.iter().for_each(|what| tracing::info!(what, "of the schedule not checked"));
            room.board.schedule(|schedule| schedule.findings = findings);
        }
        tokio::select! {
            changed = loaded.changed() => changed?,
            () = tokio::time::sleep(LOOK) => {}
        }
    }
}

/// Answers what is wrong with a schedule, while this node commands or nobody does.
pub async fn keep_answering(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let (mut hold, mut service): (_, Option<Service>) = (room.hold.clone(), None);
    loop {
        if !room.may_speak() {
            service = None;
        } else if service.is_none() {
            service = Some(serve(&room).await?);
        }
        if hold.changed().await.is_err() {
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }
}

async fn serve(room: &Arc<ControlRoom>) -> anyhow::Result<Service> {
    let at = room.clone();
    // One at a time: the other core is for the night.
    let turn = Arc::new(tokio::sync::Mutex::new(()));
    let key = Key::ScheduleCheck(room.node.config.address());
    let service = room.node.bus.serve(&key, move |asked: Result<ScheduleDraft, String>| {
        let (room, turn) = (at.clone(), turn.clone());
        async move {
            let draft = match asked {
                Ok(draft) => draft,
                Err(why) => return unreadable(&format!("the question is no schedule.draft: {why}")),
            };
            let _turn = turn.lock().await;
            let check = move || validate(&draft.text, &known(&room).at(room.node.bus.clock().utc()));
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
