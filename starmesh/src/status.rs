//! `starmesh status`: prints all telescopes on the bus, the activity of each, why it is not safe, and its alerts.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use clap::Args;
use contract::command::operator;
use contract::node::NodeState;
use contract::observatory::{
    Alert, Alerts, NightState, OperatorOrders, Posture, RowState, RowStatus, SafetyState, ScheduleState, Unsafe,
    Verdict,
};
use contract::{Address, Key, NodeTopic, Part, Topic};
use units::Utc;

use crate::console::{foreign_line, line};
use crate::join::Join;

/// So many alerts of a telescope are shown: the most urgent ones.
const MOST_ALERTS: usize = 5;

/// Options of `starmesh status`.
#[derive(Debug, Args)]
pub struct Options {
    /// How long to look for telescopes, s.
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
    #[command(flatten)]
    join: Join,
}

/// The states that one telescope published.
#[derive(Default)]
struct Status {
    night: Option<NightState>,
    /// Sky time of the newest sample.
    at: Option<Utc>,
    safety: Option<SafetyState>,
    schedule: Option<ScheduleState>,
    /// The active alerts, the most urgent first.
    alerts: Vec<Alert>,
    /// Its nodes that answer, of whatever role.
    nodes: BTreeSet<String>,
    /// The operator who has taken it over, if there is one.
    held: Option<String>,
    /// The operator who ordered that it stays closed, if there is such an order.
    stay_closed: Option<String>,
}

/// Asks all observatory nodes and prints the table.
pub async fn run(options: Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.seconds.is_finite(), "--seconds {}: expected 0.5 to 60", options.seconds);
    let bus = options.join.open().await?;
    let until = Instant::now() + Duration::from_secs_f64(options.seconds.clamp(0.5, 60.0));
    let mut telescopes: BTreeMap<Address, Status> = BTreeMap::new();
    // Peers are found one after another: the command asks until the time is up or an answer brings nothing new.
    let mut known = 0;
    while Instant::now() < until {
        ask(&bus, &mut telescopes).await;
        let all_report = telescopes.values().all(|status| status.night.is_some());
        if all_report && !telescopes.is_empty() && telescopes.len() == known {
            break;
        }
        known = telescopes.len();
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    bus.close().await;
    if telescopes.is_empty() {
        anyhow::bail!(
            "no telescope answered on the bus within {} s; is a node running, and is it reachable by multicast or --connect?",
            options.seconds
        );
    }
    line(format_args!(
        "{:28} {:8} {:9} {:8} {:14} {:>6}  NOW",
        "TELESCOPE", "SAFETY", "POSTURE", "MODE", "SKY", "ALERTS"
    ))?;
    for (address, status) in &telescopes {
        for text in status.lines(address) {
            foreign_line(format_args!("{text}"))?;
        }
    }
    Ok(())
}

async fn ask(bus: &bus::Bus, telescopes: &mut BTreeMap<Address, Status>) {
    let timeout = Duration::from_secs(1);
    let part = |part| Topic::Observatory(part).everywhere();
    // A telescope whose observatory node is dead or hangs is the one that must not be absent here.
    let nodes = Topic::Node(NodeTopic::State).everywhere();
    for (key, _) in bus.get_all::<NodeState>(nodes, timeout).await {
        if let Key::Node(address, role, id, _) = &key
            && address.telescope.as_str() != Address::SHARED
        {
            telescopes.entry(address.clone()).or_default().nodes.insert(format!("{}/{id}", role.word()));
        }
    }
    for (key, sample) in bus.get_all::<NightState>(part(Part::Night), timeout).await {
        let status = telescopes.entry(key.address().clone()).or_default();
        status.at = Some(sample.at_utc);
        status.night = Some(sample.body);
    }
    for (key, sample) in bus.get_all::<SafetyState>(part(Part::Safety), timeout).await {
        telescopes.entry(key.address().clone()).or_default().safety = Some(sample.body);
    }
    for (key, sample) in bus.get_all::<ScheduleState>(part(Part::Schedule), timeout).await {
        telescopes.entry(key.address().clone()).or_default().schedule = Some(sample.body);
    }
    for (key, sample) in bus.get_all::<OperatorOrders>(part(Part::OperatorOrders), timeout).await {
        let because = |why: &str| if why.is_empty() { String::new() } else { format!(": {why}") };
        if let Some(closed) = sample.body.stay_closed {
            let (name, why) = (operator(&closed.from), because(&closed.reason));
            let status = telescopes.entry(key.address().clone()).or_default();
            status.stay_closed = Some(format!("{name} ordered at {} that it stays closed{why}", closed.at_utc));
        }
        if let Some(held) = sample.body.control {
            let why = because(&held.reason);
            let status = telescopes.entry(key.address().clone()).or_default();
            status.held = Some(format!("{} has it since {}{why}", operator(&held.from), held.at_utc));
        }
    }
    for (key, sample) in bus.get_all::<Alerts>(part(Part::Alerts), timeout).await {
        if matches!(key, Key::Observatory(..)) {
            telescopes.entry(key.address().clone()).or_default().alerts = sample.body.alerts;
        }
    }
}

impl Status {
    /// The telescope's line of the table, and a line for each reason.
    fn lines(&self, address: &Address) -> Vec<String> {
        let safety = self.safety.as_ref().map_or("-", |safety| match safety.verdict {
            Verdict::Safe => "SAFE",
            Verdict::Unsafe => "UNSAFE",
        });
        let night = self.night.as_ref();
        let posture = night.map_or("-", |night| posture_word(night.posture));
        let mode = night.map_or("-", |night| if night.robotic { "ROBOTIC" } else { "MANUAL" });
        let sky = night.map_or_else(|| "-".to_owned(), sky_word);
        let (alerts, now) = (self.alerts.len(), self.now(address));
        let now = match &self.held {
            Some(held) if now.is_empty() => held.clone(),
            Some(held) => format!("{held}; {now}"),
            None => now,
        };
        let head = format!("{:28} {safety:8} {posture:9} {mode:8} {sky:14} {alerts:>6}  {now}", address.to_string());
        let mut lines = vec![head.trim_end().to_owned()];
        if let Some(safety) = &self.safety {
            let of = |what: &'static str, reasons: &[Unsafe]| {
                reasons.iter().map(|reason| format!("    {what}: {}", reason_words(reason))).collect::<Vec<_>>()
            };
            lines.extend(of("not safe", &safety.reasons));
            lines.extend(of("no exposures", &safety.suspended));
            lines.extend(of("note", &safety.advisories));
            if safety.verdict == Verdict::Unsafe && safety.reasons.len() > 1 {
                let all = match safety.time_to_safe_s {
                    Some(left) => format!("    safe in {} at the earliest", length(left)),
                    None => "    when it will be safe again cannot be known yet".to_owned(),
                };
                lines.push(all);
            }
        }
        lines.extend(self.alerts.iter().take(MOST_ALERTS).map(alert_words));
        if let Some(more) = alerts.checked_sub(MOST_ALERTS).filter(|more| *more > 0) {
            lines.push(format!(
                "    {more} more alerts: starmesh tail '{}'",
                Key::Observatory(address.clone(), Part::Alerts)
            ));
        }
        lines
    }

    /// Its activity, or the reason why it waits.
    fn now(&self, address: &Address) -> String {
        let Some(night) = &self.night else {
            let nodes: Vec<&str> = self.nodes.iter().map(String::as_str).collect();
            return format!("NO OBSERVATORY NODE ANSWERS; of this telescope there answer: {}", nodes.join(", "));
        };
        if !night.actions.is_empty() {
            let actions = night.actions.iter().map(|action| {
                let object = action.object.as_ref().map(|object| format!(" {object}")).unwrap_or_default();
                format!("{}{object}: {}", action.action, action.step)
            });
            return actions.collect::<Vec<_>>().join("; ");
        }
        if let Some(closed) = &self.stay_closed {
            return format!("{closed}: starmesh order {address} open-again");
        }
        if !night.robotic {
            return format!("waits for a person: starmesh order {address} start");
        }
        let Some(schedule) = &self.schedule else { return String::new() };
        let waits = |row: &&RowState| matches!(row.status, RowStatus::Pending | RowStatus::Interrupted);
        let now = self.at;
        let mut rows: Vec<&RowState> = schedule.rows.iter().filter(waits).collect();
        rows.retain(|row| now.is_none_or(|now| row.end_utc > now));
        let open = rows.iter().find(|row| now.is_some_and(|now| row.start_utc <= now));
        let Some(row) = open.or_else(|| rows.iter().min_by_key(|row| row.start_utc)) else {
            return match (&schedule.refused, schedule.rows.is_empty()) {
                (Some(_), true) => "the schedule was refused: see the alerts".to_owned(),
                (None, true) => "waits for a schedule".to_owned(),
                _ => "waits for a new schedule: no row of this one is left".to_owned(),
            };
        };
        let object = row.object.as_ref().map(|object| format!(" {object}")).unwrap_or_default();
        let what = format!("row {}, {}{object}", row.row, row.action);
        match now.filter(|now| row.start_utc > *now) {
            Some(now) => {
                let left = length(row.start_utc.seconds_since(now));
                format!("waits for {what}, which starts at {} (in {left})", clock(row.start_utc))
            }
            None if !row.detail.is_empty() => format!("{what} waits: {}", row.detail),
            None if self.safety.as_ref().is_some_and(|safety| safety.verdict == Verdict::Unsafe) => {
                format!("{what} waits for a safe sky")
            }
            None => format!("about to begin {what}"),
        }
    }
}

/// The event and what a person should do.
fn alert_words(alert: &Alert) -> String {
    let who = alert.acknowledged_by.as_ref().map(|who| format!(" ({who} sees to it)")).unwrap_or_default();
    let gone = if alert.returned_utc.is_some() { " (its cause is gone)" } else { "" };
    format!("    {} {}: {}{gone}{who}; {}", alert.priority.word(), alert.id, alert.cause, alert.action)
}

/// A reason with the time at which it can end.
fn reason_words(reason: &Unsafe) -> String {
    let clears = match reason.clears_in_s {
        Some(left) => format!("; can clear in {}", length(left)),
        None => "; when it clears cannot be known".to_owned(),
    };
    format!("{}: {}{clears}", reason.input, reason.why)
}

/// Whether the sky is simulated, and how fast it turns.
fn sky_word(night: &NightState) -> String {
    match (night.simulated, night.speed) {
        (false, _) => "real".to_owned(),
        (true, 1.0) => "simulated".to_owned(),
        (true, speed) => format!("simulated x{speed:.0}"),
    }
}

fn clock(at: Utc) -> String {
    at.strftime("%m-%d %H:%M:%S UTC")
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

/// The word of operators for a posture.
pub fn posture_word(posture: Posture) -> &'static str {
    match posture {
        Posture::Closed => "CLOSED",
        Posture::Opening => "OPENING",
        Posture::Open => "OPEN",
        Posture::Closing => "CLOSING",
        Posture::Unknown => "UNKNOWN",
    }
}

#[cfg(test)]
mod tests {
    use contract::observatory::AlertKind;

    use super::*;

    fn shown(night: &str, safety: &str, rows: &str) -> Status {
        Status {
            night: Some(serde_json::from_str(night).unwrap()),
            at: Some("2026-11-21T02:00:00Z".parse().unwrap()),
            safety: Some(serde_json::from_str(safety).unwrap()),
            schedule: Some(
                serde_json::from_str(&format!(r#"{{"file": "s", "revision": 1, "rows": [{rows}]}}"#)).unwrap(),
            ),
            alerts: vec![AlertKind::DomeNotClosed.alert("dome", Utc::from_seconds(1.0), "it says open")],
            nodes: BTreeSet::new(),
            held: None,
            stay_closed: None,
        }
    }

    const UNSAFE: &str = r#"{"verdict": "unsafe", "since_utc": "2026-11-21T01:00:00Z", "inputs": [], "reasons": [
        {"input": "wx/Humidity", "why": "91 is above 80"},
        {"input": "wx/WindSpeed", "why": "good for 3.0 of 15.0 min", "clears_in_s": 720}]}"#;
    const SAFE: &str = r#"{"verdict": "safe", "since_utc": "2026-11-21T01:00:00Z", "inputs": [], "reasons": []}"#;
    const ROW: &str = r#"{"row": 2, "action": "object", "camera": "main", "object": "M42", "start_utc": "START",
        "end_utc": "2026-11-21T05:00:00Z", "status": "pending", "frames": 0}"#;

    fn night(robotic: bool) -> String {
        format!(
            r#"{{"robotic": {robotic}, "posture": "closed", "actions": [], "frames": 0, "open_s": 0, "speed": 60,
                "simulated": true, "ended": false}}"#
        )
    }

    #[test]
    fn every_reason_stands_there_with_the_time_at_which_it_can_clear() {
        let address = Address::new("paranal", "io").unwrap();
        let lines = shown(&night(true), UNSAFE, &ROW.replace("START", "2026-11-21T01:00:00Z")).lines(&address);
        assert!(lines[0].contains("UNSAFE") && lines[0].contains("ROBOTIC  simulated x60"), "{lines:#?}");
        assert!(lines[0].ends_with("row 2, object M42 waits for a safe sky"), "{lines:#?}");
        assert_eq!(lines[1], "    not safe: wx/Humidity: 91 is above 80; when it clears cannot be known");
        assert_eq!(lines[2], "    not safe: wx/WindSpeed: good for 3.0 of 15.0 min; can clear in 12 min");
        assert_eq!(lines[3], "    when it will be safe again cannot be known yet");
        assert!(lines[4].starts_with("    CRITICAL dome-not-closed/dome: it says open; "), "{lines:#?}");
        let six =
            Status { alerts: vec![shown(&night(true), SAFE, "").alerts.remove(0); 7], ..shown(&night(true), SAFE, "") };
        let last = six.lines(&address).pop().unwrap();
        let alerts = Key::Observatory(address, Part::Alerts);
        assert_eq!(last, format!("    2 more alerts: starmesh tail '{alerts}'"));
    }

    #[test]
    fn a_telescope_whose_observatory_node_is_silent_is_not_left_out() {
        let nodes = ["device/main", "archive/main"].map(str::to_owned).into();
        let lines = Status { nodes, ..Status::default() }.lines(&Address::new("paranal", "europa").unwrap());
        assert!(lines[0].starts_with("paranal/europa               -        -"), "{lines:#?}");
        assert!(
            lines[0]
                .ends_with("NO OBSERVATORY NODE ANSWERS; of this telescope there answer: archive/main, device/main")
        );
    }

    #[test]
    fn between_rows_it_prints_what_is_waited_for() {
        let address = Address::new("paranal", "io").unwrap();
        let later = ROW.replace("START", "2026-11-21T02:30:00Z");
        let now = |night: &str, safety: &str, rows: &str| shown(night, safety, rows).now(&address);
        assert_eq!(
            now(&night(true), SAFE, &later),
            "waits for row 2, object M42, which starts at 11-21 02:30:00 UTC (in 30 min)"
        );
        assert_eq!(now(&night(false), SAFE, &later), "waits for a person: starmesh order paranal/io start");
        let closed = Status { stay_closed: Some("ana ordered it".to_owned()), ..shown(&night(false), UNSAFE, &later) };
        assert_eq!(closed.now(&address), "ana ordered it: starmesh order paranal/io open-again");
        assert_eq!(now(&night(true), SAFE, ""), "waits for a schedule");
        let done = later.replace("pending", "finished");
        assert_eq!(now(&night(true), SAFE, &done), "waits for a new schedule: no row of this one is left");
        let rests = ROW
            .replace("START", "2026-11-21T01:00:00Z")
            .replace("\"frames\": 0", "\"frames\": 0, \"detail\": \"rests\"");
        assert_eq!(now(&night(true), SAFE, &rests), "row 2, object M42 waits: rests");
    }
}
