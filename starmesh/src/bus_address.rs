//! The addresses on the bus of the programs that `starmesh up` starts.
//!
//! The supervisor itself has the addresses of `[bus] listen`: it runs as long as `starmesh up` does, and nodes come and
//! go. Each node listens on a free port of the same interface, and meets the supervisor on this host.

use std::net::UdpSocket;

use bus::Bus;
use node::lines;

/// The addresses of the supervisor: as the file has them, and on this host.
pub fn of_supervisor(file: &config::Bus) -> config::Bus {
    let mut listen = file.listen.clone();
    listen.push(HERE.to_owned());
    config::Bus { listen, ..file.clone() }
}

/// A free port of this host.
const HERE: &str = "tcp/127.0.0.1:0";

/// The address of the supervisor for programs of this host.
pub async fn on_this_host(supervisor: &Bus) -> Option<String> {
    supervisor.locators().await.into_iter().find(|locator| is_here(locator))
}

fn is_here(locator: &str) -> bool {
    locator.starts_with("tcp/127.0.0.1:")
}

/// The arguments of a node with its addresses to listen on and to connect to.
pub async fn of_nodes(file: &config::Bus, supervisor: &Bus) -> Vec<String> {
    let mut arguments = Vec::new();
    let locators = supervisor.locators().await;
    for endpoint in &file.listen {
        arguments.extend(["--listen".to_owned(), with_free_port(endpoint)]);
    }
    if file.listen.is_empty() && file.multicast && !has_network() {
        // zenoh announces no address of this host's own where the host has no other one.
        for endpoint in ["tcp/0.0.0.0:0", HERE] {
            arguments.extend(["--listen".to_owned(), endpoint.to_owned()]);
        }
        lines::complain("starmesh: this host has no network; its own nodes and commands meet all the same");
    }
    for locator in locators.iter().filter(|locator| is_here(locator)) {
        arguments.extend(["--connect".to_owned(), locator.clone()]);
    }
    // The address of files without `[bus]` is for all of them: the first has it, and the others meet it there.
    let own = file.listen.iter().filter(|endpoint| *endpoint != config::endpoints::THIS_HOST);
    for endpoint in own.filter(|endpoint| is_elsewhere(endpoint, &locators)) {
        lines::complain(format_args!(
            "starmesh: {endpoint} of [bus] listen is held by another program, or is no address of this host; \
             the nodes go on without it and meet the others where they can"
        ));
    }
    arguments
}

/// Where the bus of a file is reached, for a person.
pub fn shown(file: &config::Bus, locators: &[String]) -> String {
    // The loopback port of the nodes of this file is one more address of the same program.
    let named = |locator: &&String| file.listen.iter().any(|endpoint| port(endpoint) == port(locator));
    let mut addresses: Vec<&str> = locators.iter().filter(named).map(String::as_str).collect();
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

/// The port of an endpoint, as text.
fn port(endpoint: &str) -> Option<&str> {
    endpoint.split(['?', '#']).next().and_then(|address| address.rsplit_once(':')).map(|(_, port)| port)
}

/// Has this host a way to any other? A computer may start before its switch does, or work without a network.
fn has_network() -> bool {
    // Nothing is sent: the system looks up the route to an address that is reserved for documents.
    UdpSocket::bind("0.0.0.0:0").and_then(|socket| socket.connect("192.0.2.1:9")).is_ok()
}

/// The same interface with a port that the system chooses.
fn with_free_port(endpoint: &str) -> String {
    let end = endpoint.find(['?', '#']).unwrap_or(endpoint.len());
    match endpoint.get(..end).and_then(|address| address.rsplit_once(':')) {
        Some((host, _)) => format!("{host}:0{}", endpoint.get(end..).unwrap_or_default()),
        None => endpoint.to_owned(),
    }
}

/// Does this session listen nowhere on the port that was requested?
fn is_elsewhere(endpoint: &str, locators: &[String]) -> bool {
    let asked = port(endpoint).filter(|port| *port != "0");
    asked.is_some() && !locators.iter().any(|locator| port(locator) == asked)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_listen_on_the_interface_that_the_file_names() {
        for (endpoint, node) in [
            ("tcp/10.0.0.5:7447", "tcp/10.0.0.5:0"),
            ("tcp/[::1]:7447", "tcp/[::1]:0"),
            ("tcp/0.0.0.0:7447#iface=eth0", "tcp/0.0.0.0:0#iface=eth0"),
        ] {
            assert_eq!(with_free_port(endpoint), node);
        }
    }

    #[test]
    fn an_address_that_the_supervisor_did_not_get_is_reported() {
        let locators = ["tcp/10.0.0.5:7447".to_owned(), "tcp/127.0.0.1:40001".to_owned()];
        assert!(!is_elsewhere("tcp/0.0.0.0:7447", &locators) && !is_elsewhere("tcp/0.0.0.0:0", &locators));
        assert!(is_elsewhere("tcp/10.0.0.5:7448", &locators));
    }

    #[test]
    fn a_person_reads_where_the_bus_is_and_who_reaches_it() {
        let bus = |listen: &[&str], multicast| config::Bus {
            listen: listen.iter().map(|endpoint| (*endpoint).to_owned()).collect(),
            connect: Vec::new(),
            multicast,
        };
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
