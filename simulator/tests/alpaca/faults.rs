//! Faults have the effects that they describe.

use std::time::{Duration, Instant};

use simulator::{Fault, Kind, Quantity};

use crate::client::{LIMIT, Site, options};

#[tokio::test]
async fn rain_makes_it_unsafe_and_stops_being_so() {
    let site = Site::connected(options(1.0), &["safetymonitor", "observingconditions"]).await;
    assert_eq!(site.get("safetymonitor", "issafe").await, true);
    assert_eq!(site.order("world/rain", r#"{"on": true}"#).await, 200);
    assert_eq!(site.get("safetymonitor", "issafe").await, false);
    assert!(site.get("observingconditions", "rainrate").await.as_f64().unwrap() > 0.0);
    assert_eq!(site.order("world/rain", r#"{"on": false}"#).await, 200);
    assert_eq!(site.get("safetymonitor", "issafe").await, true);
    site.order("world/weather", r#"{"WindSpeed": 30, "temperature": -3.5}"#).await;
    assert_eq!(site.get("observingconditions", "temperature").await, -3.5);
    assert_eq!(site.get("safetymonitor", "issafe").await, false);
    assert_eq!(site.order("world/weather", r#"{"Windspeed": "much"}"#).await, 400);
    site.simulator.world().clear_faults();
    assert_eq!(site.get("safetymonitor", "issafe").await, true);
    site.simulator.world().set_unsafe(true);
    assert_eq!(site.get("safetymonitor", "issafe").await, false);
}

#[tokio::test]
async fn a_stale_device_repeats_itself() {
    let site = Site::connected(options(1.0), &["safetymonitor"]).await;
    site.simulator.world().fault(Kind::SafetyMonitor, Fault::stale());
    site.simulator.world().rain(true);
    assert_eq!(site.get("safetymonitor", "issafe").await, true, "as it was when the fault began");
    assert_eq!(site.order("faults/safetymonitor", "{}").await, 200);
    assert_eq!(site.get("safetymonitor", "issafe").await, false);
}

#[tokio::test]
async fn numbers_become_nan_only_on_request() {
    let site = Site::connected(options(1.0), &["observingconditions"]).await;
    site.order("faults/observingconditions", r#"{"nan": true, "only": ["humidity", "devicestate"]}"#).await;
    let text = async |member: &str| {
        site.http.get(site.url("observingconditions", member)).send().await.unwrap().text().await.unwrap()
    };
    assert!(text("humidity").await.contains("\"Value\":NaN"));
    assert!(text("devicestate").await.contains("\"Value\":NaN"));
    assert!(!text("temperature").await.contains("NaN"));
}

#[tokio::test]
async fn a_hung_device_never_answers_and_delays_no_other() {
    let site = Site::connected(options(1.0), &["dome", "telescope"]).await;
    site.simulator.world().fault(Kind::Dome, Fault::hang());
    let asked = site.http.get(site.url("dome", "azimuth")).timeout(Duration::from_millis(300)).send().await;
    assert!(asked.unwrap_err().is_timeout());
    let put = site.http.put(site.url("dome", "openshutter")).timeout(Duration::from_millis(300)).send().await;
    assert!(put.unwrap_err().is_timeout());
    site.get("telescope", "altitude").await;
    site.simulator.world().clear_faults();
    assert_eq!(site.get("dome", "shutterstatus").await, 1, "a hung dome executes nothing");
}

#[tokio::test]
async fn a_refusing_device_drops_the_line() {
    let site = Site::connected(options(1.0), &["dome"]).await;
    site.simulator.world().fault(Kind::Dome, Fault::refuse());
    let error = site.http.get(site.url("dome", "azimuth")).send().await.unwrap_err();
    assert!(!error.is_timeout() && error.status().is_none(), "{error:?}");
    site.simulator.world().clear_faults();
    site.get("dome", "azimuth").await;
}

#[tokio::test]
async fn a_mute_device_executes_and_drops_the_connection() {
    let site = Site::connected(options(100.0), &["dome"]).await;
    site.simulator.world().fault(Kind::Dome, Fault::mute().only(&["openshutter"]));
    let error = site.http.put(site.url("dome", "openshutter")).send().await.unwrap_err();
    assert!(!error.is_timeout() && error.status().is_none(), "{error:?}");
    site.until("dome", "shutterstatus", 0).await;
}

#[tokio::test]
async fn slow_erring_and_broken_answers() {
    let site = Site::connected(options(1.0), &["focuser"]).await;
    let world = site.simulator.world();
    world.fault(Kind::Focuser, Fault::slow(250));
    let started = Instant::now();
    site.get("focuser", "position").await;
    assert!(started.elapsed() >= Duration::from_millis(250));
    world.fault(Kind::Focuser, Fault::error(0x500));
    assert_eq!(site.answer("focuser", "position").await["ErrorNumber"], 0x500);
    world.fault(Kind::Focuser, Fault::html().only(&["Position"]));
    let page = site.http.get(site.url("focuser", "position")).send().await.unwrap();
    assert_eq!(page.status(), 500);
    assert!(page.text().await.unwrap().contains("<html>"));
    site.get("focuser", "maxstep").await;
}

#[tokio::test]
async fn a_stuck_shutter_stays_half_open() {
    let site = Site::connected(options(100.0), &["dome"]).await;
    site.put("dome", "openshutter", "").await;
    site.until("dome", "shutterstatus", 0).await;
    site.order("world/shutter", r#"{"sticks_half_open": true}"#).await;
    site.put("dome", "closeshutter", "").await;
    site.until("dome", "shutterstatus", 4).await;
    assert_eq!(site.simulator.world().dome_open(), 0.5);
    site.put("dome", "closeshutter", "").await;
    site.pass(40.0).await;
    assert_eq!(site.get("dome", "shutterstatus").await, 4);
    site.simulator.world().stick_shutter_half_open(false);
    site.put("dome", "closeshutter", "").await;
    site.until("dome", "shutterstatus", 1).await;
}

#[tokio::test]
async fn a_dome_runs_on_until_it_is_stopped_and_its_shutter_waits_for_that() {
    let site = Site::connected(options(10.0), &["dome"]).await;
    site.order("world/dome", r#"{"runs_on": true}"#).await;
    site.order("world/dome", r#"{"shutter_needs_rest": true}"#).await;
    site.put("dome", "slewtoazimuth", "Azimuth=3").await;
    site.pass(3.0).await;
    assert_eq!(site.get("dome", "slewing").await, true);
    assert!(site.get("dome", "azimuth").await.as_f64().unwrap() > 6.0, "it has run past 3 deg");
    assert_eq!(site.try_put("dome", "openshutter", "").await, (200, 0x40B));
    site.put("dome", "abortslew", "").await;
    assert_eq!(site.get("dome", "slewing").await, false);
    site.put("dome", "openshutter", "").await;
    site.until("dome", "shutterstatus", 0).await;
    // Sent again it runs on again, until the fault is cleared.
    site.put("dome", "slewtoazimuth", "Azimuth=300").await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert_eq!(site.get("dome", "slewing").await, true);
    site.simulator.world().clear_faults();
    site.until("dome", "slewing", false).await;
    site.put("dome", "closeshutter", "").await;
    site.until("dome", "shutterstatus", 1).await;
}

#[tokio::test]
async fn a_lying_mount_reports_parked_and_a_lost_one_wants_connecting() {
    let site = Site::connected(options(1.0), &["telescope"]).await;
    site.put("telescope", "unpark", "").await;
    assert_eq!(site.get("telescope", "atpark").await, false);
    site.simulator.world().lie_about_park(true);
    assert_eq!(site.get("telescope", "atpark").await, true);
    site.put("telescope", "park", "").await;
    assert!(!site.simulator.world().is_parked());
    site.simulator.world().lose_connection(Kind::Telescope);
    assert_eq!(site.get("telescope", "connected").await, false);
    assert_eq!(site.answer("telescope", "atpark").await["ErrorNumber"], 0x407);
    site.put("telescope", "connect", "").await;
    assert_eq!(site.get("telescope", "atpark").await, true);
}

#[tokio::test]
async fn the_watchdog_closes_a_dome_that_nobody_commands() {
    let site = Site::connected(options(100.0), &["dome"]).await;
    let world = site.simulator.world();
    site.put("dome", "openshutter", "").await;
    site.until("dome", "shutterstatus", 0).await;
    world.set_watchdog(Some(LIMIT.as_secs_f64()));
    site.put("dome", "action", "Action=feedwatchdog&Parameters=").await;
    site.pass(600.0).await;
    assert_eq!(site.get("dome", "shutterstatus").await, 0, "it counts machine seconds since it was fed");
    world.set_watchdog(Some(0.3));
    tokio::time::sleep(Duration::from_millis(400)).await;
    // Polling does not feed the watchdog.
    site.until("dome", "shutterstatus", 1).await;
    assert_eq!(world.watchdog_closings(), 1);
}

#[tokio::test]
async fn the_log_shows_when_a_command_was_on_the_wire() {
    let site = Site::connected(options(1.0), &["dome"]).await;
    let world = site.simulator.world();
    let before = Instant::now();
    site.put("dome", "slewtoazimuth", "Azimuth=30&ClientID=4&ClientTransactionID=5").await;
    site.put("dome", "closeshutter", "ClientID=4").await;
    let puts = world.puts_since(0);
    let last: Vec<(&str, &str)> = puts.iter().map(|put| (put.member.as_str(), put.parameters.as_str())).collect();
    assert_eq!(last, [("connected", "Connected=true"), ("slewtoazimuth", "Azimuth=30"), ("closeshutter", "")]);
    assert!(puts[1].at > before && puts[2].at >= puts[1].at && puts[2].error == Some(0));
    let answer = site.control("log?since=2").await;
    assert_eq!(answer["puts"][0]["member"], "closeshutter");
    assert_eq!(answer["requests"]["last_minute"], 3);
}

#[tokio::test]
async fn the_ups_runs_down_without_mains() {
    let site = Site::connected(options(100.0), &["switch", "observingconditions"]).await;
    let world = site.simulator.world();
    assert_eq!(site.get("switch", "getswitch?Id=3").await, true);
    world.set_on_mains(false);
    assert_eq!(site.get("switch", "getswitch?Id=3").await, false);
    site.pass(30.0).await;
    assert!(site.get("switch", "getswitchvalue?Id=4").await.as_f64().unwrap() < 99.0);
    world.set_weather(Quantity::Pressure, Some(700.0));
    assert_eq!(site.get("observingconditions", "pressure").await, 700.0);
}

mod proof {
    use super::*;

    /// The dome must be fed in time, by a real clock.
    #[tokio::test]
    async fn the_watchdog_leaves_a_dome_open_that_is_fed() {
        let site = Site::connected(options(100.0), &["dome"]).await;
        site.put("dome", "openshutter", "").await;
        site.until("dome", "shutterstatus", 0).await;
        site.world().set_watchdog(Some(0.6));
        for _ in 0..8 {
            tokio::time::sleep(Duration::from_millis(150)).await;
            site.put("dome", "action", "Action=feedwatchdog&Parameters=").await;
            site.pass(1.0).await;
        }
        assert_eq!(site.get("dome", "shutterstatus").await, 0, "fed for longer than its limit");
    }
}
