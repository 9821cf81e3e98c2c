//! The focus is found from near and from far, stored, drawn, and not found under clouds: judged by the simulated
//! telescope.

#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

use std::time::Duration;

use bus::{Catch, Subscriber};
use contract::observatory::{Alerts, FocusOutcome, FocusRun, FocusState, RowStatus};
use contract::{Address, DeviceState, Key, Kind, Part, Role, device::focuser};
use serde_json::json;
use test_support::{Harness, HarnessOptions, row};

/// Where the simulated focus is at 10 C through V, steps.
const TRUTH: f64 = 25_000.0;

/// A field of half a degree, in a sky and a tube that stay as they are.
fn options() -> HarnessOptions {
    let mut options = HarnessOptions::default();
    options.world.speed = 25.0;
    (options.world.camera.width, options.world.camera.height) = (640, 640);
    options.world.camera.pixel_um = 13.5;
    // Gears with play; the truth is that of a focuser driven upward.
    options.world.focus.backlash_steps = 100.0;
    // The run begins 2.9 critical zones from the truth.
    options.focuser_block = "best_position = 25350\nbacklash_steps = 120\nsettle_s = 1.0\n";
    options
}

async fn next(runs: &Subscriber<FocusRun>, harness: &Harness) -> anyhow::Result<FocusRun> {
    match tokio::time::timeout(Duration::from_secs(120), runs.recv()).await {
        Ok(received) => Ok(received.sample.body),
        Err(_) => anyhow::bail!("no focus run has ended\n{}", harness.last_words()),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_ends_at_the_focus_from_near_and_far_and_where_it_began_under_clouds() -> anyhow::Result<()> {
    let mut harness = Harness::new(options(), |_| {
        vec![
            row("autofocus", json!({"exptime": 2, "filter": "V", "selection_method": "maximal"})),
            // All of the first look lies beyond the focus: 600 steps are five critical zones.
            row("autofocus", json!({"exptime": 2, "filter": "V", "search_range": [25600, 27600]})),
            row("autofocus", json!({"exptime": 0.001, "filter": "V"})),
        ]
    })
    .await?;
    harness.simulator.world().set_weather(simulator::Quantity::Temperature, Some(10.0));
    harness.simulator.world().set_weather(simulator::Quantity::StarFwhm, Some(1.0));
    let address = Address::new(test_support::SITE, test_support::TELESCOPE)?;
    let key = Key::FocusRun(address.clone()).to_string();
    let runs = harness.bus.subscribe::<FocusRun>(&key, Catch::All, 100).await?;
    let state = harness.bus.latest::<FocusState>(&Key::Observatory(address.clone(), Part::Focus)).await?;
    let alerts = harness.bus.latest::<Alerts>(&Key::Observatory(address.clone(), Part::Alerts)).await?;
    let device = address.device(Kind::Focuser, &"focuser".parse()?);
    let focuser = harness.bus.latest::<DeviceState<focuser::Fields>>(&Key::State(device)).await?;
    for role in [Role::Device, Role::Observatory, Role::Archive] {
        harness.start(role)?;
    }
    let focus = || state.get().map(|received| received.sample.body);
    harness
        .until("a run is shown point by point", 60.0, |_| {
            focus().is_some_and(|focus| focus.active && focus.run.is_some_and(|run| run.points.len() >= 2))
        })
        .await?;
    assert_eq!(focus().unwrap().best_position, Some(25_350), "as configured, until it is learned");

    for far in [false, true] {
        let run = next(&runs, &harness).await?;
        println!(
            "{} frames, {:?} +- {:?}, zone {:?}, verified {:?}",
            run.points.len(),
            run.best_position,
            run.best_position_error,
            run.critical_zone,
            run.verified
        );
        assert_eq!((run.outcome, &run.reason), (FocusOutcome::Focused, &None), "{run:?}");
        let (best, zone) = (run.best_position.unwrap(), run.critical_zone.unwrap());
        assert!((best - TRUTH).abs() < 0.2 * zone, "{best} +- {:?}, zone {zone}", run.best_position_error);
        assert_eq!(run.start_position == 25_350, !far, "the second begins where the first ended");
        assert!(run.altitude_deg.unwrap() > 80.0 && (run.temperature_c.unwrap() - 10.0).abs() < 0.01, "{run:?}");
        assert!(run.points.iter().all(|point| point.frames.len() == 1));
    }
    // As thick as the safety monitor lets pass, and the stars smeared: nothing can be seen in a millisecond.
    harness.simulator.world().set_weather(simulator::Quantity::CloudCover, Some(79.0));
    harness.simulator.world().set_weather(simulator::Quantity::StarFwhm, Some(60.0));
    let failed = next(&runs, &harness).await?;
    assert_eq!(failed.outcome, FocusOutcome::Failed, "{failed:?}");
    let reason = failed.reason.clone().unwrap();
    assert!(reason.contains("look for clouds"), "{reason}: {:?}", failed.points);
    let position = || focuser.get()?.sample.body.fields.position.known().copied();
    harness.until("the focuser is back where it stood", 20.0, |_| position() == Some(failed.start_position)).await?;
    assert!((failed.start_position as f64 - TRUTH).abs() < 25.0, "at what was kept: {}", failed.start_position);
    let alert = || alerts.get().is_some_and(|h| h.sample.body.alerts.iter().any(|a| a.id == "focus-failed/camera"));
    harness.until("an alert is raised", 20.0, |_| alert()).await?;
    harness
        .until("the row has failed, and says why", 20.0, |harness| {
            let rows = harness.schedule.get().map(|received| received.sample.body.rows).unwrap_or_default();
            let status: Vec<RowStatus> = rows.iter().map(|row| row.status).collect();
            status == [RowStatus::Finished, RowStatus::Finished, RowStatus::Failed]
                && rows[2].detail.contains("no focus")
        })
        .await?;
    let shown = focus().unwrap();
    assert!(!shown.active && shown.focusers[0].runs == 2, "{shown:?}");

    let database = harness.path("data/archive.db");
    harness
        .until("three runs in the database", 20.0, |_| {
            let count = rusqlite::Connection::open(&database).and_then(|database| {
                database.query_row("SELECT count(*) FROM focus_runs", [], |row| row.get::<_, i64>(0))
            });
            count.is_ok_and(|count| count == 3)
        })
        .await?;
    let learned: serde_json::Value = serde_json::from_slice(&std::fs::read(harness.path("data/focus-alpha.json"))?)?;
    assert_eq!(learned["focusers"]["focuser"].as_array().map(Vec::len), Some(2), "{learned}");
    harness.until("the dome ends shut", 90.0, Harness::is_shut).await?;
    let night = harness.path("images/autofocus").join(&failed.night);
    let plots = std::fs::read_dir(&night)?.flatten().filter(|file| file.path().extension().is_some_and(|e| e == "svg"));
    assert_eq!(plots.count(), 3, "in {}", night.display());
    Ok(())
}
