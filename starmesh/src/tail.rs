//! `starmesh tail`: prints the samples on the bus, one line each.

use std::time::Duration;

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

/// After so long without a sample it prints where it looked.
const QUIET: Duration = Duration::from_secs(5);

/// Prints until it is interrupted.
pub async fn run(options: Options) -> anyhow::Result<()> {
    let bus = options.join.open().await?;
    let samples = bus.subscribe::<serde_json::Value>(&options.expression, bus::Catch::Newest, 4096).await?;
    let mut is_quiet = true;
    loop {
        let received = match tokio::time::timeout(QUIET, samples.recv()).await {
            Ok(received) => received,
            Err(_) if is_quiet => {
                node::lines::complain(format_args!("starmesh: nothing received yet; {}", options.join.tried()));
                samples.recv().await
            }
            Err(_) => samples.recv().await,
        };
        is_quiet = false;
        foreign_line(format_args!("{} {} {}", received.sample.at_utc, received.key, received.sample.body))?;
    }
}
