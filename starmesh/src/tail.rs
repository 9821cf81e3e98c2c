//! `starmesh tail`: prints the samples on the bus, one line each.

use clap::Args;

use crate::console::foreign_line;
use crate::join::Join;

/// Options of `starmesh tail`.
#[derive(Debug, Args)]
pub struct Options {
    /// Zenoh key expression, such as 'starmesh/v1/*/callisto/**'.
    #[arg(default_value = contract::EVERYTHING)]
    expression: String,
    #[command(flatten)]
    join: Join,
}

/// Prints until it is interrupted.
pub async fn run(options: Options) -> anyhow::Result<()> {
    let bus = options.join.open().await?;
    let samples = bus.subscribe::<serde_json::Value>(&options.expression, bus::Catch::Newest, 4096).await?;
    loop {
        let received = samples.recv().await;
        foreign_line(format_args!("{} {} {}", received.sample.at_utc, received.key, received.sample.body))?;
    }
}
