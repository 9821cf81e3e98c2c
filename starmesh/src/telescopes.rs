//! Telescopes as people name them: SITE/TELESCOPE; for one that does not answer the message lists those that do.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use anyhow::anyhow;
use bus::Bus;
use contract::node::NodeState;
use contract::observatory::NightState;
use contract::{Address, Key, Kind, NodeTopic, Part, Role, Topic};
use serde_json::Value;

use crate::join::Join;
use crate::running;

/// So often the command asks which telescopes are on the bus: a session that has just opened does not know all its
/// peers.
const TRIES: u32 = 4;
const TIMEOUT: Duration = Duration::from_millis(800);

/// The address that a person wrote.
///
/// # Errors
/// It is none; the words name the telescopes on the bus.
pub async fn read(text: &str, bus: &Bus, join: &Join) -> anyhow::Result<Address> {
    let read = text.split_once('/').and_then(|(site, telescope)| Address::new(site, telescope).ok());
    match read {
        Some(address) => Ok(address),
        None => Err(anyhow!(
            "{text:?} is no telescope: expected SITE/TELESCOPE, such as paranal/io; {}",
            meant(text, &known(bus).await, join)
        )),
    }
}

/// The error for a telescope whose observatory node did not answer. Another telescope is proposed only where neither the
/// bus nor a file knows this one.
pub async fn unanswered(address: &Address, bus: &Bus, join: &Join) -> anyhow::Error {
    let nodes = nodes(address, bus).await;
    let is_observatory = |(role, _): &(Role, String)| *role == Role::Observatory;
    if nodes.iter().any(is_observatory) {
        let nights = Topic::Observatory(Part::Night).at(address);
        return match bus.get_all::<NightState>(nights, TIMEOUT).await.is_empty() {
            false => anyhow!("the observatory node of {address} is on the bus and gives no answer; look at its log"),
            true => anyhow!(
                "the observatory node of {address} is on the bus and does not command yet; try again in some seconds"
            ),
        };
    }
    let known = known(bus).await;
    if known.contains(address) {
        let answering: Vec<String> = nodes.into_iter().map(|(role, id)| contract::node::name(role, id)).collect();
        let answering = match answering.is_empty() {
            true => String::new(),
            false => format!(" (of it there answer: {})", answering.join(", ")),
        };
        return anyhow!(
            "no observatory node of {address} answers{answering}; nothing was ordered. `starmesh status` prints how it stands, and \
             `starmesh order {address} close` closes it without that node"
        );
    }
    match in_files(address) {
        Some(place) => anyhow!("no node of {address} answers, which {place} names; is it running? {}", join.tried()),
        None => mistyped(address, &known, join),
    }
}

/// The error for a telescope that nobody knows, where these telescopes are known.
pub fn mistyped(address: &Address, known: &BTreeSet<Address>, join: &Join) -> anyhow::Error {
    let meant = meant(&address.to_string(), known, join);
    anyhow!(
        "no node of a telescope {address} answers on the bus; {meant}. If that is its name, its nodes have ended or are out of \
         reach: look at its dome"
    )
}

/// Telescopes of which any node answers, or a dome's guard.
pub async fn known(bus: &Bus) -> BTreeSet<Address> {
    let nodes = Topic::Node(NodeTopic::State).everywhere();
    let nights = Topic::Observatory(Part::Night).everywhere();
    let domes = Topic::State.everywhere().of_kind(Kind::Dome);
    let mut found = BTreeSet::new();
    for _ in 0..TRIES {
        let before = found.len();
        let (nodes, nights, domes) = tokio::join!(
            bus.get_all::<NodeState>(nodes, TIMEOUT),
            bus.get_all::<NightState>(nights, TIMEOUT),
            bus.get_all::<Value>(domes, TIMEOUT),
        );
        let keys = nodes.into_iter().map(|(key, _)| key).chain(nights.into_iter().map(|(key, _)| key));
        let keys = keys.chain(domes.into_iter().map(|(key, _)| key));
        let addresses = keys.map(|key| key.address().clone());
        found.extend(addresses.filter(|address| address.telescope.as_str() != Address::SHARED));
        if !found.is_empty() && found.len() == before {
            break;
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    found
}

/// Does the bus or a file know this telescope? Then no other one was meant.
pub async fn is_known(address: &Address, known: &BTreeSet<Address>, bus: &Bus) -> bool {
    known.contains(address) || in_files(address).is_some() || !nodes(address, bus).await.is_empty()
}

/// The nodes of a telescope that answer, also an observatory node that does not command yet.
async fn nodes(address: &Address, bus: &Bus) -> BTreeSet<(Role, String)> {
    let states = bus.get_all::<NodeState>(Topic::Node(NodeTopic::State).at(address), TIMEOUT).await;
    let node = |(key, _)| match key {
        Key::Node(_, role, id, _) => Some((role, id.to_string())),
        _ => None,
    };
    states.into_iter().filter_map(node).collect()
}

/// The file that names this telescope: that of a running `demo` or `up`, or the configuration of the current folder.
fn in_files(address: &Address) -> Option<String> {
    let running = running::all().into_iter().find(|running| running.telescope == *address);
    if let Some(running) = running {
        return Some(running.to_string());
    }
    let text = std::fs::read_to_string(CONFIGURATION).ok()?;
    let config = config::parse(&text, Path::new(".")).ok()?;
    (config.address() == *address).then(|| CONFIGURATION.to_owned())
}

/// The usual name of a telescope's configuration.
const CONFIGURATION: &str = "observatory.toml";

/// The names that were probably meant, and the names on the bus.
fn meant(text: &str, known: &BTreeSet<Address>, join: &Join) -> String {
    match suggestion(text, known) {
        Some(words) => words,
        None => format!("no telescope answers: {}", join.tried()),
    }
}

fn suggestion(text: &str, known: &BTreeSet<Address>) -> Option<String> {
    let names: Vec<String> = known.iter().map(ToString::to_string).collect();
    if names.is_empty() {
        return None;
    }
    // Most people who forget the site write the telescope's name alone.
    let alone = names.iter().find(|name| name.split_once('/').is_some_and(|(_, telescope)| telescope == text));
    // Both parts are nearly the same: the site that two telescopes share makes none of them the other.
    let part = |of: &str, known: &str| config::nearest(of, [known]).is_some();
    let is_near = |known: &&Address| match text.split_once('/') {
        Some((site, telescope)) => part(site, known.site.as_str()) && part(telescope, known.telescope.as_str()),
        None => true,
    };
    let near: Vec<String> = known.iter().filter(is_near).map(ToString::to_string).collect();
    let near = alone.map(String::as_str).or_else(|| config::nearest(text, near.iter().map(String::as_str)));
    let near = near.map(|near| format!("did you mean {near}? ")).unwrap_or_default();
    Some(format!("{near}On the bus: {}", names.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mistyped_telescope_is_reported_with_those_that_exist() {
        let known: BTreeSet<Address> = [("paranal", "io"), ("paranal", "callisto")]
            .into_iter()
            .map(|(s, t)| Address::new(s, t).unwrap())
            .collect();
        let all = "On the bus: paranal/callisto, paranal/io";
        assert_eq!(suggestion("paranal/calisto", &known).unwrap(), format!("did you mean paranal/callisto? {all}"));
        assert_eq!(suggestion("paranal/ganymede", &known).unwrap(), all, "another telescope of the site is not meant");
        assert_eq!(suggestion("io", &known).unwrap(), format!("did you mean paranal/io? {all}"));
        assert_eq!(suggestion("x", &known).unwrap(), all);
        assert_eq!(suggestion("x", &BTreeSet::new()), None);
    }
}
