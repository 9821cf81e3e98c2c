//! Where `[bus]` listens and connects: endpoints such as `tcp/10.0.0.5:7447`.

use crate::Bus;

/// A peer on the bus, as a person names it on a command line.
///
/// # Errors
/// It cannot be one: with what is wrong and what was expected.
pub fn peer(text: &str) -> Result<String, String> {
    let why = reason(text, true);
    why.map_or(Ok(text.to_owned()), |why| Err(format!("it {why}; expected one such as tcp/10.0.0.5:7447")))
}

impl Bus {
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
}
