//! What an observatory node writes down of the nodes that it has heard, for the one that starts after it.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use config::Observatory;
use contract::Role;
use node::Node;
use serde::{Deserialize, Serialize};

/// A node that no file names and that was not heard for so long was taken away for good.
pub(super) const EXPECTED_FOR_S: u64 = 7 * 86_400;

/// What is written of a node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Noted {
    /// The node, for people.
    pub(super) words: String,
    /// Empty where it was never heard; that is not written.
    pub(super) host: String,
    /// By the clock of this host, at most an hour before it was heard last, s since 1970.
    pub(super) heard_s: u64,
    /// It has reported that it will be silent.
    pub(super) ended_well: bool,
    /// The start of this host's kernel since which it is missed; empty while it is not.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub(super) missed_since: String,
}

/// Nodes by the instances of their alerts.
pub(super) type Record = BTreeMap<String, Noted>;

/// The file of the nodes that this one has heard.
pub(super) fn path(node: &Node) -> PathBuf {
    node.config.folders.data.join(format!("nodes-{}-{}.json", node.config.place.telescope, node.id))
}

/// The nodes that an earlier incarnation heard within the last days, as far as the file can be read.
pub(super) fn ran_before(config: &Observatory, file: &Path, now_s: u64) -> Record {
    let read = std::fs::read(file).map_err(|error| (error.kind() == ErrorKind::NotFound, error.to_string()));
    let read = read.and_then(|bytes| serde_json::from_slice(&bytes).map_err(|error| (false, error.to_string())));
    let mut known: Record = read.unwrap_or_else(|(is_first, why)| {
        if !is_first {
            node::aside::keep_copy(file, &why, "Of nodes that died before, only those of the file are missed.");
        }
        Record::default()
    });
    // A clock that is wrong, such as one that has begun in 1970, takes nobody away.
    known.retain(|_, noted| now_s <= noted.heard_s.saturating_add(EXPECTED_FOR_S));
    let here = node::host_name();
    for (instance, noted) in known.iter_mut().filter(|(_, noted)| noted.host == here) {
        // Under `starmesh up` these end after the observatory node, which does not hear it.
        let own = instance.split_once('/').filter(|(role, id)| *role != Role::Device.word() && !id.contains('/'));
        noted.ended_well |= own.is_some_and(|(role, id)| !node::runs::is_open(config, role, id));
    }
    known
}

/// Errors are logged: at the next start a node that is dead already is missed only if the file names it.
pub(super) fn write(file: &Path, record: &Record) {
    let written = serde_json::to_vec_pretty(record).map_err(std::io::Error::other);
    if let Err(error) = written.and_then(|bytes| node::private::write_whole(file, &bytes)) {
        tracing::warn!(file = %file.display(), %error, "the nodes that were heard cannot be written down");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The clock of this host.
    const NOW_S: u64 = 1_800_000_000;

    #[test]
    fn a_node_of_this_host_that_ended_well_after_the_observatory_node_is_not_expected_and_one_that_died_is() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("nodes.json");
        let config = config::parse(&test_support::ALPHA.replace("alpha", "callisto"), folder.path()).unwrap();
        let all = ["archive/main", "web/main", "device/main"];
        let noted = || Noted {
            words: "it".to_owned(),
            host: node::host_name(),
            heard_s: NOW_S,
            ended_well: false,
            missed_since: String::new(),
        };
        write(&file, &all.map(|instance| (instance.to_owned(), noted())).into());
        std::fs::create_dir_all(&config.folders.data).unwrap();
        std::fs::write(config.folders.data.join(".run-callisto-web-main"), "7").unwrap();
        let ended = ran_before(&config, &file, NOW_S);
        let ended: Vec<bool> = all.iter().map(|instance| ended[*instance].ended_well).collect();
        assert_eq!(ended, [true, false, false], "the file of the telescope names its device nodes");
    }
}
