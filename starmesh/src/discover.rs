//! `starmesh discover`: finds Alpaca devices and prints ready blocks.

use std::time::Duration;

use clap::Args;

use crate::console::line;

/// Options of `starmesh discover`.
#[derive(Debug, Args)]
pub struct Options {
    /// How long to wait for answers, s.
    #[arg(long, default_value_t = 2.0)]
    seconds: f64,
}

/// Asks the network and prints what answered.
pub async fn run(options: Options) -> anyhow::Result<()> {
    anyhow::ensure!((0.1..=60.0).contains(&options.seconds), "--seconds {}: expected 0.1 to 60", options.seconds);
    let found = alpaca::discovery::discover(Duration::from_secs_f64(options.seconds)).await?;
    if found.is_empty() {
        line(format_args!(
            "# no Alpaca server answered on UDP port {} within {} s",
            alpaca::discovery::PORT,
            options.seconds
        ))?;
        line(format_args!(
            "# servers in another subnet, or without discovery, are written by hand: server = \"host:port\""
        ))?;
    }
    for device in &found {
        line(format_args!("{}", alpaca::discovery::as_toml(device)))?;
    }
    Ok(())
}
