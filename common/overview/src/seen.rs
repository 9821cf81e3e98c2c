//! What a telescope does now, or the present reason why it does nothing.

use contract::Address;
use contract::command::operator;
use contract::observatory::{
    Alert, AlertKind, NightState, OperatorOrders, Ordered, RowState, RowStatus, SafetyState, ScheduleState, Verdict,
};
use units::Utc;

/// What is received of one telescope. What is too old to count is `None`.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    /// Which telescope.
    pub address: &'a Address,
    /// Sky time now; of a telescope that publishes, that of its newest sample.
    pub now: Option<Utc>,
    /// Its night; `None` while its observatory node is silent.
    pub night: Option<&'a NightState>,
    /// Its verdict.
    pub safety: Option<&'a SafetyState>,
    /// Its schedule.
    pub schedule: Option<&'a ScheduleState>,
    /// What people ordered.
    pub orders: Option<&'a OperatorOrders>,
    /// Its alerts.
    pub alerts: &'a [Alert],
    /// Since when its observatory node is silent, where somebody knows.
    pub silent_since: Option<Utc>,
}

/// That the observatory node is silent, and what follows for safety.
pub fn silent(since: Option<Utc>) -> String {
    let since = since.map(|since| format!(" since {}", since.time_of_day())).unwrap_or_default();
    format!("the observatory node is silent{since}, so safety is unknown")
}

/// A length of sky time in words.
pub fn length(span_s: f64) -> String {
    match span_s.max(0.0) {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} days", s / 86_400.0),
    }
}

impl Seen<'_> {
    /// One text for the command line and the page.
    pub fn now(&self) -> String {
        let Some(night) = self.night else { return silent(self.silent_since) };
        let cause = self.cause(night);
        match self.orders.and_then(|orders| orders.control.as_ref()) {
            Some(held) if cause.is_empty() => self.held(held),
            Some(held) => format!("{}; {cause}", self.held(held)),
            None => cause,
        }
    }

    fn held(&self, held: &Ordered) -> String {
        format!("{} has it since {}{}", operator(&held.from), held.at_utc.to_second(), because(&held.reason))
    }

    /// What an order that loosens needs from anybody but the person who has the telescope.
    fn reason_to_take_over(&self) -> &'static str {
        let is_held = self.orders.is_some_and(|orders| orders.control.is_some());
        if is_held { " --reason \"...\"" } else { "" }
    }

    fn cause(&self, night: &NightState) -> String {
        let address = self.address;
        if !night.actions.is_empty() {
            let actions = night.actions.iter().map(|action| {
                let object = action.object.as_ref().map(|object| format!(" {object}")).unwrap_or_default();
                format!("{}{object}: {}", action.action, action.step)
            });
            return actions.collect::<Vec<_>>().join("; ");
        }
        let no_lease = AlertKind::NoLease.id("");
        let stands = |alert: &&Alert| alert.id == no_lease && alert.returned_utc.is_none();
        if let Some(alert) = self.alerts.iter().find(stands) {
            return format!("nobody commands it, so nothing opens or moves: {}", alert.cause);
        }
        if let Some(closed) = self.orders.and_then(|orders| orders.stay_closed.as_ref()) {
            let (name, at, why) = (operator(&closed.from), closed.at_utc.to_second(), because(&closed.reason));
            let reason = self.reason_to_take_over();
            return format!(
                "{name} ordered at {at} that it stays closed{why}: starmesh order {address} open-again{reason}"
            );
        }
        if !night.robotic {
            return format!("waits for a person: starmesh order {address} start{}", self.reason_to_take_over());
        }
        if night.ended {
            return "the night is over".to_owned();
        }
        let Some(schedule) = self.schedule else { return "waits for a schedule".to_owned() };
        let waits = |row: &&RowState| matches!(row.status, RowStatus::Pending | RowStatus::Interrupted);
        let mut rows: Vec<&RowState> = schedule.rows.iter().filter(waits).collect();
        rows.retain(|row| self.now.is_none_or(|now| row.end_utc > now));
        let open = rows.iter().find(|row| self.now.is_some_and(|now| row.start_utc <= now));
        let Some(row) = open.or_else(|| rows.iter().min_by_key(|row| row.start_utc)) else {
            return match (&schedule.refused, schedule.rows.is_empty()) {
                (Some(_), true) => "the schedule was refused: see the alerts".to_owned(),
                (None, true) => "waits for a schedule".to_owned(),
                _ => "waits for a new schedule: no row of this one is left".to_owned(),
            };
        };
        self.waiting(row)
    }

    /// Why a row that is next does not run.
    fn waiting(&self, row: &RowState) -> String {
        let object = row.object.as_ref().map(|object| format!(" {object}")).unwrap_or_default();
        let what = format!("row {}, {}{object}", RowState::told(row.row), row.action);
        if let Some(now) = self.now.filter(|now| row.start_utc > *now) {
            let left = length(row.start_utc.seconds_since(now));
            return format!("waits for {what}, which starts at {} (in {left})", row.start_utc.to_second());
        }
        if let Some(detail) = row.own_detail() {
            return format!("{what} waits: {detail}");
        }
        let unsafe_now = self.safety.filter(|safety| safety.verdict == Verdict::Unsafe);
        if let Some(safety) = unsafe_now {
            let first = safety.reasons.first().map(|reason| format!(": {}: {}", reason.input, reason.why));
            return format!("{what} waits for a safe sky{}", first.unwrap_or_default());
        }
        match self.safety.and_then(|safety| safety.suspended.first()) {
            Some(reason) => format!("{what} waits until the sky may be exposed: {}: {}", reason.input, reason.why),
            None => format!("about to begin {what}"),
        }
    }
}

fn because(why: &str) -> String {
    if why.is_empty() { String::new() } else { format!(" ({why})") }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

    use serde_json::{Value, json};

    use super::*;

    fn night(robotic: bool) -> Value {
        json!({"robotic": robotic, "posture": "closed", "actions": [], "frames": 0, "open_s": 0.0, "speed": 60.0, "simulated": true,
               "ended": false})
    }

    fn verdict(word: &str, reasons: Value, suspended: Value) -> Value {
        json!({"verdict": word, "since_utc": "2026-11-21T01:00:00Z", "inputs": [], "reasons": reasons, "suspended": suspended})
    }

    fn row(start: &str, status: &str, detail: &str) -> Value {
        json!({"row": 2, "action": "object", "camera": "main", "object": "M42", "start_utc": start,
               "end_utc": "2026-11-21T05:00:00Z", "status": status, "frames": 0, "detail": detail})
    }

    /// The text at 02:00 of a telescope that publishes and has no alerts.
    fn now(night: Value, safety: Value, rows: &[Value], orders: Value) -> String {
        now_with(&[], night, safety, rows, orders)
    }

    fn now_with(alerts: &[Alert], night: Value, safety: Value, rows: &[Value], orders: Value) -> String {
        let schedule = json!({"file": "s", "revision": 1, "rows": rows});
        let (night, safety) = (serde_json::from_value(night).unwrap(), serde_json::from_value(safety).unwrap());
        let (schedule, orders) = (serde_json::from_value(schedule).unwrap(), serde_json::from_value(orders).unwrap());
        let seen = Seen {
            address: &Address::new("paranal", "io").unwrap(),
            now: Some("2026-11-21T02:00:00Z".parse().unwrap()),
            night: Some(&night),
            safety: Some(&safety),
            schedule: Some(&schedule),
            orders: Some(&orders),
            alerts,
            silent_since: None,
        };
        seen.now()
    }

    const LATER: &str = "2026-11-21T02:30:00Z";
    const BEFORE: &str = "2026-11-21T01:00:00Z";

    #[test]
    fn between_rows_the_present_cause_is_given_and_no_other() {
        let nobody = || json!({"overrides": [], "shelved": []});
        let safe = || verdict("safe", json!([]), json!([]));
        let rain = json!([{"input": "wx/RainRate", "why": "2 is above 0"}]);
        let humid = json!([{"input": "wx/Humidity", "why": "80 is above 75"}]);
        let due = [row(BEFORE, "pending", "")];
        for (text, night, safety, rows) in [
            (
                "waits for row 3, object M42, which starts at 2026-11-21 02:30:00 UTC (in 30 min)",
                night(true),
                safe(),
                vec![row(LATER, "pending", "")],
            ),
            ("waits for a person: starmesh order paranal/io start", night(false), safe(), due.to_vec()),
            (
                "row 3, object M42 waits for a safe sky: wx/RainRate: 2 is above 0",
                night(true),
                verdict("unsafe", rain, json!([])),
                due.to_vec(),
            ),
            (
                "row 3, object M42 waits until the sky may be exposed: wx/Humidity: 80 is above 75",
                night(true),
                verdict("safe", json!([]), humid.clone()),
                due.to_vec(),
            ),
            ("about to begin row 3, object M42", night(true), safe(), due.to_vec()),
            (
                "row 3, object M42 waits: tried again at 02:10:00",
                night(true),
                safe(),
                vec![row(BEFORE, "interrupted", "tried again at 02:10:00")],
            ),
            // It rained; now it is humid, and then nothing stands against the row any more.
            (
                "row 3, object M42 waits until the sky may be exposed: wx/Humidity: 80 is above 75",
                night(true),
                verdict("safe", json!([]), humid),
                vec![row(BEFORE, "interrupted", "not safe: wx/RainRate: 2 is above 0")],
            ),
            (
                "about to begin row 3, object M42",
                night(true),
                safe(),
                vec![row(BEFORE, "interrupted", "not safe: wx/RainRate: 2 is above 0")],
            ),
            ("waits for a schedule", night(true), safe(), vec![]),
            (
                "waits for a new schedule: no row of this one is left",
                night(true),
                safe(),
                vec![row(BEFORE, "finished", "")],
            ),
        ] {
            assert_eq!(now(night, safety, &rows, nobody()), text);
        }
        let mut over = night(true);
        over["ended"] = json!(true);
        assert_eq!(now(over, safe(), &due, nobody()), "the night is over");
    }

    #[test]
    fn orders_of_people_are_named_with_their_times_to_the_second() {
        let ordered =
            |why: &str| json!({"from": "web/ana@1.2.3.4", "reason": why, "at_utc": "2026-11-21T01:59:58.123456Z"});
        let orders =
            json!({"stay_closed": ordered("wet snow"), "control": ordered(""), "overrides": [], "shelved": []});
        assert_eq!(
            now(night(false), verdict("safe", json!([]), json!([])), &[], orders),
            "ana has it since 2026-11-21 01:59:58 UTC; ana ordered at 2026-11-21 01:59:58 UTC that it stays closed (wet snow): \
             starmesh order paranal/io open-again --reason \"...\""
        );
    }

    #[test]
    fn a_telescope_that_nobody_commands_says_why_and_not_that_it_waits_for_a_schedule() {
        let safe = verdict("safe", json!([]), json!([]));
        let orders = json!({"overrides": [], "shelved": []});
        let cause = "dome/dome_1 grants no lease: /data/tokens.json: No space left on device";
        let mut alert = AlertKind::NoLease.alert("", Utc::EPOCH, cause);
        let told =
            |alert: &Alert| now_with(std::slice::from_ref(alert), night(true), safe.clone(), &[], orders.clone());
        assert_eq!(told(&alert), format!("nobody commands it, so nothing opens or moves: {cause}"));
        alert.returned_utc = Some(Utc::EPOCH);
        assert_eq!(told(&alert), "waits for a schedule");
    }

    #[test]
    fn of_a_silent_observatory_node_nothing_old_is_repeated() {
        let address = Address::new("paranal", "io").unwrap();
        let since = Some("2026-11-21T03:12:45.9Z".parse().unwrap());
        let (night, safety, schedule, orders) = (None, None, None, None);
        let silent_since = since;
        let seen = Seen { address: &address, now: since, night, safety, schedule, orders, alerts: &[], silent_since };
        assert_eq!(seen.now(), "the observatory node is silent since 03:12:45 UTC, so safety is unknown");
        let unknown = Seen { silent_since: None, ..seen };
        assert_eq!(unknown.now(), "the observatory node is silent, so safety is unknown");
    }
}
