//! The report of a night on request, as `starmesh night report` makes it.

use std::time::Instant;

use bus::MOST_BYTES;
use config::Observatory;
use contract::archived_frame::{ArchiveRefusal, NotGiven, ReportForm, ReportQuestion};
use sky::NightDate;
use units::Utc;

use super::found::{Shelf, failed};
use super::refused;
use crate::night::Night;
use crate::night_report;

/// The bytes of an answer except its text, and more.
const FRAME_BYTES: usize = 1024;

/// The report of a night until `now`, as JSON or HTML.
pub fn make(
    config: &Observatory,
    shelf: &Shelf,
    question: &ReportQuestion,
    now: Utc,
    deadline: Instant,
) -> Result<String, ArchiveRefusal> {
    let date: NightDate = question.night.parse().map_err(|_| {
        let detail = format!("{:?} is no night; expected the date of its evening, such as 20261121", question.night);
        refused(NotGiven::Malformed, detail)
    })?;
    let reader = shelf.reader(deadline)?;
    let night = Night::new(date, &config.place);
    if !reader.is_recorded(&night).map_err(failed)? {
        let detail = format!("nothing of the night {} is stored", night.date);
        return Err(refused(NotGiven::Unknown, detail));
    }
    let report = night_report::make(config, &reader, &night, now).map_err(|error| failed(format!("{error:#}")))?;
    if reader.is_cut() {
        let detail = "the report takes longer than the archive looks; use the one next to the frames, in reports/, or `starmesh night report`";
        return Err(refused(NotGiven::Busy, detail));
    }
    let text = match question.form {
        ReportForm::Json => serde_json::to_string(&report).map_err(failed)?,
        ReportForm::Html => report::html::page(&report),
    };
    let bytes = serde_json::to_vec(&text).map_or(usize::MAX, |bytes| bytes.len());
    if bytes > MOST_BYTES - FRAME_BYTES {
        let detail = "the report is larger than a message; use the one next to the frames, in reports/, or `starmesh night report`";
        return Err(refused(NotGiven::TooLarge, detail));
    }
    Ok(text)
}
