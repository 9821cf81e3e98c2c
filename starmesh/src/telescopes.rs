//! Telescopes as people name them: SITE/TELESCOPE; for one that does not answer the message lists those that do.

use std::collections::BTreeSet;
use std::time::Duration;

use anyhow::anyhow;
use bus::Bus;
use contract::node::NodeState;
use contract::observatory::NightState;
use contract::{Address, NodeTopic, Part, Role, Topic};

/// So often the command asks which telescopes are on the bus: a session that has just opened does not know all its
/// peers.
const TRIES: u32 = 4;
const TIMEOUT: Duration = Duration::from_millis(800);

/// The address that a person wrote.
///
/// # Errors
/// It is none; the words name the telescopes on the bus.
pub async fn read(text: &str, bus: &Bus) -> anyhow::Result<Address> {
    let read = text.split_once('/').and_then(|(site, telescope)| Address::new(site, telescope).ok());
    match read {
        Some(address) => Ok(address),
        None => Err(anyhow!(
            "{text:?} is no telescope: expected SITE/TELESCOPE, such as paranal/io; {}",
            meant(text, &known(bus).await)
        )),
    }
}

/// No node answered for this telescope: the error lists the telescopes that are on the bus.
pub async fn unanswered(address: &Address, bus: &Bus) -> anyhow::Error {
    let known = known(bus).await;
    if known.contains(address) {
        return anyhow!("the observatory node of {address} is on the bus and gives no answer; look at its log");
    }
    if has_node(address, bus).await {
        return anyhow!(
            "the observatory node of {address} is on the bus and does not command yet; try again in some seconds"
        );
    }
    mistyped(address, &known)
}

/// The error for a telescope without a node on the bus, where these telescopes are known.
pub fn mistyped(address: &Address, known: &BTreeSet<Address>) -> anyhow::Error {
    anyhow!("no observatory node of a telescope {address} answers on the bus; {}", meant(&address.to_string(), known))
}

/// Telescopes whose observatory nodes command.
pub async fn known(bus: &Bus) -> BTreeSet<Address> {
    let nights = Topic::Observatory(Part::Night).everywhere();
    let mut found = BTreeSet::new();
    for _ in 0..TRIES {
        let before = found.len();
        found
            .extend(bus.get_all::<NightState>(nights, TIMEOUT).await.into_iter().map(|(key, _)| key.address().clone()));
        if !found.is_empty() && found.len() == before {
            break;
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    found
}

/// Whether an observatory node of a telescope is on the bus, also one that does not command yet: a node that has just
/// started asks for the lease first.
pub async fn has_node(address: &Address, bus: &Bus) -> bool {
    let nodes = Topic::Node(NodeTopic::State).at(address).of_role(Role::Observatory);
    !bus.get_all::<NodeState>(nodes, TIMEOUT).await.is_empty()
}

/// The names that were probably meant, and the names on the bus.
fn meant(text: &str, known: &BTreeSet<Address>) -> String {
    let names: Vec<String> = known.iter().map(ToString::to_string).collect();
    if names.is_empty() {
        return "no telescope answers; is a node running, and is it reached by multicast or --connect?".to_owned();
    }
    // Most people who forget the site write the telescope's name alone.
    let alone = names.iter().find(|name| name.split_once('/').is_some_and(|(_, telescope)| telescope == text));
    let near = alone.map(String::as_str).or_else(|| config::nearest(text, names.iter().map(String::as_str)));
    let near = near.map(|near| format!("did you mean {near}? ")).unwrap_or_default();
    format!("{near}On the bus: {}", names.join(", "))
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
        assert_eq!(meant("paranal/calisto", &known), format!("did you mean paranal/callisto? {all}"));
        assert_eq!(meant("io", &known), format!("did you mean paranal/io? {all}"));
        assert_eq!(meant("x", &known), all);
        assert!(meant("x", &BTreeSet::new()).contains("no telescope answers"));
    }
}
