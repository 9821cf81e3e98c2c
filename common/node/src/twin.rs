//! One node of a role and id per telescope: a second one is reported, and on one host the younger leaves.
//!
//! No sample on the bus ends a node: anybody may publish there. A node leaves only to a process that this host itself
//! shows, and that was started before it, by the host's own count.

use std::path::Path;
use std::time::Duration;

use anyhow::bail;
use bus::{Bus, Catch};
use contract::node::NodeState;
use contract::observatory::AlertKind;
use contract::{Key, Name};

use crate::alerts::NodeAlerts;
use crate::host::host_name;

/// A node publishes its state every 5 s; a twin that was silent for three of them is gone.
const GONE: Duration = Duration::from_secs(15);

/// Listens for a twin for ever; ends with an error when an older one runs on this host. `key` is that of the state of
/// this node, `id` its name.
pub async fn leave_to_older(key: &Key, id: &Name, bus: &Bus, alerts: &NodeAlerts) -> anyhow::Result<()> {
    let states = bus.subscribe::<NodeState>(key, Catch::Newest, 8).await?;
    let (own, clock) = (bus.boot_id(), bus.clock());
    let mut foreign = None;
    loop {
        if let Ok(received) = tokio::time::timeout(GONE, states.recv()).await
            && received.sample.boot_id != *own
            && received.sample.body.stopped.is_none()
        {
            let NodeState { role, host, pid, .. } = &received.sample.body;
            let cause = format!("another {role} node with id \"{id}\" runs on host \"{host}\"");
            if *host == host_name() && is_older_twin(Path::new("/proc"), std::process::id(), *pid) {
                bail!("{cause} as process {pid}; end it, or give this one another name with --id");
            }
            foreign = Some(clock.machine());
            alerts.raise(AlertKind::Twin, "", &cause);
        }
        if foreign.is_some_and(|at| clock.machine().since(at) > GONE) {
            foreign = None;
            alerts.clear(AlertKind::Twin, "");
        }
    }
}

/// Does a process run here with the very same command line, which was started before this one and is not stopped? Where
/// the host does not show its processes, no.
fn is_older_twin(processes: &Path, own: u32, other: u32) -> bool {
    let words = |pid: u32| std::fs::read(processes.join(pid.to_string()).join("cmdline")).ok().map(arguments);
    let started = |pid: u32| {
        let text = std::fs::read_to_string(processes.join(pid.to_string()).join("stat")).ok()?;
        // The name is in parentheses and may hold spaces; after it the state is the first word, the start the 20th.
        let mut rest = text.rsplit_once(')')?.1.split_whitespace();
        let is_stopped = matches!(rest.next()?, "T" | "t" | "Z" | "X");
        let at: u64 = rest.nth(18)?.parse().ok()?;
        Some((is_stopped, at))
    };
    let same = words(own).is_some_and(|own| !own.is_empty() && words(other) == Some(own));
    match (started(own), started(other)) {
        (Some((_, own_start)), Some((false, other_start))) if own != other && same => {
            (other_start, other) < (own_start, own)
        }
        _ => false,
    }
}

/// The words of a command line that say which node it is: role, configuration and id, and not where it listens.
fn arguments(line: Vec<u8>) -> Vec<Vec<u8>> {
    let words: Vec<Vec<u8>> = line.split(|byte| *byte == 0).skip(1).map(<[u8]>::to_vec).collect();
    let mut retained = Vec::new();
    let mut skip = false;
    for word in words {
        let takes_value = word == b"--listen" || word == b"--connect";
        if !skip && !takes_value {
            retained.push(word);
        }
        skip = takes_value;
    }
    retained
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A host that shows these processes: number, state, start, command line.
    fn host(shows: &[(u32, &str, u64, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (pid, state, start, line) in shows {
            let at = folder.path().join(pid.to_string());
            std::fs::create_dir(&at).unwrap();
            let between = ["0"; 18].join(" ");
            std::fs::write(at.join("stat"), format!("{pid} (a (name) of) {state} {between} {start} 0 0")).unwrap();
            std::fs::write(at.join("cmdline"), line.replace(' ', "\0")).unwrap();
        }
        folder
    }

    #[test]
    fn a_node_leaves_only_to_a_process_that_this_host_shows() {
        let own = "starmesh node device --id dome --config a.toml --listen tcp/1";
        let twin = "starmesh node device --id dome --config a.toml --listen tcp/2";
        for (other, leaves, why) in [
            (Some((7, "S", 90, twin)), true, "it was started before"),
            (Some((7, "S", 110, twin)), false, "it was started later"),
            (Some((7, "S", 100, twin)), true, "in the same moment the smaller number stays"),
            (Some((7, "T", 90, twin)), false, "a process that is stopped serves nothing"),
            (Some((7, "S", 90, "starmesh node device --id main --config a.toml")), false, "another node"),
            (Some((7, "S", 90, "sleep 1000")), false, "an innocent process that somebody names"),
            (None, false, "there is no such process"),
        ] {
            let mut shows = vec![(8, "S", 100, own)];
            shows.extend(other);
            assert_eq!(is_older_twin(host(&shows).path(), 8, 7), leaves, "{why}");
        }
        assert!(!is_older_twin(host(&[(8, "S", 100, own)]).path(), 8, 8), "itself");
        assert!(!is_older_twin(Path::new("/absent"), 8, 7));
    }
}
