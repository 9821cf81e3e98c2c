//! A field that guiding has lost is found again: first the stars themselves, then a slew back to where they were; and
//! where the site wants it, the row stops for it, nothing else moves, and the row begins again at its target.

use bus::Latest;
use contract::observatory::{Alerts, CalibrationSource, Correction, GuideCalibration, GuideStage, PulseWhy, RowStatus};
use contract::{Address, Key, Part};
use sky::Icrs;
use units::Angle;

use crate::MOST;
use crate::sim::{Sim, by_geometry, telescope};

/// Seconds of sky time in one of machine time.
const SPEED: f64 = 25.0;
/// A field that is held again looks so near to where it did, arcsec: two frames of residual, and a correction under
/// way.
const NEAR_ARCSEC: f64 = 2.0;
/// A mount that somebody has moved shows it in a slew of this member.
const SLEW: &str = "slewtocoordinatesasync";

/// A telescope whose camera is turned, that knows what pulses do, and a row that guides, in the west of the meridian.
async fn guiding(frames: u32, more: &str, solves: bool) -> Sim {
    let mut options = telescope(SPEED);
    options.camera.position_angle = Angle::from_degrees(30.0);
    (options.mount.pointing_error_arcmin, options.mount.scatter_arcsec) = (0.0, 2.0);
    let known = GuideCalibration { source: CalibrationSource::Pulses, ..by_geometry(&options.camera) };
    let imaging = if solves { "catalogue = \"sky.smcat\"" } else { "solve = false" };
    let mut sim = Sim::new(options, &format!("[imaging]\n{imaging}\n{more}")).await;
    sim.keep_calibration("camera", known);
    let field = sim.place(0.7, -20.0);
    if solves {
        sim.write_catalogue(field);
    }
    let (ra, dec) = field;
    let row =
        format!(r#"{{"object": "field", "ra": {ra}, "dec": {dec}, "exptime": 8, "n": {frames}, "guiding": true}}"#);
    sim.write_schedule(&[("object", &row)], 18_000.0);
    sim.start().await;
    sim.until("held", MOST, |sim| sim.holds(5)).await;
    sim
}

fn stage(sim: &Sim) -> Option<GuideStage> {
    sim.guiding.get()?.sample.body.stage
}

fn frames(sim: &Sim) -> u32 {
    sim.guiding.get().and_then(|received| received.sample.body.frames).unwrap_or(0)
}

/// How far the telescope truly looks from a place, arcsec.
fn offset(sim: &Sim, place: &Icrs) -> f64 {
    sky::separation(place, &sim.simulator.world().looks_at()).arcseconds()
}

/// Moves the mount by hand, arcmin to the east and to the north of where it looks.
fn slip(sim: &Sim, [east, north]: [f64; 2]) {
    sim.simulator.world().slip([60.0 * east, 60.0 * north]);
}

fn slews(sim: &Sim, since: u64) -> usize {
    sim.sent_to_mount(since).iter().filter(|(member, _)| member == SLEW).count()
}

fn matching<'a>(corrections: &'a [Correction], words: &str) -> Vec<&'a Correction> {
    let has = |correction: &&Correction| {
        correction.further_action.as_ref().is_some_and(|further_action| further_action.starts_with(words))
    };
    corrections.iter().filter(has).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn hidden_stars_and_a_mount_that_slips_within_the_field_are_held_again() {
    let frames_wanted = 45;
    let sim = guiding(frames_wanted, "", false).await;
    let (place, before) = (sim.simulator.world().looks_at(), sim.last_put());
    let held_to = sim.guiding.get().unwrap().sample.body.reference;

    // As a bank of clouds hides them, with a clear edge.
    sim.by_hand("covercalibrator", "connected", &[("Connected", "True".to_owned())]).await;
    sim.by_hand("covercalibrator", "closecover", &[]).await;
    sim.until("lost", MOST, |sim| stage(sim) == Some(GuideStage::Lost)).await;
    sim.by_hand("covercalibrator", "opencover", &[]).await;
    sim.until("held when the stars are back", MOST, |sim| stage(sim) == Some(GuideStage::Guide)).await;
    assert_eq!(slews(&sim, before), 0, "what clouds hide is where it was");
    sim.until("near after the clouds", MOST, |sim| offset(sim, &place) < NEAR_ARCSEC).await;

    // 137 px on the detector: more than pulses take back, and most of the stars are still on it.
    let (moved_at, seen) = (sim.last_put(), frames(&sim));
    slip(&sim, [1.4, -1.8]);
    sim.until("off", MOST, |sim| offset(sim, &place) > 100.0).await;
    sim.until("slewed back", MOST, |sim| slews(sim, moved_at) > 0).await;
    sim.until("held where it was", MOST, |sim| {
        stage(sim) == Some(GuideStage::Guide) && frames(sim) > seen + 3 && offset(sim, &place) < NEAR_ARCSEC
    })
    .await;
    sim.until("the row observed", MOST, |sim| sim.ended(0).is_some()).await;
    println!("{}", sim.ended(0).unwrap());
    assert_eq!(sim.schedule.get().unwrap().sample.body.rows[0].frames, frames_wanted);

    let corrections = sim.corrections().await;
    let back = matching(&corrections, "slewed back by");
    assert_eq!((back.len(), slews(&sim, moved_at)), (1, 1), "one slew is enough: {corrections:#?}");
    // Two frames agree before anything is slewed; the stars moved by that much, and the whole frame showed it.
    let off_px = back[0].dx_px.unwrap().hypot(back[0].dy_px.unwrap());
    assert!((120.0..155.0).contains(&off_px), "{off_px}");
    let at = corrections.iter().position(|correction| correction.frame == back[0].frame).unwrap();
    assert_eq!(corrections[at - 1].further_action.as_deref(), Some("looking for the field in the whole next frame"));
    // Frames that were taken while it was lost show it, and were not pulsed after.
    let lost: Vec<&Correction> = corrections.iter().filter(|c| c.stage == GuideStage::Lost).collect();
    assert!(lost.iter().any(|c| c.dx_px.is_none() && c.reason.is_some()), "behind the clouds: {lost:#?}");
    let off: Vec<&&Correction> = lost.iter().filter(|c| c.east.why == PulseWhy::Lost).collect();
    assert!(off.len() >= 2 && off.iter().all(|c| [c.east.given_ms, c.north.given_ms] == [0, 0]), "{off:#?}");
    assert!(corrections.iter().all(|c| Some(&c.reference) == held_to.as_ref()), "one reference all the time");
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mount_that_slips_to_another_field_is_slewed_back_by_a_solved_frame() {
    let sim = guiding(30, "", true).await;
    let (place, before) = (sim.simulator.world().looks_at(), sim.last_put());
    let held_to = sim.guiding.get().unwrap().sample.body.reference;
    // The field is 6.7 arcmin wide: none of its stars is seen any more.
    slip(&sim, [6.5, 5.5]);
    sim.until("off", MOST, |sim| offset(sim, &place) > 400.0).await;
    sim.until("slewed back", MOST, |sim| slews(sim, before) > 0).await;
    sim.until("held where it was", MOST, |sim| {
        stage(sim) == Some(GuideStage::Guide) && offset(sim, &place) < NEAR_ARCSEC
    })
    .await;
    sim.until("the row observed", MOST, |sim| sim.ended(0).is_some()).await;
    println!("{}", sim.ended(0).unwrap());
    let corrections = sim.corrections().await;
    let back = matching(&corrections, "slewed back by");
    assert_eq!((back.len(), slews(&sim, before)), (1, 1), "{corrections:#?}");
    assert!(back[0].dx_px.is_none(), "nothing of the reference is on that frame: {:#?}", back[0]);
    assert!(corrections.iter().all(|c| Some(&c.reference) == held_to.as_ref()), "and it is held to the same frame");
    let last = corrections.iter().rev().find(|c| c.stage == GuideStage::Guide).unwrap();
    assert!(last.dx_px.unwrap().hypot(last.dy_px.unwrap()) < 2.0, "{last:#?}");
    sim.stop().await;
}

/// What a mount is moved by.
fn motions(sim: &Sim, since: u64) -> Vec<String> {
    let moves = sim.sent_to_mount(since).into_iter().map(|(member, _)| member);
    moves.filter(|member| [SLEW, "pulseguide", "moveaxis"].contains(&member.as_str())).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn where_the_site_wants_it_a_row_that_lost_its_field_stops_and_begins_again_at_its_target() {
    let frames_wanted = 60;
    // A drift is not held behind clouds, so that every motion in the dark shows; a pause of the row that nobody misses.
    let more = "[guiding]\nwhen_lost = \"stop\"\nhold_drift_s = 0.0\n[faults]\npause_s = 6.0\n";
    let sim = guiding(frames_wanted, more, false).await;
    let alerts: Latest<Alerts> =
        sim.bus.latest(&Key::Observatory(Address::new("test", "alpha").unwrap(), Part::Alerts)).await.unwrap();
    let is_alerted = |_: &Sim| {
        let active = alerts.get().map(|received| received.sample.body.alerts).unwrap_or_default();
        active.iter().any(|alert| alert.id == "guiding-lost/camera")
    };
    let steps =
        |sim: &Sim| sim.night.get().map(|received| format!("{:?}", received.sample.body.actions)).unwrap_or_default();
    let (place, held_to) = (sim.simulator.world().looks_at(), sim.guiding.get().unwrap().sample.body.reference);
    assert!(!is_alerted(&sim));

    // Four fields away: no star of the reference is there, and nobody solves what is.
    slip(&sim, [-22.0, 18.0]);
    sim.until("lost", MOST, |sim| matches!(stage(sim), Some(GuideStage::Lost | GuideStage::Stopped))).await;
    let lost_at = sim.last_put();
    sim.until("an alert is raised", MOST, is_alerted).await;
    sim.until("stopped, and the alert stands while the row pauses", MOST, |sim| {
        let steps = steps(sim);
        steps.contains("trying again after: ") && steps.contains("be guided: field is lost") && is_alerted(sim)
    })
    .await;

    // Somebody puts it right.
    slip(&sim, [22.0, -18.0]);
    sim.until("held again", MOST, |sim| sim.holds(3) && offset(sim, &place) < NEAR_ARCSEC).await;
    assert_eq!(slews(&sim, lost_at), 1, "the row's own, to its target");
    // Until the row stopped, and while it paused, nothing was tried in the dark.
    assert_eq!(motions(&sim, lost_at)[0], SLEW, "before any pulse");
    sim.until("nobody needs to come", MOST, |sim| !is_alerted(sim)).await;
    sim.until("the row observed", MOST, |sim| sim.ended(0).is_some()).await;
    let row = sim.schedule.get().unwrap().sample.body.rows[0].clone();
    assert_eq!((row.status, row.frames), (RowStatus::Finished, frames_wanted), "{row:?}");
    let corrections = sim.corrections().await;
    assert_eq!(corrections.iter().filter(|c| c.stage == GuideStage::Stopped).count(), 1, "{corrections:#?}");
    assert!(corrections.iter().all(|c| Some(&c.reference) == held_to.as_ref()), "the same row, the same place");
    sim.stop().await;
}
