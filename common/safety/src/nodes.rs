//! The machines that the night rests on: whether their clocks agree with this one's, and whether their disks have room.
//!
//! Neither opens nor closes anything: a wrong clock or a full disk spoils frames, so none are taken meanwhile.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use contract::node::{MOUNT_CLOCK_OFFSET_S, NodeState};
use units::MachineTime;
use units::Utc;

/// The begin of the inputs that stand for nodes.
pub const NODE_INPUT: &str = "node/";

/// A node that was silent for so long does not count, machine time.
const SILENT: Duration = Duration::from_secs(30);
/// An offset is judged from this many messages: what comes from a cache, or late, looks like a slow clock.
const MESSAGES: usize = 3;
/// Figure of a node's state: free room of its data folder, GB.
pub const DATA_FREE: &str = "data_free_gb";

/// What is known of each node.
#[derive(Debug, Clone, Default)]
pub struct Nodes {
    reports: BTreeMap<String, NodeReport>,
}

/// A clock other than this one.
#[derive(Debug, Clone, PartialEq)]
pub struct Witness {
    /// Whose.
    pub clock: String,
    /// By how much it is ahead of this node's wall clock, s.
    pub offset_s: f64,
    /// It is not the wall clock of this machine.
    pub of_other_machine: bool,
    /// It is a mount's.
    pub is_mount: bool,
}

#[derive(Debug, Clone, Default)]
struct NodeReport {
    host: String,
    mounts: Vec<(String, f64)>,
    offsets_s: VecDeque<f64>,
    data_free_gb: Option<f64>,
    at: Option<MachineTime>,
}

/// A complaint against exposing.
#[derive(Debug, Clone, PartialEq)]
pub struct Complaint {
    /// Which node: `node/callisto/device/main`.
    pub input: String,
    /// Why.
    pub why: String,
}

impl Nodes {
    /// Takes in the state of a node (`callisto/device/main`): `sent` is its own stamp, `own` this clock when it
    /// arrived.
    pub fn observe(&mut self, node: String, state: &NodeState, sent: Utc, own: Utc, now: MachineTime) {
        let report = self.reports.entry(node).or_default();
        // Sky time runs at its speed, and two clocks of one simulation part at that speed too.
        report.offsets_s.push_back(sent.seconds_since(own) / state.speed.max(1.0));
        if report.offsets_s.len() > MESSAGES {
            report.offsets_s.pop_front();
        }
        report.data_free_gb = state.figures.get(DATA_FREE).and_then(contract::Scalar::number);
        report.host = state.host.clone();
        let mounts = state.figures.iter().filter_map(|(name, value)| {
            let offset_s = value.number().filter(|s| s.is_finite())?;
            Some((name.strip_suffix(MOUNT_CLOCK_OFFSET_S)?.to_owned(), offset_s))
        });
        report.mounts = mounts.collect();
        report.at = Some(now);
    }

    /// The clocks of nodes that published lately, and of their mounts; `host` is this machine.
    pub fn witnesses(&self, host: &str, now: MachineTime) -> Vec<Witness> {
        let mut witnesses = Vec::new();
        for (node, report) in &self.reports {
            let lately = report.at.is_some_and(|at| now.since(at) <= SILENT);
            let Some(offset_s) = report.offset_s().filter(|_| lately) else { continue };
            let of_other_machine = report.host != host;
            let clock = format!("the clock of node {node}");
            witnesses.push(Witness { clock, offset_s, of_other_machine, is_mount: false });
            for (mount, mount_s) in &report.mounts {
                let (clock, offset_s) = (format!("the clock of mount {mount}"), offset_s + mount_s);
                witnesses.push(Witness { clock, offset_s, of_other_machine: true, is_mount: true });
            }
        }
        witnesses
    }

    /// The complaints against exposing, about nodes that published lately.
    pub fn complaints(&self, offset_max_s: f64, free_min_gb: f64, now: MachineTime) -> Vec<Complaint> {
        let mut complaints = Vec::new();
        for (node, report) in &self.reports {
            if report.at.is_none_or(|at| now.since(at) > SILENT) {
                continue;
            }
            let mut complain = |why: String| complaints.push(Complaint { input: format!("{NODE_INPUT}{node}"), why });
            if let Some(offset_s) = report.offset_s().filter(|offset_s| offset_s.abs() > offset_max_s) {
                complain(format!("its clock is {offset_s:+.1} s off this one's, allowed are {offset_max_s} s"));
            }
            if let Some(free_gb) = report.data_free_gb.filter(|free_gb| *free_gb < free_min_gb) {
                complain(format!("its data folder has {free_gb:.2} GB left, needed are {free_min_gb} GB"));
            }
        }
        complaints
    }
}

impl NodeReport {
    /// By how much the node's clock is ahead, s; messages only come late, so the largest difference is the truest.
    fn offset_s(&self) -> Option<f64> {
        (self.offsets_s.len() == MESSAGES).then(|| self.offsets_s.iter().copied().fold(f64::MIN, f64::max))
    }
}

#[cfg(test)]
mod tests {
    use contract::{Role, Scalar};

    use super::*;

    fn state(free_gb: Option<f64>) -> NodeState {
        NodeState {
            role: Role::Device,
            version: String::new(),
            host: String::new(),
            pid: 1,
            uptime_s: 1.0,
            speed: 1.0,
            figures: free_gb.map(|free| (DATA_FREE.to_owned(), Scalar::Float(free))).into_iter().collect(),
            stopped: None,
        }
    }

    /// What is complained of after messages with these differences between their stamp and the arrival.
    fn complaints(differences_s: &[f64], free_gb: Option<f64>, later_s: u64) -> Vec<String> {
        let mut nodes = Nodes::default();
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        for difference_s in differences_s {
            let own = Utc::from_seconds(1e9);
            nodes.observe(
                "callisto/device/main".to_owned(),
                &state(free_gb),
                own.plus_seconds(*difference_s),
                own,
                at(0),
            );
        }
        nodes.complaints(2.0, 1.0, at(later_s)).into_iter().map(|complaint| complaint.why).collect()
    }

    #[test]
    fn a_clock_that_is_off_is_reported_and_a_late_message_is_no_slow_clock() {
        assert_eq!(complaints(&[-0.01, -4.0, -0.02], None, 1), Vec::<String>::new());
        assert_eq!(complaints(&[-4.0, -4.1], None, 1), Vec::<String>::new(), "too few to judge");
        assert!(complaints(&[-3600.0, -3600.1, -3604.0], None, 1)[0].contains("-3600.0 s off"));
        assert!(complaints(&[2.5, 2.5, 2.4], None, 1)[0].contains("+2.5 s off"));
        assert_eq!(complaints(&[2.5, 2.5, 2.4], None, 31), Vec::<String>::new(), "silent");
    }

    #[test]
    fn a_disk_that_is_almost_full_is_reported() {
        assert!(complaints(&[0.0], Some(0.4), 1)[0].contains("0.40 GB left"));
        assert_eq!(complaints(&[0.0], Some(1.4), 1), Vec::<String>::new());
        assert_eq!(complaints(&[0.0], Some(f64::NAN), 1), Vec::<String>::new());
    }
}
