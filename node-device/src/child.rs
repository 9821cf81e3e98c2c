//! How this program starts a device node as a process of its own.

use std::process::Stdio;

use node::NodeOptions;
use tokio::process::{Child, Command};

/// A device node ends within this time after it was asked to, an open enclosure included (docs/deploy.md).
pub const END_LIMIT: std::time::Duration = std::time::Duration::from_secs(300);

/// A command of this program that runs the device node `id` with the options of this process.
///
/// The node gets a process group of its own, so that Ctrl-C in a terminal reaches the process that supervises it, and
/// that process alone decides in which order nodes end.
pub fn command(options: &NodeOptions, id: &str) -> anyhow::Result<Command> {
    let program = node::runs::program()?;
    let mut command = Command::new(program);
    command.args(["node", "device", "--id", id, "--config"]).arg(&options.config);
    for (flag, values) in [("--listen", &options.listen), ("--connect", &options.connect)] {
        for value in values {
            command.args([flag, value]);
        }
    }
    if options.no_multicast {
        command.arg("--no-multicast");
    }
    if options.with_parent {
        command.arg("--with-parent");
    }
    own_group(&mut command);
    command.stdin(Stdio::piped());
    Ok(command)
}

#[cfg(unix)]
fn own_group(command: &mut Command) {
    command.process_group(0);
}

#[cfg(windows)]
fn own_group(command: &mut Command) {
    const CREATE_NEW_PROCESS_GROUP: u32 = 0x200;
    command.creation_flags(CREATE_NEW_PROCESS_GROUP);
}

#[cfg(not(any(unix, windows)))]
fn own_group(_: &mut Command) {}

/// Asks a process to end: closes its standard input, and sends SIGTERM where there are signals.
pub fn ask_to_end(child: &mut Child) {
    drop(child.stdin.take());
    #[cfg(unix)]
    if let Some(pid) = child.id().and_then(|id| i32::try_from(id).ok()).and_then(rustix::process::Pid::from_raw) {
        // It may have ended just now; then there is nobody to ask.
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
    }
}
