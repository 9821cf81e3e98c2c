//! Which properties a device has, as its answers show.

use std::collections::HashSet;

use alpaca::AlpacaError;
use serde_json::Value;

use crate::readings::aged_sensor;

/// What a device was found to have and not to have.
#[derive(Debug, Default)]
pub struct Has {
    /// Properties that it denies to have; never those that it had once.
    absent: HashSet<String>,
    answered: HashSet<String>,
}

impl Has {
    /// Learns from an answer.
    pub fn learn(&mut self, property: &str, answer: &Result<Value, AlpacaError>) {
        match answer {
            Ok(_) => drop(self.answered.insert(property.to_owned())),
            // A device has each property that it had once: a server that is restarted denies everything for a while.
            Err(error) if lacks(property, error) && !self.answered.contains(property) => {
                self.absent.insert(property.to_owned());
            }
            Err(_) => {}
        }
    }

    /// It was connected anew, and may have changed.
    pub fn ask_again(&mut self) {
        self.absent.clear();
    }

    /// Those of these that are worth asking for.
    pub fn present(&self, names: impl Iterator<Item = String>) -> Vec<String> {
        names.filter(|name| !self.absent.contains(name)).collect()
    }

    /// Has it ever answered anything?
    pub fn has_spoken(&self) -> bool {
        !self.answered.is_empty()
    }
}

/// Does an error mean that a device does not have a property? Drivers that know only the newest of all ages call the
/// name of a sensor an invalid value.
fn lacks(property: &str, error: &AlpacaError) -> bool {
    error.is_not_implemented()
        || (error.is_invalid_value() && aged_sensor(property).is_some_and(|sensor| !sensor.is_empty()))
}
