//! `starmesh node device` without `--id`: every device node of the file, each as a process of its own.

use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use node::restart::{self, Pauses};
use node::watchdog::{self, Watchdog};
use node::{NodeOptions, Stop, lines};
use tokio::process::Child;
use tokio::task::JoinSet;

use crate::child::{self, END_LIMIT};

/// A device node that keeps ending is started again after at most this time; an enclosure has no permit meanwhile.
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// A file that could not be read is read again so often.
const READ_AGAIN: Duration = Duration::from_secs(5);

/// Runs all device nodes of the file until a signal; then ends them one after another, enclosures first, because one
/// that waits for the mount needs the mount's node until it is closed. If a file cannot be read, the enclosure's
/// node runs, whose guard process knows what last worked; the others follow when it can be read.
pub fn main(options: &NodeOptions) -> ExitCode {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let ended = runtime.context("cannot start the runtime").and_then(|runtime| runtime.block_on(run(options)));
    if let Err(error) = &ended {
        lines::complain(format_args!("node-device: {error:#}"));
    }
    lines::flush();
    if ended.is_ok() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// One node.
struct RunningNode {
    id: String,
    stop: Stop,
    tasks: JoinSet<bool>,
}

async fn run(options: &NodeOptions) -> anyhow::Result<()> {
    let mut nodes: Vec<RunningNode> = Vec::new();
    let asked = async {
        tokio::select! {
            () = node::signals::end_asked() => {}
            () = node::signals::parent_end(), if options.with_parent => {}
        }
    };
    tokio::pin!(asked);
    let mut complaint = String::new();
    loop {
        let is_whole = match read(options) {
            Ok(ids) => {
                start_missing(&mut nodes, options, &ids);
                true
            }
            Err(error) => {
                start_missing(&mut nodes, options, &[(config::ENCLOSURE_NODE.to_owned(), true)]);
                if complaint != error {
                    lines::complain(format_args!(
                        "node-device: {error}; what last worked guards the enclosure, and the file is read again"
                    ));
                    complaint = error;
                }
                false
            }
        };
        tokio::select! {
            () = &mut asked => break,
            () = alive_for(if is_whole { Duration::MAX } else { READ_AGAIN }) => {}
        }
    }
    lines::complain(format_args!(
        "node-device: ending; an open enclosure is closed first, which takes up to {} s",
        END_LIMIT.as_secs()
    ));
    let ending = async {
        let mut failed = false;
        for RunningNode { stop, mut tasks, .. } in nodes {
            stop.stop();
            while let Some(ended) = tasks.join_next().await {
                failed |= !matches!(ended, Ok(true));
            }
        }
        failed
    };
    let alive = async {
        loop {
            alive_for(READ_AGAIN).await;
        }
    };
    tokio::select! {
        failed = ending => if failed {
            bail!("a device node did not end in good order; the reason is in its lines above")
        } else {
            Ok(())
        },
        () = node::signals::termination() => bail!("ended at once by a second signal; look whether the enclosures are closed"),
        () = alive => Ok(()),
    }
}

/// Reports to the service manager that this process is alive, for so long.
async fn alive_for(time: Duration) {
    let began = Instant::now();
    while began.elapsed() < time {
        node::service_manager::alive();
        tokio::time::sleep(time.saturating_sub(began.elapsed()).min(Duration::from_secs(5))).await;
    }
}

/// The device nodes of the file, enclosures first; true: it serves an enclosure.
fn read(options: &NodeOptions) -> Result<Vec<(String, bool)>, String> {
    let config = node::configuration::read_observatory(&options.config).map_err(|error| format!("{error:#}"))?;
    let is_enclosure = |id: &str| config.served_by(id).iter().any(|(kind, _)| *kind == contract::Kind::Dome);
    let ids = config.device_nodes().into_iter().map(|id| (id.to_owned(), is_enclosure(id)));
    let ids: Vec<(String, bool)> = ids.collect();
    let names = |id: &str| config.served_by(id).iter().map(|(_, common)| common.name.to_string()).collect::<Vec<_>>();
    let listed: Vec<String> = ids.iter().map(|(id, _)| format!("{id} ({})", names(id).join(", "))).collect();
    lines::complain(format_args!(
        "node-device: each device node runs as a process of its own: {}; --id starts one alone",
        listed.join(", ")
    ));
    Ok(ids)
}

fn start_missing(nodes: &mut Vec<RunningNode>, options: &NodeOptions, ids: &[(String, bool)]) {
    for (id, is_enclosure) in ids {
        if nodes.iter().any(|node| node.id == *id) {
            continue;
        }
        let (stop, mut tasks) = (Stop::default(), JoinSet::new());
        // An enclosure's node survives this process, however that ends; the others do not.
        let options = NodeOptions { with_parent: options.with_parent || !is_enclosure, ..options.clone() };
        let (own_id, stopped) = (id.clone(), stop.clone());
        tasks.spawn(async move { keep(&options, &own_id, stopped).await });
        nodes.push(RunningNode { id: id.clone(), stop, tasks });
    }
}

/// Runs one node and starts it again, also after a start that failed; true where it ended in good order after it was asked
/// to.
async fn keep(options: &NodeOptions, id: &str, stop: Stop) -> bool {
    run_again(id, &stop, || run_once(options, id, &stop), tokio::time::sleep).await
}

async fn run_again<R: Future<Output = Result<bool, String>>, P: Future<Output = ()>>(
    id: &str,
    stop: &Stop,
    run: impl Fn() -> R,
    sleep: impl Fn(Duration) -> P,
) -> bool {
    let mut pauses = Pauses::default();
    loop {
        let started = Instant::now();
        let status = match run().await {
            Ok(in_good_order) => return in_good_order,
            Err(status) => status,
        };
        let pause = pauses.after(started.elapsed(), LONGEST_PAUSE);
        let next = restart::words(pause);
        lines::complain(format_args!("node-device: the device node {id} ended ({status}); next start {next}"));
        if stop.or(sleep(pause)).await.is_none() {
            return true;
        }
    }
}

/// Runs one node until it is asked to end: true where it then ended in good order. An error says how it ended without being
/// asked to, or why it was not started.
async fn run_once(options: &NodeOptions, id: &str, stop: &Stop) -> Result<bool, String> {
    let watchdog = Watchdog::open();
    let spawned = spawn(options, id, watchdog.as_ref().ok());
    let mut child = spawned.map_err(|error| format!("it was not started: {error:#}"))?;
    // Waiting would close it, and the node would take that for our end.
    let lifeline = child.stdin.take();
    let Some(ended) = stop.or(watchdog::ended(&mut child, &watchdog)).await else {
        child::ask_to_end(&mut child);
        let ended = tokio::time::timeout(END_LIMIT + Duration::from_secs(10), child.wait()).await;
        drop(lifeline);
        return Ok(matches!(ended, Ok(Ok(status)) if status.success()));
    };
    Err(match ended {
        Some(ended) => ended.map_or_else(|error| error.to_string(), |status| status.to_string()),
        None => match child.kill().await {
            Ok(()) => "it hung, and was killed".to_owned(),
            Err(error) => format!("it hung, and cannot be killed: {error}"),
        },
    })
}

fn spawn(options: &NodeOptions, id: &str, watchdog: Option<&Watchdog>) -> anyhow::Result<Child> {
    let mut command = child::command(options, id)?;
    match watchdog {
        Some(watchdog) => command.env(watchdog::SOCKET, watchdog.path()),
        None => command.env_remove(watchdog::SOCKET),
    };
    command.kill_on_drop(options.with_parent).spawn().context("cannot start this program again")
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;

    #[tokio::test]
    async fn a_device_node_that_ends_at_once_is_started_again_after_pauses_that_grow_to_five_seconds() {
        let (stop, paused_s) = (Stop::default(), RefCell::new(Vec::new()));
        let run = || std::future::ready(Err("exit status: 1".to_owned()));
        let pause = |pause: Duration| {
            paused_s.borrow_mut().push(pause.as_secs());
            if paused_s.borrow().len() == 5 {
                stop.stop();
            }
            std::future::ready(())
        };
        assert!(run_again("enclosure", &stop, run, pause).await, "it was asked to end");
        assert_eq!(*paused_s.borrow(), [1, 2, 4, 5, 5]);
    }
}
