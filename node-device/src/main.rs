//! The device node as a program of its own.

use std::process::ExitCode;

use clap::Parser as _;

fn main() -> ExitCode {
    node_device::main(bus::NodeOptions::parse(), &[])
}
