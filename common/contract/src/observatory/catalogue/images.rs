//! Alerts of what frames show.

use super::super::Priority;
use super::super::catalogue_entry::{AlertEntry, PLAIN};

pub(super) const FOCUS_DRIFT: AlertEntry = AlertEntry {
    word: "focus-drift",
    instance: "CAMERA",
    consequence: "The frames are less sharp than they could be.",
    action: "Compare with the seeing; focus again where the seeing is not worse.",
    ..PLAIN
};

pub(super) const FOCUS_FAILED: AlertEntry = AlertEntry {
    word: "focus-failed",
    instance: "CAMERA",
    priority: Priority::Medium,
    consequence: "Frames are taken at the focus as it was known before.",
    action: "Look at the plot of the run and at its reason; the next run that succeeds ends this alert.",
    ..PLAIN
};

pub(super) const STARS_GONE: AlertEntry = AlertEntry {
    word: "stars-gone",
    instance: "CAMERA",
    consequence: "The frames may be worth nothing; the sensors of the weather decide alone whether the roof closes.",
    action: "Look at the sky and at the last frame.",
    ..PLAIN
};

pub(super) const STARS_TRAILED: AlertEntry = AlertEntry {
    word: "stars-trailed",
    instance: "CAMERA",
    priority: Priority::Medium,
    consequence: "The frames are smeared.",
    action: "Look at tracking, guiding and wind.",
    ..PLAIN
};

pub(super) const GUIDING_LOST: AlertEntry = AlertEntry {
    word: "guiding-lost",
    instance: "CAMERA",
    priority: Priority::Medium,
    consequence: "The mount only tracks: the field may drift. Frames go on unless `guiding.when_lost` says otherwise.",
    action: "Look at the sky, the last frame and the mount; without a calibration run calibrate_guiding.",
    ..PLAIN
};

pub(super) const FIELD_TURNS: AlertEntry = AlertEntry {
    word: "field-turns",
    instance: "CAMERA",
    consequence: "Stars far from the middle are drawn out on long exposures.",
    action: "Look at the polar alignment, or at the rotator.",
    ..PLAIN
};

pub(super) const POINTING_UNPROVEN: AlertEntry = AlertEntry {
    word: "pointing-unproven",
    instance: "CAMERA",
    priority: Priority::Medium,
    consequence: "The row rests or is given up, as `pointing.on_failure` says; no frame counts meanwhile.",
    action: "Look at the last frame and at the sky; compare the mount's clock, site and alignment.",
    ..PLAIN
};

pub(super) const WRONG_FIELD: AlertEntry = AlertEntry {
    word: "wrong-field",
    instance: "CAMERA",
    priority: Priority::Medium,
    consequence: "The target is not on the frames.",
    action: "Look at the target's coordinates, the mount's alignment and its frame of coordinates.",
    ..PLAIN
};

pub(super) const TARGET_SATURATED: AlertEntry = AlertEntry {
    word: "target-saturated",
    instance: "CAMERA",
    priority: Priority::Medium,
    consequence: "The light of the target cannot be measured on these frames; they are taken and stored all the same.",
    action: "Shorten the exposure of the row, defocus, or set `reduce_exposure_time` in it.",
    ..PLAIN
};

pub(super) const FRAMES_UNMEASURED: AlertEntry = AlertEntry {
    word: "frames-unmeasured",
    instance: "CAMERA",
    consequence: "Focus drift, clouds and trailing are not noticed on them; the archive stores them all the same.",
    action: "Look at the reason in the facts of the last frame, and at the way from this node to the spool.",
    ..PLAIN
};
