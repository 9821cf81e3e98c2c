use bus::Clock;
use serde_json::{Value, json};

use super::*;
use crate::model::tests::received;
use crate::network::Network;

/// The summary of a telescope long after these last states, by the node's path below `node`.
fn long_after(states: &[(&str, serde_json::Value)]) -> Face {
    let address = Address::new("paranal", "callisto").unwrap();
    let network = crate::network::Network::new(bus::Clock::machine_clock(), address.clone());
    let state = |pid: u32, stopped: &serde_json::Value| {
        serde_json::json!({ "role": "observatory", "version": "", "host": "pc", "pid": pid, "uptime_s": 1.0,
            "speed": 1.0, "stopped": stopped })
    };
    let night = serde_json::json!({ "robotic": true, "posture": "closed", "actions": [], "frames": 0, "open_s": 0,
        "speed": 1, "simulated": false, "ended": false });
    let receive =
        |key: &str, body| crate::model::tests::received(&format!("paranal/callisto/{key}"), "b", 0, 100, body);
    network.accept(receive("observatory/night/state", night));
    for (node, stopped) in states {
        network.accept(receive(&format!("node/{node}/state"), state(1, stopped)));
    }
    let now = MachineTime::from_boot(std::time::Duration::from_secs(9000));
    let model = network.read();
    Summary::of(&model, &address, &model.telescopes[&address], now, Utc::EPOCH).face
}

#[test]
fn a_telescope_that_was_stopped_in_good_order_concerns_nobody_and_names_who_stopped_it() {
    let by = |closed: Option<bool>| match closed {
        Some(closed) => serde_json::json!({ "by": "starmesh up on pc", "closed": closed }),
        None => serde_json::json!({ "by": "starmesh up on pc" }),
    };
    let runs = serde_json::Value::Null;
    let all = [("observatory/main", by(Some(true))), ("device/enclosure", by(Some(true))), ("device/main", by(None))];
    let face = long_after(&all);
    assert_eq!(face.stopped.unwrap().text, "stopped by starmesh up on pc, closed");
    assert_eq!((face.concern, face.node_count, face.alerts.len()), (None, Heads { known: 3, lost: 0 }, 0));
    assert_eq!((face.now.as_str(), face.domes.len()), ("stopped by starmesh up on pc, closed", 0));

    let open = [("observatory/main", by(Some(false))), ("device/enclosure", by(Some(false)))];
    let face = long_after(&open);
    assert_eq!(face.stopped.unwrap().text, "stopped by starmesh up on pc, NOT verified closed");
    assert!(face.concern == Some(Priority::Critical) && face.alerts.len() == 2 && face.node_count.lost == 2);

    let closed_later = [("observatory/main", by(Some(false))), ("device/enclosure", by(Some(true)))];
    assert_eq!(long_after(&closed_later).stopped.unwrap().closed, Some(true));
    let standby = [("observatory/main", by(Some(true))), ("observatory/second", runs.clone())];
    assert_eq!(long_after(&standby).stopped, None);
    let lost = [("observatory/main", runs)];
    assert!(long_after(&lost).concern == Some(Priority::Critical), "no node has published that it would be silent");
}

#[test]
fn figures_are_in_arcsec_and_of_now_or_absent() {
    let address = Address::new("paranal", "callisto").unwrap();
    let night = include_str!("../../common/contract/golden/v1/observatory.night.json");
    let facts = json!({"frame": "f", "camera": "andor", "fwhm_px": 3.0, "scale_arcsec_px": 0.5});
    let guiding = json!({"active": true, "detail": "", "camera": "andor", "rms_px": 0.4});
    let figures = |guiding: &Value, now_s| {
        let network = Network::new(Clock::machine_clock(), address.clone());
        let states = [
            ("observatory/night/state", serde_json::from_str(night).unwrap()),
            ("observatory/frame/f/facts", facts.clone()),
            ("observatory/guiding/state", guiding.clone()),
        ];
        for (key, body) in states {
            network.accept(received(&format!("paranal/callisto/{key}"), "b", 0, 100, body));
        }
        let now = MachineTime::from_boot(Duration::from_secs(now_s));
        let model = network.read();
        Summary::of(&model, &address, &model.telescopes[&address], now, Utc::EPOCH).face.figures
    };
    assert_eq!(figures(&guiding, 101), Figures { guide_rms_arcsec: Some(0.2), fwhm_arcsec: Some(1.5) });
    let ended = json!({"active": false, "detail": "", "camera": "andor", "rms_px": 0.4});
    assert_eq!(figures(&ended, 101), Figures { guide_rms_arcsec: None, fwhm_arcsec: Some(1.5) });
    assert_eq!(figures(&guiding, 500), Figures::default(), "the observatory node is silent");
}

#[test]
fn the_night_is_the_one_under_which_frames_of_now_are_filed() {
    let night = |longitude_deg: f64, at: &str| {
        let address = Address::new("paranal", "callisto").unwrap();
        let file = json!({ "site": "paranal", "telescope": "callisto", "latitude_deg": -24.6, "longitude_deg": longitude_deg,
            "elevation_m": 2518.0 });
        let file: config::Place = serde_json::from_value(file).unwrap();
        let network = Network::new(Clock::machine_clock(), &file);
        let model = network.read();
        let now = MachineTime::from_boot(Duration::from_secs(1));
        Summary::of(&model, &address, &model.telescopes[&address], now, at.parse().unwrap()).face.night
    };
    for (longitude_deg, at, date) in [
        (150.0, "2026-11-21T01:59:59Z", "20261120"),
        (150.0, "2026-11-21T02:00:00Z", "20261121"),
        (150.0, "2026-11-21T20:00:00Z", "20261121"),
        (-150.0, "2026-11-21T21:59:59Z", "20261120"),
        (-150.0, "2026-11-21T22:00:00Z", "20261121"),
        (-150.0, "2026-11-22T16:00:00Z", "20261121"),
    ] {
        assert_eq!(night(longitude_deg, at).as_deref(), Some(date), "{longitude_deg} {at}");
    }
    assert_eq!(long_after(&[]).night, None, "nobody says where it stands");
}

#[test]
fn the_alerts_of_a_shared_dome_stand_at_its_telescope_whether_or_not_the_observatory_node_publishes() {
    let address = Address::new("paranal", "callisto").unwrap();
    let network = Network::new(Clock::machine_clock(), address.clone());
    let alert = |id: &str, cause: &str| {
        json!({ "id": id, "priority": "critical", "raised_utc": "2026-11-21T03:00:00Z", "cause": cause,
            "consequence": "", "action": "" })
    };
    let alerts = [alert("dome-not-closed/roof", "it is half open"), alert("device-lost/station", "it is silent")];
    let guard: Value = serde_json::from_str(include_str!("../../common/contract/golden/v1/dome.guard.json")).unwrap();
    let night: Value =
        serde_json::from_str(include_str!("../../common/contract/golden/v1/observatory.night.json")).unwrap();
    network.accept(received("paranal/shared/node/device/enclosure/alerts", "b", 0, 100, json!({ "alerts": alerts })));
    network.accept(received("paranal/shared/device/dome/roof/guard", "b", 0, 100, guard));
    let told = |wanted: &Address| {
        let model = network.read();
        let now = MachineTime::from_boot(Duration::from_secs(101));
        let known = model.telescopes.iter();
        let faces = known.map(|(address, telescope)| Summary::of(&model, address, telescope, now, Utc::EPOCH).face);
        let faces: Vec<Face> = faces.collect();
        let face = faces.iter().find(|face| face.id == wanted.to_string()).unwrap();
        let ids = |alerts: &[Alert]| alerts.iter().map(|alert| alert.id.clone()).collect::<Vec<_>>();
        (ids(&face.alerts), ids(&face.alerts_beside(faces.iter())), face.domes.len())
    };
    let (dome, station) = ("dome-not-closed/roof".to_owned(), "device-lost/station".to_owned());
    assert_eq!(told(&address), (vec![dome.clone()], vec![], 1), "the observatory node is silent");
    network.accept(received("paranal/callisto/observatory/night/state", "b", 0, 100, night));
    assert_eq!(told(&address), (vec![dome.clone()], vec![], 0));
    let all = vec![station.clone(), dome];
    assert_eq!(told(&address.shared()), (all, vec![station], 0), "what stands at a telescope is not told again");
}

#[test]
fn the_concern_is_never_less_than_the_most_urgent_alert_that_needs_somebody() {
    let address = Address::new("paranal", "callisto").unwrap();
    let golden = |text: &str| -> Value { serde_json::from_str(text).unwrap() };
    let told = |verdict: &str, alerts: &[(&str, Option<&str>)]| {
        let mut night = golden(include_str!("../../common/contract/golden/v1/observatory.night.json"));
        let mut safety = golden(include_str!("../../common/contract/golden/v1/observatory.safety.json"));
        (night["posture"], safety["verdict"]) = (json!("closed"), json!(verdict));
        let alert = |(priority, acknowledged_by): &(&str, Option<&str>)| {
            json!({ "id": priority, "priority": priority, "raised_utc": "2026-11-21T03:00:00Z", "cause": priority,
                "consequence": "", "action": "", "acknowledged_by": acknowledged_by })
        };
        let alerts = json!({ "alerts": alerts.iter().map(alert).collect::<Vec<_>>() });
        let network = Network::new(Clock::machine_clock(), address.clone());
        for (part, body) in [("night", night), ("safety", safety), ("alerts", alerts)] {
            network.accept(received(&format!("paranal/callisto/observatory/{part}/state"), "b", 0, 100, body));
        }
        let model = network.read();
        let now = MachineTime::from_boot(Duration::from_secs(101));
        let face = Summary::of(&model, &address, &model.telescopes[&address], now, Utc::EPOCH).face;
        (face.concern, face.safety_concern)
    };
    assert_eq!(told("safe", &[]), (None, None));
    assert_eq!(told("safe", &[("medium", None), ("high", None)]), (Some(Priority::High), None));
    assert_eq!(told("unsafe", &[("critical", None)]), (Some(Priority::Critical), None), "unsafe and closed");
    assert_eq!(told("safe", &[("high", Some("web/ana")), ("medium", None)]), (Some(Priority::Medium), None));
}
