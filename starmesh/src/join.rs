//! How a command finds the bus.

use clap::Args;
use contract::Address;

use crate::{connect, running};

/// Where the bus is.
#[derive(Debug, Clone, Args)]
pub struct Join {
    /// Meet this peer, such as tcp/10.0.0.5:7447. Peers on the local network, and a `starmesh demo` or `starmesh up` of this
    /// account on this machine, are found without it.
    #[arg(long, value_name = "ENDPOINT", global = true, value_parser = config::endpoints::peer)]
    connect: Vec<String>,
    /// Do not look for peers by multicast.
    #[arg(long, global = true)]
    no_multicast: bool,
}

impl Join {
    /// Joins the bus; without an address, that of what runs here for this account.
    pub async fn open(&self) -> anyhow::Result<bus::Bus> {
        // Several networks may run here, which have nothing to do with each other.
        let mut connect = self.connect.clone();
        if connect.is_empty() {
            connect.extend(running::all().into_iter().map(|running| running.bus));
        }
        let config = config::Bus { listen: Vec::new(), connect, multicast: !self.no_multicast };
        Ok(bus::Bus::visit(&config, bus::Clock::machine_clock()).await?)
    }

    /// Is it known where the nodes of a telescope are: here, or at an address that was given?
    pub fn leads_to(&self, telescope: &Address) -> bool {
        !self.connect.is_empty() || running::all().iter().any(|running| running.telescope == *telescope)
    }

    /// Where this looked, for the message that it found nothing.
    pub fn tried(&self) -> String {
        let multicast = match self.no_multicast {
            true => "not the local network, because of --no-multicast",
            false => "the local network, by multicast",
        };
        if !self.connect.is_empty() {
            let found: Vec<String> = self.connect.iter().map(|endpoint| connect::found_at(endpoint)).collect();
            return format!("looked at {} (--connect) and {multicast}; {}", self.connect.join(", "), found.join("; "));
        }
        let here: Vec<String> = running::all().iter().map(ToString::to_string).collect();
        let here = match here.as_slice() {
            [] => format!("no `starmesh demo` or `starmesh up` of this account runs here{}", files()),
            found => format!("here run {}", found.join(", ")),
        };
        format!(
            "looked at {multicast}; {here}. Start one, or name a host's address with --connect, such as --connect tcp/10.0.0.5:7447, \
             and --connect {} for what another account runs here",
            config::endpoints::THIS_HOST
        )
    }
}

fn files() -> String {
    running::place().map(|place| format!(" (by {})", place.display())).unwrap_or_default()
}
