//! The record of a weather station outlives whoever listens.

use std::time::Duration;

use contract::Kind;
use contract::device::observing_conditions::{Fields, ObservingConditions};
use contract::device::record::{Question, Record};
use contract::{Key, Link};
use serde_json::json;

use crate::fake::{Fake, Says};
use crate::stage::{LIMIT, Stage};

#[tokio::test(flavor = "multi_thread")]
async fn a_weather_stations_record_is_what_was_heard_of_it() {
    let hardware = Fake::start(&[("humidity", json!(50.0)), ("temperature", json!(5.0))]).await;
    let block = |kind: &str, name: &str, more: &str| {
        format!("[[{kind}]]\nname = \"{name}\"\nserver = \"{}\"\nperiod_s = 0.2\n{more}\n", hardware.address)
    };
    let stage = Stage::start(&(block("observingconditions", "wx", "") + &block("safetymonitor", "monitor", ""))).await;
    let states = stage.states::<ObservingConditions>("wx").await;
    let mut heard = Vec::new();
    let mut hear_until = async |wanted: fn(&Link, &Fields) -> bool| {
        let hearing = async {
            loop {
                let state = states.hear().await;
                let is_wanted = wanted(&state.said.body.link, &state.said.body.fields);
                // the first states may come twice: as an answer, and as they are said
                if !heard.iter().any(|known: &bus::Heard<_>| known.said.seq == state.said.seq) {
                    heard.push(state);
                }
                if is_wanted {
                    return;
                }
            }
        };
        tokio::time::timeout(LIMIT, hearing).await.unwrap();
    };
    hear_until(|_, fields| fields.humidity_percent.known() == Some(&50.0)).await;
    hardware.say("humidity", Says::Value(json!(81.0)));
    hear_until(|_, fields| fields.humidity_percent.known() == Some(&81.0)).await;
    hardware.hang(true);
    hear_until(|link, _| matches!(link, Link::Lost { .. })).await;
    hardware.hang(false);
    hear_until(|link, fields| *link == Link::Connected && fields.humidity_percent.known() == Some(&81.0)).await;

    let key = Key::Record(stage.device(Kind::ObservingConditions, "wx"));
    let (clock, limit) = (stage.bus.clock(), Duration::from_secs(3));
    let asked = clock.machine();
    let record: Record<Fields> = stage.bus.ask(&key, &Question { back_s: 600.0 }, limit).await.unwrap();
    let answered = clock.machine();
    assert_eq!((record.speed, &record.boot_id), (1.0, &heard[0].said.boot_id));
    assert_eq!(record.entries[0].seq, 0, "from the first word of this life on");
    for state in &heard {
        let told = &record.entries[usize::try_from(state.said.seq).unwrap()];
        assert_eq!(
            (told.seq, &told.link, &told.fields),
            (state.said.seq, &state.said.body.link, &state.said.body.fields)
        );
        // it was said before it arrived, and the age is that of the moment of the answer
        let age = Duration::from_secs_f64(told.age_s);
        assert!(state.arrived.plus(age) >= asked.minus(Duration::from_millis(1)), "{told:?}");
        assert!(age <= answered.since(heard[0].arrived) + Duration::from_secs(5), "{told:?}");
    }
    let bad = record.entries.iter().filter(|entry| entry.link != Link::Connected).count();
    assert!(bad >= 2, "connecting and lost are told too");

    let short: Record<Fields> = stage.bus.ask(&key, &Question { back_s: 0.0 }, limit).await.unwrap();
    assert!(short.entries.len() <= 2 && short.entries.last().unwrap().seq >= record.entries.last().unwrap().seq);
    let nonsense: Record<Fields> = stage.bus.ask(&key, &json!({"back_s": "long"}), limit).await.unwrap();
    assert!(nonsense.entries.is_empty());
    // a safety monitor tells the length of its record with its state
    let other = Key::Record(stage.device(Kind::SafetyMonitor, "monitor"));
    assert!(stage.bus.ask::<_, Record<Fields>>(&other, &Question { back_s: 600.0 }, limit).await.is_err());
    stage.end().await;
}
