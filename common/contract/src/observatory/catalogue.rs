//! The catalogue: every sort of alert there is, in one table, with its urgency and what a person should do.
//!
//! Only what stands here can be raised. `docs/operator/alerts.md` is made from it by [`super::markdown`]; a test holds both
//! together. The comment above a row is its text in that page.

use std::fmt::Display;

use units::Utc;

use super::{Alert, Priority};

/// What is the same for every alert of one kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entry {
    /// Begins the id; what varies follows after a `/`.
    pub word: &'static str,
    /// What varies, as the page shows it, such as `DOME`; empty where there is only one.
    pub instance: &'static str,
    /// How urgent.
    pub priority: Priority,
    /// What follows from it.
    pub consequence: &'static str,
    /// What a person should do.
    pub action: &'static str,
    /// Shown only after it has stood so long, machine s.
    pub on_delay_s: u16,
    /// Stands on for so long after its cause is gone, machine s: what comes and goes is one alert.
    pub hold_s: u16,
}

macro_rules! catalogue {
    ($($(#[doc = $means:literal])+ $kind:ident: $entry:expr,)*) => {
        /// A sort of alert. The text of each is its explanation in `docs/operator/alerts.md`.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum AlertKind {
            $($(#[doc = $means])+ $kind,)*
        }

        impl AlertKind {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$kind),*];

            /// Its row of the catalogue.
            pub const fn entry(self) -> &'static Entry {
                match self {
                    $(Self::$kind => {
                        const ENTRY: Entry = $entry;
                        &ENTRY
                    })*
                }
            }

            /// What has happened, for a person.
            pub const fn means(self) -> &'static str {
                match self {
                    $(Self::$kind => const { concat!($($means),+).trim_ascii() },)*
                }
            }
        }
    };
}

catalogue! {
    /// A device failed again and again, so a row of the schedule rests and is tried again later, each time after twice
    /// as long; the other rows go on. What `[faults] policy` says of the kind of device is done.
    RowPostponed: Entry {
        word: "row-postponed",
        instance: "ROW",
        priority: Priority::Medium,
        consequence: "Its frames are not taken meanwhile.",
        action: "Look at the device that is named. The row goes on by itself while its window is open.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// The disk of a node's folder is almost full (`safety.disk_free_min_gb`). While it is the data folder of a device
    /// or observatory node, nothing is exposed: the last room is for the journal and for frames that are under way.
    Disk: Entry {
        word: "disk",
        instance: "FOLDER",
        priority: Priority::High,
        consequence: "No new exposures of the sky; when it is full, nothing more can be kept.",
        action: "Move old files away, or give it a larger disk.",
        on_delay_s: 0,
        hold_s: 30,
    },
    /// A mount was left tracking until it came to one of its limits (`telescope.limits`). Its device node stops it,
    /// without the observatory node and without the bus.
    MountLimit: Entry {
        word: "mount-limit",
        instance: "MOUNT",
        priority: Priority::High,
        consequence: "Its device node stops the tracking, and again every 5 s until it obeys.",
        action: "Look why it was left tracking; a person may have to stop it at the mount.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// The dome's own watchdog did not take its food. It closes the dome when its time is over, safe or not.
    Watchdog: Entry {
        word: "watchdog",
        instance: "DOME",
        priority: Priority::High,
        consequence: "The dome will close by itself.",
        action: "Look at the dome's controller; compare watchdog_action with its manual.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// Nothing closes this dome when its device node's host loses power or hangs: it has no watchdog of its own, or
    /// none is configured.
    NoWatchdog: Entry {
        word: "no-watchdog",
        instance: "DOME",
        priority: Priority::Advisory,
        consequence: "Nothing closes it when the host of its device node dies.",
        action: "Configure watchdog_s and watchdog_action, or give the dome a controller that has one.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// The disk that holds a node's data folder does not take its records of what was ordered and moved. Nothing waits
    /// for it: closing and all else go on.
    Audit: Entry {
        word: "audit",
        instance: "",
        priority: Priority::High,
        consequence: "What is ordered and moved goes on and may leave no record.",
        action: "Free or repair the disk that holds this node's data folder.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// Records of what was ordered and moved found no room while a disk was slow or full. The chain says where, and how
    /// many.
    AuditLost: Entry {
        word: "audit-lost",
        instance: "",
        priority: Priority::Medium,
        consequence: "Nothing can bring them back.",
        action: "Find out why the disk was slow or full.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// Records of what was ordered and moved do not follow from each other: somebody or something has changed or removed
    /// some. A node tells it of its own file, the archive of a node's. Stands until the node that tells it ends.
    AuditBroken: Entry {
        word: "audit-broken",
        instance: "NODE",
        priority: Priority::High,
        consequence: "What was done before the break cannot be proven by this file; a new chain has begun.",
        action: "Compare the node's own files with the archive: starmesh audit verify FILE archive.db.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A node does not tell the archive what was ordered and moved there. The node itself keeps it.
    AuditLacking: Entry {
        word: "audit-lacking",
        instance: "NODE",
        priority: Priority::Medium,
        consequence: "The archive's copy is not whole.",
        action: "Look whether the node and its disk are well.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A person's order to stay closed, or to do without a limit, was accepted and could not be written.
    StandingOrders: Entry {
        word: "standing-orders",
        instance: "",
        priority: Priority::High,
        consequence: "It holds, but a restart of the observatory node would forget it.",
        action: "Look at the disk that holds the data folder.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// An enclosure must be closed and is not seen to be. The guard of the dome and the observatory node each try
    /// again, for ever. Look at the camera of the site before anything else: the shutter may be shut and only its
    /// sensor wrong.
    DomeNotClosed: Entry {
        word: "dome-not-closed",
        instance: "DOME",
        priority: Priority::Critical,
        consequence: "The telescope may stand in the weather.",
        action: "Close it by hand or at its own controls, or call the site. The closing goes on by itself.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A dome opened and no node had told it to. Somebody stands at it, another program drives it, or its controller
    /// has a fault. Ask who is on site before you touch anything.
    DomeUncommandedOpen: Entry {
        word: "dome-uncommanded-open",
        instance: "DOME",
        priority: Priority::Critical,
        consequence: "The guard closes it and holds it closed.",
        action: "Find out who opened it: another program, a handset, a person.",
        on_delay_s: 0,
        hold_s: 60,
    },
    /// The roof must close, may not close over a telescope that is not parked (`parked_only`), and the mount does not
    /// park.
    DomeWaitsForMount: Entry {
        word: "dome-waits-for-mount",
        instance: "DOME",
        priority: Priority::Critical,
        consequence: "It stays open as long as its policy is parked_only.",
        action: "Park the mount, or make sure that the roof can pass it and close by hand.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// The slit of a dome could not be brought to where the telescope looks: the dome does not turn, or not far enough,
    /// or no azimuth of its slit leaves the whole aperture free. Closing does not depend on it.
    DomeNotTurned: Entry {
        word: "dome-not-turned",
        instance: "DOME",
        priority: Priority::High,
        consequence: "The sky is not exposed; rows wait and are tried again.",
        action: "Look at the dome's rotation, and whether `dome.follow` and `dome.slit` are right. It is tried again by itself.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// The guard closed the dome because nobody renewed its permission. The dome is safe; the night waits. The
    /// observatory node takes over again by itself when it runs and the sky is safe.
    DomeHeld: Entry {
        word: "dome-held",
        instance: "DOME",
        priority: Priority::High,
        consequence: "It opens for nobody until the commander resumes.",
        action: "Look why the observatory node was silent or unsafe.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A mount was told to park and is not seen parked in time.
    MountNotParked: Entry {
        word: "mount-not-parked",
        instance: "MOUNT",
        priority: Priority::High,
        consequence: "It may move under a closed roof, or hold up a roof that waits for it.",
        action: "Look at the mount. The parking goes on by itself.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// No device node grants the right to command: the one that serves the dome (without a dome: the mount) does not
    /// answer or refuses.
    NoLease: Entry {
        word: "no-lease",
        instance: "",
        priority: Priority::High,
        consequence: "Nothing can be opened or moved.",
        action: "Look at the device node that serves the dome or, without one, the mount.",
        on_delay_s: 0,
        hold_s: 10,
    },
    /// A node that was heard is heard no more: it ended, hangs, or its host or the network is down.
    NodeSilent: Entry {
        word: "node-silent",
        instance: "ROLE/NODE",
        priority: Priority::High,
        consequence: "What it told is no longer true.",
        action: "Look at its host and restart it.",
        on_delay_s: 10,
        hold_s: 0,
    },
    /// Two nodes serve one device. Their states and their commands mix.
    SecondWriter: Entry {
        word: "second-writer",
        instance: "KIND/DEVICE",
        priority: Priority::High,
        consequence: "Its state and its commands are unsure.",
        action: "Stop one of the two device nodes, or give the device to one of them (node = ...).",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// Two nodes of one role have one name. The younger ends by itself.
    Twin: Entry {
        word: "twin",
        instance: "",
        priority: Priority::High,
        consequence: "The younger should leave by itself.",
        action: "End it if it does not.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// The newest schedule file cannot be read. The cause names the line.
    ScheduleRefused: Entry {
        word: "schedule-refused",
        instance: "",
        priority: Priority::High,
        consequence: "The schedule before it stays in force; without one, nothing is observed.",
        action: "Correct the file; it is read again by itself.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// What was begun and finished cannot be written down.
    Journal: Entry {
        word: "journal",
        instance: "",
        priority: Priority::High,
        consequence: "After a restart rows may begin again.",
        action: "Look at the disk that holds the data folder.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A frame was taken and the device node could not write it.
    SpoolCannotWrite: Entry {
        word: "spool-cannot-write",
        instance: "",
        priority: Priority::High,
        consequence: "Frames are lost.",
        action: "Look at the disk of the device node.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// The archive's database does not take rows: its disk is full or read-only, or another program locks it.
    ArchiveDatabase: Entry {
        word: "archive/database",
        instance: "",
        priority: Priority::High,
        consequence: "Telemetry waits in memory; when that is full, it is lost.",
        action: "Free disk space, or find who locks it.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// The archive tried several times to store a frame. Nothing is lost yet: the frame stays in the spool of its
    /// camera's device node.
    ArchiveFrame: Entry {
        word: "archive/frame",
        instance: "FRAME",
        priority: Priority::High,
        consequence: "It stays in the camera's spool; when that is full, exposing ends.",
        action: "Look at the archive's disk and its way to the device node.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// Nobody can be told of alerts at this address: it does not answer, refuses, or its password is wrong. The cause has
    /// its words. Everybody else is told, this alert too.
    AlertNotSent: Entry {
        word: "alert-not-sent",
        instance: "RECEIVER",
        priority: Priority::High,
        consequence: "Whoever reads there does not hear of alerts.",
        action: "Look at `[alerts]` in observatory.toml, at the network and at the receiver. It is tried again by itself.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// What people acknowledged and shelved cannot be written down.
    AlertsNotKept: Entry {
        word: "alerts-not-kept",
        instance: "",
        priority: Priority::Medium,
        consequence: "After a restart they stand as new again.",
        action: "Look at the disk that holds the data folder.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A frame was exposed and never announced by the camera's device node.
    FrameLost: Entry {
        word: "frame-lost",
        instance: "CAMERA",
        priority: Priority::Medium,
        consequence: "It may not be on disk.",
        action: "Look at the device node of the camera and its spool.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A camera does not reach its temperature in its time.
    CoolingFailed: Entry {
        word: "cooling-failed",
        instance: "CAMERA",
        priority: Priority::Medium,
        consequence: "Rows of this camera fail.",
        action: "Look at the cooler, or raise temperature_c.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A mirror cover must be closed and is not seen to be.
    CoverNotClosed: Entry {
        word: "cover-not-closed",
        instance: "COVER",
        priority: Priority::Medium,
        consequence: "Dust and dew reach the mirror.",
        action: "Look at the cover. The closing goes on by itself.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A safety input is switched off in the configuration. It stands so that nobody forgets.
    Disabled: Entry {
        word: "disabled",
        instance: "INPUT",
        priority: Priority::Medium,
        consequence: "The verdict does without it.",
        action: "Take `disabled` out of the configuration once it can be relied on again.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A file's header lacks values that the telemetry should give.
    ArchiveHeaders: Entry {
        word: "archive/headers",
        instance: "",
        priority: Priority::Advisory,
        consequence: "Its keywords stay incomplete.",
        action: "Put the file back where it was, or look at the disk.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A person ordered that nothing opens.
    StayClosed: Entry {
        word: "stay-closed",
        instance: "",
        priority: Priority::Advisory,
        consequence: "Nothing opens.",
        action: "Take it back: starmesh order SITE/TELESCOPE open-again.",
        on_delay_s: 0,
        hold_s: 0,
    },
    /// A person does without one limit for a while.
    Override: Entry {
        word: "override",
        instance: "INPUT",
        priority: Priority::Advisory,
        consequence: "It closes nothing.",
        action: "Heed it again: starmesh order SITE/TELESCOPE heed INPUT.",
        on_delay_s: 0,
        hold_s: 0,
    },
}

impl AlertKind {
    /// The id of one alert of this kind; `instance` is empty where there is only one.
    pub fn id(self, instance: impl Display) -> String {
        let word = self.entry().word;
        match instance.to_string().as_str() {
            "" => word.to_owned(),
            instance => format!("{word}/{instance}"),
        }
    }

    /// An alert of this kind.
    pub fn alert(self, instance: impl Display, raised_utc: Utc, cause: &str) -> Alert {
        let entry = self.entry();
        let [cause, consequence, action] = [cause, entry.consequence, entry.action].map(str::to_owned);
        Alert {
            id: self.id(instance),
            priority: entry.priority,
            raised_utc,
            cause,
            consequence,
            action,
            returned_utc: None,
            acknowledged_by: None,
            acknowledged_utc: None,
            shelved_by: None,
            shelved_until_utc: None,
            shelved_reason: None,
        }
    }

    /// The kind that an id names; `None` for one of a newer version.
    pub fn of(id: &str) -> Option<Self> {
        let begins = |kind: &&Self| {
            let rest = id.strip_prefix(kind.entry().word);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
        };
        Self::ALL.iter().find(begins).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_id_names_its_kind() {
        for kind in AlertKind::ALL {
            for instance in ["", "dome_1", "wx/Humidity"] {
                assert_eq!(AlertKind::of(&kind.id(instance)), Some(*kind), "{instance}");
            }
        }
        for id in ["", "dome", "dome-not-closed-yet", "archive", "archive/other", "twin2"] {
            assert_eq!(AlertKind::of(id), None, "{id}");
        }
    }

    #[test]
    fn every_row_has_words_that_are_sentences() {
        for kind in AlertKind::ALL {
            let Entry { word, consequence, action, .. } = kind.entry();
            for text in [*consequence, *action, kind.means()] {
                assert!(text.ends_with('.') && text.starts_with(char::is_uppercase), "{word}: {text:?}");
            }
        }
    }
}
