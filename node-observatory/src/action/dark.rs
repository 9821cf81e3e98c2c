//! Takes a dark like the frames of a row, and takes it off them before they are measured.

use std::time::Duration;

use schedule::shot::Shot;

use crate::action_error::ActionError;
use crate::exposing::{Series, aside};
use crate::frames::dark::{Dark, InForce};
use crate::frames::looked::caught;
use crate::frames::stepped_back;
use crate::row_context::RowContext;

/// Pixels of a dark are here so long after its exposure, or frames are measured without it; machine time.
const PIXELS: Duration = Duration::from_secs(60);
/// Takes a dark like the frames of a series, which never counts as one of them; or returns why there is none.
pub async fn take<'a>(
    context: &'a RowContext,
    series: &Series,
    exposure_s: f64,
) -> Result<Result<InForce<'a>, String>, ActionError> {
    let mut pixels = context.tools.frames.looks.follow_pixels();
    let series = Series { open_sky: false, target_deg: None, ..series.clone() };
    let shot = Shot { exposure_s, image_type: "Dark Frame", words: format!("a dark of {exposure_s} s") };
    let id = aside(context, &series, &shot, context.row.action.name()).await?;
    let fetched = async {
        tokio::select! {
            biased;
            fetched = caught(&mut pixels, &id) => fetched.ok_or_else(|| "the node ends".to_owned()),
            // Once the frame was looked at, its pixels have been fetched, or never will be.
            looked = context.tools.frames.looks.of(&id) => Err(looked.facts.reason.clone().unwrap_or_default()),
        }
    };
    let fetched = tokio::time::timeout(PIXELS, fetched).await;
    let fetched = match fetched.unwrap_or_else(|_| Err(format!("its pixels did not arrive within {PIXELS:?}"))) {
        Ok(fetched) => fetched,
        Err(why) => return Ok(Err(why)),
    };
    let dark = stepped_back(move || Dark::of(&fetched)).await;
    Ok(dark.map(|dark| context.tools.frames.darks.put(context.row.camera.as_str(), dark)))
}
