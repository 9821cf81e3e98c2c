//! A start of the device node, as far as it needs the disk: on a thread, because a disk that hangs must not hold up
//! what closes.

use std::sync::mpsc::{Receiver, sync_channel};

use anyhow::Context as _;
use bus::MachineTime;
use interlock::Deadlines;
use node::NodeOptions;
use tokio::process::Child;

use super::NODE_LOCK;
use super::copy::Copy;
use super::link::{DEADLINES, deadlines_to_text};
use super::places::Places;
use crate::child;

/// What came of it.
pub struct Ready {
    /// The copy of the configuration, or why there is none.
    pub copy: Result<Copy, String>,
    /// The node, or why it could not be started; none where another one has not ended yet.
    pub node: Option<anyhow::Result<Child>>,
}

/// Reads the configuration and starts the node; the answer comes when the disk has given all of it.
pub fn ask(
    options: &NodeOptions,
    id: &str,
    places: &Places,
    mut deadlines: Deadlines,
    now: MachineTime,
) -> Receiver<Ready> {
    let (sender, receiver) = sync_channel(1);
    let (options, id, places) = (options.clone(), id.to_owned(), places.clone());
    let runtime = tokio::runtime::Handle::current();
    std::thread::spawn(move || {
        let copy = match node::configuration::read_observatory(&options.config).map(|config| Copy::of(&config, &id)) {
            Ok(Some(copy)) => Ok(copy),
            Ok(None) => Err("the configuration names no dome for this device node any more".to_owned()),
            Err(error) => Err(format!("{error:#}")),
        };
        for dome in copy.iter().flat_map(|copy| &copy.domes) {
            deadlines.entry(dome.name.to_string()).or_insert_with(|| now.plus(dome.permit_valid()));
        }
        // A node that lost its guard process leaves as soon as it sees the new one.
        let may_start = copy.is_ok() && places.lock(NODE_LOCK).is_ok();
        let _within = runtime.enter();
        let node = may_start.then(|| spawn(&options, &id, &places, &deadlines));
        // The receiver is gone when this process ends.
        let _ = sender.send(Ready { copy, node });
    });
    receiver
}

fn spawn(options: &NodeOptions, id: &str, places: &Places, deadlines: &Deadlines) -> anyhow::Result<Child> {
    let mut command = child::command(options, id)?;
    command.arg("--guarded").env(DEADLINES, deadlines_to_text(deadlines));
    if let Some(file) = places.last_words() {
        command.env(node::start::LAST_WORDS, file);
    }
    command.env_remove("NOTIFY_SOCKET").stdout(std::process::Stdio::piped());
    command.spawn().context("cannot start the device node")
}
