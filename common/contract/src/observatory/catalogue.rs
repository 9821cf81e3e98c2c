//! The catalogue: every sort of alert there is, in one table, with its urgency and what a person should do.
//!
//! Only what stands here can be raised. `docs/operator/alerts.md` is made from it by [`super::markdown`]; a test holds both
//! together. The comment above a row is its text in that page.

use super::Priority;
pub use super::catalogue_entry::Entry;
use super::catalogue_entry::PLAIN;
use super::catalogue_macro::catalogue;

catalogue! {
    /// A device failed again and again, so a row of the schedule rests and is tried again later, each time after twice
    /// as long; the other rows go on. What `[faults] policy` says of the kind of device is done.
    RowPostponed: Entry {
        word: "row-postponed",
        instance: "ROW",
        priority: Priority::Medium,
        consequence: "Its frames are not taken meanwhile.",
        action: "Look at the device that is named. The row goes on by itself while its window is open.",
        ..PLAIN
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
        ..PLAIN
    },
    /// The dome's own watchdog did not take its food. It closes the dome when its time is over, safe or not.
    Watchdog: Entry {
        word: "watchdog",
        instance: "DOME",
        priority: Priority::High,
        consequence: "The dome will close by itself.",
        action: "Look at the dome's controller; compare watchdog_action with its manual.",
        ..PLAIN
    },
    /// Nothing closes this dome when its device node's host loses power or hangs: it has no watchdog of its own, or
    /// none is configured.
    NoWatchdog: Entry {
        word: "no-watchdog",
        instance: "DOME",
        priority: Priority::Advisory,
        consequence: "Nothing closes it when the host of its device node dies.",
        action: "Configure watchdog_s and watchdog_action, or give the dome a controller that has one.",
        ..PLAIN
    },
    /// The disk that holds a node's data folder does not take its records of what was ordered and moved. Nothing waits
    /// for it: closing and all else go on.
    Audit: Entry {
        word: "audit",
        priority: Priority::High,
        consequence: "What is ordered and moved goes on and may leave no record.",
        action: "Free or repair the disk that holds this node's data folder.",
        ..PLAIN
    },
    /// Records of what was ordered and moved found no room while a disk was slow or full. The chain says where, and how
    /// many.
    AuditLost: Entry {
        word: "audit-lost",
        priority: Priority::Medium,
        consequence: "Nothing can bring them back.",
        action: "Find out why the disk was slow or full.",
        ..PLAIN
    },
    /// Records of what was ordered and moved do not follow from each other: somebody or something has changed or removed
    /// some. A node tells it of its own file, the archive of a node's. Stands until the node that tells it ends.
    AuditBroken: Entry {
        word: "audit-broken",
        instance: "NODE",
        priority: Priority::High,
        consequence: "What was done before the break cannot be proven by this file; a new chain has begun.",
        action: "Compare the node's own files with the archive: starmesh audit verify FILE archive.db.",
        ..PLAIN
    },
    /// A node does not tell the archive what was ordered and moved there. The node itself keeps it.
    AuditLacking: Entry {
        word: "audit-lacking",
        instance: "NODE",
        priority: Priority::Medium,
        consequence: "The archive's copy is not whole.",
        action: "Look whether the node and its disk are well.",
        ..PLAIN
    },
    /// A person's order to stay closed, or to do without a limit, was accepted and could not be written.
    StandingOrders: Entry {
        word: "standing-orders",
        priority: Priority::High,
        consequence: "It holds, but a restart of the observatory node would forget it.",
        action: "Look at the disk that holds the data folder.",
        ..PLAIN
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
        ..PLAIN
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
        ..PLAIN
    },
    /// The slit of a dome could not be brought to where the telescope looks: the dome does not turn, or not far enough,
    /// or no azimuth of its slit leaves the whole aperture free. Closing does not depend on it.
    DomeNotTurned: Entry {
        word: "dome-not-turned",
        instance: "DOME",
        priority: Priority::High,
        consequence: "The sky is not exposed; rows wait and are tried again.",
        action: "Look at the dome's rotation, and whether `dome.follow` and `dome.slit` are right. It is tried again by itself.",
        ..PLAIN
    },
    /// A dome that says that it can turn stands over several telescopes, and nothing says who turns its slit
    /// (`dome.follow`). One slit cannot stand where each of them looks, so Starmesh treats it as a roof.
    DomeShared: Entry {
        word: "dome-shared",
        instance: "DOME",
        priority: Priority::Medium,
        consequence: "Nobody turns it: frames may show its wall.",
        action: "Set `follow = \"off\"` where the site turns it or it is a roof; else give each telescope a dome block of its own.",
        ..PLAIN
    },
    /// The guard closed the dome because nobody renewed its permission. The dome is safe; the night waits. The
    /// observatory node takes over again by itself when it runs and the sky is safe.
    DomeHeld: Entry {
        word: "dome-held",
        instance: "DOME",
        priority: Priority::High,
        consequence: "It opens for nobody until the commander resumes.",
        action: "Look why the observatory node was silent or unsafe.",
        ..PLAIN
    },
    /// A mount was told to park and is not seen parked in time.
    MountNotParked: Entry {
        word: "mount-not-parked",
        instance: "MOUNT",
        priority: Priority::High,
        consequence: "It may move under a closed roof, or hold up a roof that waits for it.",
        action: "Look at the mount. The parking goes on by itself.",
        ..PLAIN
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
        ..PLAIN
    },
    /// Two nodes of one role have one name. The younger ends by itself.
    Twin: Entry {
        word: "twin",
        priority: Priority::High,
        consequence: "The younger should leave by itself.",
        action: "End it if it does not.",
        ..PLAIN
    },
    /// The newest schedule file cannot be read. The cause names the line.
    ScheduleRefused: Entry {
        word: "schedule-refused",
        priority: Priority::High,
        consequence: "The schedule before it stays in force; without one, nothing is observed.",
        action: "Correct the file; it is read again by itself.",
        ..PLAIN
    },
    /// The schedule in force cannot be kept as a version beside those before it.
    ScheduleNotKept: Entry {
        word: "schedule-not-kept",
        consequence: "It is observed all the same; who changed it, when and why may be missing from the list of versions.",
        action: "Look at the disk that holds the data folder.",
        ..PLAIN
    },
    /// What was begun and finished cannot be written down.
    Journal: Entry {
        word: "journal",
        priority: Priority::High,
        consequence: "After a restart rows may begin again.",
        action: "Look at the disk that holds the data folder.",
        ..PLAIN
    },
    /// A frame was taken and the device node could not write it.
    SpoolCannotWrite: Entry {
        word: "spool-cannot-write",
        priority: Priority::High,
        consequence: "Frames are lost.",
        action: "Look at the disk of the device node.",
        ..PLAIN
    },
    /// The archive's database does not take rows: its disk is full or read-only, or another program locks it.
    ArchiveDatabase: Entry {
        word: "archive/database",
        priority: Priority::High,
        consequence: "Telemetry waits in memory; when that is full, it is lost.",
        action: "Free disk space, or find who locks it.",
        ..PLAIN
    },
    /// The archive tried several times to store a frame. Nothing is lost yet: the frame stays in the spool of its
    /// camera's device node.
    ArchiveFrame: Entry {
        word: "archive/frame",
        instance: "FRAME",
        priority: Priority::High,
        consequence: "It stays in the camera's spool; when that is full, exposing ends.",
        action: "Look at the archive's disk and its way to the device node.",
        ..PLAIN
    },
    /// Nobody can be told of alerts at this address: it does not answer, refuses, or its password is wrong. The cause has
    /// its words. Everybody else is told, this alert too.
    AlertNotSent: Entry {
        word: "alert-not-sent",
        instance: "RECEIVER",
        priority: Priority::High,
        consequence: "Whoever reads there does not hear of alerts.",
        action: "Look at `[alerts]` in observatory.toml, at the network and at the receiver. It is tried again by itself.",
        ..PLAIN
    },
    /// What people acknowledged and shelved cannot be written down.
    AlertsNotKept: Entry {
        word: "alerts-not-kept",
        priority: Priority::Medium,
        consequence: "After a restart they stand as new again.",
        action: "Look at the disk that holds the data folder.",
        ..PLAIN
    },
    /// A frame was exposed and never announced by the camera's device node.
    FrameLost: Entry {
        word: "frame-lost",
        instance: "CAMERA",
        priority: Priority::Medium,
        consequence: "It may not be on disk.",
        action: "Look at the device node of the camera and its spool.",
        ..PLAIN
    },
    /// A camera does not reach its temperature in its time.
    CoolingFailed: Entry {
        word: "cooling-failed",
        instance: "CAMERA",
        priority: Priority::Medium,
        consequence: "Rows of this camera fail.",
        action: "Look at the cooler, or raise temperature_c.",
        ..PLAIN
    },
    /// A mirror cover must be closed and is not seen to be.
    CoverNotClosed: Entry {
        word: "cover-not-closed",
        instance: "COVER",
        priority: Priority::Medium,
        consequence: "Dust and dew reach the mirror.",
        action: "Look at the cover. The closing goes on by itself.",
        ..PLAIN
    },
    /// A safety input is switched off in the configuration. It stands so that nobody forgets.
    Disabled: Entry {
        word: "disabled",
        instance: "INPUT",
        priority: Priority::Medium,
        consequence: "The verdict does without it.",
        action: "Take `disabled` out of the configuration once it can be relied on again.",
        ..PLAIN
    },
    /// A file's header lacks values that the telemetry should give.
    ArchiveHeaders: Entry {
        word: "archive/headers",
        priority: Priority::Advisory,
        consequence: "Its keywords stay incomplete.",
        action: "Put the file back where it was, or look at the disk.",
        ..PLAIN
    },
    /// A person ordered that nothing opens.
    StayClosed: Entry {
        word: "stay-closed",
        priority: Priority::Advisory,
        consequence: "Nothing opens.",
        action: "Take it back: starmesh order SITE/TELESCOPE open-again.",
        ..PLAIN
    },
    /// A person does without one limit for a while.
    Override: Entry {
        word: "override",
        instance: "INPUT",
        priority: Priority::Advisory,
        consequence: "It closes nothing.",
        action: "Heed it again: starmesh order SITE/TELESCOPE heed INPUT.",
        ..PLAIN
    },
    /// The stars of a camera grow wider from frame to frame, and not by the seeing of a moment: the middle of the last
    /// five frames of a row is more than 1.3 times as wide as its best five were.
    FocusDrift: Entry {
        word: "focus-drift",
        instance: "CAMERA",
        priority: Priority::Advisory,
        consequence: "The frames are less sharp than they could be.",
        action: "Compare with the seeing; focus again where the seeing is not worse.",
        ..PLAIN
    },
    /// A focus run of a camera has not found the focus; the focuser went back to where it stood before.
    FocusFailed: Entry {
        word: "focus-failed",
        instance: "CAMERA",
        priority: Priority::Medium,
        consequence: "Frames are taken at the focus as it was known before.",
        action: "Look at the plot of the run and at its reason; the next run that succeeds ends this alert.",
        ..PLAIN
    },
    /// What was learnt of the focus (best positions, runs) cannot be written down; it is tried again and again.
    FocusNotKept: Entry {
        word: "focus-not-kept",
        priority: Priority::Medium,
        consequence: "A restart of the observatory node would fall back to the focus known before.",
        action: "Look at the disk of the observatory node's data folder.",
        ..PLAIN
    },
    /// A camera sees fewer than 30 % of the stars that the frames before of the same row showed, or less than 30 % of the light
    /// that the stars give at best, clear air allowed for: clouds, a dome before the telescope, dew, or dawn. It ends at half.
    StarsGone: Entry {
        word: "stars-gone",
        instance: "CAMERA",
        priority: Priority::Advisory,
        consequence: "The frames may be worth nothing; the sensors of the weather decide alone whether the roof closes.",
        action: "Look at the sky and at the last frame.",
        ..PLAIN
    },
    /// The stars of a camera were drawn out in one direction on two frames, one after the other.
    StarsTrailed: Entry {
        word: "stars-trailed",
        instance: "CAMERA",
        priority: Priority::Medium,
        consequence: "The frames are smeared.",
        action: "Look at tracking, guiding and wind.",
        ..PLAIN
    },
    /// A row asks for guiding, and the field is lost, no frame can be measured, the mount takes no pulses, or nobody knows
    /// what pulses do. The cause says which.
    GuidingLost: Entry {
        word: "guiding-lost",
        instance: "CAMERA",
        priority: Priority::Medium,
        consequence: "The mount only tracks: the field may drift. Frames go on unless `guiding.when_lost` says otherwise.",
        action: "Look at the sky, the last frame and the mount; without a calibration run calibrate_guiding.",
        ..PLAIN
    },
    /// The field turns around the star that is guided on.
    FieldTurns: Entry {
        word: "field-turns",
        instance: "CAMERA",
        priority: Priority::Advisory,
        consequence: "Stars far from the middle are drawn out on long exposures.",
        action: "Look at the polar alignment, or at the rotator.",
        ..PLAIN
    },
    /// What guiding has learnt (what pulses do, where fields stood) cannot be written down.
    GuidingNotKept: Entry {
        word: "guiding-not-kept",
        priority: Priority::Advisory,
        consequence: "After a restart it is learnt again: fields may stand on other pixels than before.",
        action: "Look at the disk that holds the data folder.",
        ..PLAIN
    },
    /// A row asks for `pointing`, and where its camera looks could not be proven, or the mount does not go where it is sent.
    /// The cause says which. It ends with the next telescope that is proven to be on target.
    PointingUnproven: Entry {
        word: "pointing-unproven",
        instance: "CAMERA",
        priority: Priority::Medium,
        consequence: "The row rests or is given up, as `pointing.on_failure` says; no frame counts meanwhile.",
        action: "Look at the last frame and at the sky; compare the mount's clock, site and alignment.",
        ..PLAIN
    },
    /// What was learnt of the pointing cannot be written down.
    PointingNotKept: Entry {
        word: "pointing-not-kept",
        priority: Priority::Advisory,
        consequence: "After a restart the pointing model is learnt anew: first slews need more corrections.",
        action: "Look at the disk of the data folder.",
        ..PLAIN
    },
    /// A solved frame shows another field than that of its target: the middle of the sensor is farther from it than half the
    /// frame's shorter side. It ends with the next frame that is on target.
    WrongField: Entry {
        word: "wrong-field",
        instance: "CAMERA",
        priority: Priority::Medium,
        consequence: "The target is not on the frames.",
        action: "Look at the target's coordinates, the mount's alignment and its frame of coordinates.",
        ..PLAIN
    },
    /// The star catalogue that `[imaging] catalogue` names cannot be opened.
    CatalogueUnusable: Entry {
        word: "catalogue",
        priority: Priority::Advisory,
        consequence: "Frames are measured but not solved: no coordinates, no zero point, no check of the pointing.",
        action: "Put the file there, or take the key out of the configuration for the catalogue that is shipped.",
        ..PLAIN
    },
    /// What solved frames taught of the optics cannot be written down.
    OpticsNotKept: Entry {
        word: "optics-not-kept",
        priority: Priority::Advisory,
        consequence: "After a restart the optics are learnt anew: the first frames take longer to solve.",
        action: "Look at the disk of the data folder.",
        ..PLAIN
    },
    /// Frames of a camera could not be measured, three in a row: their pixels could not be fetched from the spool, or
    /// measuring does not keep up.
    FramesUnmeasured: Entry {
        word: "frames-unmeasured",
        instance: "CAMERA",
        priority: Priority::Advisory,
        consequence: "Focus drift, clouds and trailing are not noticed on them; the archive stores them all the same.",
        action: "Look at the reason in the facts of the last frame, and at the way from this node to the spool.",
        ..PLAIN
    },
    /// A function of the site's script (`[hooks]`) failed, took too long, or could not be read; the cause names it, with
    /// line and column. It ends when that function succeeds; of a script that cannot be read, with a restart.
    SiteScript: Entry {
        word: "site-script",
        instance: "FUNCTION",
        priority: Priority::High,
        consequence: "Closing goes on by default. What the script was to open stays closed or is closed again, and the row rests.",
        action: "Look at what the cause says of the devices; correct the script, prove it with starmesh check, restart the observatory node.",
        ..PLAIN
    },
}
