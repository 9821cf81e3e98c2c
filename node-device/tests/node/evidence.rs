//! The record of a weather station survives every subscriber.

use std::time::Duration;

use bus::Clock;
use contract::Kind;
use contract::device::observing_conditions::{Fields, ObservingConditions};
use contract::device::record::{RecordQuestion, StateEntry, StateRecord};
use contract::device::safety_monitor::{self, SafetyMonitor};
use contract::{DeviceState, Key, Link};
use serde_json::json;
use test_support::{LIMIT, block, within};

use crate::fake::{Fake, FakeAnswer};
use crate::stage::Stage;

#[tokio::test(flavor = "multi_thread")]
async fn a_weather_stations_record_is_what_was_received_from_it() {
    let hardware = Fake::start(&[("humidity", json!(50.0)), ("temperature", json!(5.0))]).await;
    let booted = Clock::machine_clock().machine();
    let stage = Stage::start(&block("observingconditions", "wx", hardware.address, "period_s = 0.2")).await;
    let states = stage.states::<ObservingConditions>("wx").await;
    let mut received = Vec::new();
    let mut recv_until = async |wanted: fn(&Link, &Fields) -> bool| {
        let waiting = async {
            loop {
                let state = states.recv().await;
                let is_wanted = wanted(&state.sample.body.link, &state.sample.body.fields);
                // The first states may come twice: as an answer, and as they are published.
                if !received.iter().any(|known: &bus::Received<_>| known.sample.seq == state.sample.seq) {
                    received.push(state);
                }
                if is_wanted {
                    return;
                }
            }
        };
        let is_so = tokio::time::timeout(LIMIT, waiting).await.is_ok();
        assert!(is_so, "the last of {}: {:?}", received.len(), received.last());
    };
    recv_until(|_, fields| fields.humidity_percent.known() == Some(&50.0)).await;
    hardware.answer("humidity", FakeAnswer::Value(json!(81.0)));
    recv_until(|_, fields| fields.humidity_percent.known() == Some(&81.0)).await;
    hardware.hang(true);
    recv_until(|link, _| matches!(link, Link::Lost { .. })).await;
    hardware.hang(false);
    recv_until(|link, fields| *link == Link::Connected && fields.humidity_percent.known() == Some(&81.0)).await;

    let key = Key::Record(stage.device(Kind::ObservingConditions, "wx"));
    let clock = stage.bus.clock();
    let asked = clock.machine();
    let record: StateRecord<Fields> = stage.bus.ask(&key, &RecordQuestion { back_s: 600.0 }, LIMIT).await.unwrap();
    let answered = clock.machine();
    assert_eq!((record.speed, &record.boot_id), (1.0, &received[0].sample.boot_id));
    assert_eq!(record.entries[0].seq, 0, "from the first payload of this incarnation on");
    for state in &received {
        let reported = &record.entries[usize::try_from(state.sample.seq).unwrap()];
        assert_eq!(
            (reported.seq, &reported.link, &reported.fields),
            (state.sample.seq, &state.sample.body.link, &state.sample.body.fields)
        );
        // It was published before it arrived, and the age is that of the moment of the answer.
        let age = Duration::from_secs_f64(reported.age_s);
        assert!(state.arrived.plus(age) >= asked.minus(Duration::from_millis(1)), "{reported:?}");
        assert!(age <= answered.since(booted) + Duration::from_millis(1), "{reported:?}");
    }
    let bad = record.entries.iter().filter(|entry| entry.link != Link::Connected).count();
    assert!(bad >= 2, "connecting and lost are reported too");

    let short: StateRecord<Fields> = stage.bus.ask(&key, &RecordQuestion { back_s: 0.0 }, LIMIT).await.unwrap();
    assert!(short.entries.len() <= 2 && short.entries.last().unwrap().seq >= record.entries.last().unwrap().seq);
    let nonsense: StateRecord<Fields> = stage.bus.ask(&key, &json!({"back_s": "long"}), LIMIT).await.unwrap();
    assert!(nonsense.entries.is_empty());
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_recorded_before_a_restart_of_the_device_node_is_answered_after_it() {
    if node::kernel_boot_id().is_empty() {
        return; // a system on which nothing that was written before counts
    }
    let hardware = Fake::start(&[("issafe", json!(true))]).await;
    let monitor = block("safetymonitor", "monitor", hardware.address, "period_s = 0.2");
    let is_safe = |state: &DeviceState<safety_monitor::Fields>| state.fields.is_safe.known() == Some(&true);
    let stage = Stage::start(&monitor).await;
    stage.until::<SafetyMonitor>("monitor", is_safe).await;
    let file = stage.node().config.folders.data.join("states-alpha-main-safetymonitor-monitor.jsonl");
    let written = || std::fs::read_to_string(&file).ok().filter(|text| text.contains("\"is_safe\":true"));
    assert!(within(LIMIT, written).await.is_some(), "{}", file.display());
    let boot_id = stage.node().bus.boot_id().clone();

    let stage = stage.restarted(&monitor).await;
    stage.until::<SafetyMonitor>("monitor", is_safe).await;
    let (key, back) = (Key::Record(stage.device(Kind::SafetyMonitor, "monitor")), RecordQuestion { back_s: 600.0 });
    let record: StateRecord<safety_monitor::Fields> = stage.bus.ask(&key, &back, LIMIT).await.unwrap();
    let known = |entries: &[StateEntry<safety_monitor::Fields>]| {
        entries.iter().any(|entry| entry.fields.is_safe.known() == Some(&true))
    };
    assert_eq!(record.earlier.len(), 1, "{record:?}");
    assert_eq!((record.earlier[0].boot_id == boot_id, record.boot_id == boot_id), (true, false));
    assert!(known(&record.earlier[0].entries) && known(&record.entries), "{record:?}");
    let all = record.earlier[0].entries.iter().chain(&record.entries);
    assert!(all.map(|entry| entry.age_s).is_sorted_by(|older, newer| older >= newer), "{record:?}");
    stage.end().await;
}

/// A station whose every property answers late, with limits, once it has reported that it does not rain; an answer takes
/// `takes` from then on.
pub async fn a_slow_station(takes: Duration, one_at_a_time: bool) -> (Fake, Stage) {
    let sensors = ["cloudcover", "dewpoint", "humidity", "pressure", "rainrate", "skybrightness", "skyquality"];
    let more =
        ["skytemperature", "starfwhm", "temperature", "winddirection", "windgust", "windspeed", "timesincelastupdate"];
    let values: Vec<_> = sensors.into_iter().chain(more).map(|name| (name, json!(0.0))).collect();
    let hardware = Fake::start(&values).await;
    let limits = "limit = [{ parameter = \"Humidity\", upper = 80.0 }, { parameter = \"RainRate\", upper = 0.1 }, \
                  { parameter = \"WindSpeed\", upper = 15.0 }]";
    let stage = Stage::start(&block("observingconditions", "wx", hardware.address, limits)).await;
    stage.until::<ObservingConditions>("wx", |state| state.fields.rain_mm_per_h.known() == Some(&0.0)).await;
    hardware.slow(takes, one_at_a_time);
    (hardware, stage)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_station_reports_rain() {
    for one_at_a_time in [false, true] {
        let (hardware, stage) = a_slow_station(Duration::from_millis(200), one_at_a_time).await;
        hardware.answer("rainrate", FakeAnswer::Value(json!(5.0)));
        // Slow is not missing: all that decides is known.
        let raining = |state: &DeviceState<Fields>| {
            let known = [&state.fields.humidity_percent, &state.fields.wind_mps];
            let rains = state.fields.rain_mm_per_h.known() == Some(&5.0);
            rains && state.link == Link::Connected && known.iter().all(|datum| datum.known().is_some())
        };
        stage.until::<ObservingConditions>("wx", raining).await;
        stage.end().await;
    }
}
