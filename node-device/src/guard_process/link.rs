//! What the guard process and the device node send each other through the node's standard input and output.
//!
//! The node writes one line for each beat of its guard's own loop; a thread of its own writes, so that a guard process
//! that does not read holds nothing up. The guard process writes `end` when the node is to close and leave; the end of
//! the input means that the guard process has died.

use std::io::{BufRead as _, Write as _};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use bus::MachineTime;
use interlock::{Deadlines, DomeReport, Report, nanos};
use node::Stop;
use tokio::io::{AsyncWriteExt as _, BufReader, Lines};
use tokio::process::{ChildStdin, ChildStdout};

/// The order to close and leave.
pub const END: &str = "end";
/// The guard process and its node read the same boot-time clock; on other systems each counts from its own start.
pub const SHARES_CLOCK: bool = cfg!(target_os = "linux");
/// The variable with the times until which the node's domes may be open.
pub const DEADLINES: &str = "STARMESH_OPEN_UNTIL_NS";

/// The deadlines as the variable has them.
pub fn deadlines_to_text(deadlines: &Deadlines) -> String {
    let each = deadlines.iter().map(|(dome, at)| format!("{dome}={}", nanos(*at)));
    each.collect::<Vec<_>>().join(",")
}

/// Until when a dome may be open, as the guard process has set it for this node.
pub fn deadline_of(dome: &str) -> Option<MachineTime> {
    deadline_in(&std::env::var(DEADLINES).ok()?, dome)
}

fn deadline_in(text: &str, dome: &str) -> Option<MachineTime> {
    let each = text.split(',').filter_map(|pair| pair.split_once('='));
    let found = each.filter(|(name, _)| *name == dome).find_map(|(_, ns)| ns.parse().ok());
    found.map(|ns| MachineTime::from_boot(Duration::from_nanos(ns)))
}

/// The node's side of the link.
#[derive(Clone)]
pub struct GuardLink {
    shared: Arc<NewestReport>,
    /// Set when the guard process has died.
    pub orphaned: Stop,
    /// Set when the guard process wants the node to close and end.
    pub asked_to_end: Stop,
}

struct NewestReport {
    newest: Mutex<(Report, bool)>,
    changed: Condvar,
}

impl GuardLink {
    /// Takes this process's standard input and output for the link.
    pub fn open() -> Self {
        let shared = Arc::new(NewestReport { newest: Mutex::default(), changed: Condvar::new() });
        let link = Self { shared: shared.clone(), orphaned: Stop::default(), asked_to_end: Stop::default() };
        let (orphaned, asked) = (link.orphaned.clone(), link.asked_to_end.clone());
        std::thread::spawn(move || {
            for line in std::io::stdin().lock().lines() {
                match line {
                    Ok(line) if line.trim() == END => asked.stop(),
                    Ok(_) => {}
                    Err(_) => break,
                }
            }
            orphaned.stop();
        });
        std::thread::spawn(move || write(&shared));
        link
    }

    /// Sends the state of a dome's guard, and the tokens that it knows. Never waits.
    pub fn publish(&self, dome: &str, report: DomeReport, tokens: impl IntoIterator<Item = (String, u64)>) {
        let mut newest = self.shared.newest.lock().unwrap_or_else(PoisonError::into_inner);
        newest.0.domes.insert(dome.to_owned(), report);
        newest.0.tokens.extend(tokens);
        newest.1 = true;
        self.shared.changed.notify_one();
    }

    /// What was sent last.
    pub fn last(&self) -> Report {
        self.shared.newest.lock().unwrap_or_else(PoisonError::into_inner).0.clone()
    }
}

/// Writes what is new, until nobody reads.
fn write(shared: &NewestReport) {
    loop {
        let report = {
            let guard = shared.newest.lock().unwrap_or_else(PoisonError::into_inner);
            let changed = shared.changed.wait_while(guard, |(_, is_new)| !*is_new);
            let mut newest = changed.unwrap_or_else(PoisonError::into_inner);
            newest.1 = false;
            newest.0.clone()
        };
        let Ok(line) = serde_json::to_string(&report) else { continue };
        let mut out = std::io::stdout().lock();
        if writeln!(out, "{line}").and_then(|()| out.flush()).is_err() {
            return;
        }
    }
}

/// The lines that the device node writes to the guard process; nothing once it has ended.
pub(super) type NodeLines = Option<Lines<BufReader<ChildStdout>>>;

/// The next line of the device node; none at its end, and never one after it.
pub(super) async fn next_line(lines: &mut NodeLines) -> Option<String> {
    let Some(reader) = lines else { return std::future::pending().await };
    let line = reader.next_line().await.ok().flatten();
    if line.is_none() {
        *lines = None;
    }
    line
}

/// Asks the node to end. Its line stays open for so long afterwards: to the node its end means that the guard process
/// has died.
pub async fn ask_to_end(mut orders: ChildStdin, open_for: Duration) {
    // It may have ended; then it needs no order.
    let _ = orders.write_all(format!("{END}\n").as_bytes()).await;
    let _ = orders.flush().await;
    tokio::time::sleep(open_for).await;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deadlines_pass_through_the_environment() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let text = deadlines_to_text(&[("a".to_owned(), at(1)), ("b".to_owned(), at(2))].into());
        assert_eq!(deadline_in(&text, "b"), Some(at(2)));
        assert_eq!(deadline_in(&text, "c"), None);
        assert_eq!(deadline_in("nonsense", "b"), None);
    }
}
