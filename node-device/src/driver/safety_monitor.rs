//! The safety monitor, and the record of its state, which survives a restart of the observatory node.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use alpaca::{Abilities, Alpaca, AlpacaError};
use bus::{MachineTime, SkyTime};
use contract::device::safety_monitor::{self, Capabilities, Command, Fields};
use contract::{CommandId, NoData};
use interlock::Need;

use super::{Driver, Executed};
use crate::now::Now;
use crate::readings::Readings;

/// Reads a safety monitor.
pub struct SafetyMonitor {
    record: Mutex<SafeRecord>,
}

impl SafetyMonitor {
    /// One that is polled every `period_s` machine seconds.
    pub fn new(period_s: f64) -> Self {
        // Five missed polls are a gap, as they are a loss for those who listen.
        let longest_gap = Duration::from_secs_f64((period_s * 5.0).clamp(5.0, 86_400.0));
        Self { record: Mutex::new(SafeRecord::new(longest_gap)) }
    }
}

impl Driver for SafetyMonitor {
    type Kind = safety_monitor::SafetyMonitor;

    fn polled(&self) -> Vec<String> {
        vec!["IsSafe".to_owned()]
    }

    async fn capabilities(&self, _: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        Ok(Capabilities {})
    }

    fn observed(&self, readings: &Readings, now: Now) {
        // No answer is no reading: the next one shows how long the gap was.
        if readings.strict_flag("IsSafe").as_result().is_err_and(NoData::is_silence) {
            return;
        }
        // A reading counts from when it was asked for, however often it is seen.
        let asked = readings.asked("IsSafe").filter(|_| readings.strict_flag("IsSafe").known() == Some(&true));
        let at = asked.unwrap_or(now);
        self.record.lock().unwrap_or_else(PoisonError::into_inner).observe(asked.is_some(), at.machine, at.sky);
    }

    fn fields(&self, readings: &Readings) -> Fields {
        let is_safe = readings.strict_flag("IsSafe");
        let gapless = self.record.lock().unwrap_or_else(PoisonError::into_inner).gapless();
        Fields { is_safe, gapless_safe_s: gapless.as_secs_f64() }
    }

    fn need(&self, command: &Command) -> Need {
        match *command {}
    }

    async fn execute(&self, _: &Alpaca, _: &CommandId, command: &Command, _: &Fields) -> Result<Executed, AlpacaError> {
        match *command {}
    }
}

/// The gapless run of safe readings that ends with the newest one.
#[derive(Debug)]
pub struct SafeRecord {
    longest_gap: Duration,
    run: Option<Run>,
}

#[derive(Debug, Clone, Copy)]
struct Run {
    began: SkyTime,
    newest: SkyTime,
    newest_machine: MachineTime,
}

impl SafeRecord {
    /// An empty record; readings farther apart than `longest_gap` of machine time do not join.
    pub fn new(longest_gap: Duration) -> Self {
        Self { longest_gap, run: None }
    }

    /// Takes a reading; one that is missing counts as not safe.
    pub fn observe(&mut self, safe: bool, machine: MachineTime, sky: SkyTime) {
        let joins = self.run.filter(|run| machine.since(run.newest_machine) <= self.longest_gap);
        let began = joins.map_or(sky, |run| run.began);
        self.run = safe.then_some(Run { began, newest: sky, newest_machine: machine });
    }

    /// Length of the run, sky time; it ends with the newest reading and does not grow without one.
    pub fn gapless(&self) -> Duration {
        self.run.map_or(Duration::ZERO, |run| run.newest.since(run.began))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};
    use units::Utc;

    use super::*;

    fn observe(record: &mut SafeRecord, second: u64, safe: bool) -> u64 {
        // Sky time runs ten times as fast as the machine.
        let machine = MachineTime::from_boot(Duration::from_secs(1000 + second));
        record.observe(safe, machine, SkyTime::from_start(Duration::from_secs(second * 10)));
        record.gapless().as_secs()
    }

    #[test]
    fn safe_readings_add_up_in_sky_time() {
        let mut record = SafeRecord::new(Duration::from_secs(5));
        let lengths: Vec<u64> = (0..4).map(|second| observe(&mut record, second, true)).collect();
        assert_eq!(lengths, [0, 10, 20, 30]);
    }

    #[test]
    fn an_unsafe_reading_or_a_gap_starts_anew() {
        let mut record = SafeRecord::new(Duration::from_secs(5));
        observe(&mut record, 0, true);
        observe(&mut record, 5, true);
        assert_eq!(observe(&mut record, 6, false), 0);
        assert_eq!(observe(&mut record, 7, true), 0);
        assert_eq!(observe(&mut record, 12, true), 50);
        assert_eq!(observe(&mut record, 18, true), 0);
    }

    #[test]
    fn a_server_that_refuses_connections_for_a_moment_does_not_end_the_record() {
        let monitor = SafetyMonitor::new(1.0);
        let at = |second: f64| Now {
            machine: MachineTime::from_boot(Duration::from_secs_f64(second)),
            sky: SkyTime::from_start(Duration::from_secs_f64(second)),
        };
        let mut readings = Readings::default();
        let mut answers = |second, answer: Result<Value, NoData>| {
            readings.keep_asked("IsSafe", answer, Utc::EPOCH, at(second));
            monitor.observed(&readings, at(second));
            monitor.fields(&readings).gapless_safe_s
        };
        let refused = || Err(NoData::new("transport", "connection refused"));
        answers(100.0, Ok(json!(true)));
        assert_eq!(answers(110.0, Ok(json!(true))), 0.0, "a gap of 10 s");
        assert_eq!(answers(113.0, Ok(json!(true))), 3.0);
        answers(114.0, refused());
        assert_eq!(answers(115.0, Ok(json!(true))), 5.0, "refused for a second");
        answers(116.0, refused());
        assert_eq!(answers(121.0, Ok(json!(true))), 0.0, "for six");
        answers(122.0, Err(NoData::new("wrong type", "")));
        assert_eq!(answers(123.0, Ok(json!(true))), 0.0, "an answer that is none");
    }

    #[test]
    fn only_json_true_is_safe() {
        let monitor = SafetyMonitor::new(1.0);
        let sloppy = [json!("True"), json!("true"), json!(1), json!(1.0), json!(null), json!([true]), json!("NaN")];
        let answers = sloppy.into_iter().map(Ok::<Value, NoData>).chain([Err(NoData::never_read())]);
        for answer in answers {
            let mut readings = Readings::default();
            readings.keep("IsSafe", answer.clone(), Utc::EPOCH);
            assert_eq!(monitor.fields(&readings).is_safe.known(), None, "{answer:?}");
        }
        let mut readings = Readings::default();
        readings.keep("IsSafe", Ok(json!(true)), Utc::EPOCH);
        assert_eq!(monitor.fields(&readings).is_safe.known(), Some(&true));
    }
}
