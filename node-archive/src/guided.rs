//! The keyword that guiding makes in a header: how well the telescope was held during the exposure.
//!
//! It is in the header of every frame during which guiding measured something, whether the site's table lists it or not,
//! as the keywords of [`crate::quality`]. A frame that is guided on itself counts for its own exposure. Which guided frames
//! count, the database says, for its views and the night's report too (`database/guiding.rs`).

use std::time::Duration;

use contract::device::camera::Frame;
use units::Utc;

use crate::card::{Card, CardValue};
use crate::database::DatabaseError;
use crate::plan::Plan;
use crate::quality::GUIDED;
use crate::reader::Reader;

/// Guiding runs if it looked at a frame in this time before an exposure, or in the time of one exposure before it; sky s.
const RUNS_S: f64 = 60.0;
/// A header waits so long for what guiding measured, machine time: it is published behind the pulses that follow from it.
const TIMEOUT: Duration = Duration::from_secs(10);

/// The begin of the line of history of a frame without the keyword.
const NOT_GUIDED: &str = "not guided, as far as known at completion";

/// The keyword of a frame; the history says so where a frame of a target has none.
///
/// # Errors
/// The database.
pub fn plan(reader: &Reader, telescope: &str, frame: &Frame) -> Result<Plan, DatabaseError> {
    let errors_px: Vec<f64> = reader.guided_frames(telescope, frame)?.iter().map(|guided| guided.off_px).collect();
    Ok(match rms(&errors_px) {
        Some(rms_px) => {
            let comment = format!("[pix] rms guide error, guide frames: {}", errors_px.len());
            let card = Card::new(GUIDED, CardValue::Float(rms_px), &comment);
            Plan { cards: vec![card], own_history: vec![NOT_GUIDED], ..Plan::default() }
        }
        None if frame.purpose.action == "object" => {
            let note = format!("{NOT_GUIDED}: {GUIDED}");
            Plan { history: vec![note], own_history: vec![NOT_GUIDED], ..Plan::default() }
        }
        None => Plan::default(),
    })
}

/// Whether the telescope is being guided, and what was measured during this exposure is still to come: a frame that is
/// guided on itself is measured after it was stored. `waited` is how long its header has waited.
///
/// # Errors
/// The database.
pub fn is_awaited(reader: &Reader, telescope: &str, frame: &Frame, waited: Duration) -> Result<bool, DatabaseError> {
    if frame.purpose.action != "object" || waited >= TIMEOUT {
        return Ok(false);
    }
    let (from, to) = span(frame);
    let before = from.plus_seconds(-(RUNS_S + 2.0 * frame.exposure_s));
    Ok(reader.is_guided(telescope, (before, from))? && !reader.is_guided(telescope, (from, to))?)
}

/// The exposure of a frame.
fn span(frame: &Frame) -> (Utc, Utc) {
    (frame.started_utc, frame.started_utc.plus_seconds(frame.exposure_s))
}

/// Root mean square of distances; none of none.
fn rms(errors_px: &[f64]) -> Option<f64> {
    let sum: f64 = errors_px.iter().map(|error| error * error).sum();
    let rms = (sum / errors_px.len() as f64).sqrt();
    rms.is_finite().then_some(rms)
}

#[cfg(test)]
#[path = "guided_tests.rs"]
mod tests;
