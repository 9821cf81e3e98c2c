//! Every endpoint of the document, with every right that somebody may have: made of the document itself, so that a new endpoint
//! is in it.

use contract::observatory::NightState;
use contract::{Key, Part, Right};
use serde_json::json;
use units::Utc;

use crate::stage::raw::{add_user, change};
use crate::stage::{Stage, address, sample};

/// A token for a user of its own with these rights, as a header.
fn token(folder: &std::path::Path, name: &str, rights: &[&str]) -> String {
    add_user(folder, name, rights);
    let (made, expires): (Utc, Utc) =
        ("2026-01-01T00:00:00Z".parse().unwrap(), "2200-01-01T00:00:00Z".parse().unwrap());
    let (name, user) = (name.parse().unwrap(), name.parse().unwrap());
    let secret = change(folder, |users| users.add_token(name, user, None, made, expires).unwrap());
    format!("Authorization: Bearer {}\r\n", secret.reveal())
}

fn filled(path: &str) -> String {
    let mut path = path.to_owned();
    for (name, value) in [("site", "paranal"), ("telescope", "callisto"), ("kind", "dome"), ("version", "1")] {
        path = path.replace(&format!("{{{name}}}"), value);
    }
    // Whatever else is in braces names something that is not there.
    while let Some((before, rest)) = path.clone().split_once('{') {
        path = format!("{before}nothing{}", rest.split_once('}').unwrap().1);
    }
    path
}

#[tokio::test(flavor = "multi_thread")]
async fn every_endpoint_refuses_every_right_that_is_too_small_and_takes_every_other() {
    let folder = tempfile::tempdir().unwrap();
    let words = ["viewer", "observer", "operator", "engineer"];
    let own: Vec<String> =
        words.map(|word| token(folder.path(), word, &[&format!("{word}:paranal/callisto")])).to_vec();
    let everywhere: Vec<String> = words.map(|word| token(folder.path(), &format!("all-{word}"), &[word])).to_vec();
    let foreign: Vec<String> =
        words.map(|word| token(folder.path(), &format!("far-{word}"), &[&format!("{word}:teide/*")])).to_vec();
    let stage = Stage::start_with("requests_per_s = 1000\n", folder.path()).await;
    let night: NightState = serde_json::from_value(sample("observatory.night")).unwrap();
    let _night = stage.publish(Key::Observatory(address("callisto"), Part::Night), night).await;
    let document = stage.ask("GET /api/openapi.json", &own[0], None).await.json();
    let mut count = 0;
    for (path, verbs) in document["paths"].as_object().unwrap() {
        let is_of_telescope = path.contains("{telescope}");
        for (verb, operation) in verbs.as_object().unwrap() {
            let ask = format!("{} {}", verb.to_uppercase(), filled(path));
            // What is asked for needs a body that is JSON and nothing sensible: no order is given, and nothing is changed.
            let has_body = operation.get("requestBody").is_some();
            let body = has_body.then(|| json!({"nothing": "sensible"}));
            let send = async |headers: &str| {
                let answer = stage.ask(&ask, headers, body.as_ref()).await;
                if answer.status >= 400 && answer.status != 304 {
                    assert_eq!(
                        answer.header("content-type"),
                        Some("application/problem+json"),
                        "{ask}: {}",
                        answer.text
                    );
                    assert_eq!(answer.json()["status"], answer.status, "{ask}");
                }
                answer
            };
            let right = operation["x-right"].as_str().unwrap();
            let nobody = send("").await;
            let word = right.strip_suffix(" of all telescopes");
            let (is_of_all, right) = (word.is_some(), word.unwrap_or(right));
            let needed = Right::ALL.into_iter().find(|known| known.word() == right);
            match right {
                "none" => {
                    assert!(!matches!(nobody.status, 401 | 403) || path.ends_with("/login"), "{ask}: {}", nobody.text)
                }
                // Programs of this host may ask for the heartbeat.
                _ if path == "/api/heartbeat" => assert_eq!(nobody.status, 200, "{ask}"),
                _ => assert_eq!(nobody.status, 401, "{ask}: {}", nobody.text),
            }
            for (list, holds_here) in
                [(&own, !is_of_all), (&everywhere, true), (&foreign, !is_of_telescope && !is_of_all)]
            {
                for (has, headers) in Right::ALL.iter().zip(list) {
                    let answer = send(headers).await;
                    let may = needed.is_none_or(|needed| holds_here && *has >= needed);
                    let refused = answer.status == 403 && answer.json()["required_right"] == right;
                    assert_ne!(answer.status, 401, "{ask} as {has}: {}", answer.text);
                    assert_eq!(refused, !may, "{ask} as {has}, here: {holds_here}: {} {}", answer.status, answer.text);
                    assert!(
                        answer.status < 500 || answer.status == 504 || answer.status == 503,
                        "{ask}: {}",
                        answer.text
                    );
                    count += 1;
                }
            }
        }
    }
    assert!(count > 500, "{count}");
    stage.end().await;
}
