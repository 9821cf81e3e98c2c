//! The addresses of a server's name; for a server that a stranger named, public ones alone.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::pin::Pin;
use std::task::{Context, Poll};

use hyper_util::client::legacy::connect::dns::{GaiResolver, Name};
use tower_service::Service;

/// Asks the host's resolver.
#[derive(Debug, Clone)]
pub struct Names {
    resolver: GaiResolver,
    public_only: bool,
}

impl Names {
    pub fn new(public_only: bool) -> Self {
        Self { resolver: GaiResolver::new(), public_only }
    }
}

impl Service<Name> for Names {
    type Response = std::vec::IntoIter<SocketAddr>;
    type Error = io::Error;
    type Future = Pin<Box<dyn Future<Output = io::Result<Self::Response>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.resolver.poll_ready(context)
    }

    fn call(&mut self, name: Name) -> Self::Future {
        let (asked, public_only) = (self.resolver.call(name), self.public_only);
        Box::pin(async move {
            let mut found: Vec<SocketAddr> = asked.await?.collect();
            if public_only {
                // What is connected to is what was judged: a name that leads elsewhere the next time gains nothing.
                found.retain(|address| is_public(address.ip()));
                if found.is_empty() {
                    return Err(io::Error::other("its name leads to no address of the public internet"));
                }
            }
            Ok(found.into_iter())
        })
    }
}

/// Is it an address of the public internet, and of no special purpose?
fn is_public(address: IpAddr) -> bool {
    match address.to_canonical() {
        IpAddr::V4(v4) => {
            let [a, b, c, _] = v4.octets();
            let is_special = v4.is_private() || v4.is_loopback() || v4.is_link_local() || v4.is_documentation();
            // 0/8 this network, 100.64/10 shared, 192.0.0/24 protocols, 198.18/15 tests, 224/3 groups and reserved
            !(is_special
                || matches!((a, b, c), (0, ..) | (100, 64..=127, _) | (192, 0, 0) | (198, 18..=19, _) | (224.., ..)))
        }
        IpAddr::V6(v6) => match v6.segments() {
            // A network without IPv4 reaches it so.
            [0x64, 0xff9b, 0, 0, 0, 0, high, low] => {
                is_public(Ipv4Addr::from(u32::from(high) << 16 | u32::from(low)).into())
            }
            // Tunnels to any IPv4 address, protocols, and documentation.
            [0x2001, 0..=0x1ff | 0xdb8, ..] | [0x2002, ..] | [0x3fff, ..] => false,
            [first, ..] => first & 0xe000 == 0x2000,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_addresses_of_the_public_internet_are_public() {
        let is = |text: &str| is_public(text.parse().unwrap());
        for public in ["142.250.1.1", "100.63.0.1", "192.0.1.1", "2a00:1450::1", "64:ff9b::8.8.8.8", "::ffff:8.8.8.8"] {
            assert!(is(public), "{public}");
        }
        for other in [
            "127.0.0.1",
            "10.1.2.3",
            "172.16.0.1",
            "192.168.1.1",
            "169.254.169.254",
            "0.0.0.0",
            "100.64.0.1",
            "192.0.0.8",
            "198.18.0.1",
            "224.0.0.1",
            "255.255.255.255",
            "::1",
            "::",
            "fe80::1",
            "fd00::1",
            "ff02::1",
            "::ffff:127.0.0.1",
            "::ffff:10.0.0.1",
            "64:ff9b::10.0.0.1",
            "2002:7f00:1::",
            "2001:0:1::",
            "2001:db8::1",
        ] {
            assert!(!is(other), "{other}");
        }
    }

    #[tokio::test]
    async fn a_name_of_this_host_is_found_and_is_not_public() {
        let name = || "localhost".parse::<Name>().unwrap();
        assert!(Names::new(false).call(name()).await.unwrap().next().is_some());
        let refused = Names::new(true).call(name()).await.unwrap_err();
        assert!(refused.to_string().contains("no address of the public internet"), "{refused}");
    }
}
