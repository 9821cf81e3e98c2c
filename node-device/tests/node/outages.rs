//! What does not answer for a moment is read on at once after it.

use contract::DeviceState;
use contract::device::safety_monitor::{Fields, SafetyMonitor};
use serde_json::json;
use test_support::until;

use crate::block;
use crate::fake::Fake;
use crate::stage::Stage;

/// A monitor that was read, the length of its record, and how often it was connected.
async fn a_monitor() -> (Fake, Stage, f64, usize) {
    let hardware = Fake::start(&[("issafe", json!(true))]).await;
    let stage = Stage::start(&block("safetymonitor", "monitor", &hardware, "period_s = 0.5")).await;
    let read = |state: &DeviceState<Fields>| state.fields.is_safe.known() == Some(&true);
    let before_s = stage.until::<SafetyMonitor>("monitor", read).await.fields.gapless_safe_s;
    let connected = hardware.puts("connected").len();
    (hardware, stage, before_s, connected)
}

#[tokio::test(flavor = "multi_thread")]
async fn one_question_without_an_answer_loses_no_device_that_decides() {
    let (hardware, stage, before_s, connected) = a_monitor().await;
    // One is never answered, and the next one is.
    hardware.hang_next(1);
    until("a question hangs", || hardware.hanging() > 0).await;
    // The question hangs for 2 s, so that this is a reading after it.
    stage.until::<SafetyMonitor>("monitor", |state| state.fields.gapless_safe_s > before_s + 2.0).await;
    assert_eq!(hardware.puts("connected").len(), connected, "it was not connected anew");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_has_fallen_silent_is_asked_beside_the_question_that_hangs() {
    let (hardware, stage, before_s, _) = a_monitor().await;
    hardware.hang(true);
    until("it is asked beside the question that hangs", || hardware.hanging() > 1).await;
    hardware.hang(false);
    let read = |state: &DeviceState<Fields>| state.fields.gapless_safe_s > before_s + 2.0;
    stage.until::<SafetyMonitor>("monitor", read).await;
    stage.end().await;
}
