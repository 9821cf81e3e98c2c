//! `starmesh status`: prints all telescopes on the bus, the activity of each, why it is not safe, and its alerts.

mod shared;
mod words;

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use bus::{Bus, Catch, Subscriber};
use clap::Args;
use contract::device::dome::{self, Shutter};
use contract::node::NodeState;
use contract::observatory::{
    Alert, Alerts, NightState, OperatorOrders, Posture, SafetyState, ScheduleState, Standing, Unsafe, Verdict, merge,
};
use contract::{Address, Device, DeviceState, Key, Kind, NodeTopic, Part, Role, Stamped, Topic};
use overview::{DomeView, PublishedGuard, Seen, length};
use units::Utc;

use self::words::{alert_lines, reason_words, sky_word};
use crate::console::{foreign_line, line};
use crate::join::Join;

/// Options of `starmesh status`.
#[derive(Debug, Args)]
pub struct Options {
    /// How long to look for telescopes, s.
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
    #[command(flatten)]
    join: Join,
}

/// An observatory node publishes its night and its verdict each second; what it has held for longer says that it hangs.
const STALE_S: f64 = 5.0;

/// The states that one telescope published.
#[derive(Default)]
struct Status {
    night: Option<NightState>,
    /// Sky time of the newest sample.
    at: Option<Utc>,
    safety: Option<SafetyState>,
    schedule: Option<ScheduleState>,
    orders: Option<OperatorOrders>,
    /// The alerts that its observatory node merges; none until that has published them, as just after its start.
    merged: Option<Vec<Alert>>,
    /// The alerts of each of its nodes.
    own: Vec<Alert>,
    /// Its nodes that answer, of whatever role.
    nodes: BTreeSet<(Role, String)>,
    /// When its observatory node last published, where that hangs.
    stale_utc: Option<Utc>,
    /// Sky seconds per machine second.
    speed: Option<f64>,
}

/// The states that the whole bus published.
#[derive(Default)]
struct Found {
    telescopes: BTreeMap<Address, Status>,
    /// The shutter of each dome, where its device node reads it.
    domes: BTreeMap<Device, Option<Shutter>>,
    /// The newest sample of each guard; guards answer no question.
    guards: BTreeMap<Device, Stamped<dome::Guard>>,
    /// What sites share, each in words.
    sensors: BTreeMap<Device, String>,
}

/// Asks all nodes and prints the table.
pub async fn run(options: Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.seconds.is_finite(), "--seconds {}: expected 0.5 to 60", options.seconds);
    let bus = options.join.open().await?;
    let guards = bus.subscribe::<dome::Guard>(Topic::Guard.everywhere(), Catch::Newest, 256).await?;
    let until = Instant::now() + Duration::from_secs_f64(options.seconds.clamp(0.5, 60.0));
    let mut found = Found::default();
    // Peers are found one after another: the command asks until the time is up or an answer brings nothing new.
    let mut known = 0;
    while Instant::now() < until {
        found.ask(&bus).await;
        if found.telescopes.len() == known && found.all_report() {
            break;
        }
        known = found.telescopes.len();
        found.listen(&guards, Duration::from_millis(300)).await;
    }
    bus.close().await;
    found.add_telescopes_of_guards();
    if found.telescopes.is_empty() {
        anyhow::bail!("no telescope answered within {} s; {}", options.seconds, options.join.tried());
    }
    line(format_args!(
        "{:28} {:8} {:9} {:8} {:14} {:>6}  NOW",
        "TELESCOPE", "SAFETY", "POSTURE", "MODE", "SKY", "ALERTS"
    ))?;
    for (address, status) in &found.telescopes {
        let lines = match is_shared(address) {
            true => shared::lines(address, status, &found.sensors),
            false => status.lines(address, &found.domes_over(address), &found.of_shared(address)),
        };
        for text in lines {
            foreign_line(format_args!("{text}"))?;
        }
    }
    Ok(())
}

impl Found {
    fn at(&mut self, key: &Key) -> &mut Status {
        self.telescopes.entry(key.address().clone()).or_default()
    }

    /// Is there a telescope, and has every one an observatory node that publishes, also its alerts?
    fn all_report(&self) -> bool {
        let telescopes = self.telescopes.iter().filter(|(address, _)| !is_shared(address));
        let reports: Vec<bool> =
            telescopes.map(|(_, status)| status.night.is_some() && status.merged.is_some()).collect();
        !reports.is_empty() && !reports.contains(&false)
    }

    /// Asks for all states at once: a node that hangs costs the time of one question.
    async fn ask(&mut self, bus: &Bus) {
        let timeout = Duration::from_secs(1);
        let part = |part| Topic::Observatory(part).everywhere();
        let (nodes, own, domes) = (
            Topic::Node(NodeTopic::State).everywhere(),
            Topic::Node(NodeTopic::Alerts).everywhere(),
            Topic::State.everywhere().of_kind(Kind::Dome),
        );
        let (nodes, own, domes, nights, verdicts, schedules, orders, alerts, sensors) = tokio::join!(
            bus.get_all::<NodeState>(nodes, timeout),
            bus.get_all::<Alerts>(own, timeout),
            bus.get_all::<DeviceState<dome::Fields>>(domes, timeout),
            bus.get_all::<NightState>(part(Part::Night), timeout),
            bus.get_all::<SafetyState>(part(Part::Safety), timeout),
            bus.get_all::<ScheduleState>(part(Part::Schedule), timeout),
            bus.get_all::<OperatorOrders>(part(Part::OperatorOrders), timeout),
            bus.get_all::<Alerts>(part(Part::Alerts), timeout),
            shared::sensors(bus, timeout),
        );
        self.sensors.extend(sensors);
        for (key, sample) in nodes {
            let Key::Node(_, role, id, _) = &key else { continue };
            let node = (*role, id.to_string());
            let status = self.at(&key);
            status.nodes.insert(node);
            status.speed = Some(sample.body.speed);
        }
        self.telescopes.values_mut().for_each(|status| status.own.clear());
        for (key, sample) in own {
            self.at(&key).own.extend(sample.body.alerts);
        }
        for (key, sample) in domes {
            let Key::State(dome) = key else { continue };
            self.domes.insert(dome, ::orders::domes::shutter(&sample.body, sample.held_s));
        }
        for (key, sample) in nights {
            let (status, is_stale) = (self.at(&key), sample.held_s.unwrap_or(0.0) > STALE_S);
            status.stale_utc = is_stale.then_some(sample.at_utc);
            (status.at, status.night) = (Some(sample.at_utc), Some(sample.body).filter(|_| !is_stale));
        }
        for (key, sample) in verdicts {
            let is_stale = sample.held_s.unwrap_or(0.0) > STALE_S;
            self.at(&key).safety = Some(sample.body).filter(|_| !is_stale);
        }
        for (key, sample) in schedules {
            self.at(&key).schedule = Some(sample.body);
        }
        for (key, sample) in orders {
            self.at(&key).orders = Some(sample.body);
        }
        for (key, sample) in alerts {
            self.at(&key).merged = Some(sample.body.alerts);
        }
        // A telescope of which only the dome answers is not left out.
        let addresses: Vec<Address> = self.domes.keys().map(|dome| dome.address.clone()).collect();
        for address in addresses {
            self.telescopes.entry(address).or_default();
        }
    }

    /// Takes what guards publish for so long.
    async fn listen(&mut self, guards: &Subscriber<dome::Guard>, time: Duration) {
        let listening = async {
            loop {
                let received = guards.recv().await;
                if let Key::Guard(dome) = received.key {
                    self.guards.insert(dome, received.sample);
                }
            }
        };
        // It ends by the time alone.
        let _: Result<(), _> = tokio::time::timeout(time, listening).await;
    }

    /// A telescope of which only the guard of a dome knows is not left out.
    fn add_telescopes_of_guards(&mut self) {
        for (dome, sample) in &self.guards {
            let permits = sample.body.permits.iter().map(|permit| permit.telescope.as_str());
            let granted = sample.body.granted.iter().map(|granted| granted.telescope.as_str());
            let named = permits.chain(granted).filter_map(|name| Address::new(dome.address.site.as_str(), name).ok());
            for address in named {
                self.telescopes.entry(address).or_default();
            }
        }
    }

    /// The domes over a telescope.
    fn domes_over(&self, address: &Address) -> Vec<DomeView> {
        let domes: BTreeSet<&Device> = self.domes.keys().chain(self.guards.keys()).collect();
        let views = domes.into_iter().map(|dome| {
            let speed = self.telescopes.get(&dome.address).and_then(|status| status.speed).unwrap_or(1.0);
            let guard = self.guards.get(dome);
            DomeView {
                dome: dome.clone(),
                shutter: self.domes.get(dome).copied().flatten(),
                guard: guard.map(|sample| PublishedGuard { guard: sample.body.clone(), at_utc: sample.at_utc, speed }),
            }
        });
        views.filter(|view| view.is_over(address)).collect()
    }

    /// The alerts of the nodes that the telescopes of a site share.
    fn of_shared(&self, address: &Address) -> Vec<Alert> {
        self.telescopes.get(&address.shared()).map(|status| status.own.clone()).unwrap_or_default()
    }
}

fn is_shared(address: &Address) -> bool {
    address.telescope.as_str() == Address::SHARED
}

impl Status {
    /// The telescope's line of the table, and a line for each reason.
    fn lines(&self, address: &Address, domes: &[DomeView], of_shared: &[Alert]) -> Vec<String> {
        let safety = self.safety.as_ref().map_or("UNKNOWN", |safety| match safety.verdict {
            Verdict::Safe => "SAFE",
            Verdict::Unsafe => "UNSAFE",
        });
        let night = self.night.as_ref();
        let posture = night.map(|night| night.posture);
        let posture = posture.or_else(|| Posture::least_closed(domes.iter().map(DomeView::posture)));
        let posture = posture.unwrap_or(Posture::Unknown).word().to_uppercase();
        let mode = night.map_or("-", |night| if night.robotic { "ROBOTIC" } else { "MANUAL" });
        let sky = night.map_or_else(|| "-".to_owned(), sky_word);
        let alerts = self.alerts(domes, of_shared);
        // As on the page: what somebody sees to, has shelved, or is over, needs nobody else.
        let count = match alerts.iter().filter(|alert| alert.standing() == Standing::Active).count() {
            0 if self.merged.is_none() => "?".to_owned(),
            count => count.to_string(),
        };
        let now = self.now(address, domes, &alerts);
        let head = format!("{:28} {safety:8} {posture:9} {mode:8} {sky:14} {count:>6}  {now}", address.to_string());
        let mut lines = vec![head.trim_end().to_owned()];
        if night.is_none() {
            lines.extend(domes.iter().map(|dome| format!("    {}", dome.words())));
            lines.push(format!("    nodes of this telescope that answer: {}", self.node_names()));
        }
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
        lines.extend(self.counted(&alerts));
        lines.extend(alert_lines(&alerts, Key::Observatory(address.clone(), Part::Alerts)));
        lines
    }

    /// The list of the observatory node, which has what people did about each; where that node is silent or has published
    /// none yet, those of the nodes themselves, and of a dome that the site shares.
    fn alerts(&self, domes: &[DomeView], of_shared: &[Alert]) -> Vec<Alert> {
        let mut alerts = match &self.merged {
            Some(merged) if self.night.is_some() => merged.clone(),
            merged => {
                let is_about =
                    |alert: &&Alert, dome: &DomeView| alert.id.split('/').any(|part| part == dome.dome.name.as_str());
                let shared = of_shared.iter().filter(|alert| domes.iter().any(|dome| is_about(alert, dome)));
                let all = merged.iter().flatten().chain(&self.own).chain(shared).cloned().collect();
                merge(std::iter::once(Alerts { alerts: all, ..Alerts::default() })).alerts
            }
        };
        Alert::sort_for_people(&mut alerts);
        alerts
    }

    /// How many alerts there are of each standing, and whether there may be more; nothing where there are none.
    fn counted(&self, alerts: &[Alert]) -> Option<String> {
        let words = [
            (Standing::Active, "active"),
            (Standing::SeenTo, "seen to or shelved"),
            (Standing::Gone, "whose cause is gone"),
        ];
        let count = |(standing, words): (Standing, &str)| {
            let count = alerts.iter().filter(|alert| alert.standing() == standing).count();
            (count > 0).then(|| format!("{count} {words}"))
        };
        let counts: Vec<String> = words.into_iter().filter_map(count).collect();
        let counts = Some(counts.join(", ")).filter(|counts| !counts.is_empty());
        let is_coming = self.night.is_some() || self.nodes.iter().any(|(role, _)| *role == Role::Observatory);
        let unknown = match (&self.merged, is_coming) {
            (Some(_), _) => None,
            (None, true) => Some("those of the observatory node are not known yet".to_owned()),
            (None, false) => Some("those of the observatory node are not known".to_owned()),
        };
        let all: Vec<String> = counts.into_iter().chain(unknown).collect();
        (!all.is_empty()).then(|| format!("    alerts: {}", all.join("; ")))
    }

    fn node_names(&self) -> String {
        let nodes: Vec<String> = self.nodes.iter().map(|(role, id)| contract::node::name(*role, id)).collect();
        if nodes.is_empty() { "none".to_owned() } else { nodes.join(", ") }
    }

    /// Its activity, or the present reason why it waits.
    fn now(&self, address: &Address, domes: &[DomeView], alerts: &[Alert]) -> String {
        let renewed = domes.iter().filter_map(|dome| dome.renewed(address)).max();
        let seen = Seen {
            address,
            now: self.at,
            night: self.night.as_ref(),
            safety: self.safety.as_ref(),
            schedule: self.schedule.as_ref(),
            orders: self.orders.as_ref(),
            alerts,
            silent_since: self.stale_utc.or(renewed),
        };
        seen.now()
    }
}

#[cfg(test)]
mod tests {
    use contract::device::dome::GuardAction;
    use contract::observatory::AlertKind;

    use super::*;

    fn not_closed(dome: &str) -> Alert {
        AlertKind::DomeNotClosed.alert(dome, Utc::from_seconds(1.0), "it says open")
    }

    fn shown(night: &str, safety: &str, rows: &str) -> Status {
        Status {
            night: Some(serde_json::from_str(night).unwrap()),
            at: Some("2026-11-21T02:00:00Z".parse().unwrap()),
            safety: Some(serde_json::from_str(safety).unwrap()),
            schedule: Some(
                serde_json::from_str(&format!(r#"{{"file": "s", "revision": 1, "rows": [{rows}]}}"#)).unwrap(),
            ),
            merged: Some(vec![not_closed("dome")]),
            ..Status::default()
        }
    }

    const UNSAFE: &str = r#"{"verdict": "unsafe", "since_utc": "2026-11-21T01:00:00Z", "inputs": [], "reasons": [
        {"input": "wx/Humidity", "why": "91 is above 80"},
        {"input": "wx/WindSpeed", "why": "good for 3.0 of 15.0 min", "clears_in_s": 720}]}"#;
    const SAFE: &str = r#"{"verdict": "safe", "since_utc": "2026-11-21T01:00:00Z", "inputs": [], "reasons": []}"#;
    const ROW: &str = r#"{"row": 2, "action": "object", "camera": "main", "object": "M42", "start_utc": "2026-11-21T01:00:00Z",
        "end_utc": "2026-11-21T05:00:00Z", "status": "pending", "frames": 0}"#;
    const NIGHT: &str = r#"{"robotic": true, "posture": "closed", "actions": [], "frames": 0, "open_s": 0, "speed": 60,
        "simulated": true, "ended": false}"#;

    #[test]
    fn every_reason_stands_there_with_the_time_at_which_it_can_clear() {
        let address = Address::new("paranal", "io").unwrap();
        let lines = shown(NIGHT, UNSAFE, ROW).lines(&address, &[], &[]);
        assert!(lines[0].contains("UNSAFE   CLOSED    ROBOTIC  simulated x60"), "{lines:#?}");
        assert!(
            lines[0].ends_with("row 3, object M42 waits for a safe sky: wx/Humidity: 91 is above 80"),
            "{lines:#?}"
        );
        assert_eq!(lines[1], "    not safe: wx/Humidity: 91 is above 80; when it clears cannot be known");
        assert_eq!(lines[2], "    not safe: wx/WindSpeed: good for 3.0 of 15.0 min; can clear in 12 min");
        assert_eq!(lines[3], "    when it will be safe again cannot be known yet");
        assert_eq!(lines[4], "    alerts: 1 active");
        assert!(lines[5].starts_with("    critical dome-not-closed/dome: it says open; "), "{lines:#?}");
        let seven = Status { merged: Some(vec![not_closed("dome"); 7]), ..shown(NIGHT, SAFE, "") };
        let last = seven.lines(&address, &[], &[]).pop().unwrap();
        let alerts = Key::Observatory(address, Part::Alerts);
        assert_eq!(last, format!("    2 more alerts: starmesh tail '{alerts}'"));
    }

    #[test]
    fn a_telescope_whose_observatory_node_is_silent_is_seen_by_what_its_other_nodes_know() {
        let europa = Address::new("paranal", "europa").unwrap();
        let sample = include_str!("../../common/contract/golden/v1/dome.guard.json");
        let mut guard: dome::Guard = serde_json::from_str(&sample.replace("callisto", "europa")).unwrap();
        (guard.permits[0].left_s, guard.may_be_open, guard.action) = (-24.0, false, GuardAction::Closing);
        let at_utc = "2026-11-21T03:12:45Z".parse().unwrap();
        let guard = Some(PublishedGuard { guard, at_utc, speed: 1.0 });
        let dome = europa.shared().device(Kind::Dome, &"roof".parse().unwrap());
        let domes = [DomeView { dome, shutter: Some(Shutter::Error), guard }];
        let at = |second| Utc::from_seconds(second);
        let status = Status {
            nodes: [(Role::Device, "main".to_owned()), (Role::Archive, "main".to_owned())].into(),
            own: vec![AlertKind::CoolingFailed.alert("cam", at(2.0), "warm")],
            ..Status::default()
        };
        let shared = [
            AlertKind::DomeNotClosed.alert("roof", at(1.0), "it is half open"),
            AlertKind::DomeNotClosed.alert("another", at(1.0), "of other telescopes"),
        ];
        let lines = status.lines(&europa, &domes, &shared);
        assert!(lines[0].starts_with("paranal/europa               UNKNOWN  UNKNOWN   -        -"), "{lines:#?}");
        assert!(
            lines[0].contains("     2  the observatory node is silent since 03:12:11 UTC, so safety is unknown"),
            "{lines:#?}"
        );
        assert!(
            lines[1].starts_with("    dome roof: shutter in error, it may be half open, not verified closed"),
            "{lines:#?}"
        );
        assert!(
            lines[1].contains("its guard closes it now") && lines[1].contains("its own watchdog (120 s)"),
            "{lines:#?}"
        );
        assert_eq!(lines[2], "    nodes of this telescope that answer: device/main, archive/main");
        assert_eq!(lines[3], "    alerts: 2 active; those of the observatory node are not known");
        assert!(lines[4].contains("dome-not-closed/roof") && lines[5].contains("cooling-failed/cam"), "{lines:#?}");
    }

    #[test]
    fn alerts_whose_cause_is_gone_are_counted_apart_and_displace_no_active_one() {
        let address = Address::new("paranal", "io").unwrap();
        let gone = |dome| Alert { returned_utc: Some(Utc::from_seconds(2.0)), ..not_closed(dome) };
        let mut alerts: Vec<Alert> = ["a", "b", "c", "d", "e"].map(gone).into();
        let warm = |camera: &str| AlertKind::CoolingFailed.alert(camera, Utc::from_seconds(3.0), "it is warm");
        alerts.push(Alert { acknowledged_by: Some("ana".to_owned()), ..warm("a-first") });
        alerts.extend(["one", "two"].map(warm));
        let status = Status { merged: Some(alerts), ..shown(NIGHT, SAFE, "") };
        let lines = status.lines(&address, &[], &[]);
        assert!(lines[0].contains("simulated x60       2"), "{lines:#?}");
        assert_eq!(lines[1], "    alerts: 2 active, 1 seen to or shelved, 5 whose cause is gone");
        assert!(lines[2].contains("cooling-failed/one: it is warm;"), "{lines:#?}");
        assert!(lines[3].contains("cooling-failed/two: it is warm;"), "{lines:#?}");
        assert!(lines[4].contains("cooling-failed/a-first: it is warm (ana sees to it);"), "{lines:#?}");
        assert!(lines[5].contains("dome-not-closed/a: it says open (its cause is gone);"), "{lines:#?}");
        assert!(lines[7].starts_with("    3 more alerts: "), "{lines:#?}");
    }

    #[test]
    fn alerts_that_an_observatory_node_has_not_published_yet_are_not_none() {
        let address = Address::new("paranal", "io").unwrap();
        let waits = "alerts: those of the observatory node are not known yet";
        let starts = Status { nodes: [(Role::Observatory, "main".to_owned())].into(), ..Status::default() };
        for status in [Status { merged: None, ..shown(NIGHT, SAFE, "") }, starts] {
            let lines = status.lines(&address, &[], &[]);
            assert!(lines[0].contains("     ?"), "{lines:#?}");
            assert!(lines.iter().any(|line| line.trim() == waits), "{lines:#?}");
        }
        let own = vec![not_closed("dome")];
        let status = Status { merged: None, own, ..shown(NIGHT, SAFE, "") };
        let lines = status.lines(&address, &[], &[]);
        assert!(lines[0].contains("     1"), "{lines:#?}");
        assert_eq!(lines[1], "    alerts: 1 active; those of the observatory node are not known yet");
        assert!(lines[2].contains("dome-not-closed/dome"), "{lines:#?}");
        let none = Status { merged: Some(Vec::new()), ..shown(NIGHT, SAFE, "") };
        let lines = none.lines(&address, &[], &[]);
        assert!(lines.len() == 1 && lines[0].contains("     0"), "{lines:#?}");
    }
}
