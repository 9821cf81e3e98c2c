//! `/lite`: every telescope as plain HTML, for a browser without JavaScript, a text browser, or when the page is broken.

use std::fmt::Write as _;
use std::sync::Arc;

use axum::Extension;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse as _, Response};
use contract::Address;
use contract::observatory::{Alert, Posture, Standing};
use users::Principal;

use crate::routes::network::WebcamInNetwork;
use crate::routes::{network, page};
use crate::safety::SafetyWord;
use crate::server::Server;
use crate::summary::{Face, Mode, Summary};

/// The browser asks again after so long, s.
const AGAIN_S: u32 = 15;

/// The page of all telescopes that the caller may see; for somebody without any right, the login page.
pub async fn lite(State(server): State<Arc<Server>>, Extension(caller): Extension<Principal>) -> Response {
    if caller.right_anywhere().is_none() {
        return page::login();
    }
    let summaries = server.network.summaries();
    let may_see = |summary: &&Summary| caller.right_at(&address(summary)).is_some();
    let webcams = network::webcams(&server, &caller);
    let text = html(summaries.iter().filter(may_see), &webcams, &server.network.clock().utc().to_string());
    let named = [(header::CONTENT_TYPE, page::HTML), (header::CACHE_CONTROL, "no-store")];
    (named, text).into_response()
}

fn address(summary: &Summary) -> Address {
    let Face { site_id, telescope_id, .. } = &summary.face;
    Address { site: site_id.clone(), telescope: telescope_id.clone() }
}

fn html<'a>(summaries: impl Iterator<Item = &'a Summary> + Clone, webcams: &[WebcamInNetwork], now: &str) -> String {
    let mut text = format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta http-equiv=\"refresh\" content=\"{AGAIN_S}\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><title>Starmesh, plain</title>\
         <link rel=\"stylesheet\" href=\"/assets/starmesh.css\"><link rel=\"stylesheet\" href=\"/assets/live.css\">\
         <link rel=\"icon\" href=\"/assets/favicon.svg\"></head><body class=\"document\"><main class=\"stack\"><h1>Telescopes</h1>\
         <p>As of <b>{} UTC</b>; asked again each {AGAIN_S} s. An older page is out of date. <a href=\"/\">The whole page</a></p>",
        escaped(now.get(..19).unwrap_or(now))
    );
    let faces = summaries.clone().map(|summary| &summary.face);
    let mut known = 0;
    for summary in summaries {
        if summary.face.shared {
            let alerts = summary.face.alerts_beside(faces.clone());
            if !alerts.is_empty() {
                let _ = write!(text, "<section class=\"card\"><h2>{}</h2>", escaped(&summary.face.id));
                list(&mut text, alerts.iter().map(told));
                text.push_str("</section>");
            }
            continue;
        }
        known += 1;
        telescope(&mut text, summary);
        let address = address(summary);
        let links: Vec<String> = webcams.iter().filter(|one| one.shows(&address)).map(link).collect();
        if !links.is_empty() {
            let _ = write!(text, "<p>To look at it: {}</p>", links.join(", "));
        }
        text.push_str("</section>");
    }
    if known == 0 {
        text.push_str("<p>No telescope on the bus yet.</p>");
    }
    text.push_str("</main></body></html>");
    text
}

fn telescope(text: &mut String, Summary { face, ages }: &Summary) {
    let safety = match face.safety.state {
        SafetyWord::Safe => "SAFE",
        SafetyWord::Unsafe => "UNSAFE",
        SafetyWord::Unknown => "SAFETY UNKNOWN",
    };
    let posture = match face.posture {
        Posture::Closed => "CLOSED",
        Posture::Opening => "OPENING",
        Posture::Open => "OPEN",
        Posture::Closing => "CLOSING",
        Posture::Unknown => "DOME UNKNOWN",
    };
    let mode = match face.mode {
        Mode::Robotic => ", robotic",
        Mode::Manual => ", manual",
        Mode::Unknown => "",
    };
    let age = ages.age_s.map_or("nothing received yet".to_owned(), |age| format!("{age:.0} s old"));
    let simulated = if face.simulated { ", simulation" } else { "" };
    let id = escaped(&face.id);
    let _ = write!(text, "<section class=\"card\"><h2>{id}</h2>");
    // A device node that goes on may report that it stands open again.
    let is_quiet = face.alerts.is_empty() && face.domes.is_empty();
    if let Some(stopped) = face.stopped.as_ref().filter(|stopped| stopped.is_closed() && is_quiet) {
        let _ = write!(text, "<p>{}, {age}</p>", escaped(&stopped.text));
        return;
    }
    let _ =
        write!(text, "<p><b>{safety}</b> <b>{posture}</b>{mode}{simulated}, {age}</p><p>{}</p>", escaped(&face.now));
    list(text, face.domes.iter().cloned());
    list(text, face.safety.reasons.iter().map(|reason| format!("{} {}", reason.input, reason.why)));
    list(text, face.alerts.iter().map(told));
    let _ = write!(text, "<p>To close it: <code>starmesh order {id} close</code></p>");
}

/// A webcam's picture, from its own server.
fn link(webcam: &WebcamInNetwork) -> String {
    format!("<a href=\"{}\" rel=\"noreferrer\">{}</a>", escaped(&webcam.url), escaped(&webcam.name))
}

fn told(alert: &Alert) -> String {
    let fate = match alert.standing() {
        Standing::Active => "",
        Standing::SeenTo => " (somebody sees to it, or has shelved it)",
        Standing::Gone => " (its cause is gone)",
    };
    format!("{}{fate}: {} {} {}", alert.priority.word(), alert.cause, alert.consequence, alert.action)
}

fn list(text: &mut String, lines: impl Iterator<Item = String>) {
    let items: String = lines.map(|line| format!("<li>{}</li>", escaped(&line))).collect();
    if !items.is_empty() {
        let _ = write!(text, "<ul>{items}</ul>");
    }
}

/// Text from the bus is never markup.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use bus::Clock;
    use serde_json::json;

    use super::*;
    use crate::model::tests::received;
    use crate::network::Network;

    #[test]
    fn text_from_the_bus_is_never_markup_and_an_unknown_telescope_says_so() {
        let address = Address { site: "paranal".parse().unwrap(), telescope: "callisto".parse().unwrap() };
        let network = Network::new(Clock::machine_clock(), address);
        let alert = json!({"alerts": [{"id": "a", "priority": "critical", "raised_utc": "2026-11-21T03:00:00Z",
            "cause": "<img src=x onerror=\"a()\">", "consequence": "c", "action": "d"}]});
        network.accept(received("paranal/callisto/observatory/alerts/state", "b1", 1, 0, alert));
        let summaries = network.summaries();
        let page = html(summaries.iter(), &[], "now");
        assert!(page.contains("SAFETY UNKNOWN") && page.contains("DOME UNKNOWN"), "{page}");
        assert!(page.contains("critical: &lt;img") && !page.contains("<img"), "{page}");
    }

    #[test]
    fn a_telescope_that_was_stopped_in_good_order_is_told_so_and_one_that_runs_has_its_own_command() {
        let address = Address { site: "paranal".parse().unwrap(), telescope: "callisto".parse().unwrap() };
        let state = |stopped| json!({"role": "observatory", "version": "", "host": "pc", "pid": 1, "uptime_s": 1.0, "speed": 1.0, "stopped": stopped});
        let page = |stopped, webcams: &[WebcamInNetwork]| {
            let network = Network::new(Clock::machine_clock(), address.clone());
            network.accept(received("paranal/callisto/node/observatory/main/state", "b1", 1, 100, state(stopped)));
            html(network.summaries().iter(), webcams, "now")
        };
        let webcam = |name: &str, telescope: Option<&str>| WebcamInNetwork {
            name: name.to_owned(),
            url: "https://cams.example/a?b=1&c=\"".to_owned(),
            site_id: "paranal".parse().unwrap(),
            telescope_id: telescope.map(|id| id.parse().unwrap()),
            period_s: 60.0,
        };
        let webcams = [webcam("<Sky>", None), webcam("Dome", Some("callisto")), webcam("Other", Some("io"))];
        let runs = page(serde_json::Value::Null, &webcams);
        assert!(runs.contains("<code>starmesh order paranal/callisto close</code>"), "{runs}");
        let sky = "<a href=\"https://cams.example/a?b=1&amp;c=&quot;\" rel=\"noreferrer\">&lt;Sky&gt;</a>, <a ";
        assert!(runs.contains(sky) && runs.contains(">Dome</a>") && !runs.contains("Other"), "{runs}");
        let stopped = page(json!({"by": "starmesh up on pc", "closed": true}), &[]);
        assert!(stopped.contains("stopped by starmesh up on pc, closed") && !stopped.contains("UNKNOWN"), "{stopped}");
    }

    #[test]
    fn what_a_device_node_goes_on_to_report_of_a_telescope_that_was_stopped_is_shown() {
        let address = Address { site: "paranal".parse().unwrap(), telescope: "callisto".parse().unwrap() };
        let network = Network::new(Clock::machine_clock(), address);
        let state = |role: &str, stopped| json!({"role": role, "version": "", "host": "pc", "pid": 1, "uptime_s": 1.0, "speed": 1.0, "stopped": stopped});
        let alert = json!({"alerts": [{"id": "a", "priority": "critical", "raised_utc": "2026-11-21T03:00:00Z",
            "cause": "it is half open", "consequence": "c", "action": "d"}]});
        for (key, body) in [
            ("node/observatory/main/state", state("observatory", json!({"by": "starmesh up on pc", "closed": true}))),
            ("node/device/enclosure/state", state("device", serde_json::Value::Null)),
            ("node/device/enclosure/alerts", alert),
        ] {
            network.accept(received(&format!("paranal/callisto/{key}"), "b1", 1, 0, body));
        }
        let page = html(network.summaries().iter(), &[], "now");
        assert!(page.contains("stopped by starmesh up on pc, closed") && page.contains("it is half open"), "{page}");
    }

    #[test]
    fn alerts_about_what_a_site_shares_stand_under_its_own_name() {
        let page = |alerts: serde_json::Value| {
            let network = Network::new(Clock::machine_clock(), Address::new("paranal", "callisto").unwrap());
            let alerts = json!({ "alerts": alerts });
            network.accept(received("paranal/shared/node/device/main/alerts", "b1", 0, 0, alerts));
            html(network.summaries().iter(), &[], "now")
        };
        let silent = json!([{"id": "a/station", "priority": "high", "raised_utc": "2026-11-21T03:00:00Z",
            "cause": "the station is silent", "consequence": "c", "action": "d"}]);
        let mut over = silent.clone();
        over[0]["returned_utc"] = json!("2026-11-21T03:20:00Z");
        let over = page(over);
        let since = "; last known, from the device node main, silent since 2027-01-15 08:00:00 UTC";
        assert!(
            over.contains(&format!("<li>high (its cause is gone): the station is silent{since} c d</li>")),
            "{over}"
        );
        let (none, one) = (page(json!([])), page(silent));
        assert!(!none.contains("paranal/shared"), "{none}");
        let stands = format!("<h2>paranal/shared</h2><ul><li>high: the station is silent{since} c d</li></ul>");
        assert!(one.contains(&stands), "{one}");
    }
}
