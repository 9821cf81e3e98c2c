//! The command line: try it, run it, look at it.

mod audit;
mod check;
mod console;
mod demo;
mod discover;
mod join;
mod order;
mod simulate;
mod status;
mod supervise;
mod tail;
mod up;

use std::process::ExitCode;

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
    /// A whole simulated night: simulator, all four nodes as processes, and the page.
    Demo(demo::Options),
    /// Start and supervise the nodes of one telescope.
    Up(up::Options),
    /// Prove a configuration and say what is wrong with it.
    Check(check::Options),
    /// One table of all telescopes on the bus.
    Status(status::Options),
    /// Close, stay closed, start, stop, or do without a limit for a while.
    Order(order::Options),
    /// Prove and print the records of what was ordered and moved.
    Audit(audit::Options),
    /// Print what is said on the bus.
    Tail(tail::Options),
    /// Find Alpaca devices on the network and print them as blocks for observatory.toml.
    Discover(discover::Options),
    /// Serve a simulated observatory over Alpaca.
    Simulator(simulate::Options),
    /// Run one node in this process.
    Node {
        /// Which one.
        role: NodeRole,
        #[command(flatten)]
        options: bus::NodeOptions,
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
        Command::Up(options) => block_on(up::run(options)),
        Command::Check(options) => check::run(&options),
        Command::Status(options) => block_on(status::run(options)),
        Command::Order(options) => block_on(order::run(options)),
        Command::Audit(options) => audit::run(options),
        Command::Tail(options) => block_on(tail::run(options)),
        Command::Discover(options) => block_on(discover::run(options)),
        Command::Simulator(options) => block_on(simulate::run(options)),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if console::reader_has_gone(&error) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("starmesh: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn node(role: NodeRole, options: bus::NodeOptions) -> ExitCode {
    match role {
        NodeRole::Device => bus::node::main_with(options, Role::Device, node_device::run),
        NodeRole::Observatory => bus::node::main_with(options, Role::Observatory, node_observatory::run),
        NodeRole::Archive => bus::node::main_with(options, Role::Archive, node_archive::run),
        NodeRole::Web => bus::node::main_with(options, Role::Web, node_web::run),
    }
}

fn block_on(work: impl Future<Output = anyhow::Result<()>>) -> anyhow::Result<()> {
    tokio::runtime::Builder::new_multi_thread().enable_all().build()?.block_on(work)
}
