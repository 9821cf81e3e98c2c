//! The catalogue: every sort of alert there is, and what each means.
//!
//! Only what stands here can be raised. The urgency of each and what a person should do are in a file for each area.
//! `docs/operator/alerts.md` is made from both by [`super::markdown`]; a test compares them. The comment above a row is its
//! text in that page.

mod devices;
mod enclosure;
mod images;
mod network;
mod orders;
mod records;

pub use super::catalogue_entry::AlertEntry;
use super::catalogue_macro::catalogue;

catalogue! {
    /// A device of this kind failed again and again, so rows of the schedule rest and are tried again later, each time
    /// after twice as long; the other rows go on. What `[faults] policy` says of the kind of device is done.
    RowPostponed: devices::ROW_POSTPONED,
    /// A step of a row (a slew, cooling, a frame) is silent for longer than such steps take: twice as long as the archive's
    /// telemetry of earlier nights says, or four times as long as is assumed without one, and `faults.overdue_s`. It ends
    /// with the next step, or with the row.
    StepOverdue: devices::STEP_OVERDUE,
    /// The disk of a node's folder is almost full (`safety.disk_free_min_gb`). While it is the data folder of a device
    /// or observatory node, nothing is exposed: the last room is for the journal and for frames that are under way.
    Disk: records::DISK,
    /// A mount was left tracking until it came to one of its limits (`telescope.limits`). Its device node stops it,
    /// without the observatory node and without the bus.
    MountLimit: devices::MOUNT_LIMIT,
    /// A mount goes on to track after a row, although it was told to end that.
    MountTracksOn: devices::MOUNT_TRACKS_ON,
    /// A mount says that it tracks, and its own coordinates, or trailed frames that cannot be solved, show that it has left
    /// the place that it was sent to. It ends with the next frame at its place.
    MountLeftItsPlace: devices::MOUNT_LEFT_ITS_PLACE,
    /// The dome's own watchdog did not accept the command that resets its timer (`watchdog_action`). It closes the dome when its time is over, safe or not.
    Watchdog: enclosure::WATCHDOG,
    /// Nothing closes this dome when its device node's host loses power or hangs: it has no watchdog of its own, or
    /// none is configured.
    NoWatchdog: enclosure::NO_WATCHDOG,
    /// The disk that holds a node's data folder does not take its records of what was ordered and moved. Nothing waits
    /// for it: closing and all else go on.
    Audit: records::AUDIT,
    /// Records of what was ordered and moved found no room while a disk was slow or full. The chain says where, and how
    /// many.
    AuditLost: records::AUDIT_LOST,
    /// Records of what was ordered and moved do not follow from each other: somebody or something has changed or removed
    /// some. A node raises it for its own file; the archive raises it for a node's file. It is active until the node that raised it ends.
    AuditBroken: records::AUDIT_BROKEN,
    /// A node does not send its audit records to the archive. They are still in the node's own file.
    AuditLacking: records::AUDIT_LACKING,
    /// A person's order to stay closed, or to override a limit, was accepted and could not be written.
    OperatorOrders: records::OPERATOR_ORDERS,
    /// An enclosure must be closed and is not seen to be. The guard of the dome and the observatory node each try
    /// again, for ever. Look at the camera of the site before anything else: the shutter may be shut and only its
    /// sensor wrong.
    DomeNotClosed: enclosure::DOME_NOT_CLOSED,
    /// A dome opened and no node had commanded it. Somebody stands at it, another program drives it, or its controller
    /// has a fault. Ask who is on site before you touch anything.
    DomeUncommandedOpen: enclosure::DOME_UNCOMMANDED_OPEN,
    /// The device node of an enclosure and the guard process around it both guard it. One of them has not for 10 s, or has
    /// ended again and again: it does not start, hangs, or cannot do its part, since the configuration is broken, for
    /// example. The cause says which one, and why. The other one guards alone.
    GuardProcess: enclosure::GUARD_PROCESS,
    /// The roof must close, may not close over a telescope that is not parked (`parked_only`), and the mount does not
    /// park.
    DomeWaitsForMount: enclosure::DOME_WAITS_FOR_MOUNT,
    /// The slit of a dome could not be brought to where the telescope looks: the dome does not turn, or not far enough,
    /// or no azimuth of its slit leaves the whole aperture free. Closing does not depend on it.
    DomeNotTurned: enclosure::DOME_NOT_TURNED,
    /// A dome that says that it can turn stands over several telescopes, and nothing says who turns its slit
    /// (`dome.follow`). One slit cannot stand where each of them looks, so Starmesh treats it as a roof.
    DomeShared: enclosure::DOME_SHARED,
    /// What a dome says of its shutter does not fit what was asked of it: its status did not change when it was opened, it
    /// says closed although nobody saw it close, or it changes by itself. The cause says which.
    DomeContradicts: enclosure::DOME_CONTRADICTS,
    /// The guard closed the dome because nobody renewed its permission. The dome is safe; the night waits. The
    /// observatory node takes over again by itself when it runs and the sky is safe.
    DomeHeld: enclosure::DOME_HELD,
    /// A device has not answered for a while: it, its driver or its Alpaca server hangs or is gone, or the network is. The cause
    /// says what happens when it is asked.
    DeviceLost: devices::DEVICE_LOST,
    /// What a device can do, or a part of its state, could not be read: it answers with an error or with nonsense. The cause
    /// names each property. They are asked for again and again; meanwhile nobody takes them for "no" or for 0.
    DeviceUnread: devices::DEVICE_UNREAD,
    /// A device says something of itself that cannot be, for half a minute and longer: it moves without a command, or is busy
    /// although it has done what it was asked. The cause names it. Commands that have their effect are done all the same.
    DeviceContradicts: devices::DEVICE_CONTRADICTS,
    /// Rows of the schedule have failed and are not tried again: they ask for what the device that is named, or the
    /// telescope, cannot do. The cause says what.
    RowFailed: devices::ROW_FAILED,
    /// A mount was commanded to park and is not seen parked in time.
    MountNotParked: devices::MOUNT_NOT_PARKED,
    /// No device node grants the right to command: the one that serves the dome (without a dome: the mount) does not
    /// answer or refuses.
    NoLease: network::NO_LEASE,
    /// The device node that grants the lease of a telescope had lost its file of tokens, or had an older copy of it, and
    /// went on from the newest token that somebody showed it.
    LeaseCountLost: network::LEASE_COUNT_LOST,
    /// A node that published, or that ought to run, is silent now: it ended, hangs, or its host or the network is down. The
    /// time counts from the last that was received of it. After its own start the observatory node expects the device nodes
    /// and archive nodes that its file names, and what ran in the last seven days and has not ended in good order; it gives
    /// them 120 s, since after a power cut other computers start later; one that was heard once and was silent
    /// before that start, with the host of the observatory node running since, gets 15 s.
    NodeSilent: network::NODE_SILENT,
    /// A node hung and was ended by its supervisor, or ended three times within ten minutes without being asked to. The cause
    /// says how it ended last, such as by which signal.
    NodeEnds: network::NODE_ENDS,
    /// The wall clock differs by more than 30 s from what the boot-time clock, other nodes or a mount show; the cause
    /// says by how much.
    ClocksDisagree: network::CLOCKS_DISAGREE,
    /// Two nodes serve one device. While both live, a safety input is unsafe and a dome is not known to be closed.
    SecondWriter: network::SECOND_WRITER,
    /// Two nodes of one role have one name, or a program publishes under a node's name. On one host the younger ends by itself;
    /// from the network alone no node is ended.
    Twin: network::TWIN,
    /// The dome had to be closed again and again: three times within ten minutes.
    ClosesOften: enclosure::CLOSES_OFTEN,
    /// A safety monitor, weather station or switch answers so slowly that its readings are old before they arrive.
    SlowDevice: devices::SLOW_DEVICE,
    /// A program uses a lease, or publishes as a guard, without the right to. Permits, leases or guard numbers of two
    /// programs contradict each other.
    Impostor: network::IMPOSTOR,
    /// The newest schedule file cannot be read, it is gone, or there is none while the robotic switch is on. The cause says which,
    /// and names the line.
    ScheduleRefused: orders::SCHEDULE_REFUSED,
    /// The schedule in force cannot be stored as a version next to those before it.
    ScheduleNotSaved: records::SCHEDULE_NOT_SAVED,
    /// What was begun and finished cannot be written down.
    Journal: records::JOURNAL,
    /// A frame was taken and the device node could not write it.
    SpoolCannotWrite: records::SPOOL_CANNOT_WRITE,
    /// What a camera answered as its image cannot be read: it has lists of different length, fewer pixels than it says, as JSON
    /// another size than was asked for, or is no image at all. The cause says what was wrong. It ends with the next image of that
    /// camera that can be read.
    ImageUnreadable: devices::IMAGE_UNREADABLE,
    /// The archive's database does not take rows: its disk is full or read-only, or another program locks it.
    ArchiveDatabase: records::ARCHIVE_DATABASE,
    /// The daily copy of the archive's database could not be made, or is damaged.
    ArchiveBackup: records::ARCHIVE_BACKUP,
    /// A finished night could not be written as Parquet into the folder of the network's archive. The cause names the file.
    ArchiveParquet: records::ARCHIVE_PARQUET,
    /// A night could not be handed over to a destination (`[[delivery]]`), or not by its time. The cause names the night and what
    /// the destination reported.
    ArchiveDelivery: records::ARCHIVE_DELIVERY,
    /// The folder of images has less room than `archive.disk_warn_gb`. Nothing stops yet.
    ArchiveDiskLow: records::ARCHIVE_DISK_LOW,
    /// The archive tried several times to store one frame or more; the cause says how many. Nothing is lost yet: they
    /// stay in the spools of their cameras' device nodes.
    ArchiveFrame: records::ARCHIVE_FRAME,
    /// Device states or log lines did not reach the archive, and the node that published them holds them no more. The
    /// cause says how many, and on which key.
    ArchiveLost: records::ARCHIVE_LOST,
    /// No alert reaches this address: it does not answer, refuses, or its password is wrong. The cause quotes
    /// its answer. All other receivers get their alerts, and this alert too.
    AlertNotSent: network::ALERT_NOT_SENT,
    /// No alert reaches this browser or phone: its push service does not take it. The cause quotes the answer. All other
    /// receivers get their alerts.
    PushNotSent: network::PUSH_NOT_SENT,
    /// What people acknowledged and shelved cannot be written down.
    AlertsNotSaved: records::ALERTS_NOT_SAVED,
    /// A frame was exposed and never announced by the camera's device node.
    FrameLost: devices::FRAME_LOST,
    /// A camera does not reach its temperature in its time.
    CoolingFailed: devices::COOLING_FAILED,
    /// A mirror cover must be closed and is not seen to be.
    CoverNotClosed: devices::COVER_NOT_CLOSED,
    /// A safety input is switched off in the configuration. The alert stays active as a reminder.
    Disabled: orders::DISABLED,
    /// A file's header lacks values that the telemetry should give.
    ArchiveHeaders: records::ARCHIVE_HEADERS,
    /// A person ordered that nothing opens.
    StayClosed: orders::STAY_CLOSED,
    /// The observatory node does not know what people ordered before it began (their file is gone, or an earlier commander did
    /// not send them), and stays closed until a person says that it may open.
    OrdersLost: orders::ORDERS_LOST,
    /// A person has overridden one limit for a while.
    Override: orders::OVERRIDE,
    /// The stars of a camera grow wider from frame to frame, and not by the seeing of a moment: the middle of the last
    /// five frames of a row is more than 1.3 times as wide as its best five were.
    FocusDrift: images::FOCUS_DRIFT,
    /// A focus run of a camera has not found the focus; the focuser went back to where it stood before.
    FocusFailed: images::FOCUS_FAILED,
    /// What was learned of the focus (best positions, runs) cannot be written down; it is tried again and again.
    FocusNotSaved: records::FOCUS_NOT_SAVED,
    /// A camera sees fewer than 30 % of the stars that the frames before of the same row showed, or less than 30 % of the light
    /// that the stars give at best, clear air allowed for: clouds, a dome before the telescope, dew, or dawn. It ends at half.
    StarsGone: images::STARS_GONE,
    /// The stars of a camera were drawn out in one direction on two frames, one after the other.
    StarsTrailed: images::STARS_TRAILED,
    /// A row asks for guiding, and the field is lost, no frame can be measured, the camera repeats its last frame, pulses
    /// throw the field to and fro, do not hold it or move it the wrong way, the mount takes no pulses, or nobody knows what
    /// pulses do. The cause says which.
    GuidingLost: images::GUIDING_LOST,
    /// The field turns around the star that is guided on.
    FieldTurns: images::FIELD_TURNS,
    /// The learned guiding (effect of pulses, places of fields) cannot be written to disk.
    GuidingNotSaved: records::GUIDING_NOT_SAVED,
    /// A row asks for `pointing`, and where its camera looks could not be proven, or the mount does not go where it is sent.
    /// The cause says which. It ends with the next telescope that is proven to be on target.
    PointingUnproven: images::POINTING_UNPROVEN,
    /// The learned pointing models cannot be written to disk.
    PointingNotSaved: records::POINTING_NOT_SAVED,
    /// A solved frame shows another field than that of its target: the middle of the sensor is farther from it than half the
    /// frame's shorter side. It ends with the next frame that is on target.
    WrongField: images::WRONG_FIELD,
    /// Two frames in a row show the target's star with pixels as bright as the camera can count. Cleared by a frame on
    /// which it is not.
    TargetSaturated: images::TARGET_SATURATED,
    /// A part of `observatory.toml`, or of a file that it names, cannot be used as it stands. The node that needs it goes on
    /// without it, or tries it again, and everything else goes on.
    Configuration: network::CONFIGURATION,
    /// The star catalogue that `[imaging] catalogue` names cannot be opened.
    CatalogueUnusable: network::CATALOGUE_UNUSABLE,
    /// What solved frames taught of the optics cannot be written down.
    OpticsNotSaved: records::OPTICS_NOT_SAVED,
    /// Frames of a camera could not be measured, three in a row: their pixels could not be fetched from the spool, or
    /// measuring does not keep up.
    FramesUnmeasured: images::FRAMES_UNMEASURED,
    /// A function of the site's script (`[hooks]`) failed, took too long, or could not be read; the cause names it, with
    /// line and column. It ends when that function succeeds; of a script that cannot be read, with a restart.
    SiteScript: network::SITE_SCRIPT,
}
