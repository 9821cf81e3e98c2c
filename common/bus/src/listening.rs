//! Where a session listens when several programs of one host are configured with the same address.
//!
//! The roles of one `observatory.toml` read the same `[bus] listen`, and only one of them can have it. The others
//! listen on a free port of the same interface and meet the one that has it, which introduces them to everybody. They
//! go on asking for the address: a program that is configured to connect to it must find a node there when that one has
//! ended. So do the nodes of a `starmesh up`, which has the addresses as long as it runs.

use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, ToSocketAddrs as _, UdpSocket};
use std::path::Path;

/// How often an address is tried again that could not be had.
const AGAIN_MS: u32 = 3000;

/// The same settings with a free port for each address that cannot be had yet, and a connection to the program that has
/// it.
pub(crate) fn share(config: &config::Bus) -> config::Bus {
    let mut shared = config::Bus { listen: Vec::new(), ..config.clone() };
    // An address of one's own is nobody to meet.
    shared.connect.retain(|peer| !config.listen.contains(peer));
    // An address is held while the others are tried: two of one list may be the same one.
    let mut held: Vec<(&str, SocketAddr, Held)> = Vec::new();
    for endpoint in in_order(&config.listen) {
        let (protocol, _) = endpoint.split_once('/').unwrap_or(("tcp", ""));
        let address = match usable(endpoint) {
            Ok(address) => address,
            Err(why) => {
                shared.listen.extend(instead(endpoint, protocol, &why));
                continue;
            }
        };
        let is_held = |(of, at, _): &(&str, SocketAddr, Held)| {
            *of == protocol && at.port() == address.port() && (at.ip() == address.ip() || at.ip().is_unspecified())
        };
        match bind(protocol, address) {
            Ok(socket) => {
                held.push((protocol, address, socket));
                shared.listen.push(endpoint.clone());
            }
            Err(_) if held.iter().any(is_held) => {}
            Err(error) if error.kind() == ErrorKind::AddrInUse => {
                tracing::info!(endpoint, "another program listens here already; it is met, and a free port is used");
                let free = with_free_port(endpoint);
                if !shared.listen.contains(&free) {
                    shared.listen.push(free);
                }
                shared.listen.push(when_it_can_be_had(endpoint));
                shared.connect.push(format!("{protocol}/{}", reachable(address)));
            }
            Err(error) => {
                let why = if error.kind() == ErrorKind::AddrNotAvailable {
                    "no address of this host".to_owned()
                } else {
                    error.to_string()
                };
                shared.listen.extend(instead(endpoint, protocol, &why));
                // The program that has that address is met there.
                if address.port() != 0 {
                    shared.connect.push(format!("{protocol}/{}", reachable(address)));
                }
            }
        }
    }
    shared
}

/// A socket of either protocol, kept from others while it lives.
enum Held {
    Tcp { _listener: TcpListener },
    Udp { _socket: UdpSocket },
}

/// A free port of this host while an address cannot be had, which is logged.
fn instead(endpoint: &str, protocol: &str, why: &str) -> [String; 2] {
    tracing::warn!(
        endpoint,
        why,
        "this node cannot listen here, and nobody can meet it there; it goes on without, and tries again every few seconds"
    );
    [format!("{protocol}/127.0.0.1:0"), when_it_can_be_had(endpoint)]
}

/// The same interface with a port that the system chooses.
fn with_free_port(endpoint: &str) -> String {
    let (address, settings) = endpoint.split_at(endpoint.find(['?', '#']).unwrap_or(endpoint.len()));
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    format!("{host}:0{settings}")
}

/// The endpoint, with the options that make zenoh try it again and again in parallel with its other work.
fn when_it_can_be_had(endpoint: &str) -> String {
    let joint = if endpoint.contains('#') { ';' } else { '#' };
    format!(
        "{endpoint}{joint}exit_on_failure=false;retry_period_init_ms={AGAIN_MS};retry_period_max_ms={AGAIN_MS};\
         retry_period_increase_factor=1"
    )
}

/// Those on all interfaces first, since they hold the port of all others.
fn in_order(endpoints: &[String]) -> Vec<&String> {
    let mut all: Vec<&String> = endpoints.iter().collect();
    all.sort_by_key(|endpoint| usable(endpoint).is_ok_and(|address| !address.ip().is_unspecified()));
    all
}

/// The address of an endpoint such as `tcp/10.0.0.5:7447` or `udp/localhost:7447`, or why this host has none of it.
fn usable(endpoint: &str) -> Result<SocketAddr, String> {
    let rest = endpoint.split_once('/').map_or(endpoint, |(_, rest)| rest);
    let (address, settings) = rest.split_at(rest.find(['?', '#']).unwrap_or(rest.len()));
    let interface = settings.split(['?', '#', ';']).find_map(|setting| setting.strip_prefix("iface="));
    let interfaces = Path::new("/sys/class/net");
    if let Some(name) = interface.filter(|name| interfaces.is_dir() && !interfaces.join(name).exists()) {
        return Err(format!("this host has no network interface {name}"));
    }
    let found = address.to_socket_addrs().ok().and_then(|mut found| found.next());
    found.ok_or_else(|| format!("no address is known for {address}"))
}

fn bind(protocol: &str, address: SocketAddr) -> std::io::Result<Held> {
    match protocol {
        "udp" => UdpSocket::bind(address).map(|socket| Held::Udp { _socket: socket }),
        _ => TcpListener::bind(address).map(|listener| Held::Tcp { _listener: listener }),
    }
}

fn reachable(address: SocketAddr) -> SocketAddr {
    let ip = match address.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        ip => ip,
    };
    SocketAddr::new(ip, address.port())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_that_is_taken_is_met_and_one_of_our_own_is_not() {
        let holder = TcpListener::bind("127.0.0.1:0").unwrap();
        let taken = format!("tcp/{}", holder.local_addr().unwrap());
        let free = "tcp/127.0.0.1:0".to_owned();
        let config =
            config::Bus { listen: vec![taken.clone(), free.clone()], connect: vec![taken.clone()], multicast: false };
        let shared = share(&config);
        let later = when_it_can_be_had(&taken);
        assert_eq!((shared.listen, shared.connect), (vec![free.clone(), later, free], vec![taken.clone()]));
        drop(holder);
        let shared = share(&config);
        assert_eq!((shared.listen[0].as_str(), shared.connect.len()), (taken.as_str(), 0));
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let udp = format!("udp/{}", socket.local_addr().unwrap());
        let config = config::Bus { listen: vec![udp.clone()], connect: Vec::new(), multicast: false };
        let shared = share(&config);
        assert_eq!(
            (shared.listen, shared.connect),
            (vec!["udp/127.0.0.1:0".to_owned(), when_it_can_be_had(&udp)], vec![udp])
        );
        // 192.0.2.0/24 is of no host: an interface that is not up yet must not keep a node from its start.
        let away = config::Bus { listen: vec!["tcp/192.0.2.1:7447".to_owned()], connect: Vec::new(), multicast: true };
        assert_eq!(share(&away).listen, ["tcp/127.0.0.1:0".to_owned(), when_it_can_be_had("tcp/192.0.2.1:7447")]);
    }

    fn listened(listen: &[&str]) -> (Vec<String>, Vec<String>) {
        let listen = listen.iter().map(|endpoint| (*endpoint).to_owned()).collect();
        let shared = share(&config::Bus { listen, connect: Vec::new(), multicast: false });
        (shared.listen, shared.connect)
    }

    #[test]
    fn several_addresses_that_are_taken_are_met_and_asked_for_and_one_free_port_of_their_interface_is_enough() {
        // Those of a `starmesh up`, as its nodes see them.
        let holders = ["127.0.0.1:0"; 2].map(|free| TcpListener::bind(free).unwrap());
        let [file, own] = holders.each_ref().map(|holder| format!("tcp/{}", holder.local_addr().unwrap()));
        let free = "tcp/127.0.0.1:0".to_owned();
        let asked_for = vec![free, when_it_can_be_had(&file), when_it_can_be_had(&own)];
        assert_eq!(listened(&[&file, &own]), (asked_for, vec![file, own]));
    }

    #[test]
    fn a_free_port_is_one_of_the_same_interface() {
        for (endpoint, free) in [
            ("tcp/10.0.0.5:7447", "tcp/10.0.0.5:0"),
            ("tcp/[::1]:7447", "tcp/[::1]:0"),
            ("tcp/0.0.0.0:7447#iface=eth0", "tcp/0.0.0.0:0#iface=eth0"),
        ] {
            assert_eq!(with_free_port(endpoint), free);
        }
    }

    #[test]
    fn what_this_host_has_not_is_gone_without_also_on_a_free_port() {
        for endpoint in ["tcp/192.0.2.1:0", "tcp/no-such-host.invalid:7447", "tcp/*:7447", "udp/192.0.2.1:0"] {
            let here = format!("{}/127.0.0.1:0", &endpoint[..3]);
            assert_eq!(listened(&[endpoint]), (vec![here, when_it_can_be_had(endpoint)], Vec::new()));
        }
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn an_interface_that_is_not_there_is_gone_without() {
        let absent = listened(&["tcp/0.0.0.0:7447#iface=none9"]).0;
        assert_eq!(absent[0], "tcp/127.0.0.1:0");
        assert!(absent[1].starts_with("tcp/0.0.0.0:7447#iface=none9;exit_on_failure=false;"), "{absent:?}");
        assert_eq!(listened(&["tcp/127.0.0.1:0#iface=lo"]).0, ["tcp/127.0.0.1:0#iface=lo"]);
    }

    #[test]
    fn an_address_that_stands_there_twice_is_listened_on_once() {
        let free = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = free.local_addr().unwrap().port();
        drop(free);
        let (one, all) = (format!("tcp/127.0.0.1:{port}"), format!("tcp/0.0.0.0:{port}"));
        let other = format!("udp/127.0.0.1:{port}");
        assert_eq!(listened(&[&one, &one]), (vec![one.clone()], Vec::new()));
        assert_eq!(listened(&[&one, &all]), (vec![all], Vec::new()));
        assert_eq!(listened(&[&one, &other]), (vec![one, other], Vec::new()));
    }
}
