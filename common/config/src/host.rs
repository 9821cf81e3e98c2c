//! Names, addresses and ports of hosts, as a configuration may write them.

/// Is this a host and a port?
///
/// # Errors
/// What is wrong with it, and what to do.
pub fn host_port(text: &str) -> Result<(), String> {
    if let Some((scheme, rest)) = text.split_once("://") {
        return Err(format!("leave \"{scheme}://\" away: {}", rest.trim_end_matches('/')));
    }
    if text.is_empty() {
        return Err("it is empty".to_owned());
    }
    if let Some((host, port)) = text.rsplit_once(',').filter(|(host, _)| host_name(host).is_ok()) {
        return Err(format!("a colon stands before the port: {host}:{}", port.trim()));
    }
    let Some((host, port)) = text.rsplit_once(':') else {
        return Err(format!("add the port: {}:11111", text.trim_end_matches('/')));
    };
    if port.contains('/') {
        return Err("leave away what follows the port".to_owned());
    }
    if !port.bytes().all(|byte| byte.is_ascii_digit()) || !port.parse::<u16>().is_ok_and(|port| port > 0) {
        return Err(format!("port {port}: expected a whole number from 1 to 65535"));
    }
    host_name(host)
}

/// One way to write a server: names of this host are one, and so are capital letters and a dot at the end.
pub(crate) fn same_host(server: &str) -> String {
    let lower = server.to_ascii_lowercase();
    let (host, port) = lower.rsplit_once(':').unwrap_or((&lower, ""));
    let host = host.trim_end_matches('.');
    let address = host.trim_start_matches('[').trim_end_matches(']').parse::<std::net::IpAddr>();
    let is_here = host == "localhost" || address.as_ref().is_ok_and(std::net::IpAddr::is_loopback);
    match address {
        _ if is_here => format!("localhost:{port}"),
        Ok(address) => format!("{address}:{port}"),
        Err(_) => format!("{host}:{port}"),
    }
}

/// Is this the name or address of a host?
pub(crate) fn host_name(host: &str) -> Result<(), String> {
    if let Some(address) = host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
        let read = address.parse::<std::net::Ipv6Addr>();
        return read.map(drop).map_err(|_| format!("\"{address}\" is no IPv6 address"));
    }
    if host.parse::<std::net::Ipv6Addr>().is_ok() {
        return Err(format!("an IPv6 address stands in brackets: [{host}]"));
    }
    let digits_only = !host.is_empty() && host.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
    if digits_only && host.parse::<std::net::Ipv4Addr>().is_err() {
        return Err(format!("\"{host}\" is no address: expected four numbers from 0 to 255"));
    }
    let is_part = |part: &str| {
        !part.is_empty()
            && part.len() <= 63
            && !part.starts_with('-')
            && part.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_')
    };
    if host.len() <= 253 && host.trim_end_matches('.').split('.').all(is_part) {
        Ok(())
    } else {
        Err(format!("\"{host}\" is no name of a host: expected letters, digits, '-' and '.'"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hosts_and_ports_are_distinguished_from_what_is_none() {
        for good in ["10.0.0.5:11111", "localhost:1", "dome-pc.site.example.org:80", "[::1]:11111", "my_pc:65535"] {
            assert_eq!(host_port(good), Ok(()), "{good}");
        }
        for (bad, words) in [
            ("http://10.0.0.5:11111", "leave \"http://\" away: 10.0.0.5:11111"),
            ("10.0.0.5", "add the port: 10.0.0.5:11111"),
            ("10.0.0.5:70000", "port 70000: expected a whole number from 1 to 65535"),
            ("10.0.0.5:0", "port 0"),
            ("10.0.0.5:+80", "port +80"),
            ("10.0.0.500:80", "no address"),
            ("a b:80", "no name of a host"),
            (":80", "no name of a host"),
            ("::1:80", "in brackets: [::1]"),
            ("10.0.0.5:80/api", "what follows the port"),
        ] {
            assert!(host_port(bad).unwrap_err().contains(words), "{bad}: {:?}", host_port(bad));
        }
    }
}
