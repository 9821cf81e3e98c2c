//! Writes what the observatory node does, and why, into the database: the night, the verdicts, the rows of the schedule
//! and the alerts. Only changes become rows, so a state that is published each second costs nothing.
//!
//! An archive that was away gets from the bus what its publishers store: ten minutes of the night and of the
//! verdicts, the newest schedule, and the last hundred lists of alerts. A row counts by incarnation and sequence
//! number, so what is received again changes nothing.

use std::collections::{BTreeMap, BTreeSet};

use bus::{Catch, Clock, Received, Subscriber};
use contract::observatory::{Alerts, InputState, NightState, RowState, SafetyState, ScheduleState, Unsafe};
use contract::{BootId, Key, Part, Payload, Stamped};
use node::Node;
use report::events::{Doing, Reason, ScheduleRecord, VerdictRecord};
use serde::Serialize;

use crate::database::{Database, StoredAlerts, StoredRow, StoredState, Write};

/// Samples that wait here when the database is slow.
const WAITING: usize = 4096;
/// The same state may have had another one between two samples that are farther apart, s of machine time.
const GAP_S: f64 = 15.0;
/// Clocks of two machines differ by less, s: beyond 2 s there is an alert.
const AHEAD_S: f64 = 5.0;
/// A state that is repeated every 10 s.
const SLOW_GAP_S: f64 = 45.0;

/// Stores the states of this telescope's observatory nodes.
pub async fn keep(node: Node, database: Database) -> anyhow::Result<()> {
    let night = subscribe::<NightState>(&node, Part::Night).await?;
    let safety = subscribe::<SafetyState>(&node, Part::Safety).await?;
    let schedule = subscribe::<ScheduleState>(&node, Part::Schedule).await?;
    let alerts = subscribe::<Alerts>(&node, Part::Alerts).await?;
    let speed = node.bus.clock().speed().max(1.0);
    let mut arrival = Arrival { clock: node.bus.clock().clone(), reported: BTreeSet::new() };
    let mut rows: BTreeMap<u32, RowState> = BTreeMap::new();
    loop {
        tokio::select! {
            mut received = night.recv() => {
                arrival.bound(&mut received.sample);
                let doing = doing(&received.sample.body);
                let write = state(&received, "night", &doing, &doing, GAP_S * speed)?;
                database.put(write).await?;
            }
            mut received = safety.recv() => {
                arrival.bound(&mut received.sample);
                let (same, verdict) = verdict(&received.sample.body);
                let write = state(&received, "safety", &same, &verdict, GAP_S * speed)?;
                database.put(write).await?;
            }
            mut received = schedule.recv() => {
                arrival.bound(&mut received.sample);
                let body = &received.sample.body;
                let record = ScheduleRecord {
                    file: body.file.clone(),
                    revision: body.revision,
                    refused: body.refused.clone(),
                    rows: u32::try_from(body.rows.len()).unwrap_or(u32::MAX),
                };
                let write = state(&received, "schedule", &record, &record, SLOW_GAP_S * speed)?;
                database.put(write).await?;
                let (at, origin) = (received.sample.at_utc, (received.sample.boot_id.clone(), received.sample.seq));
                for row in &body.rows {
                    // The database decides what is new; this only saves it from being asked.
                    if rows.get(&row.row) != Some(row) {
                        rows.insert(row.row, row.clone());
                        let stored = StoredRow { row: row.clone(), at, origin: origin.clone() };
                        database.put(Write::Row(Box::new(stored))).await?;
                    }
                }
            }
            received = alerts.recv() => {
                let mut sample = received.sample;
                arrival.bound(&mut sample);
                let stored =
                    StoredAlerts { alerts: sample.body.alerts, at: sample.at_utc, origin: (sample.boot_id, sample.seq) };
                database.put(Write::Alerts(Box::new(stored))).await?;
            }
        }
    }
}

/// Samples of a clock that is ahead: nothing is later than its arrival, or it would be the newest for ever.
struct Arrival {
    clock: Clock,
    /// The incarnations whose clock was reported.
    reported: BTreeSet<BootId>,
}

impl Arrival {
    /// A sample from the future gets the time at which it arrived.
    fn bound<T>(&mut self, sample: &mut Stamped<T>) {
        let now = self.clock.utc();
        let ahead_s = sample.at_utc.seconds_since(now);
        if ahead_s <= AHEAD_S * self.clock.speed().max(1.0) {
            return;
        }
        sample.at_utc = now;
        if self.reported.insert(sample.boot_id.clone()) {
            tracing::warn!(
                incarnation = sample.boot_id.as_str(),
                ahead_s,
                "the clock of the observatory node's machine is ahead; what it publishes is recorded at the time of its arrival"
            );
        }
    }
}

async fn subscribe<T: Payload>(node: &Node, part: Part) -> anyhow::Result<Subscriber<T>> {
    let key = Key::Observatory(node.config.address(), part);
    Ok(node.bus.subscribe::<T>(&key.to_string(), Catch::All, WAITING).await?)
}

fn state<T>(
    received: &Received<T>,
    part: &'static str,
    same: &impl Serialize,
    state: &impl Serialize,
    gap_s: f64,
) -> anyhow::Result<Write> {
    Ok(Write::State(Box::new(StoredState {
        part,
        same: serde_json::to_string(same)?,
        state: serde_json::to_string(state)?,
        at: received.sample.at_utc,
        gap_s,
        origin: (received.sample.boot_id.clone(), received.sample.seq),
    })))
}

fn doing(night: &NightState) -> Doing {
    Doing {
        robotic: night.robotic,
        posture: night.posture,
        ended: night.ended,
        speed: night.speed,
        simulated: night.simulated,
        actions: night.actions.clone(),
    }
}

/// A verdict, and what makes it another one than the one before: values in its words change each second.
fn verdict(safety: &SafetyState) -> (impl Serialize, VerdictRecord) {
    let reasons = |of: &[Unsafe]| -> Vec<Reason> { of.iter().map(|one| reason(one, &safety.inputs)).collect() };
    let record = VerdictRecord {
        verdict: safety.verdict,
        reasons: reasons(&safety.reasons),
        suspended: reasons(&safety.suspended),
    };
    let inputs = |of: &[Reason]| -> Vec<(String, bool)> {
        of.iter().map(|reason| (reason.input.clone(), reason.is_missing)).collect()
    };
    ((record.verdict, inputs(&record.reasons), inputs(&record.suspended)), record)
}

/// A reason is that its input is missing where the input has no value but these words.
fn reason(against: &Unsafe, inputs: &[InputState]) -> Reason {
    let has_no_value =
        inputs.iter().any(|state| state.input == against.input && !state.good && state.value == against.why);
    let is_old = against.why.starts_with("stale:") || against.why.starts_with("nothing received");
    Reason { input: against.input.clone(), why: against.why.clone(), is_missing: has_no_value || is_old }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn golden<T: Payload>(text: &str) -> T {
        let samples: serde_json::Value = serde_json::from_str(text).unwrap();
        serde_json::from_value(samples.get(0).unwrap_or(&samples).clone()).unwrap()
    }

    #[test]
    fn a_reason_whose_values_change_each_second_is_the_same_reason() {
        let text = include_str!("../../common/contract/golden/v1/observatory.safety.json");
        let mut safety: SafetyState = golden(text);
        let same = |safety: &SafetyState| serde_json::to_string(&verdict(safety).0).unwrap();
        let before = same(&safety);
        safety.reasons[0].why = "71.3 % was above 70 % at 03:02:12".to_owned();
        assert_eq!(same(&safety), before);
        assert!(!verdict(&safety).1.reasons[0].is_missing);
        safety.reasons[0].why = "stale: last received 31.0 s ago, allowed are 30.0 s".to_owned();
        assert_ne!(same(&safety), before);
        assert!(verdict(&safety).1.reasons[0].is_missing);
    }

    #[test]
    fn a_sample_of_a_clock_that_is_ahead_gets_the_time_of_its_arrival_and_others_stay_as_they_are() {
        let clock = Clock::machine_clock();
        let mut arrival = Arrival { clock: clock.clone(), reported: BTreeSet::new() };
        for (ahead_s, is_bounded) in [(-600.0, false), (0.0, false), (4.0, false), (3600.0, true), (1e9, true)] {
            let at_utc = clock.utc().plus_seconds(ahead_s);
            let mut sample = Stamped { boot_id: BootId::fresh(), seq: 1, at_utc, sent_s: None, held_s: None, body: () };
            arrival.bound(&mut sample);
            assert_eq!(sample.at_utc != at_utc, is_bounded, "{ahead_s}");
            assert!(sample.at_utc <= clock.utc().plus_seconds(AHEAD_S), "{ahead_s}");
        }
        assert_eq!(arrival.reported.len(), 2);
    }
}
