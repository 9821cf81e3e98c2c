//! Alerts of domes, roofs and what guards them.

use super::super::Priority;
use super::super::catalogue_entry::{AlertEntry, HIGH, PLAIN};

pub(super) const WATCHDOG: AlertEntry = AlertEntry {
    word: "watchdog",
    instance: "DOME",
    consequence: "The dome will close by itself.",
    action: "Look at the dome's controller; compare watchdog_action with its manual.",
    ..HIGH
};

pub(super) const NO_WATCHDOG: AlertEntry = AlertEntry {
    word: "no-watchdog",
    instance: "DOME",
    consequence: "Nothing closes it when the host of its device node dies.",
    action: "Configure watchdog_s and watchdog_action, or give the dome a controller that has one.",
    ..PLAIN
};

pub(super) const DOME_NOT_CLOSED: AlertEntry = AlertEntry {
    word: "dome-not-closed",
    instance: "DOME",
    priority: Priority::Critical,
    consequence: "The telescope may stand in the weather.",
    action: "Close it by hand or at its own controls, or call the site. The closing goes on by itself.",
    ..PLAIN
};

pub(super) const DOME_UNCOMMANDED_OPEN: AlertEntry = AlertEntry {
    word: "dome-uncommanded-open",
    instance: "DOME",
    priority: Priority::Critical,
    consequence: "The guard closes it and holds it closed.",
    action: "Find out who opened it: another program, a handset, a person.",
    hold_s: 60,
    ..PLAIN
};

pub(super) const GUARD_PROCESS: AlertEntry = AlertEntry {
    word: "guard-process",
    instance: "DOME",
    priority: Priority::Critical,
    consequence: "Without its device node the enclosure is closed and stays closed. Without its guard process nothing closes it when its device node ends too.",
    action: "Correct what the cause names (starmesh check); then start the device node again.",
    ..PLAIN
};

pub(super) const DOME_WAITS_FOR_MOUNT: AlertEntry = AlertEntry {
    word: "dome-waits-for-mount",
    instance: "DOME",
    priority: Priority::Critical,
    consequence: "It stays open as long as its policy is parked_only.",
    action: "Park the mount, or make sure that the roof can pass it and close by hand.",
    ..PLAIN
};

pub(super) const DOME_NOT_TURNED: AlertEntry = AlertEntry {
    word: "dome-not-turned",
    instance: "DOME",
    consequence: "The sky is not exposed; rows wait and are tried again.",
    action: "Look at the dome's rotation, and whether `dome.follow` and `dome.slit` are right. It is tried again by itself.",
    ..HIGH
};

pub(super) const DOME_SHARED: AlertEntry = AlertEntry {
    word: "dome-shared",
    instance: "DOME",
    priority: Priority::Medium,
    consequence: "Nobody turns it: frames may show its wall.",
    action: "Set `follow = \"off\"` where the site turns it or it is a roof; else give each telescope a dome block of its own.",
    ..PLAIN
};

pub(super) const DOME_CONTRADICTS: AlertEntry = AlertEntry {
    word: "dome-contradicts",
    instance: "DOME",
    consequence: "Whether it is closed cannot be proven. It is asked to close again as soon as it must be closed.",
    action: "Look at the dome by camera or by eye; then look at its limit switches and at the program that serves it.",
    ..HIGH
};

pub(super) const DOME_HELD: AlertEntry = AlertEntry {
    word: "dome-held",
    instance: "DOME",
    consequence: "It opens for nobody until the commander resumes.",
    action: "Look why the observatory node was silent or unsafe.",
    ..HIGH
};

pub(super) const CLOSES_OFTEN: AlertEntry = AlertEntry {
    word: "closes-often",
    consequence: "Hardly anything is observed, and the shutter's motor wears.",
    action: "Look which input the causes of the closings name: a sensor at its limit or with gaps, or a period that is too long.",
    hold_s: 600,
    ..HIGH
};
