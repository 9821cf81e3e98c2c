//! Starts one archive node.

use std::process::ExitCode;

fn main() -> ExitCode {
    bus::node::main(contract::Role::Archive, node_archive::run)
}
