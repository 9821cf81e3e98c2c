//! `GET /metrics`: the network for Prometheus. A value that is stale is left out, so that it is absent and not frozen.

use std::fmt::Write as _;
use std::sync::Arc;

use axum::extract::{Extension, State};
use axum::http::header;
use axum::response::{IntoResponse as _, Response};
use bus::MachineTime;
use contract::observatory::{Posture, Priority, RowStatus, ScheduleState};
use contract::{Address, Key, Kind, Part, Scalar};
use serde_json::Value;
use units::Utc;
use users::Principal;

use crate::alerts::Counts;
use crate::freshness::Quality;
use crate::model::{Model, Telescope};
use crate::safety::SafetyWord;
use crate::server::Server;
use crate::summary::{Mode, Summary, nodes};

/// The page of metrics.
pub async fn metrics(State(server): State<Arc<Server>>, Extension(caller): Extension<Principal>) -> Response {
    let clock = server.network.clock();
    let mut page = Page::default();
    page.gauge("starmesh_build_info", "Version of the web node.", &[("version", env!("CARGO_PKG_VERSION"))], 1.0);
    page.gauge(
        "starmesh_bus_peers",
        "Processes that the web node is joined with.",
        &[],
        server.bus.peers().await as f64,
    );
    page.gauge("starmesh_sockets", "Pages that are open.", &[], server.sockets.taken() as f64);
    network(&mut page, &server.network.read(), &caller, clock.machine(), clock.utc());
    (
        [(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8"), (header::CACHE_CONTROL, "no-store")],
        page.text(),
    )
        .into_response()
}

/// All telescopes that the caller may see, and what their sites share.
fn network(page: &mut Page, model: &Model, caller: &Principal, now: MachineTime, utc: Utc) {
    let visible = model.telescopes.iter().filter(|(address, _)| caller.right_at(address).is_some());
    let known: Vec<(&Address, &Telescope, Summary)> = visible
        .map(|(address, telescope)| (address, telescope, Summary::of(model, address, telescope, now, utc)))
        .collect();
    for (address, telescope, summary) in &known {
        let place = [("site", address.site.as_str()), ("telescope", address.telescope.as_str())];
        if summary.face.shared {
            alerts(page, &place, Counts::of(&summary.face.alerts_beside(known.iter().map(|(.., other)| &other.face))));
        } else {
            observatory(page, &place, summary);
            let schedule = telescope.read::<ScheduleState>(&Key::Observatory((*address).clone(), Part::Schedule));
            if let Some((entry, schedule)) = schedule.filter(|(entry, _)| entry.quality(now) == Quality::Fresh) {
                let _ = entry;
                rows(page, &place, &schedule);
            }
        }
        readings(page, &place, telescope, now);
        for node in nodes(telescope, now) {
            let (role, name) = (node.state.role.word(), node.id.as_str());
            let labels = [place[0], place[1], ("role", role), ("node", name)];
            let is_up = f64::from(u8::from(node.quality < Quality::Lost));
            page.gauge("starmesh_node_up", "1 while the node publishes.", &labels, is_up);
            if node.quality != Quality::Fresh {
                continue;
            }
            page.gauge("starmesh_node_uptime_seconds", "Since the node started.", &labels, node.state.uptime_s);
            for (figure, value) in &node.state.figures {
                let number = match value {
                    Scalar::Bool(is_so) => Some(f64::from(u8::from(*is_so))),
                    value => value.number(),
                };
                if let Some(number) = number {
                    let labels = [place[0], place[1], ("role", role), ("node", name), ("figure", figure.as_str())];
                    page.gauge(
                        "starmesh_node_figure",
                        "What this role of node reports; the name ends in its unit.",
                        &labels,
                        number,
                    );
                }
            }
        }
    }
}

fn observatory(page: &mut Page, place: &[(&str, &str)], summary: &Summary) {
    let face = &summary.face;
    let is_up = face.quality == Quality::Fresh;
    page.gauge("starmesh_telescope_up", "1 while the observatory node publishes.", place, f64::from(u8::from(is_up)));
    if let Some(age_s) = summary.ages.age_s {
        page.gauge("starmesh_heartbeat_age_seconds", "Since the observatory node last published.", place, age_s);
    }
    let safety = [SafetyWord::Safe, SafetyWord::Unsafe, SafetyWord::Unknown].map(|safety| (safety, safety.word()));
    let posture = [Posture::Closed, Posture::Opening, Posture::Open, Posture::Closing, Posture::Unknown];
    let posture = posture.map(|posture| (posture, posture.word()));
    let mode = [(Mode::Robotic, "robotic"), (Mode::Manual, "manual"), (Mode::Unknown, "unknown")];
    one_of(page, "starmesh_safety_state", "The verdict: 1 at the word that holds.", place, &safety, face.safety.state);
    one_of(page, "starmesh_posture_state", "Domes: 1 at the word that holds.", place, &posture, face.posture);
    one_of(page, "starmesh_mode_state", "How it is run: 1 at the word that holds.", place, &mode, face.mode);
    alerts(page, place, face.alert_counts);
    if is_up {
        if let Some(time_s) = face.safety.time_to_safe_s {
            page.gauge("starmesh_time_to_safe_seconds", "Sky time until it can be safe.", place, time_s);
        }
        page.gauge("starmesh_frames", "Frames since the observatory node started.", place, face.frames as f64);
    }
}

fn alerts(page: &mut Page, place: &[(&str, &str)], counts: Counts) {
    for (priority, count) in [
        (Priority::Critical, counts.critical),
        (Priority::High, counts.high),
        (Priority::Medium, counts.medium),
        (Priority::Advisory, counts.advisory),
    ] {
        let labels = [place[0], place[1], ("priority", priority.word())];
        page.gauge("starmesh_alerts_active", "Active alerts.", &labels, count as f64);
    }
}

fn rows(page: &mut Page, place: &[(&str, &str)], schedule: &ScheduleState) {
    for status in [
        RowStatus::Pending,
        RowStatus::Running,
        RowStatus::Finished,
        RowStatus::Failed,
        RowStatus::Skipped,
        RowStatus::Interrupted,
    ] {
        let count = schedule.rows.iter().filter(|row| row.status == status).count();
        let word = format!("{status:?}").to_lowercase();
        let labels = [place[0], place[1], ("status", word.as_str())];
        page.gauge("starmesh_schedule_rows", "Rows of the schedule.", &labels, count as f64);
    }
}

/// Devices, and their readings that are numbers or yes and no.
fn readings(page: &mut Page, place: &[(&str, &str)], telescope: &Telescope, now: MachineTime) {
    for entry in telescope.states.values() {
        let Key::State(device) = &entry.key else { continue };
        let (kind, name) = (Kind::word(device.kind), device.name.as_str());
        let labels = [place[0], place[1], ("kind", kind), ("device", name)];
        let is_up = entry.quality(now) < Quality::Lost && entry.body["link"]["is"] == "connected";
        page.gauge("starmesh_device_up", "1 while the device answers its node.", &labels, f64::from(u8::from(is_up)));
        if entry.quality(now) != Quality::Fresh || !is_up {
            continue;
        }
        for (property, reading) in entry.body["readings"].as_object().into_iter().flatten() {
            let number = match &reading["value"] {
                Value::Bool(is_so) => Some(f64::from(u8::from(*is_so))),
                value => value.as_f64(),
            };
            if let Some(number) = number {
                let labels = [place[0], place[1], ("kind", kind), ("device", name), ("property", property.as_str())];
                page.gauge(
                    "starmesh_reading",
                    "A polled property of a device, in the unit that ASCOM gives it.",
                    &labels,
                    number,
                );
            }
        }
    }
}

/// One gauge for each word of a state, 1 at the one that holds.
fn one_of<T: PartialEq>(
    page: &mut Page,
    name: &'static str,
    help: &'static str,
    place: &[(&str, &str)],
    words: &[(T, &str)],
    now: T,
) {
    for (state, word) in words {
        let labels = [place[0], place[1], ("state", *word)];
        page.gauge(name, help, &labels, f64::from(u8::from(*state == now)));
    }
}

/// Metrics in Prometheus's text format: samples of one name stand together.
#[derive(Default)]
struct Page {
    metrics: Vec<(&'static str, &'static str, String)>,
}

impl Page {
    fn gauge(&mut self, name: &'static str, help: &'static str, labels: &[(&str, &str)], value: f64) {
        if !value.is_finite() {
            return;
        }
        let at = self.metrics.iter().position(|(known, ..)| *known == name).unwrap_or_else(|| {
            self.metrics.push((name, help, String::new()));
            self.metrics.len() - 1
        });
        let escaped = |text: &str| text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
        let labels: Vec<String> = labels.iter().map(|(name, value)| format!("{name}=\"{}\"", escaped(value))).collect();
        let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
        if let Some((.., samples)) = self.metrics.get_mut(at) {
            let _ = writeln!(samples, "{name}{labels} {value}");
        }
    }

    fn text(self) -> String {
        let text = |(name, help, samples): (&str, &str, String)| {
            format!("# HELP {name} {help}\n# TYPE {name} gauge\n{samples}")
        };
        self.metrics.into_iter().map(text).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;
    use std::time::Duration;

    use bus::Clock;
    use serde_json::json;

    use super::*;
    use crate::model::tests::received;
    use crate::network::Network;

    #[test]
    fn an_alert_of_what_a_site_shares_is_counted_once() {
        let network = Network::new(Clock::machine_clock(), Address::new("paranal", "callisto").unwrap());
        let alert = |id: &str| json!({ "id": id, "priority": "critical", "raised_utc": "2026-11-21T03:00:00Z", "cause": id, "consequence": "", "action": "" });
        let alerts = json!({ "alerts": [alert("dome-not-closed/roof"), alert("a/station"), alert("b/station")] });
        let guard = serde_json::from_str(include_str!("../../../common/contract/golden/v1/dome.guard.json")).unwrap();
        network.accept(received("paranal/shared/node/device/enclosure/alerts", "b", 0, 100, alerts));
        network.accept(received("paranal/shared/device/dome/roof/guard", "b", 0, 100, guard));
        let mut page = Page::default();
        let now = MachineTime::from_boot(Duration::from_secs(101));
        super::network(&mut page, &network.read(), &Principal::open("local"), now, Utc::EPOCH);
        let text = page.text();
        for (telescope, count) in [("callisto", 1), ("shared", 2)] {
            let labels = format!("site=\"paranal\",telescope=\"{telescope}\",priority=\"critical\"");
            assert!(text.contains(&format!("starmesh_alerts_active{{{labels}}} {count}\n")), "{text}");
        }
    }

    /// The words of a text that begin like a metric of ours.
    fn metrics(text: &str) -> BTreeSet<&str> {
        let words = text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
        words.filter(|word| word.starts_with("starmesh_")).collect()
    }

    #[test]
    fn the_examples_for_prometheus_and_grafana_name_only_metrics_and_labels_that_there_are() {
        let code = include_str!("metrics.rs").split("#[cfg(test)]").next().unwrap();
        let known = metrics(code);
        let labels: BTreeSet<&str> = code.split("(\"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy");
        let mut named = BTreeSet::new();
        for file in ["prometheus/starmesh.rules.yml", "grafana/starmesh.json"] {
            let text = std::fs::read_to_string(folder.join(file)).unwrap().replace("\\\"", "\"");
            for metric in metrics(&text) {
                assert!(known.contains(metric), "{file}: {metric}");
                named.insert(metric.to_owned());
            }
            // In braces stand labels, each before = or =~.
            let selectors = text.split("starmesh_").skip(1).filter_map(|rest| {
                let (name, rest) = rest.split_once('{')?;
                name.bytes().all(|b| b.is_ascii_lowercase() || b == b'_').then(|| rest.split('}').next())?
            });
            for selector in selectors {
                for label in selector.split(", ").filter_map(|part| part.split(['=', '!', '~']).next()) {
                    assert!(labels.contains(label.trim()), "{file}: label {label} in {{{selector}}}");
                }
            }
        }
        // What nobody looks at by an example is only the version.
        let unused: Vec<&&str> = known.iter().filter(|metric| !named.contains(**metric)).collect();
        assert_eq!(unused, [&"starmesh_build_info"]);
        let dashboard = std::fs::read_to_string(folder.join("grafana/starmesh.json")).unwrap();
        let dashboard: serde_json::Value = serde_json::from_str(&dashboard).unwrap();
        let panels = dashboard["panels"].as_array().unwrap();
        assert!(panels.iter().all(|panel| panel["targets"].as_array().is_some_and(|targets| !targets.is_empty())));
    }
}
