//! The addresses on the bus of the programs that `starmesh up` starts.
//!
//! The supervisor itself has the addresses of `[bus] listen`, and one more of this host: it runs as long as
//! `starmesh up` does, and nodes come and go. Each node listens on a free port of the same interfaces, meets the
//! supervisor, and asks for its addresses again and again (`bus`): device nodes guard their domes on when the supervisor
//! was killed, and whoever looks for them has those addresses alone.

use std::net::UdpSocket;

use node::lines;

/// The addresses of the supervisor: as the file has them, and on this host.
pub fn of_supervisor(file: &config::Bus) -> config::Bus {
    let mut listen = file.listen.clone();
    listen.push(HERE.to_owned());
    config::Bus { listen, ..file.clone() }
}

/// A free port of this host.
const HERE: &str = "tcp/127.0.0.1:0";

/// The address of the supervisor for programs of this host, of all that it has: none of the file, which another program
/// may get later.
pub fn on_this_host(file: &config::Bus, locators: &[String]) -> Option<String> {
    let is_own = |locator: &&String| locator.starts_with("tcp/127.0.0.1:") && !is_named(file, locator);
    locators.iter().find(is_own).cloned()
}

/// The arguments of a node with its addresses to listen on and to connect to; `here` is that of the supervisor on this
/// host.
pub fn of_nodes(file: &config::Bus, here: Option<&str>) -> Vec<String> {
    let mut listen: Vec<&str> = file.listen.iter().map(String::as_str).collect();
    if listen.is_empty() && file.multicast {
        // As a node does whose file names none.
        listen.push("tcp/0.0.0.0:0");
    }
    let asked_for = listen.into_iter().chain(here).map(|endpoint| ["--listen", endpoint]);
    asked_for.chain(here.map(|here| ["--connect", here])).flatten().map(str::to_owned).collect()
}

/// Complains of what a person does not expect: a host without a network, and addresses that the supervisor did not get.
pub fn complain(file: &config::Bus, locators: &[String]) {
    if file.listen.is_empty() && file.multicast && !has_network() {
        lines::complain("starmesh: this host has no network; its own nodes and commands meet all the same");
    }
    // The address of files without `[bus]` is for all of them: the first has it, and the others meet it there.
    let own = file.listen.iter().filter(|endpoint| *endpoint != config::endpoints::THIS_HOST);
    for endpoint in own.filter(|endpoint| is_elsewhere(endpoint, locators)) {
        lines::complain(is_not_had(endpoint));
    }
}

/// For a person: an address of the file that the supervisor did not get, and what to do.
fn is_not_had(endpoint: &str) -> String {
    format!(
        "starmesh: {endpoint} of [bus] listen is held by another program, or is no address of this host; the nodes go on \
         without it and meet the others where they can. If others look for them there, end that program, or correct [bus] \
         listen"
    )
}

/// Where the bus of a file is reached, for a person.
pub fn shown(file: &config::Bus, locators: &[String]) -> String {
    // The loopback port of the nodes of this file is one more address of the same program.
    let named = locators.iter().filter(|locator| is_named(file, locator));
    let mut addresses: Vec<&str> = named.map(String::as_str).collect();
    if addresses.is_empty() {
        addresses.extend(locators.iter().take(1).map(String::as_str));
    }
    let is_here = |address: &&str| address.contains("/127.") || address.contains("/[::1]");
    let whom = match (file.multicast, addresses.iter().all(is_here)) {
        (true, _) => "and looks for others by multicast; everybody who reaches it may order",
        (false, true) => "this host only",
        (false, false) => "everybody who reaches it may order",
    };
    let addresses = if addresses.is_empty() { "no address".to_owned() } else { addresses.join(" and ") };
    format!("the bus is at {addresses} ({whom})")
}

/// Has the file an address with the port of this one?
fn is_named(file: &config::Bus, locator: &str) -> bool {
    file.listen.iter().any(|endpoint| port(endpoint) == port(locator))
}

/// The port of an endpoint, as text.
fn port(endpoint: &str) -> Option<&str> {
    endpoint.split(['?', '#']).next().and_then(|address| address.rsplit_once(':')).map(|(_, port)| port)
}

/// Has this host a way to any other? A computer may start before its switch does, or work without a network.
fn has_network() -> bool {
    // Nothing is sent: the system looks up the route to an address that is reserved for documents.
    UdpSocket::bind("0.0.0.0:0").and_then(|socket| socket.connect("192.0.2.1:9")).is_ok()
}

/// Does this session listen nowhere on the port that was requested?
fn is_elsewhere(endpoint: &str, locators: &[String]) -> bool {
    let asked = port(endpoint).filter(|port| *port != "0");
    asked.is_some() && !locators.iter().any(|locator| port(locator) == asked)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bus(listen: &[&str], multicast: bool) -> config::Bus {
        let listen = listen.iter().map(|endpoint| (*endpoint).to_owned()).collect();
        config::Bus { listen, connect: Vec::new(), multicast }
    }

    #[test]
    fn nodes_ask_for_all_addresses_of_the_supervisor_so_that_one_of_them_has_each_when_it_was_killed() {
        let locators = ["tcp/127.0.0.1:7447".to_owned(), "tcp/127.0.0.1:40001".to_owned()];
        let here = locators[1].as_str();
        for (file, listen) in [
            (config::Bus::of_this_host(), Some("tcp/127.0.0.1:7447")),
            (bus(&["tcp/10.0.0.5:7447"], true), Some("tcp/10.0.0.5:7447")),
            (bus(&[], true), Some("tcp/0.0.0.0:0")),
            (bus(&[], false), None),
        ] {
            let mut words: Vec<&str> = listen.into_iter().chain([here]).flat_map(|at| ["--listen", at]).collect();
            words.extend(["--connect", here]);
            assert_eq!(of_nodes(&file, Some(here)), words);
        }
        let none = config::Bus::of_this_host();
        assert_eq!(on_this_host(&none, &locators).as_deref(), Some(here), "the other one may be another program's");
        assert_eq!(on_this_host(&none, &locators[..1]), None);
    }

    #[test]
    fn an_address_that_the_supervisor_did_not_get_is_reported() {
        let locators = ["tcp/10.0.0.5:7447".to_owned(), "tcp/127.0.0.1:40001".to_owned()];
        assert!(!is_elsewhere("tcp/0.0.0.0:7447", &locators) && !is_elsewhere("tcp/0.0.0.0:0", &locators));
        assert!(is_elsewhere("tcp/10.0.0.5:7448", &locators));
        let words = is_not_had("tcp/10.0.0.5:7448");
        assert!(words.contains("tcp/10.0.0.5:7448") && words.contains("end that program, or correct [bus]"), "{words}");
    }

    #[test]
    fn a_person_reads_where_the_bus_is_and_who_reaches_it() {
        let locators = ["tcp/127.0.0.1:7447".to_owned(), "tcp/127.0.0.1:40001".to_owned()];
        let none = config::Bus::of_this_host();
        assert_eq!(shown(&none, &locators), "the bus is at tcp/127.0.0.1:7447 (this host only)");
        let elsewhere = "the bus is at tcp/127.0.0.1:40001 (this host only)";
        assert_eq!(shown(&none, &locators[1..]), elsewhere, "the first of several `up` has the other address");
        let locators = ["tcp/10.0.0.5:7447".to_owned(), "tcp/127.0.0.1:40001".to_owned()];
        let named = shown(&bus(&["tcp/10.0.0.5:7447"], false), &locators);
        assert_eq!(named, "the bus is at tcp/10.0.0.5:7447 (everybody who reaches it may order)");
        assert!(shown(&bus(&[], true), &locators).contains("multicast"));
    }
}
