//! Looks names up in parallel with everything else, as soon as a schedule has them.

use std::collections::BTreeMap;
use std::time::Duration;

use config::Names;
use node::Node;
use schedule::names::{KnownNames, Meaning, key};
use tokio::sync::watch;
use units::Utc;

use super::{horizons, http, sesame};
use crate::persisted::write_whole;
use crate::schedule_file::Loaded;

/// A name that was not found, or could not be asked for, is asked for again after this, machine time.
const AGAIN: Duration = Duration::from_secs(60);

/// Looks up what the schedule names and nobody knows yet, for ever.
pub async fn keep_looking_up(
    node: Node,
    names: watch::Sender<KnownNames>,
    mut loaded: watch::Receiver<Loaded>,
) -> anyhow::Result<()> {
    if !node.config.names.online {
        std::future::pending::<()>().await;
    }
    loop {
        let wanted = wanted(&loaded.borrow_and_update(), &names.borrow());
        for (name, at) in &wanted {
            look_up(&node, &names, name, *at).await;
        }
        tokio::select! {
            changed = loaded.changed() => changed?,
            () = tokio::time::sleep(AGAIN) => {}
        }
    }
}

/// Names and when they are wanted for: the first time.
fn wanted(loaded: &Loaded, known: &KnownNames) -> BTreeMap<String, Utc> {
    let mut wanted = BTreeMap::new();
    for row in loaded.rows.iter() {
        if let Some(name) = row.action.lookup_name().filter(|name| known.wants(name, row.start)) {
            wanted.entry(name.trim().to_owned()).or_insert(row.start);
        }
    }
    wanted
}

async fn look_up(node: &Node, names: &watch::Sender<KnownNames>, name: &str, at: Utc) {
    match ask(&node.config.names, name, at).await {
        Ok(meaning) => {
            tracing::info!(name, ?meaning, "looked up");
            names.send_modify(|known| {
                known.failed.remove(&key(name));
                known.found.insert(key(name), meaning);
            });
            keep(node, names).await;
        }
        Err(why) => {
            let is_new =
                names.send_if_modified(|known| known.failed.insert(key(name), why.clone()) != Some(why.clone()));
            if is_new {
                tracing::warn!(name, why, "not looked up; asked again in {} s", AGAIN.as_secs());
            }
        }
    }
}

/// Small bodies first, as the predecessor has it: what moves must not be taken for a star of the same name.
async fn ask(names: &Names, name: &str, at: Utc) -> Result<Meaning, String> {
    let answer = http::get(&horizons::question(&names.horizons_url, name, at)).await;
    let answer = answer.map_err(|error| format!("Horizons: {error:#}"))?;
    if let Some(meaning) = horizons::read(&answer).map_err(|why| format!("Horizons: {why}"))? {
        return Ok(meaning);
    }
    let answer = http::get(&sesame::question(&names.sesame_url, name)).await;
    let answer = answer.map_err(|error| format!("Sesame: {error:#}"))?;
    let meaning = sesame::read(&answer).map_err(|why| format!("Sesame: {why}"))?;
    meaning.ok_or_else(|| "neither Horizons nor Sesame knows the name; give ra and dec".to_owned())
}

/// Writes what was found; without a disk it is looked up again after a restart.
async fn keep(node: &Node, names: &watch::Sender<KnownNames>) {
    let path = KnownNames::path(&node.config);
    let mut part = path.clone().into_os_string();
    part.push(format!(".{}.part", node.id));
    let known = names.borrow().clone();
    let written = tokio::task::spawn_blocking(move || write_whole(&path, part.as_ref(), &known)).await;
    if let Err(error) = written.unwrap_or_else(|error| Err(std::io::Error::other(error))) {
        tracing::warn!(%error, "names that were looked up are not on disk");
    }
}

#[cfg(test)]
mod tests {
    use axum::Router;
    use axum::routing::get;

    use super::*;

    const CERES: &str = "$$SOE\n2461365.5, A.D. 2026-Nov-21 00:00:00.0000, 7.857E-02, 2.549E+00, 1.0587E+01, 8.0267E+01, \
        7.3569E+01, 2.4616E+06, 2.1E-01, 3.2E+02, 3.1E+02, 2.7E+00,\n$$EOE\n";
    const VEGA: &str =
        "# Vega\t#Q1\n#=S=Simbad (via url):    1     1ms\n%J 279.23473479 +38.78368896 = 18 36 56\n%P 200.94 286.23\n";

    /// Two services that answer as the real ones do.
    async fn services() -> Names {
        let horizons = |uri: axum::http::Uri| async move {
            let asked = uri.query().unwrap_or_default().to_owned();
            match asked {
                asked if asked.contains("Ceres%3B") => CERES.to_owned(),
                asked if asked.contains("Endless%3B") => [CERES, &" ".repeat(1_000_000)].concat(),
                _ => "\n No matches found.\n".to_owned(),
            }
        };
        let sesame = |uri: axum::http::Uri| async move {
            if uri.query() == Some("Vega") { VEGA } else { "# Nonsuch\t#Q2\n#!SIMBAD: Nothing found\n" }
        };
        let router = Router::new().route("/api", get(horizons)).route("/sesame/-oI/A", get(sesame));
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let base = format!("http://{}", listener.local_addr().unwrap());
        tokio::spawn(async move { axum::serve(listener, router).await.unwrap() });
        Names { online: true, sesame_url: format!("{base}/sesame"), horizons_url: format!("{base}/api") }
    }

    #[tokio::test]
    async fn small_bodies_and_stars_are_found_and_what_nobody_knows_is_reported() {
        let (names, at) = (services().await, "2026-11-21T03:00:00Z".parse().unwrap());
        assert!(matches!(ask(&names, "Ceres", at).await, Ok(Meaning::Orbit { .. })));
        assert!(matches!(ask(&names, "Vega", at).await, Ok(Meaning::Fixed { .. })));
        let unknown = ask(&names, "Nonsuch", at).await.unwrap_err();
        assert!(unknown.contains("neither"), "{unknown}");
        // A part of an answer could have half a number at its end.
        let endless = ask(&names, "Endless", at).await.unwrap_err();
        assert!(endless.contains("more than 1000000 bytes"), "{endless}");
    }

    #[tokio::test]
    async fn a_service_that_is_away_or_answers_nonsense_is_a_reason_and_no_meaning() {
        let (mut names, at) = (services().await, "2026-11-21T03:00:00Z".parse().unwrap());
        let good = names.sesame_url.clone();
        // Bound and not listening: nobody else gets its port.
        let held = tokio::net::TcpSocket::new_v4().unwrap();
        held.bind("127.0.0.1:0".parse().unwrap()).unwrap();
        let gone = held.local_addr().unwrap();
        names.sesame_url = format!("http://{gone}");
        let why = ask(&names, "Vega", at).await.unwrap_err();
        assert!(why.starts_with("Sesame: it cannot be reached"), "{why}");
        // Horizons' address leads to what is not Horizons: the star must not be taken for it.
        names.horizons_url = format!("{good}/-oI/A");
        let why = ask(&names, "Vega", at).await.unwrap_err();
        assert!(why.starts_with("Horizons: the answer is none"), "{why}");
    }
}
