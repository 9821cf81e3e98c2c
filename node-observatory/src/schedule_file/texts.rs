//! Answers on the bus with the text of the active schedule or of an earlier one, and with the list of them.

use std::io;
use std::sync::{Arc, PoisonError};

use bus::Service;
use contract::Key;
use contract::observatory::{ScheduleTextQuestion, ScheduleTexts, ScheduleVersion};

use super::versions::{MOST_VERSIONS, Version, sha256};
use super::{ActiveText, ScheduleFile};

/// The bus takes no larger answer than 4 MiB, in which a quotation mark of the text has two characters.
const MOST_BYTES: usize = 2_000_000;

pub(super) async fn serve(file: &Arc<ScheduleFile>) -> anyhow::Result<Service> {
    let at = file.clone();
    let key = Key::ScheduleTexts(file.authority.node.config.address());
    let service = file.authority.node.bus.serve(&key, move |asked: Result<ScheduleTextQuestion, String>| {
        let file = at.clone();
        async move {
            let question = match asked {
                Ok(question) => question,
                Err(why) => return problem(format!("the question is no schedule.text_question: {why}")),
            };
            let answered = tokio::task::spawn_blocking(move || answer(&file, &question)).await;
            answered.unwrap_or_else(|lost| problem(format!("the answer was lost: {lost}")))
        }
    });
    Ok(service.await?)
}

/// Blocks.
fn answer(file: &ScheduleFile, question: &ScheduleTextQuestion) -> ScheduleTexts {
    let listed = file.versions.list();
    if let Some(most) = question.list {
        let listed = match listed {
            Ok(listed) => listed,
            Err(error) => return problem(format!("the versions cannot be read: {error}")),
        };
        let most = usize::try_from(most).unwrap_or(MOST_VERSIONS).min(MOST_VERSIONS);
        let wanted = listed.into_iter().rev().filter(|found| question.before.is_none_or(|end| found.version < end));
        return ScheduleTexts { versions: wanted.take(most).map(published).collect(), ..Default::default() };
    }
    let text = match question.version {
        Some(version) => match file.versions.text(version) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return ScheduleTexts::default(),
            read => read.map_err(|error| error.to_string()),
        },
        None => match file.active.lock().unwrap_or_else(PoisonError::into_inner).clone() {
            Some(ActiveText { text, .. }) => Ok(text.to_string()),
            None => return ScheduleTexts::default(),
        },
    };
    let text = match text {
        Ok(text) if text.len() > MOST_BYTES => {
            return problem(format!("it has {} bytes; the bus carries at most {MOST_BYTES} of a text", text.len()));
        }
        Ok(text) => text,
        Err(why) => return problem(why),
    };
    let sha256 = sha256(&text);
    let is_it = |found: &Version| match question.version {
        Some(version) => found.version == version,
        None => found.sha256 == sha256,
    };
    // A list that cannot be read hides no text.
    let versions = listed.unwrap_or_default().into_iter().rev().find(is_it).map(published).into_iter().collect();
    ScheduleTexts { text: Some(text), sha256: Some(sha256), versions, problem: None }
}

fn published(stored: Version) -> ScheduleVersion {
    let Version { version, at_utc, author, reason, rows, bytes, sha256 } = stored;
    let rows = u32::try_from(rows).unwrap_or(u32::MAX);
    ScheduleVersion { version, at_utc, author, reason, rows, bytes, sha256 }
}

fn problem(why: String) -> ScheduleTexts {
    ScheduleTexts { problem: Some(why), ..Default::default() }
}
