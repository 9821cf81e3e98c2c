//! The device node as a program of its own.

use std::process::ExitCode;

fn main() -> ExitCode {
    bus::node::main(contract::Role::Device, node_device::run)
}
