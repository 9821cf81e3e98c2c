//! Where `[bus]` listens and connects: endpoints such as `tcp/10.0.0.5:7447`.

use std::net::IpAddr;

use crate::Bus;

/// A peer on the bus, as a person names it on a command line.
///
/// # Errors
/// It cannot be one: with what is wrong and what was expected.
pub fn peer(text: &str) -> Result<String, String> {
    let why = reason(text, true);
    why.map_or(Ok(text.to_owned()), |why| Err(format!("it {why}; expected one such as tcp/10.0.0.5:7447")))
}

/// Where the nodes of a host meet that have no `[bus]`: nobody on another host reaches it.
pub const THIS_HOST: &str = "tcp/127.0.0.1:7447";

impl Bus {
    /// The bus of a file without `[bus]`. All nodes of the host share one address, also those of other files: one has it,
    /// and introduces the others to each other. No other host reaches it, and none is looked for.
    pub fn of_this_host() -> Self {
        Self { listen: vec![THIS_HOST.to_owned()], ..Self::default() }
    }

    /// The endpoints at which a further program of this host meets the nodes of this file, whichever of them listens there.
    pub fn meeting_points(&self) -> Vec<String> {
        let own = self.listen.iter().filter_map(|endpoint| {
            let (protocol, rest) = endpoint.split_once('/')?;
            let (host, port) = rest.split(['?', '#']).next()?.rsplit_once(':')?;
            let host = match host {
                "0.0.0.0" | "*" => "127.0.0.1",
                "[::]" => "[::1]",
                host => host,
            };
            (port != "0").then(|| format!("{protocol}/{host}:{port}"))
        });
        let mut all: Vec<String> = own.collect();
        all.extend(self.connect.iter().filter(|peer| !self.listen.contains(peer)).cloned());
        all
    }

    /// What a person should know: peers elsewhere are named, and cannot come back to this node.
    pub(crate) fn warnings(&self) -> Vec<(&'static str, String)> {
        let is_elsewhere = |peer: &&String| {
            let host = peer.split_once('/').map_or("", |(_, rest)| rest).rsplit_once(':').map_or("", |(host, _)| host);
            host != "localhost" && !host.trim_matches(['[', ']']).parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
        };
        match self.connect.iter().find(is_elsewhere) {
            Some(peer) if self.listen.is_empty() && !self.multicast => vec![(
                "bus.connect",
                format!(
                    "bus.connect: \"{peer}\" is on another host, and this node listens on its own host only: of the nodes there it \
                     meets that one alone. Add listen, such as listen = [\"tcp/10.0.0.11:7447\"] with this host's address"
                ),
            )],
            _ => Vec::new(),
        }
    }

    /// Each endpoint that cannot be one, with what was expected.
    pub(crate) fn faults(&self) -> Vec<(String, String)> {
        let listen = self.listen.iter().map(|endpoint| ("listen", endpoint));
        let all = listen.chain(self.connect.iter().map(|endpoint| ("connect", endpoint)));
        let fault = |(key, endpoint): (&str, &String)| {
            let why = reason(endpoint, key == "connect")?;
            Some((
                endpoint.clone(),
                format!("bus.{key}: \"{endpoint}\" {why}; expected one such as \"tcp/10.0.0.5:7447\""),
            ))
        };
        all.filter_map(fault).collect()
    }
}

fn reason(endpoint: &str, is_peer: bool) -> Option<String> {
    let Some((protocol, rest)) = endpoint.split_once('/') else { return Some("names no protocol".to_owned()) };
    if !matches!(protocol, "tcp" | "udp") {
        return Some(format!("names the protocol {protocol}, which is not known here"));
    }
    let address = rest.split(['?', '#']).next().unwrap_or_default();
    let Some((host, port)) = address.rsplit_once(':') else { return Some("has no port".to_owned()) };
    if let Err(why) = crate::host::host_name(host) {
        return Some(format!("names no host: {why}"));
    }
    match port.parse::<u16>() {
        Ok(0) if is_peer => Some("has port 0, at which nobody can be met".to_owned()),
        Ok(_) => None,
        Err(_) => Some(format!("has the port {port:?}, which is not a number from 1 to 65535")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_an_endpoint_is_reported_with_what_is_wrong() {
        for good in ["tcp/10.0.0.5:7447", "tcp/[::1]:7447", "udp/dome-pc:7447", "tcp/10.0.0.5:7447#iface=eth0"] {
            assert_eq!(reason(good, true), None, "{good}");
        }
        for (bad, why) in [
            ("10.0.0.5:7447", "protocol"),
            ("http/10.0.0.5:7447", "protocol"),
            ("tcp/10.0.0.5", "port"),
            ("tcp/10.0.0.5:70000", "70000"),
            ("tcp/:7447", "host"),
            ("tcp/fe80::1:7447", "host"),
            ("tcp/999.1.1.1:7447", "host"),
            ("tcp/dome pc:7447", "host"),
            ("tcp/10.0.0.5:0", "port 0"),
        ] {
            assert!(reason(bad, true).is_some_and(|reason| reason.contains(why)), "{bad}: {:?}", reason(bad, true));
        }
        assert_eq!(reason("tcp/0.0.0.0:0", false), None);
    }

    fn bus(block: &str) -> (Bus, Vec<String>) {
        let place =
            "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\nelevation_m = 0\n";
        let (config, faults) = crate::examine(&format!("{place}{block}"), std::path::Path::new("/"));
        let of_bus = faults.into_iter().map(|fault| fault.what).filter(|what| what.starts_with("bus."));
        (config.unwrap().bus, of_bus.collect())
    }

    #[test]
    fn without_a_block_a_node_is_on_this_host_only_and_a_block_joins_no_multicast_that_it_does_not_name() {
        let (none, faults) = bus("");
        assert_eq!((none.listen, none.connect.len(), none.multicast), (vec![THIS_HOST.to_owned()], 0, false));
        assert!(faults.is_empty(), "{faults:?}");
        let (named, _) = bus("[bus]\nlisten = [\"tcp/10.0.0.5:7447\"]\n");
        assert_eq!((named.listen.len(), named.multicast), (1, false));
        let (empty, _) = bus("[bus]\n");
        assert!(empty.listen.is_empty() && !empty.multicast, "a free port of this host");
        assert!(bus("[bus]\nmulticast = true\n").0.multicast);
    }

    #[test]
    fn a_node_that_names_peers_elsewhere_and_cannot_be_reached_is_warned_of() {
        let peer = "connect = [\"tcp/10.0.0.5:7447\"]\n";
        let (_, faults) = bus(&format!("[bus]\n{peer}"));
        assert!(faults.len() == 1 && faults[0].contains("Add listen"), "{faults:?}");
        for quiet in [
            format!("[bus]\n{peer}listen = [\"tcp/10.0.0.11:7447\"]\n"),
            format!("[bus]\n{peer}multicast = true\n"),
            "[bus]\nconnect = [\"tcp/127.0.0.1:7447\", \"tcp/localhost:7447\", \"tcp/[::1]:7447\"]\n".to_owned(),
        ] {
            assert_eq!(bus(&quiet).1, Vec::<String>::new(), "{quiet}");
        }
    }

    #[test]
    fn a_further_program_of_the_host_meets_the_nodes_where_the_file_has_them_listen() {
        let points = |block: &str| bus(block).0.meeting_points();
        assert_eq!(points(""), [THIS_HOST]);
        assert_eq!(
            points("[bus]\nlisten = [\"tcp/0.0.0.0:7448#iface=eth0\", \"tcp/127.0.0.1:0\"]\n"),
            ["tcp/127.0.0.1:7448"]
        );
        let both = "[bus]\nlisten = [\"tcp/[::]:7447\"]\nconnect = [\"tcp/10.0.0.5:7447\"]\n";
        assert_eq!(points(both), ["tcp/[::1]:7447", "tcp/10.0.0.5:7447"]);
    }
}
