//! How a command finds the bus.

use clap::Args;

/// Where the bus is.
#[derive(Debug, Clone, Args)]
pub struct Join {
    /// Meet this peer, such as tcp/10.0.0.5:7447; peers on the local network are found without it.
    #[arg(long, value_name = "ENDPOINT", global = true, value_parser = config::endpoints::peer)]
    connect: Vec<String>,
    /// Do not look for peers by multicast.
    #[arg(long, global = true)]
    no_multicast: bool,
}

impl Join {
    /// Joins the bus.
    pub async fn open(&self) -> anyhow::Result<bus::Bus> {
        let config = config::Bus { listen: Vec::new(), connect: self.connect.clone(), multicast: !self.no_multicast };
        Ok(bus::Bus::open(&config, bus::Clock::machine_clock()).await?)
    }
}
