//! What a telescope does by itself when its observatory node starts, in words for the person who starts it.

use contract::Address;
use contract::command::operator;
use interlock::takeover::last_order;
use safety::on_disk::OnDisk;
use safety::ordered_by::OrderedBy;
use units::Utc;

use crate::active_orders;
use crate::journal::{self, Journal};

/// One line, by the files of the data folder; `None` for the shared devices of a site, which begin nothing. A node on
/// another host that commands may know of newer orders. `was_commanded`: the guard process of a dome remembers that somebody
/// commanded before.
pub fn words(config: &config::Observatory, was_commanded: bool, now: Utc) -> Option<String> {
    let address = config.address();
    if address.telescope.as_str() == Address::SHARED {
        return None;
    }
    let path = journal::path(config);
    let turned = match Journal::last_robotic_in(&path) {
        Ok(turned) => turned,
        Err(error) => return Some(format!("{address} opens nothing: cannot read {}: {error}", path.display())),
    };
    let file = active_orders::path(config);
    let held = match active_orders::look(&file) {
        OnDisk::Absent if was_commanded => Some(OrderedBy::by_node(format!("{} is gone", file.display()), now)),
        disk => disk.orders(now).stay_closed,
    };
    Some(told(&address, last_order(turned, now), config.schedule.robotic, held.as_ref()))
}

/// `ordered`: how a person, or a fault, turned the robotic switch last, where that holds.
fn told(address: &Address, ordered: Option<(Utc, bool)>, configured: bool, held: Option<&OrderedBy>) -> String {
    let why = match ordered {
        Some((at, on)) => {
            format!("the robotic switch was turned {} at {}", if on { "on" } else { "off" }, at.to_second())
        }
        None => format!("[schedule] robotic is {configured}"),
    };
    if !ordered.map_or(configured, |(_, on)| on) {
        return format!("{address} waits for a person, `starmesh order {address} start`: {why}");
    }
    let Some(OrderedBy { from, reason, at_utc }) = held else {
        return format!(
            "{address} works through its schedule by itself, and opens when that is safe: {why}; `starmesh order {address} stop` \
             ends that"
        );
    };
    format!(
        "{address} would work through its schedule by itself ({why}), and stays closed until `starmesh order {address} \
         open-again`: {} ordered so at {}{}",
        operator(from),
        at_utc.to_second(),
        if reason.is_empty() { String::new() } else { format!(" ({reason})") }
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_telescope_begins_as_it_was_ordered_tonight_else_as_configured_and_says_why() {
        let folder = tempfile::tempdir().unwrap();
        let mut config = config::parse(test_support::PARANAL, folder.path()).unwrap();
        let mut read = |robotic: bool, now_s: f64| {
            config.schedule.robotic = robotic;
            words(&config, false, Utc::from_seconds(now_s)).unwrap()
        };
        let (tonight_s, tomorrow_s) = (2_000.0, 90_000.0);
        let off =
            "paranal/callisto waits for a person, `starmesh order paranal/callisto start`: [schedule] robotic is false";
        assert_eq!(read(false, tonight_s), off);
        let on = read(true, tonight_s);
        assert!(on.contains("by itself, and opens when that is safe: [schedule] robotic is true; "), "{on}");
        let data = folder.path().join("data");
        assert!(!data.exists(), "nothing is written for it");

        let journal = Journal::open(&data.join("journal-callisto.jsonl")).unwrap();
        journal.robotic_on(Utc::from_seconds(1_000.0)).unwrap();
        let ordered = read(false, tonight_s);
        assert!(ordered.contains("opens when that is safe: the robotic switch was turned on at "), "{ordered}");
        assert_eq!(read(false, tomorrow_s), off, "an order holds for a night");
        std::fs::write(data.join("operator-orders-callisto.json"), "{").unwrap();
        let lost = read(false, tonight_s);
        assert!(lost.contains("stays closed until `starmesh order paranal/callisto open-again`"), "{lost}");
        assert_eq!(std::fs::read_dir(&data).unwrap().count(), 2, "no copy is kept");
    }

    #[test]
    fn a_telescope_that_somebody_commanded_before_and_whose_orders_are_gone_stays_closed() {
        let folder = tempfile::tempdir().unwrap();
        let mut config = config::parse(test_support::PARANAL, folder.path()).unwrap();
        config.schedule.robotic = true;
        let words = words(&config, true, Utc::from_seconds(0.0)).unwrap();
        let why = "operator-orders-callisto.json is gone)";
        assert!(words.contains("stays closed until ") && words.ends_with(why), "{words}");
    }

    #[test]
    fn who_ordered_that_it_stays_closed_is_named() {
        let address = Address::new("paranal", "callisto").unwrap();
        let held = OrderedBy {
            from: "cli/ana@dome-pc".to_owned(),
            reason: "people on the roof".to_owned(),
            at_utc: Utc::from_seconds(0.0),
        };
        let words = told(&address, None, true, Some(&held));
        assert!(words.ends_with("ana ordered so at 1970-01-01 00:00:00 UTC (people on the roof)"), "{words}");
        assert!(told(&address, None, false, Some(&held)).contains("waits for a person"));
    }
}
