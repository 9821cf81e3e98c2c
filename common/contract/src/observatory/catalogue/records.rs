//! Alerts of what cannot be stored.

use super::super::Priority;
use super::super::catalogue_entry::{AlertEntry, HIGH, PLAIN};

pub(super) const DISK: AlertEntry = AlertEntry {
    word: "disk",
    instance: "FOLDER",
    consequence: "No new exposures of the sky; when it is full, nothing more can be kept.",
    action: "Move old files away, or give it a larger disk.",
    hold_s: 30,
    ..HIGH
};

pub(super) const AUDIT: AlertEntry = AlertEntry {
    word: "audit",
    consequence: "What is ordered and moved goes on and may leave no record.",
    action: "Free or repair the disk that holds this node's data folder.",
    ..HIGH
};

pub(super) const AUDIT_LOST: AlertEntry = AlertEntry {
    word: "audit-lost",
    priority: Priority::Medium,
    consequence: "Nothing can bring them back.",
    action: "Find out why the disk was slow or full.",
    ..PLAIN
};

pub(super) const AUDIT_BROKEN: AlertEntry = AlertEntry {
    word: "audit-broken",
    instance: "NODE",
    consequence: "What was done before the break cannot be proven by this file; a new chain has begun.",
    action: "Compare the node's own files with the archive: starmesh audit verify FILE archive.db.",
    ..HIGH
};

pub(super) const AUDIT_LACKING: AlertEntry = AlertEntry {
    word: "audit-lacking",
    instance: "NODE",
    priority: Priority::Medium,
    consequence: "The archive's copy is not whole.",
    action: "Look whether the node and its disk are well.",
    ..PLAIN
};

pub(super) const OPERATOR_ORDERS: AlertEntry = AlertEntry {
    word: "operator-orders",
    consequence: "It holds, but a restart of the observatory node would forget it.",
    action: "Look at the disk that holds the data folder.",
    ..HIGH
};

pub(super) const SCHEDULE_NOT_SAVED: AlertEntry = AlertEntry {
    word: "schedule-not-saved",
    consequence: "It is observed all the same; who changed it, when and why may be missing from the list of versions.",
    action: "Look at the disk that holds the data folder.",
    ..PLAIN
};

pub(super) const JOURNAL: AlertEntry = AlertEntry {
    word: "journal",
    consequence: "After a restart rows may begin again.",
    action: "Look at the disk that holds the data folder.",
    ..HIGH
};

pub(super) const SPOOL_CANNOT_WRITE: AlertEntry = AlertEntry {
    word: "spool-cannot-write",
    consequence: "Frames are lost.",
    action: "Look at the disk of the device node.",
    ..HIGH
};

pub(super) const ARCHIVE_DATABASE: AlertEntry = AlertEntry {
    word: "archive/database",
    consequence: "Telemetry waits in memory; when that is full, it is lost.",
    action: "Free disk space, or find who locks it.",
    ..HIGH
};

pub(super) const ARCHIVE_BACKUP: AlertEntry = AlertEntry {
    word: "archive/backup",
    consequence: "If the database is lost, so is the telemetry since the last copy. Frames are not in it.",
    action: "Look at the disk of the folder that [archive] backups names. A damaged copy can mean a damaged database.",
    ..PLAIN
};

pub(super) const ARCHIVE_PARQUET: AlertEntry = AlertEntry {
    word: "archive/parquet",
    consequence: "The network's archive lacks the night. Nothing is lost before [archive] raw_days have passed.",
    action: "Look at the disk of the folder, or at the bucket, that [archive] parquet names; move a file away that the cause calls damaged.",
    ..PLAIN
};

pub(super) const ARCHIVE_DELIVERY: AlertEntry = AlertEntry {
    word: "archive/delivery",
    instance: "DESTINATION",
    priority: Priority::Medium,
    consequence: "The night stays in the archive; nothing of it is removed, and its delivery is tried again and again.",
    action: "Do what the cause asks for, then type starmesh night deliver NIGHT --to DESTINATION to see it work.",
    ..PLAIN
};

pub(super) const ARCHIVE_DISK_LOW: AlertEntry = AlertEntry {
    word: "archive/disk-low",
    priority: Priority::Medium,
    consequence: "When it is full, frames wait in the cameras' spools; when those are full too, exposing ends.",
    action: "Move old nights away (archive.remove_delivered_after_days does it once they are delivered), or give it a larger disk.",
    hold_s: 30,
    ..PLAIN
};

pub(super) const ARCHIVE_FRAME: AlertEntry = AlertEntry {
    word: "archive/frame",
    consequence: "They stay in the cameras' spools; when those are full, exposing ends.",
    action: "Look at the archive's disk and its way to the device node.",
    ..HIGH
};

pub(super) const ARCHIVE_LOST: AlertEntry = AlertEntry {
    word: "archive/lost",
    instance: "WHAT",
    priority: Priority::Medium,
    consequence: "The archive's database has a gap there (its view gaps), and nothing can fill it.",
    action: "Find out why the archive was away longer than spool.hold_min, or why it is too slow.",
    ..PLAIN
};

pub(super) const ALERTS_NOT_SAVED: AlertEntry = AlertEntry {
    word: "alerts-not-saved",
    priority: Priority::Medium,
    consequence: "After a restart they are shown as new again.",
    action: "Look at the disk that holds the data folder.",
    ..PLAIN
};

pub(super) const ARCHIVE_HEADERS: AlertEntry = AlertEntry {
    word: "archive/headers",
    consequence: "Its keywords stay incomplete.",
    action: "Put the file back where it was, or look at the disk.",
    ..PLAIN
};

pub(super) const FOCUS_NOT_SAVED: AlertEntry = AlertEntry {
    word: "focus-not-saved",
    priority: Priority::Medium,
    consequence: "A restart of the observatory node would fall back to the focus known before.",
    action: "Look at the disk of the observatory node's data folder.",
    ..PLAIN
};

pub(super) const GUIDING_NOT_SAVED: AlertEntry = AlertEntry {
    word: "guiding-not-saved",
    consequence: "After a restart it is learned again: fields may stand on other pixels than before.",
    action: "Look at the disk that holds the data folder.",
    ..PLAIN
};

pub(super) const POINTING_NOT_SAVED: AlertEntry = AlertEntry {
    word: "pointing-not-saved",
    consequence: "After a restart the pointing model is learned anew: first slews need more corrections.",
    action: "Look at the disk of the data folder.",
    ..PLAIN
};

pub(super) const OPTICS_NOT_SAVED: AlertEntry = AlertEntry {
    word: "optics-not-saved",
    consequence: "After a restart the optics are learned anew: the first frames take longer to solve.",
    action: "Look at the disk of the data folder.",
    ..PLAIN
};
