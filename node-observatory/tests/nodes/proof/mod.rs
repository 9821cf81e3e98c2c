//! What is measured on this machine's own clock, or judged by statistics of noisy frames under a sky that runs faster than
//! real time: `scripts/proof`. That what is bounded here happens at all, and in which order, the other modules test.

mod guides_at_any_angle;
mod guides_the_field;

use std::time::{Duration, Instant, SystemTime};

use contract::device::camera::Command as Camera;
use contract::device::dome::{Command as Dome, Shutter};
use contract::{OrderKind, Reply};
use test_support::Lateness;

use crate::MOST;
use crate::another_schedule::{LATER, until_rows};
use crate::executes_the_sites_script::{OPEN, shut, site as scripted_site, stands};
use crate::measures_frames::{STARS, Spool, commands, sky};
use crate::site::Site;
use crate::takeover::{SHELVED, accepted, alert, eager_site, is_open, is_shut, part};
use crate::the_slit::{EAST, WEST, object, turns};

/// From the word of the monitor to the first command at the dome.
async fn closes_after(site: &Site) -> Duration {
    site.dome.log.lock().unwrap().clear();
    let (rains, lateness) = (Instant::now(), Lateness::begin());
    site.set_safe(false);
    site.until("closed and parked", MOST, |site| site.shutter() == Some(Shutter::Closed) && site.is_parked()).await;
    let first = site.dome.log.lock().unwrap().first().map(|(at, command)| (at.duration_since(rains), command.clone()));
    let (took, command) = first.unwrap();
    assert_eq!(command, Dome::CloseShutter);
    println!("from the word of the monitor to the command at the dome: {took:?}");
    took.saturating_sub(lateness.bound(Duration::ZERO))
}

// The time to the command at the dome is measured.
#[tokio::test(flavor = "multi_thread")]
async fn an_unsafe_sky_closes_within_250_ms() {
    let site = Site::new(20.0).await;
    site.write_schedule(&[("object", &object("x", EAST, 400), "03:00:00", "05:00:00")]);
    let node = site.start().await;
    site.until("exposing", MOST, |site| site.exposures() > 0).await;
    let took = closes_after(&site).await;
    assert!(took < Duration::from_millis(250), "{took:?}");
    node.stop().await;
}

// The same, of a dome that hangs.
#[tokio::test(flavor = "multi_thread")]
async fn a_dome_that_hangs_while_it_follows_closes_as_fast_as_any() {
    let site = Site::with_dome(20.0, Some(5.0)).await;
    let (east, west) = (object("east", EAST, 1), object("west", WEST, 5));
    site.write_schedule(&[("object", &east, "03:00:00", "05:00:00"), ("object", &west, "03:00:01", "05:00:00")]);
    let node = site.start().await;
    site.until("exposing in the east", MOST, Site::is_exposing).await;
    *site.turn_deg_per_s.lock().unwrap() = Some(0.0);
    site.until("a turn to the west that hangs", MOST, |site| turns(site).len() >= 2).await;
    let took = closes_after(&site).await;
    assert!(took < Duration::from_millis(250), "{took:?}");
    node.stop().await;
}

// The time to the closing is measured.
#[tokio::test(flavor = "multi_thread")]
async fn a_silent_monitor_closes_within_seconds() {
    let site = Site::new(1.0).await;
    site.write_schedule(&[("open", "{}", "02:00:00", "05:00:00")]);
    let node = site.start().await;
    site.until("open", MOST, |site| site.shutter() == Some(Shutter::Open)).await;
    let (silent, lateness) = (Instant::now(), Lateness::begin());
    site.monitor.state.send_modify(|state| {
        let reason = contract::NoData::new("timeout", "2 s");
        state.link = contract::Link::Lost { reason };
    });
    site.until("closed", MOST, |site| site.shutter() == Some(Shutter::Closed)).await;
    assert!(silent.elapsed() < lateness.bound(Duration::from_secs(7)), "{:?}", silent.elapsed());
    node.stop().await;
}

// The dead time between two frames is measured.
#[tokio::test(flavor = "multi_thread")]
async fn frames_follow_each_other_without_a_pause() {
    let site = Site::new(1.0).await;
    site.write_schedule(&[("calibration", r#"{"exptime": [0.1], "n": [20]}"#, "02:00:00", "05:00:00")]);
    let node = site.start().await;
    site.until("done", MOST, |site| site.exposures() == 20).await;
    let times: Vec<Instant> = site
        .camera
        .log
        .lock()
        .unwrap()
        .iter()
        .filter(|(_, command)| matches!(command, Camera::Expose { .. }))
        .map(|(at, _)| *at)
        .collect();
    let mut gaps: Vec<Duration> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.sort();
    // 100 ms of exposure and 20 ms of readout are the camera's own
    // of 19 gaps the fifth: a machine with other things to do lengthens some, a lost design all of them.
    let dead = gaps[gaps.len() / 4].saturating_sub(Duration::from_millis(120));
    println!("dead time beyond exposure and readout, lower quartile: {dead:?}");
    assert!(dead < Duration::from_millis(50), "{gaps:?}");
    node.stop().await;
}

/// How long it takes until so many rows are published, without what this machine was late.
async fn rows_after(site: &Site, count: usize) -> Duration {
    let (began, lateness) = (Instant::now(), Lateness::begin());
    until_rows(site, count).await;
    began.elapsed().saturating_sub(lateness.bound(Duration::ZERO))
}

// The time until another schedule is active is measured.
#[tokio::test(flavor = "multi_thread")]
async fn another_schedule_is_active_within_a_second_while_nothing_runs() {
    const SEEN: Duration = Duration::from_secs(1);
    let site = Site::new(1.0).await;
    let file = site.folder.path().join("schedule.jsonl");
    site.write_schedule(&LATER[..1]);
    let node = site.start().await;
    until_rows(&site, 1).await;
    site.write_schedule(&LATER[..2]);
    let took = rows_after(&site, 2).await;
    assert!(took < SEEN, "by the file: {took:?}");

    let stored = std::fs::read_to_string(&file).unwrap();
    site.write_schedule(&LATER);
    until_rows(&site, 3).await;
    let other = site.folder.path().join("older");
    std::fs::write(&other, &stored).unwrap();
    let older = std::fs::File::options().write(true).open(&other).unwrap();
    older.set_modified(SystemTime::now() - Duration::from_secs(800 * 86_400)).unwrap();
    drop(older);
    std::fs::rename(&other, &file).unwrap();
    let took = rows_after(&site, 2).await;
    assert!(took < SEEN, "by a file of an older time: {took:?}");

    let text = format!("{stored}{}", stored.lines().next().unwrap().replace("05:00:00", "05:30:00")) + "\n";
    let reply = site.order(OrderKind::PutSchedule { text, instead_of: None }).await;
    assert!(matches!(reply, Reply::Accepted(_)), "{reply:?}");
    let took = rows_after(&site, 3).await;
    assert!(took < SEEN, "by order: {took:?}");
    node.stop().await;
}

// The time to the answer is measured while nothing can be written.
#[tokio::test(flavor = "multi_thread")]
async fn an_order_to_close_is_answered_within_two_seconds_also_where_the_disk_takes_nothing() {
    let site = eager_site().await;
    let node = site.start().await;
    site.until("open", MOST, is_open).await;
    accepted(site.order(OrderKind::Override { input: "sun".to_owned(), for_s: 3600.0 }).await);
    site.until("the alert is active", MOST, |site| alert(site, SHELVED).is_some()).await;
    for file in ["operator-orders", "alerts"] {
        site.until("a folder in the way", MOST, |site| std::fs::create_dir(part(site, file)).is_ok()).await;
    }
    let (ordered, lateness) = (Instant::now(), Lateness::begin());
    accepted(site.order(OrderKind::StayClosed(true)).await);
    let answered = ordered.elapsed().saturating_sub(lateness.bound(Duration::ZERO));
    assert!(answered < Duration::from_secs(2), "{answered:?}");
    site.until("shut", MOST, is_shut).await;
    node.stop().await;
}

// The time from the announcement of a frame to its facts is measured.
#[tokio::test(flavor = "multi_thread")]
async fn a_frame_is_measured_within_seconds() {
    let site = Site::new(1.0).await;
    site.write_schedule(&[]);
    let (spool, node) = (Spool::start(&site).await, site.start().await);
    site.until("commanding", MOST, commands).await;
    let stars = sky(STARS);
    for n in 0..4 {
        let lateness = Lateness::begin();
        let (announced, id) = (site.clock.machine(), spool.announce(n, "stars", &stars).await);
        let received = spool.facts_of(&id).await;
        let after = received.arrived.since(announced);
        println!(
            "frame {n}: facts {after:?} after its announcement, measured in {:?} s",
            received.sample.body.measuring_s
        );
        // 1 s is promised of a release build.
        assert!(after < lateness.bound(Duration::from_secs(5)), "{after:?}");
    }
    node.stop().await;
}

/// Opens, lets the night end, and gives the machine time from the end of the opening to the order to close the shutter,
/// without what this machine was late, and with it.
async fn script_closes_after(hooks: &str, script: &str) -> (Duration, Duration) {
    let (mut sim, _alerts) = scripted_site(hooks, script).await;
    sim.write_schedule(OPEN, 18_000.0);
    sim.start().await;
    sim.until("open", MOST, |sim| sim.simulator.world().dome_open() == 1.0).await;
    sim.until("opened", MOST, |sim| sim.ended(0).is_some()).await;
    let (opened, lateness) = (Instant::now(), Lateness::begin());
    sim.until("closing", MOST, |sim| shut(sim).is_some()).await;
    let whole = shut(&sim).unwrap().saturating_duration_since(opened);
    let waited = whole.saturating_sub(lateness.bound(Duration::ZERO));
    sim.stop().await;
    (waited, whole)
}

// The time that a site's script holds the closing up is measured.
#[tokio::test(flavor = "multi_thread")]
async fn a_sites_script_holds_the_closing_up_for_close_wait_s_and_no_longer() {
    for (hooks, script, most_s) in [
        // Throws, waits for the default, calls it a thousand times, fills its memory.
        ("", "fn before_close() { note(\"begins\"); }\nfn close() { throw \"I do not know how\"; }", 3.0),
        ("close_wait_s = 10\n", "fn close() { default_close(); note(\"closed\"); }", 3.0),
        (
            "close_wait_s = 10\n",
            "fn close() { for n in 0..1000 { default_close(); } note(\"a thousand times\"); }",
            3.0,
        ),
        (
            "close_wait_s = 10\n",
            "fn close() { let a = []; loop { let m = #{}; for n in 0..900 { m[`k${n}`] = `value ${n}`; } a.push(m); } }",
            5.0,
        ),
    ] {
        let (waited, _) = script_closes_after(hooks, script).await;
        assert!(waited.as_secs_f64() < most_s, "{script}: {waited:?}");
    }
    let (waited, whole) = script_closes_after("close_wait_s = 2\n", "fn close() { loop { } }").await;
    // Counted from when this test has received that the row ended, which is a little late.
    assert!(whole.as_secs_f64() > 0.8 && waited.as_secs_f64() < 5.0, "{whole:?}, without lateness {waited:?}");
}

// The time from the monitor to the closing is measured while a script keeps the night from closing by itself.
#[tokio::test(flavor = "multi_thread")]
async fn the_guard_does_not_wait_for_a_script_when_the_sky_is_not_safe() {
    let script = "fn after_open() { throw \"no\"; }\nfn close() { loop { } }";
    let (mut sim, alerts) = scripted_site("close_wait_s = 10\n", script).await;
    sim.write_schedule(OPEN, 18_000.0);
    sim.start().await;
    sim.until("reported", MOST, |_| stands(&alerts, "site-script/after_open").is_some()).await;
    // The script left something open, which is being closed after close_wait_s; the rain is faster.
    assert_eq!(shut(&sim), None);
    sim.simulator.world().set_unsafe(true);
    let (unsafe_at, lateness) = (Instant::now(), Lateness::begin());
    sim.until("closing", MOST, |sim| shut(sim).is_some()).await;
    assert!(unsafe_at.elapsed() < lateness.bound(Duration::from_secs(4)), "{:?}", unsafe_at.elapsed());
    sim.stop().await;
}
