//! A row of the catalogue of alerts.

use super::Priority;

/// What is the same for every alert of one kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlertEntry {
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

/// What most rows have in common: one alert of its kind, shown at once and gone with its cause.
pub(super) const PLAIN: AlertEntry = AlertEntry {
    word: "",
    instance: "",
    priority: Priority::Advisory,
    consequence: "",
    action: "",
    on_delay_s: 0,
    hold_s: 0,
};

/// As [`PLAIN`], of those that need a person within minutes.
pub(super) const HIGH: AlertEntry = AlertEntry { priority: Priority::High, ..PLAIN };
