//! A sensor that is silent, reports false values or answers nonsense counts as unsafe.

use simulator::{Fault, Kind};
use test_support::Harness;

async fn closes_on(fault: Fault, kind: Kind) -> anyhow::Result<()> {
    let harness = Harness::at_open_dome().await?;
    harness.simulator.world().fault(kind, fault.clone());
    let limit_s = if kind == Kind::ObservingConditions { 100.0 } else { 40.0 };
    let reasons = |harness: &Harness| harness.safety.get().is_some_and(|safety| !safety.sample.body.reasons.is_empty());
    harness.until(&format!("the verdict says why after {fault:?}"), limit_s, reasons).await?;
    harness.until(&format!("the dome is shut after {fault:?}"), 30.0, Harness::is_shut).await?;
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
async fn a_weather_station_that_reports_nan_is_unsafe() -> anyhow::Result<()> {
    closes_on(Fault::nan(), Kind::ObservingConditions).await
}
