//! Parts of a telescope's state with their age, metrics without what is stale, and the addresses that older scripts read.

use std::time::Duration;

use contract::{Key, Kind, Part};
use serde_json::json;
use test_support::LIMIT;

use crate::stage::{Stage, address, sample};

const TELESCOPE: &str = "/api/v1/telescopes/paranal/callisto";

#[tokio::test(flavor = "multi_thread")]
async fn each_part_has_its_age_and_one_that_was_never_received_is_not_found() {
    let stage = Stage::start().await;
    let (status, problem) = stage.get(&format!("{TELESCOPE}/safety")).await;
    assert_eq!((status.as_u16(), &problem["code"]), (404, &json!("not-found")), "{problem}");
    let _safety =
        stage.publish(Key::Observatory(address("callisto"), Part::Safety), sample("observatory.safety")).await;
    let safety = stage.until(&format!("{TELESCOPE}/safety"), |safety| safety["quality"] == "fresh").await;
    assert!(safety["body"].is_object() && safety["period_s"] == 1.0, "{safety}");
    assert!(safety["age_s"].as_f64().is_some_and(|age_s| (0.0..5.0).contains(&age_s)), "{safety}");
    let dome = address("callisto").device(Kind::Dome, &"d".parse().unwrap());
    let _dome = stage.publish(Key::State(dome), sample("dome.state")).await;
    let device = stage.until(&format!("{TELESCOPE}/devices/dome/d"), |device| device["state"].is_object()).await;
    assert_eq!((&device["kind"], &device["capabilities"]), (&json!("dome"), &json!(null)));
    assert_eq!(stage.get(&format!("{TELESCOPE}/devices")).await.1.as_array().unwrap().len(), 1);
    for unknown in ["dome/e", "roof/d", "dome/%20", "dome/d/x", "camera/d"] {
        let (status, _) = stage.get(&format!("{TELESCOPE}/devices/{unknown}")).await;
        assert_eq!(status.as_u16(), 404, "{unknown}");
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_stale_is_absent_from_the_metrics() {
    let stage = Stage::start().await;
    let text = async || stage.http.get(format!("{}/metrics", stage.url)).send().await.unwrap().text().await.unwrap();
    let silent = text().await;
    let up = |up: u8| format!("starmesh_telescope_up{{site=\"paranal\",telescope=\"callisto\"}} {up}\n");
    assert!(silent.contains(&up(0)) && !silent.contains("starmesh_frames{"), "{silent}");
    let text_that = async |is_wanted: &dyn Fn(&str) -> bool| {
        let asked = async {
            loop {
                let text = text().await;
                if is_wanted(&text) {
                    return text;
                }
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        };
        tokio::time::timeout(LIMIT, asked).await.unwrap()
    };
    let night = Key::Observatory(address("callisto"), Part::Night);
    let night = stage.publish(night, sample("observatory.night")).await;
    let dome = address("callisto").device(Kind::Dome, &"d".parse().unwrap());
    let dome = stage.publish(Key::State(dome), sample("dome.state")).await;
    let live = text_that(&|text| {
        text.contains(&up(1)) && text.contains("starmesh_frames{") && text.contains("property=\"ShutterStatus\"")
    })
    .await;
    // Samples of one name stand together below their type, as Prometheus's format asks.
    let names = live.lines().filter(|line| !line.starts_with('#')).map(|line| line.split(['{', ' ']).next().unwrap());
    let mut groups: Vec<&str> = names.collect();
    groups.dedup();
    let mut once = groups.clone();
    once.sort_unstable();
    once.dedup();
    assert_eq!(groups.len(), once.len(), "{groups:?}");
    drop((night, dome));
    text_that(&|text| text.contains(&up(0)) && !text.contains("starmesh_frames{") && !text.contains("property=")).await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn older_scripts_find_what_they_know() {
    let stage = Stage::start().await;
    let _schedule =
        stage.publish(Key::Observatory(address("callisto"), Part::Schedule), sample("observatory.schedule")).await;
    let rows = stage.until("/api/schedule", |rows| rows[0].is_object()).await;
    for key in
        ["device_name", "action_type", "action_value", "start_time", "end_time", "completed", "status", "start_HHMMSS"]
    {
        assert!(!rows[0][key].is_null(), "{key}: {}", rows[0]);
    }
    let (status, lines) = stage.get("/api/log?datetime=2030-01-01T00:00:00Z&limit=5").await;
    assert_eq!((status.as_u16(), lines.is_array()), (200, true), "{lines}");
    assert_eq!(stage.get("/api/log?datetime=yesterday").await.0.as_u16(), 400);
    assert_eq!(stage.get("/api/schedule?telescope=io").await.0.as_u16(), 404);
    let response = stage.http.get(format!("{}/api/schedule", stage.url)).send().await.unwrap();
    let link = response.headers().get("link").unwrap().to_str().unwrap();
    assert!(link.contains("/api/v1/telescopes/paranal/callisto/schedule"), "{link}");
    let toggled = stage.http.post(format!("{}/api/roboticswitch", stage.url)).send().await.unwrap();
    assert_eq!(toggled.status().as_u16(), 410);
    let _second = stage.publish(Key::Observatory(address("io"), Part::Night), sample("observatory.night")).await;
    stage.until("/api/v1/network", |network| network["telescopes"].as_array().unwrap().len() == 2).await;
    assert_eq!(stage.get("/api/schedule").await.0.as_u16(), 400, "which one is meant is not clear");
    assert_eq!(stage.get("/api/schedule?telescope=callisto").await.0.as_u16(), 200);
    stage.end().await;
}
