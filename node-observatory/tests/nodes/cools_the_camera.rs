//! `cool_camera` before the simulated camera: a cooler that refuses is asked again, and a sensor that stays too warm
//! lets its row rest, exposes nothing, and raises an alert that is active until the sensor is cold.

use contract::observatory::{Alerts, RowStatus};
use contract::{Address, CommandId, Key, Order, OrderKind, Part, Reply};
use simulator::{Fault, Kind, Quantity};

use crate::MOST;
use crate::sim::{Sim, telescope};

/// With the default timeout of half an hour, 90 s of this machine.
const CAMERA: &str = "temperature_c = -10.0\n";
/// For a camera that is to fail soon: 20 s of this machine.
const IMPATIENT: &str = "temperature_c = -10.0\ncooling_timeout_min = 2.0\n";
const BIAS: (&str, &str) = ("calibration", r#"{"exptime": [0], "n": [2]}"#);

fn row(sim: &Sim, index: usize) -> Option<(RowStatus, String)> {
    let row = sim.schedule.get()?.sample.body.rows.get(index)?.clone();
    Some((row.status, row.detail))
}

fn exposures(sim: &Sim) -> usize {
    sim.simulator.world().puts_since(0).iter().filter(|put| put.member == "startexposure").count()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cooler_that_refuses_is_asked_again_until_it_runs() {
    let mut sim = Sim::with(telescope(20.0), "[faults]\nretries = 100\npause_s = 0.5\n", CAMERA, &[]).await;
    sim.write_schedule(&[("cool_camera", "{}"), BIAS], 18_000.0);
    let refuses = Fault { error: Some(0x500), only: vec!["setccdtemperature".to_owned()], ..Fault::default() };
    sim.simulator.world().fault(Kind::Camera, refuses);
    sim.start().await;
    let trying = |sim: &Sim| {
        let night = sim.night.get().map(|received| received.sample.body);
        night.is_some_and(|night| night.actions.iter().any(|now| now.step.starts_with("trying again")))
    };
    sim.until("asked again", MOST, trying).await;
    assert_eq!(row(&sim, 0).unwrap().0, RowStatus::Running);
    sim.simulator.world().fault(Kind::Camera, Fault::default());
    sim.until("cold, and the frames after it taken", MOST, |sim| sim.ended(0).is_some() && sim.ended(1).is_some())
        .await;
    assert_eq!(exposures(&sim), 2);
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sensor_that_stays_warm_lets_its_row_rest_and_is_reported_until_it_is_cold() {
    let mut sim = Sim::with(telescope(20.0), "[faults]\nrest_s = 2\n", IMPATIENT, &[]).await;
    let key = Key::Observatory(Address::new("test", "alpha").unwrap(), Part::Alerts);
    let alerts = sim.bus.latest::<Alerts>(&key).await.unwrap();
    let stands = || {
        alerts.get().is_some_and(|received| received.sample.body.alerts.iter().any(|a| a.id == "cooling-failed/camera"))
    };
    sim.write_schedule(&[("cool_camera", "{}"), BIAS], 18_000.0);
    // 45 K below such air the sensor is at 10 C.
    sim.simulator.world().set_weather(Quantity::Temperature, Some(55.0));
    sim.start().await;
    let rests = |sim: &Sim| row(sim, 0).filter(|(status, _)| *status == RowStatus::Interrupted);
    sim.until("it rests", MOST, |sim| rests(sim).is_some_and(|(_, detail)| detail.contains("tried again at"))).await;
    let (_, detail) = row(&sim, 0).unwrap();
    assert!(detail.contains("-10") && detail.contains(" C"), "what was wanted, and how warm it is: {detail}");
    sim.until("reported", MOST, |_| stands()).await;
    assert_eq!(exposures(&sim), 0, "nothing is exposed by a warm sensor");

    sim.simulator.world().set_weather(Quantity::Temperature, Some(5.0));
    sim.until("both rows, each when it is cold", MOST, |sim| sim.ended(0).is_some() && sim.ended(1).is_some()).await;
    assert_eq!(exposures(&sim), 2);
    sim.until("reported no more", MOST, |_| !stands()).await;
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_person_cools_and_warms_a_camera_whatever_the_schedule_does() {
    let mut sim = Sim::with(telescope(20.0), "", CAMERA, &[]).await;
    sim.write_schedule(&[("close", "{}")], 18_000.0);
    sim.start().await;
    sim.until("the row ends", MOST, |sim| sim.ended(0).is_some()).await;
    let address = Address::new("test", "alpha").unwrap();
    let order = async |kind: OrderKind| -> Reply {
        let order =
            Order { id: CommandId::fresh(), from: "test".to_owned(), reason: "a test".to_owned(), kind, seen: None };
        crate::site::ask(&sim.bus, &address, &order).await
    };
    let cool = |camera: &str, set_c| OrderKind::Cool { camera: camera.to_owned(), set_c };
    let last = |member: &str| {
        let puts = sim.simulator.world().puts_since(0);
        puts.into_iter().rfind(|put| put.member == member).map(|put| put.parameters).unwrap_or_default()
    };
    for (set_c, expected) in [(Some(-20.0), "SetCCDTemperature=-20"), (None, "SetCCDTemperature=-10")] {
        let reply = order(cool("camera", set_c)).await;
        assert!(matches!(reply, Reply::Accepted(_)), "{reply:?}");
        sim.until("cooling", MOST, |_| last("setccdtemperature").contains(expected)).await;
        sim.until("on", MOST, |_| last("cooleron").contains("True")).await;
    }
    let reply = order(OrderKind::Warm("camera".to_owned())).await;
    assert!(matches!(reply, Reply::Accepted(_)), "{reply:?}");
    sim.until("off", MOST, |_| last("cooleron").contains("False")).await;
    for (kind, words) in
        [(cool("camra", None), "did you mean \"camera\"?"), (cool("camera", Some(500.0)), "expected -273.15 to 100")]
    {
        let reply = order(kind).await;
        assert!(matches!(&reply, Reply::Refusal(refusal) if refusal.detail.contains(words)), "{reply:?}");
    }
    sim.stop().await;
}
