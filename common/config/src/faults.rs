//! `[faults]`: what becomes of the night when a device fails.

use std::collections::BTreeMap;

use contract::Kind;
use serde::Deserialize;

/// How faults of devices are met. The verdict and the closing know nothing of it: they never give up.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Faults {
    /// A row is tried again so often before its policy decides; frames in between start the count anew.
    pub retries: u32,
    /// Between these tries, machine s.
    pub pause_s: f64,
    /// A row that is postponed rests so long at first, then twice as long each time, at most 10 times, machine s.
    pub rest_s: f64,
    /// A step of a row may take so much longer than twice the usual time before somebody is told, machine s.
    pub overdue_s: f64,
    /// By kind of device (`focuser`): what then; `postpone` where absent.
    pub policy: BTreeMap<String, FaultPolicy>,
}

impl Default for Faults {
    fn default() -> Self {
        Self { retries: 2, pause_s: 5.0, rest_s: 30.0, overdue_s: 180.0, policy: BTreeMap::new() }
    }
}

/// What a row does about a device that fails again and again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultPolicy {
    /// Rests and is tried again while its window is open; other rows go on meanwhile.
    #[default]
    Postpone,
    /// Is given up; the next row begins.
    Skip,
    /// Goes on without the device: for focusers, rotators and covers.
    Without,
    /// Closes everything, and is then postponed.
    Close,
    /// Turns the robotic switch off, which closes everything, and waits for a person.
    Stop,
}

impl Faults {
    /// The policy for a kind of device.
    pub fn policy(&self, kind: Kind) -> FaultPolicy {
        self.policy.get(&kind.to_string()).copied().unwrap_or_default()
    }

    /// Whether the site has chosen a policy for a kind of device.
    pub fn is_chosen(&self, kind: Kind) -> bool {
        self.policy.contains_key(&kind.to_string())
    }

    /// What does not hold, in words.
    pub(crate) fn faults(&self) -> Vec<String> {
        let mut found = Vec::new();
        for (key, value) in [("pause_s", self.pause_s), ("rest_s", self.rest_s), ("overdue_s", self.overdue_s)] {
            if !(0.1..=3600.0).contains(&value) {
                found.push(format!("faults.{key} = {value}: expected 0.1 to 3600 s"));
            }
        }
        for (name, policy) in &self.policy {
            let Some(kind) = Kind::ALL.iter().find(|kind| kind.to_string() == *name) else {
                let kinds: Vec<String> = Kind::ALL.iter().map(ToString::to_string).collect();
                found.push(format!("faults.policy.{name}: no such kind; expected one of {}", kinds.join(", ")));
                continue;
            };
            if *policy == FaultPolicy::Without && !matches!(kind, Kind::Focuser | Kind::Rotator | Kind::CoverCalibrator)
            {
                found.push(format!("faults.policy.{name} = \"without\": no frame is worth taking without it"));
            }
        }
        found
    }
}
