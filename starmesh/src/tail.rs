//! `starmesh tail`: prints the samples on the bus, one line each.

use clap::Args;

use crate::console::foreign_line;
use crate::join::Join;

/// Options of `starmesh tail`.
#[derive(Debug, Args)]
pub struct Options {
    /// Zenoh key expression, such as 'starmesh/v1/*/callisto/**'.
    #[arg(default_value = "starmesh/**")]
    expression: String,
    #[command(flatten)]
    join: Join,
}

/// Prints until it is interrupted.
pub async fn run(options: Options) -> anyhow::Result<()> {
    let bus = options.join.open().await?;
    let heard = bus.subscribe::<serde_json::Value>(&options.expression, bus::Catch::Newest, 4096).await?;
    loop {
        let sample = heard.hear().await;
        foreign_line(format_args!("{} {} {}", sample.said.at_utc, sample.key, sample.said.body))?;
    }
}
