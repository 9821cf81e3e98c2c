//! `starmesh catalogue`: star catalogues made of what a site has.

mod build;
mod gaia;
mod http;

use clap::Subcommand;

/// What to do with catalogues.
#[derive(Debug, Subcommand)]
pub enum CataloguesCommand {
    /// Make a catalogue in Starmesh's format of other catalogues.
    Build(build::Options),
}

/// Runs the command.
pub async fn run(command: CataloguesCommand) -> anyhow::Result<()> {
    match command {
        CataloguesCommand::Build(options) => build::run(&options).await,
    }
}
