//! Alerts of what cannot be stored.

use super::super::Priority;
use super::super::catalogue_entry::{Entry, HIGH, PLAIN};

pub(super) const DISK: Entry = Entry {
    word: "disk",
    instance: "FOLDER",
    consequence: "No new exposures of the sky; when it is full, nothing more can be kept.",
    action: "Move old files away, or give it a larger disk.",
    hold_s: 30,
    ..HIGH
};

pub(super) const AUDIT: Entry = Entry {
    word: "audit",
    consequence: "What is ordered and moved goes on and may leave no record.",
    action: "Free or repair the disk that holds this node's data folder.",
    ..HIGH
};

pub(super) const AUDIT_LOST: Entry = Entry {
    word: "audit-lost",
    priority: Priority::Medium,
    consequence: "Nothing can bring them back.",
    action: "Find out why the disk was slow or full.",
    ..PLAIN
};

pub(super) const AUDIT_BROKEN: Entry = Entry {
    word: "audit-broken",
    instance: "NODE",
    consequence: "What was done before the break cannot be proven by this file; a new chain has begun.",
    action: "Compare the node's own files with the archive: starmesh audit verify FILE archive.db.",
    ..HIGH
};

pub(super) const AUDIT_LACKING: Entry = Entry {
    word: "audit-lacking",
    instance: "NODE",
    priority: Priority::Medium,
    consequence: "The archive's copy is not whole.",
    action: "Look whether the node and its disk are well.",
    ..PLAIN
};

pub(super) const STANDING_ORDERS: Entry = Entry {
    word: "standing-orders",
    consequence: "It holds, but a restart of the observatory node would forget it.",
    action: "Look at the disk that holds the data folder.",
    ..HIGH
};

pub(super) const SCHEDULE_NOT_KEPT: Entry = Entry {
    word: "schedule-not-kept",
    consequence: "It is observed all the same; who changed it, when and why may be missing from the list of versions.",
    action: "Look at the disk that holds the data folder.",
    ..PLAIN
};

pub(super) const JOURNAL: Entry = Entry {
    word: "journal",
    consequence: "After a restart rows may begin again.",
    action: "Look at the disk that holds the data folder.",
    ..HIGH
};

pub(super) const SPOOL_CANNOT_WRITE: Entry = Entry {
    word: "spool-cannot-write",
    consequence: "Frames are lost.",
    action: "Look at the disk of the device node.",
    ..HIGH
};

pub(super) const ARCHIVE_DATABASE: Entry = Entry {
    word: "archive/database",
    consequence: "Telemetry waits in memory; when that is full, it is lost.",
    action: "Free disk space, or find who locks it.",
    ..HIGH
};

pub(super) const ARCHIVE_FRAME: Entry = Entry {
    word: "archive/frame",
    consequence: "They stay in the cameras' spools; when those are full, exposing ends.",
    action: "Look at the archive's disk and its way to the device node.",
    ..HIGH
};

pub(super) const ALERTS_NOT_KEPT: Entry = Entry {
    word: "alerts-not-kept",
    priority: Priority::Medium,
    consequence: "After a restart they stand as new again.",
    action: "Look at the disk that holds the data folder.",
    ..PLAIN
};

pub(super) const ARCHIVE_HEADERS: Entry = Entry {
    word: "archive/headers",
    consequence: "Its keywords stay incomplete.",
    action: "Put the file back where it was, or look at the disk.",
    ..PLAIN
};

pub(super) const FOCUS_NOT_KEPT: Entry = Entry {
    word: "focus-not-kept",
    priority: Priority::Medium,
    consequence: "A restart of the observatory node would fall back to the focus known before.",
    action: "Look at the disk of the observatory node's data folder.",
    ..PLAIN
};

pub(super) const GUIDING_NOT_KEPT: Entry = Entry {
    word: "guiding-not-kept",
    consequence: "After a restart it is learnt again: fields may stand on other pixels than before.",
    action: "Look at the disk that holds the data folder.",
    ..PLAIN
};

pub(super) const POINTING_NOT_KEPT: Entry = Entry {
    word: "pointing-not-kept",
    consequence: "After a restart the pointing model is learnt anew: first slews need more corrections.",
    action: "Look at the disk of the data folder.",
    ..PLAIN
};

pub(super) const OPTICS_NOT_KEPT: Entry = Entry {
    word: "optics-not-kept",
    consequence: "After a restart the optics are learnt anew: the first frames take longer to solve.",
    action: "Look at the disk of the data folder.",
    ..PLAIN
};
