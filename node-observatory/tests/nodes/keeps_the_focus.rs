//! A row that is under way keeps its focus on the simulated telescope: found anew when the stars grow wide, moved with
//! the temperature by what many runs taught, also by the node that takes over, and set apart where the row asks for
//! that.

use std::time::Duration;

use bus::{Catch, Latest, Subscriber};
use contract::device::camera::Frame;
use contract::device::focuser;
use contract::observatory::{
    Alerts, FocusFound, FocusLearned, FocusOutcome, FocusRun, FocusState, FrameFacts, RowState, RowStatus, TriggerKind,
};
use contract::{Address, DeviceState, Key, Keys, Kind, Part, Payload, Topic};
use simulator::{MountOptions, Quantity};
use units::Utc;

use crate::MOST;
use crate::sim::Sim;

/// Where the simulated focus is at 10 C through V, steps, and how it follows the temperature, steps per degree.
const BEST: f64 = 25_000.0;
const STEPS_PER_C: f64 = -15.0;
/// So many steps off, the stars are 1.41 times as large: 5.6 arcsec at f/3, 350 mm wide, one micrometre a step.
const ZONE: f64 = 123.0;
/// Seconds of each exposure.
const EXPOSURE_S: f64 = 10.0;
const DEVICES: &str = r#"
    [[focuser]]
    name = "focuser"
    server = "@simulator"
    best_position = 25000
    search_steps = 500
    settle_s = 1.0
    [[filterwheel]]
    name = "wheel"
    server = "@simulator"
"#;

/// A field of half a degree under a roof, in a sky and a tube that stay as they are.
async fn telescope(change: impl FnOnce(&mut simulator::Options), more: &str) -> Sim {
    let mut options = simulator::Options {
        start: Utc::from_seconds(crate::sim::NIGHT),
        speed: 25.0,
        ..simulator::Options::default()
    };
    (options.camera.width, options.camera.height) = (640, 640);
    (options.mount, options.dome.slit) = (MountOptions::perfect(), None);
    change(&mut options);
    let sim = Sim::new(options, &format!("[imaging]\nsolve = false\n{more}\n{DEVICES}")).await;
    for (quantity, value) in [(Quantity::Temperature, 10.0), (Quantity::StarFwhm, 1.0), (Quantity::CloudCover, 0.0)] {
        sim.simulator.world().set_weather(quantity, Some(value));
    }
    sim
}

/// An `object` row high in the east.
fn object(sim: &Sim, more: &str) -> String {
    let (ra, dec) = sim.place(-1.4, -23.0);
    format!(r#"{{"object": "field", "ra": {ra}, "dec": {dec}, "exptime": {EXPOSURE_S}, {more}}}"#)
}

/// What the telescope publishes while a test waits.
struct FocusSubscribers {
    frames: Subscriber<Frame>,
    facts: Subscriber<FrameFacts>,
    runs: Subscriber<FocusRun>,
    alerts: Latest<Alerts>,
    focus: Latest<FocusState>,
}

impl FocusSubscribers {
    async fn on(sim: &Sim) -> Self {
        let at = Address::new("test", "alpha").unwrap();
        let part = |part| Key::Observatory(at.clone(), part);
        Self {
            frames: all(sim, Topic::Frame.at(&at)).await,
            facts: all(sim, Topic::Facts.at(&at)).await,
            runs: all(sim, Topic::FocusRun.at(&at)).await,
            alerts: sim.bus.latest(&part(Part::Alerts)).await.unwrap(),
            focus: sim.bus.latest(&part(Part::Focus)).await.unwrap(),
        }
    }

    fn alert(&self, id: &str) -> bool {
        self.alerts.get().is_some_and(|received| received.sample.body.alerts.iter().any(|alert| alert.id == id))
    }

    /// Every frame that was announced, in order of its exposure, with its last facts; waits until so many have facts.
    async fn seen(&self, least: usize) -> Vec<(Frame, Option<FrameFacts>)> {
        self.seen_with(least, Utc::EPOCH).await
    }

    /// The same; waits until so many that began after a moment have facts.
    async fn seen_with(&self, least: usize, after: Utc) -> Vec<(Frame, Option<FrameFacts>)> {
        let (began, mut seen) = (std::time::Instant::now(), Vec::<(Frame, Option<FrameFacts>)>::new());
        let mut facts = Vec::new();
        loop {
            for frame in drained(&self.frames).await {
                if seen.iter().all(|(known, _)| known.id != frame.id) {
                    seen.push((frame, None));
                }
            }
            facts.extend(drained(&self.facts).await);
            for (frame, last) in &mut seen {
                *last = facts.iter().rev().find(|facts| facts.frame == frame.id).cloned();
            }
            if seen.iter().filter(|(frame, facts)| frame.started_utc > after && facts.is_some()).count() >= least {
                seen.sort_by_key(|(frame, _)| frame.started_utc);
                return seen;
            }
            assert!(began.elapsed() < MOST, "{} frames, {} words, {least} expected", seen.len(), facts.len());
        }
    }
}

async fn all<T: Payload>(sim: &Sim, keys: Keys<'_>) -> Subscriber<T> {
    sim.bus.subscribe(keys, Catch::All, 10_000).await.unwrap()
}

async fn drained<T: Payload>(of: &Subscriber<T>) -> Vec<T> {
    let mut received = Vec::new();
    while let Ok(next) = tokio::time::timeout(Duration::from_millis(500), of.recv()).await {
        received.push(next.sample.body);
    }
    received
}

fn row(sim: &Sim, row: usize) -> Option<RowState> {
    sim.schedule.get()?.sample.body.rows.get(row).cloned()
}

/// Frames of a row that count so far.
fn frames(sim: &Sim, of: usize) -> u32 {
    row(sim, of).map_or(0, |row| row.frames)
}

fn trigger(sim: &Sim, kind: TriggerKind) -> bool {
    sim.night.get().is_some_and(|received| received.sample.body.triggers.iter().any(|trigger| trigger.kind == kind))
}

/// Width of the stars on a frame, px.
fn width_px((frame, facts): &(Frame, Option<FrameFacts>)) -> f64 {
    let facts = facts.as_ref().unwrap_or_else(|| panic!("no facts of {}", frame.id));
    facts.fwhm_px.unwrap_or_else(|| panic!("{facts:?}"))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Where the focuser was last sent before each exposure began, steps; panics where it was sent anywhere during one.
fn focus_of_exposures(sim: &Sim, until: Option<Utc>) -> Vec<i64> {
    let (mut sent, mut exposed_until, mut found) = (None, None::<Utc>, Vec::new());
    let parameter = |parameters: &str, name: &str| {
        let value = parameters.split('&').find_map(|pair| pair.split_once('=').filter(|(key, _)| *key == name));
        value.unwrap_or_else(|| panic!("no {name} in {parameters}")).1.parse::<f64>().unwrap()
    };
    for put in sim.simulator.world().puts_since(0) {
        if until.is_some_and(|until| put.sky_utc > until) {
            break;
        }
        match (put.device, put.member.as_str()) {
            (simulator::Kind::Focuser, "move") => {
                let during = exposed_until.filter(|end| put.sky_utc < *end);
                assert!(during.is_none(), "the focuser moves during an exposure: {put:?}");
                sent = Some(parameter(&put.parameters, "Position") as i64);
            }
            (simulator::Kind::Camera, "startexposure") => {
                exposed_until = Some(put.sky_utc.plus_seconds(parameter(&put.parameters, "Duration")));
                found.push(sent.unwrap_or(BEST as i64));
            }
            (simulator::Kind::Camera, "abortexposure") => exposed_until = None,
            _ => {}
        }
    }
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn a_focus_that_drifts_away_is_found_anew_between_two_frames_of_the_row() {
    const FRAMES: u32 = 27;
    let focusing = "[focusing]\non_drift = \"refocus\"\nrefocus_after_min = 30\nrefocus_exposure_s = 2.0\n";
    let mut sim = telescope(|_| {}, focusing).await;
    let value = object(&sim, &format!(r#""n": {FRAMES}, "filter": "V""#));
    sim.write_schedule(&[("object", &value)], 18_000.0);
    let subscribers = FocusSubscribers::on(&sim).await;
    sim.start().await;
    // Nine degrees colder, a degree a frame; no coefficient is known, so the focuser stays.
    for colder in 0..=9 {
        sim.until("exposing", MOST, |sim| frames(sim, 0) >= 5 + colder).await;
        sim.simulator.world().set_weather(Quantity::Temperature, Some(10.0 - f64::from(colder)));
    }
    sim.until("the drift reported", MOST, |sim| trigger(sim, TriggerKind::FocusDrift)).await;
    sim.until("an alert", MOST, |_| subscribers.alert("focus-drift/camera")).await;
    sim.until("all frames taken", MOST, |sim| sim.ended(0).is_some()).await;
    let runs = drained(&subscribers.runs).await;
    assert_eq!(runs.len(), 1, "{runs:#?}");
    let run = &runs[0];
    assert_eq!((run.outcome, run.start_position), (FocusOutcome::Focused, BEST as i64), "{run:?}");
    let truth = BEST + STEPS_PER_C * (run.temperature_c.unwrap() - 10.0);
    let (best, zone) = (run.best_position.unwrap(), run.critical_zone.unwrap());
    println!("found {best:.0} of {truth:.0}, zone {zone:.0}, {} positions", run.points.len());
    assert!(truth > BEST + 0.8 * ZONE && (best - truth).abs() < 0.2 * zone, "{best}, in truth {truth}, zone {zone}");

    // Every frame is accounted for: those of the run and those of the row, each with facts.
    sim.until("the drift is over", MOST, |sim| !trigger(sim, TriggerKind::FocusDrift)).await;
    sim.until("no alert", MOST, |_| !subscribers.alert("focus-drift/camera")).await;
    let of_run: Vec<_> = run.points.iter().flat_map(|point| point.frames.clone()).collect();
    let seen = subscribers.seen(FRAMES as usize + of_run.len()).await;
    let (own, other): (Vec<_>, Vec<_>) = seen.iter().partition(|(frame, _)| frame.purpose.action == "object");
    assert_eq!((own.len(), frames(&sim, 0)), (FRAMES as usize, FRAMES));
    assert!(other.iter().all(|(frame, _)| frame.purpose.action == "autofocus" && of_run.contains(&frame.id)));
    assert_eq!(other.len(), of_run.len(), "{of_run:?}");
    let widths: Vec<f64> = own.iter().map(|seen| width_px(seen)).collect();
    let (first, last) = (median(widths[..5].to_vec()), median(widths[widths.len() - 3..].to_vec()));
    let widest = widths.iter().copied().fold(0.0, f64::max);
    println!("{first:.2} px, then {widest:.2} px, then {last:.2} px");
    assert!(widest > 1.25 * first && last < 1.1 * first, "{widths:?}");
    focus_of_exposures(&sim, None);
    sim.stop().await;
}

/// Twelve runs of earlier nights from 4 to 15 C, found within some steps of the truth.
fn many_runs() -> FocusLearned {
    let found = |n: usize| {
        // The newest one at 10 C.
        let temperature_c = 4.0 + ((n + 7) % 12) as f64;
        FocusFound {
            id: format!("run-{n}"),
            at_utc: Utc::from_seconds(crate::sim::NIGHT - 86_400.0 * (12 - n) as f64),
            filter: Some("V".to_owned()),
            wheel_offset: 0,
            position: BEST + STEPS_PER_C * (temperature_c - 10.0) + [3.0, -4.0, 0.0, 2.0, -1.0][n % 5],
            error: Some(3.0),
            critical_zone: Some(ZONE),
            temperature_c: Some(temperature_c),
            altitude_deg: Some(85.0),
        }
    };
    FocusLearned { focusers: [("focuser".to_owned(), (0..12).map(found).collect())].into() }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_focus_follows_the_temperature_between_frames_and_the_node_that_takes_over_knows_how() {
    let mut sim = telescope(|_| {}, "").await;
    let value = object(&sim, r#""filter": "V""#);
    sim.write_schedule(&[("object", &value)], 18_000.0);
    let learned = many_runs();
    let newest = learned.focusers["focuser"].last().unwrap().clone();
    assert_eq!(newest.temperature_c, Some(10.0));
    std::fs::create_dir_all(sim.folder.path().join("data")).unwrap();
    let file = sim.folder.path().join("data/focus-alpha.json");
    std::fs::write(file, serde_json::to_vec(&learned).unwrap()).unwrap();
    let subscribers = FocusSubscribers::on(&sim).await;
    let at = Address::new("test", "alpha").unwrap().device(Kind::Focuser, &"focuser".parse().unwrap());
    let focuser = sim.bus.latest::<DeviceState<focuser::Fields>>(&Key::State(at)).await.unwrap();
    let position = || focuser.get().and_then(|received| received.sample.body.fields.position.known().copied());
    let near = |steps: f64| position().is_some_and(|position| (position as f64 - steps).abs() < 12.0);
    sim.start().await;
    // Of two nodes that start together either may command, also the one whose folder is empty.
    sim.until("exposing", MOST, |sim| frames(sim, 0) >= 1).await;
    sim.start_standby().await;
    sim.until("exposing on", MOST, |sim| frames(sim, 0) >= 3).await;
    // A thermometer that reads 9.9 C asks for a step or two.
    sim.until("in the focus that was found last", MOST, |_| near(newest.position)).await;
    let found = position();

    // 15 steps are an eighth of the critical zone: not worth a move.
    sim.simulator.world().set_weather(Quantity::Temperature, Some(9.0));
    let taken = frames(&sim, 0);
    sim.until("three more", MOST, |sim| frames(sim, 0) >= taken + 3).await;
    assert_eq!(position(), found, "it stays for a trifle");
    sim.simulator.world().set_weather(Quantity::Temperature, Some(5.0));
    sim.until("75 steps further out", MOST, |_| near(BEST + 75.0)).await;
    let taken = frames(&sim, 0);
    sim.until("three more", MOST, |sim| frames(sim, 0) >= taken + 3).await;

    let (died, boot) = (sim.clock.utc(), sim.night.get().unwrap().sample.boot_id);
    sim.kill_commander().await;
    sim.until("taken over", MOST, |sim| sim.night.get().is_some_and(|received| received.sample.boot_id != boot)).await;
    let published = || {
        subscribers.focus.get().filter(|received| received.sample.boot_id != boot).map(|received| received.sample.body)
    };
    sim.until("the new one shows its focus", MOST, |_| published().is_some()).await;
    let known = published().unwrap().focusers[0].clone();
    println!("the new one knows {known:?}");
    assert_eq!(known.runs, 12, "{known:?}");
    assert!((known.steps_per_c.unwrap() - STEPS_PER_C).abs() < 1.0, "{known:?}");
    sim.until("exposing again", MOST, |sim| {
        sim.schedule.get().is_some_and(|received| received.sample.boot_id != boot) && frames(sim, 0) >= 2
    })
    .await;
    assert!(near(BEST + 75.0), "{:?}", position());
    sim.simulator.world().set_weather(Quantity::Temperature, Some(1.0));
    sim.until("60 steps further", MOST, |_| near(BEST + 135.0)).await;
    let followed = sim.clock.utc();
    let file = sim.folder.path().join("second/focus-alpha.json");
    let stored = || std::fs::read(&file).ok().and_then(|bytes| serde_json::from_slice::<FocusLearned>(&bytes).ok());
    sim.until("on its own disk", MOST, |_| stored().as_ref() == Some(&learned)).await;

    assert!(drained(&subscribers.runs).await.is_empty(), "no run was needed");
    // At 1 C without following, they would be 1.5 times as wide.
    let seen = subscribers.seen_with(3, followed).await;
    assert!(focus_of_exposures(&sim, Some(died)).len() >= 8);
    let widths: Vec<f64> = seen.iter().filter(|(_, facts)| facts.is_some()).map(width_px).collect();
    let (first, last) = (widths[0], median(widths[widths.len() - 3..].to_vec()));
    println!("{first:.2} px at 10 C, {last:.2} px at 1 C");
    assert!(last < 1.1 * first, "{widths:?}");
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shift_counts_from_the_filters_own_focus_and_clouds_are_reported_and_sat_out() {
    let mut sim = telescope(|_| {}, "").await;
    let defocused = object(&sim, r#""n": 2, "filter": "B", "focus_shift": 200"#);
    let sharp = object(&sim, r#""n": 24, "filter": "R""#);
    sim.write_schedule(&[("object", &defocused), ("object", &sharp)], 18_000.0);
    let subscribers = FocusSubscribers::on(&sim).await;
    sim.start().await;
    sim.until("under way", MOST, |sim| frames(sim, 1) >= 4).await;
    // As thick as the safety monitor lets pass: a quarter of the light.
    sim.simulator.world().set_weather(Quantity::CloudCover, Some(79.0));
    sim.until("clouds noticed", MOST, |sim| trigger(sim, TriggerKind::Clouds)).await;
    sim.until("an alert is raised", MOST, |_| subscribers.alert("stars-gone/camera")).await;
    assert_eq!(row(&sim, 1).unwrap().status, RowStatus::Running, "the weather's sensors alone decide");
    sim.simulator.world().set_weather(Quantity::CloudCover, Some(0.0));
    sim.until("clear again", MOST, |sim| !trigger(sim, TriggerKind::Clouds)).await;
    sim.until("no alert", MOST, |_| !subscribers.alert("stars-gone/camera")).await;
    sim.until("all frames taken", MOST, |sim| sim.ended(0).is_some() && sim.ended(1).is_some()).await;
    assert_eq!((frames(&sim, 0), frames(&sim, 1)), (2, 24));

    // The simulated wheel has B 40 steps further out than V, and R 20 further in.
    let focus = focus_of_exposures(&sim, None);
    assert_eq!((&focus[..2], &focus[2..]), (&[25_240_i64; 2][..], &[24_980_i64; 24][..]));
    let seen = subscribers.seen(26).await;
    let (of_b, of_r) = (width_px(&seen[0]), width_px(&seen[2]));
    let expected = (1.0 + (200.0 / ZONE).powi(2)).sqrt();
    println!("{of_b:.2} px through B, {of_r:.2} px through R, {expected:.2} times as wide by the optics");
    assert!((of_b / of_r / expected - 1.0).abs() < 0.12, "{of_b} px through B, {of_r} px through R");
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn stars_that_trail_are_reported_while_the_row_goes_on() {
    // 25 arcsec in each exposure, ten pixels.
    let mut sim = telescope(|options| options.mount.drift_arcsec_per_min = (150.0, 0.0), "").await;
    let value = object(&sim, r#""n": 5, "filter": "V""#);
    sim.write_schedule(&[("object", &value)], 18_000.0);
    let subscribers = FocusSubscribers::on(&sim).await;
    sim.start().await;
    sim.until("noticed", MOST, |sim| trigger(sim, TriggerKind::Trailing)).await;
    sim.until("an alert is raised", MOST, |_| subscribers.alert("stars-trailed/camera")).await;
    sim.until("all frames taken", MOST, |sim| sim.ended(0).is_some()).await;
    let seen = subscribers.seen(5).await;
    assert_eq!((seen.len(), frames(&sim, 0)), (5, 5));
    for (_, facts) in &seen {
        let facts = facts.as_ref().unwrap();
        assert!(facts.trailed == Some(true) && facts.ellipticity.unwrap() > 0.4, "{facts:?}");
    }
    sim.stop().await;
}
