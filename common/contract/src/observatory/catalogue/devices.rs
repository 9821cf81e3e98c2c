//! Alerts of all other devices.

use super::super::Priority;
use super::super::catalogue_entry::{AlertEntry, HIGH, PLAIN};

pub(super) const ROW_POSTPONED: AlertEntry = AlertEntry {
    word: "row-postponed",
    instance: "KIND",
    priority: Priority::Medium,
    consequence: "Their frames are not taken meanwhile.",
    action: "Look at the device that is named. The rows go on by themselves while their windows are open.",
    ..PLAIN
};

pub(super) const STEP_OVERDUE: AlertEntry = AlertEntry {
    word: "step-overdue",
    instance: "CAMERA",
    priority: Priority::High,
    consequence: "The row may stand still, and take no frames, although every node and device answers.",
    action: "Look at what the step waits for on the telescope's page, and at the log of these minutes. Skip the row, or close \
             and begin again, if it does not go on.",
    ..PLAIN
};

pub(super) const ROW_FAILED: AlertEntry = AlertEntry {
    word: "row-failed",
    instance: "KIND",
    priority: Priority::Medium,
    consequence: "Their frames are not taken. The other rows go on.",
    action: "Correct the row in the schedule, or the device's block, by what the cause says.",
    ..PLAIN
};

pub(super) const DEVICE_LOST: AlertEntry = AlertEntry {
    word: "device-lost",
    instance: "KIND/DEVICE",
    consequence: "What needs it waits; what closes the dome does not.",
    action: "Look at the device, its cable, and the Alpaca server that the cause names. It is asked again by itself, and the night goes on when it answers.",
    on_delay_s: 20,
    hold_s: 10,
    ..HIGH
};

pub(super) const DEVICE_UNREAD: AlertEntry = AlertEntry {
    word: "device-unread",
    instance: "KIND/DEVICE",
    priority: Priority::Medium,
    consequence: "The device decides by itself whether it does what it is asked.",
    action: "Look at the device and its driver. It is asked again by itself.",
    hold_s: 10,
    ..PLAIN
};

pub(super) const DEVICE_CONTRADICTS: AlertEntry = AlertEntry {
    word: "device-contradicts",
    instance: "KIND/DEVICE",
    priority: Priority::Medium,
    consequence: "What the device reports of itself is not believed. The rows go on where their commands have an effect.",
    action: "Look at the device; connect its driver anew when nothing is observed.",
    hold_s: 10,
    ..PLAIN
};

pub(super) const MOUNT_LIMIT: AlertEntry = AlertEntry {
    word: "mount-limit",
    instance: "MOUNT",
    consequence: "Its device node switches tracking off, then aborts all movement, then parks it. If its coordinates show that nothing helps, everything is closed and nothing is exposed.",
    action: "Look why it was left tracking; the cause says what was done, and whether a person has to stop it at the mount.",
    ..HIGH
};

pub(super) const MOUNT_TRACKS_ON: AlertEntry = AlertEntry {
    word: "mount-tracks-on",
    instance: "MOUNT",
    priority: Priority::Medium,
    consequence: "The row is finished all the same. The mount was told again, and then parked where it can.",
    action: "Look at the mount and its driver.",
    ..PLAIN
};

pub(super) const MOUNT_LEFT_ITS_PLACE: AlertEntry = AlertEntry {
    word: "mount-left-its-place",
    instance: "MOUNT",
    priority: Priority::Medium,
    consequence: "The frames since then do not count, and the telescope goes back to its target.",
    action: "Look at the mount: it may have stopped to track, or somebody moved it.",
    ..PLAIN
};

pub(super) const MOUNT_NOT_PARKED: AlertEntry = AlertEntry {
    word: "mount-not-parked",
    instance: "MOUNT",
    consequence: "It may move under a closed roof, or hold up a roof that waits for it.",
    action: "Look at the mount. The parking goes on by itself.",
    ..HIGH
};

pub(super) const SLOW_DEVICE: AlertEntry = AlertEntry {
    word: "slow-device",
    instance: "KIND/DEVICE",
    priority: Priority::Medium,
    consequence: "A bad value closes later than it could; readings that are too old close by themselves.",
    action: "Look at the device and its server, or poll fewer properties.",
    on_delay_s: 10,
    hold_s: 60,
};

pub(super) const IMAGE_UNREADABLE: AlertEntry = AlertEntry {
    word: "image-unreadable",
    instance: "CAMERA",
    consequence: "The frame is lost. Another one is taken in its place.",
    action: "Look at the camera, its driver and its Alpaca server, and restart what is wrong. Nothing has to be done at the disk.",
    ..HIGH
};

pub(super) const FRAME_LOST: AlertEntry = AlertEntry {
    word: "frame-lost",
    instance: "CAMERA",
    priority: Priority::Medium,
    consequence: "It may not be on disk.",
    action: "Look at the device node of the camera and its spool.",
    ..PLAIN
};

pub(super) const COOLING_FAILED: AlertEntry = AlertEntry {
    word: "cooling-failed",
    instance: "CAMERA",
    priority: Priority::Medium,
    consequence: "Rows of this camera fail.",
    action: "Look at the cooler, or raise temperature_c.",
    ..PLAIN
};

pub(super) const COVER_NOT_CLOSED: AlertEntry = AlertEntry {
    word: "cover-not-closed",
    instance: "COVER",
    priority: Priority::Medium,
    consequence: "Dust and dew reach the mirror.",
    action: "Look at the cover. The closing goes on by itself.",
    ..PLAIN
};
