//! Alerts of what a person ordered or switched off.

use super::super::Priority;
use super::super::catalogue_entry::{AlertEntry, HIGH, PLAIN};

pub(super) const SCHEDULE_REFUSED: AlertEntry = AlertEntry {
    word: "schedule-refused",
    consequence: "The schedule before it stays in force; without one, nothing is observed.",
    action: "Correct the file, or put it back; it is read again by itself.",
    ..HIGH
};

pub(super) const DISABLED: AlertEntry = AlertEntry {
    word: "disabled",
    instance: "INPUT",
    priority: Priority::Medium,
    consequence: "The verdict does without it.",
    action: "Take `disabled` out of the configuration once it can be relied on again.",
    ..PLAIN
};

pub(super) const STAY_CLOSED: AlertEntry = AlertEntry {
    word: "stay-closed",
    consequence: "Nothing opens.",
    action: "Take it back: starmesh order SITE/TELESCOPE open-again.",
    ..PLAIN
};

pub(super) const ORDERS_LOST: AlertEntry = AlertEntry {
    word: "orders-lost",
    consequence: "Nothing opens until a person says so: the night is being lost.",
    action: "Make sure that nobody wants the dome closed, then: starmesh order SITE/TELESCOPE open-again.",
    ..HIGH
};

pub(super) const OVERRIDE: AlertEntry = AlertEntry {
    word: "override",
    instance: "INPUT",
    consequence: "It closes nothing.",
    action: "Apply the limit again: starmesh order SITE/TELESCOPE restore INPUT.",
    ..PLAIN
};
