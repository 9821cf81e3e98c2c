//! The observatory node as a program of its own.

fn main() -> std::process::ExitCode {
    bus::node::main(contract::Role::Observatory, node_observatory::run)
}
