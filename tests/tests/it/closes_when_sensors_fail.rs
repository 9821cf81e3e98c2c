//! A sensor that is silent, reports false values or answers nonsense counts as unsafe.

use simulator::{Fault, Kind};
use test_support::Rig;

async fn closes_on(fault: Fault, kind: Kind) -> anyhow::Result<()> {
    let rig = Rig::at_open_dome().await?;
    rig.simulator.world().fault(kind, fault.clone());
    let limit_s = if kind == Kind::ObservingConditions { 100.0 } else { 40.0 };
    let reasons = |rig: &Rig| rig.safety.get().is_some_and(|safety| !safety.said.body.reasons.is_empty());
    rig.until(&format!("the verdict says why after {fault:?}"), limit_s, reasons).await?;
    rig.until(&format!("the dome is shut after {fault:?}"), 30.0, Rig::is_shut).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_safety_monitor_that_hangs_is_unsafe() -> anyhow::Result<()> {
    closes_on(Fault::hang(), Kind::SafetyMonitor).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_safety_monitor_that_answers_html_is_unsafe() -> anyhow::Result<()> {
    closes_on(Fault::html(), Kind::SafetyMonitor).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_weather_station_that_says_nan_is_unsafe() -> anyhow::Result<()> {
    closes_on(Fault::nan(), Kind::ObservingConditions).await
}
