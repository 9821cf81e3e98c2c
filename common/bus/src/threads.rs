//! Gives zenoh enough threads that a dead peer holds up nobody else.
//!
//! zenoh 1.10.2 opens its TCP links with SO_LINGER of 10 s and closes them on a thread of its runtimes, which have one
//! or two each. A link to a host whose cable was pulled has bytes that nobody acknowledges, so that close blocks its
//! thread, and with it all other links: 7 s without a permit were measured (tests/faults, "cable pulled"). Where the
//! sockets can be reached, `links.rs` switches that off a moment after a link opens; these threads are for the moments
//! before, and for all other places. Only the environment of the process can set their number, before its first thread.

/// What zenoh reads.
const VARIABLE: &str = "ZENOH_RUNTIME";
/// A few links may die at once.
const THREADS: &str = "(rx: (worker_threads: 4), tx: (worker_threads: 4), net: (worker_threads: 4), \
    acc: (worker_threads: 2), app: (worker_threads: 2))";

/// Starts this very process anew with the variable set, unless it is set; returns only where that is not needed, or
/// not possible.
pub fn ensure() {
    if std::env::var_os(VARIABLE).is_none() {
        restart();
    }
}

#[cfg(unix)]
fn restart() {
    use std::os::unix::process::CommandExt as _;
    let Ok(program) = std::env::current_exe() else { return };
    // The same process: its id, its parent and its open files stay.
    let failed = std::process::Command::new(program).args(std::env::args_os().skip(1)).env(VARIABLE, THREADS).exec();
    eprintln!("the threads of the bus stay as zenoh has them: {failed}");
}

#[cfg(not(unix))]
fn restart() {}
