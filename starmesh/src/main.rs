//! The command line: try it, run it, look at it.

mod actions;
mod archive;
mod audit;
mod bus_address;
mod catalogues;
mod check;
mod compress;
mod connect;
mod console;
mod demo;
mod discover;
#[cfg(test)]
mod documents_tests;
mod fields;
mod first_tables;
mod fits_files;
mod images;
mod import;
mod init;
mod join;
mod left;
mod new_site;
mod night;
mod order;
mod plan;
mod process;
mod reports;
mod running;
mod schedules;
mod simulate;
mod status;
mod supervise;
mod tail;
mod telescopes;
mod up;
mod user;

use std::process::ExitCode;
use std::time::Duration;

use clap::{Parser, Subcommand, ValueEnum};
use contract::Role;

/// Runs networks of robotic telescopes.
#[derive(Debug, Parser)]
#[command(name = "starmesh", version, arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// A whole simulated night: simulator, all nodes as processes, and the page.
    Demo(demo::Options),
    /// Write the first files of a telescope: configuration, header table and example schedule, from the devices that answer.
    Init(init::Options),
    /// Start and supervise the nodes of one telescope.
    Up(up::Options),
    /// Prove a configuration and say what is wrong with it.
    Check(check::Options),
    /// Forecast schedules: when each row will begin and end, frames, altitudes, and what will not run.
    Plan(plan::Options),
    /// What a schedule may ask for: every action and its parameters.
    Actions(actions::Options),
    /// One table of all telescopes on the bus.
    Status(status::Options),
    /// Close, stay closed, start, stop, or override a limit for a while.
    Order(order::Options),
    /// Put another schedule in force; list and show those that were.
    #[command(subcommand)]
    Schedule(schedules::ScheduleCommand),
    /// Prove and print the records of what was ordered and moved.
    Audit(audit::Options),
    /// Copy the archive's database, or put a copy back in its place.
    #[command(subcommand)]
    Archive(archive::ArchiveCommand),
    /// What the archive has of a night.
    #[command(subcommand)]
    Night(night::NightCommand),
    /// Prove FITS files for an archive, and make the copies that it accepts.
    #[command(subcommand)]
    Fits(fits_files::FitsCommand),
    /// Let people and programs use the page and the API, and say what each may do.
    #[command(subcommand)]
    User(user::UserCommand),
    /// Print what is published on the bus.
    Tail(tail::Options),
    /// Sky, noise, width and stars of FITS images.
    Measure(images::measure::Options),
    /// How far the stars moved from one FITS image to another.
    Shift(images::shift::Options),
    /// Which piece of the sky FITS images show.
    Solve(images::solve::Options),
    /// Where the focus is, from FITS images taken at several positions.
    Focus(images::focus::Options),
    /// Star catalogues: make one of what you have.
    #[command(subcommand)]
    Catalogue(catalogues::CataloguesCommand),
    /// Make observatory.toml, header table and schedule of a site's files of Astra.
    ImportAstra(import::Options),
    /// Find Alpaca devices on the network and print them as blocks for observatory.toml.
    Discover(discover::Options),
    /// Serve a simulated observatory over Alpaca.
    Simulator(simulate::Options),
    /// Run one node in this process.
    Node {
        /// Which one.
        role: NodeRole,
        #[command(flatten)]
        options: node::NodeOptions,
    },
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum NodeRole {
    Device,
    Observatory,
    Archive,
    Web,
}

fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Node { role, options } => return node(role, options),
        Command::Demo(options) => block_on(demo::run(options)),
        Command::Init(options) => block_on(init::run(options)),
        Command::Up(options) => block_on(up::run(options)),
        Command::Check(options) => block_on(check::run(options)),
        Command::Plan(options) => plan::run(&options),
        Command::Actions(options) => actions::run(&options),
        Command::Status(options) => block_on(status::run(options)),
        Command::Order(options) => block_on(order::run(options)),
        Command::Schedule(command) => block_on(schedules::run(command)),
        Command::Audit(options) => audit::run(options),
        Command::Archive(command) => block_on(archive::run(command)),
        Command::Night(command) => block_on(night::run(command)),
        Command::Fits(command) => fits_files::run(&command),
        Command::User(command) => user::run(command),
        Command::Tail(options) => block_on(tail::run(options)),
        Command::Measure(options) => images::measure::run(&options),
        Command::Shift(options) => images::shift::run(&options),
        Command::Solve(options) => images::solve::run(&options),
        Command::Focus(options) => images::focus::run(&options),
        Command::Catalogue(command) => block_on(catalogues::run(command)),
        Command::ImportAstra(options) => block_on(import::run(options)),
        Command::Discover(options) => block_on(discover::run(options)),
        Command::Simulator(options) => block_on(simulate::run(options)),
    };
    let failed = result.err().filter(|error| !console::reader_has_gone(error));
    if let Some(error) = &failed {
        node::lines::complain(format_args!("starmesh: {error:#}"));
    }
    node::lines::flush();
    if failed.is_some() { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

fn node(role: NodeRole, options: node::NodeOptions) -> ExitCode {
    match role {
        NodeRole::Device => node_device::main(options),
        NodeRole::Observatory => node::start::main(options, Role::Observatory, node_observatory::run),
        NodeRole::Archive => node::start::main(options, Role::Archive, node_archive::run),
        NodeRole::Web => node::start::main(options, Role::Web, node_web::run),
    }
}

fn block_on(work: impl Future<Output = anyhow::Result<()>>) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let done = runtime.block_on(work);
    // What had to be on disk was waited for; what still waits for a disk that hangs keeps no process alive.
    runtime.shutdown_timeout(Duration::from_secs(5));
    done
}
