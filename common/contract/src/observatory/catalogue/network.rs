//! Alerts of nodes, clocks and what they were started with.

use super::super::Priority;
use super::super::catalogue_entry::{AlertEntry, HIGH, PLAIN};

pub(super) const NO_LEASE: AlertEntry = AlertEntry {
    word: "no-lease",
    consequence: "Nothing can be opened or moved.",
    action: "Look at the device node that serves the dome or, without one, the mount.",
    hold_s: 10,
    ..HIGH
};

pub(super) const LEASE_COUNT_LOST: AlertEntry = AlertEntry {
    word: "lease-count-lost",
    instance: "TELESCOPE",
    consequence: "The night goes on. What else was in that data folder is lost, too: frames that no archive had, the node's audit log.",
    action: "Look whether the data folder of the device node that serves the dome or, without one, the mount was emptied or replaced by an older copy, or its disk is not mounted.",
    ..PLAIN
};

pub(super) const NODE_SILENT: AlertEntry = AlertEntry {
    word: "node-silent",
    instance: "ROLE/NODE",
    consequence: "The values that it published last are no longer true.",
    action: "Look at its host and restart it.",
    on_delay_s: 15,
    ..HIGH
};

pub(super) const NODE_ENDS: AlertEntry = AlertEntry {
    word: "node-ends",
    instance: "ROLE/NODE",
    consequence: "It was started again. What it does rests until it runs, and after each further end for longer.",
    action: "Read its lines before each end in the log, correct what they name, and look at the memory of its host.",
    ..HIGH
};

pub(super) const CLOCKS_DISAGREE: AlertEntry = AlertEntry {
    word: "clocks-disagree",
    consequence: "The Sun counts as up, and an override as over, if it is by any of them.",
    action: "Set the wrong clock right; on a single machine then remove clock-TELESCOPE.json and restart the observatory node.",
    ..HIGH
};

pub(super) const SECOND_WRITER: AlertEntry = AlertEntry {
    word: "second-writer",
    instance: "KIND/DEVICE",
    consequence: "Its state and its commands are unsure.",
    action: "Stop one of the two device nodes, or give the device to one of them (node = ...).",
    ..HIGH
};

pub(super) const TWIN: AlertEntry = AlertEntry {
    word: "twin",
    consequence: "Both go on: what they say is mixed.",
    action: "End one of them, or give it another name with --id. If there is no second one, look who else is on the network.",
    ..HIGH
};

pub(super) const IMPOSTOR: AlertEntry = AlertEntry {
    word: "impostor",
    instance: "WHAT",
    consequence: "What was not granted has no effect. Where two say different things, the safer counts.",
    action: "Find the second program, and end it: another node with the same name, a test, or a stranger on the network.",
    hold_s: 60,
    ..HIGH
};

pub(super) const ALERT_NOT_SENT: AlertEntry = AlertEntry {
    word: "alert-not-sent",
    instance: "RECEIVER",
    consequence: "The people who read there get no alerts.",
    action: "Look at `[alerts]` in observatory.toml, at the network and at the receiver. It is tried again by itself.",
    ..HIGH
};

/// Whoever subscribes a device names its push service: that it does not answer wakes nobody.
pub(super) const PUSH_NOT_SENT: AlertEntry = AlertEntry {
    word: "push-not-sent",
    instance: "RECEIVER",
    priority: Priority::Medium,
    consequence: "The person gets no alerts on that device.",
    action: "On the device, switch the alerts off and on again in the settings of the page. It is tried again by itself.",
    ..PLAIN
};

pub(super) const CONFIGURATION: AlertEntry = AlertEntry {
    word: "configuration",
    instance: "KEY",
    priority: Priority::High,
    consequence: "What this key is for is done in the default way, or not at all, as the alert says.",
    action: "Correct what the alert names; `starmesh check observatory.toml` shows the line. Then restart the node.",
    ..PLAIN
};

pub(super) const CATALOGUE_UNUSABLE: AlertEntry = AlertEntry {
    word: "catalogue",
    consequence: "Frames are measured but not solved: no coordinates, no zero point, no check of the pointing.",
    action: "Put the file there, or take the key out of the configuration for the catalogue that is shipped.",
    ..PLAIN
};

pub(super) const SITE_SCRIPT: AlertEntry = AlertEntry {
    word: "site-script",
    instance: "FUNCTION",
    consequence: "Closing goes on by default. What the script was to open stays closed or is closed again, and the row rests.",
    action: "Look at what the cause says of the devices; correct the script, prove it with starmesh check, restart the observatory node.",
    ..HIGH
};
