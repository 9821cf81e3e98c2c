//! The web node as a process of its own.

use std::process::ExitCode;

fn main() -> ExitCode {
    bus::node::main(contract::Role::Web, node_web::run)
}
