//! The dome's own watchdog: fed while the permit lives, and starved when it does not.
//!
//! It closes the dome when the device node or its whole host is dead. Feeding it for a dead commander would defeat it,
//! so each feeding needs a beat of the guard's own loop with a living permit.

use std::time::Duration;

use alpaca::{Alpaca, AlpacaError};
use bus::{MachineTime, Node};
use contract::Device;
use contract::observatory::AlertKind;

/// Feedings within the watchdog's time limit, so that a few may be lost.
const PER_LIMIT: f64 = 4.0;

/// How a dome's watchdog is fed.
#[derive(Debug)]
pub struct Watchdog {
    limit_s: Option<f64>,
    action: Option<(String, String)>,
    last: Option<MachineTime>,
}

impl Watchdog {
    /// As configured.
    pub fn of(dome: &config::Dome) -> Self {
        let action = dome.watchdog_action.clone().map(|action| (action, dome.watchdog_parameters.clone()));
        Self { limit_s: dome.watchdog_s, action, last: None }
    }

    /// Raises the alert of a dome that has none.
    pub fn tell(&self, node: &Node, dome: &Device) {
        if self.limit_s.is_none() {
            let cause = format!("dome {} has no watchdog of its own, or none is configured", dome.name);
            node.alerts.raise(AlertKind::NoWatchdog, &dome.name, &cause);
        }
    }

    /// The feeding that is due now, if one is; `lives` says that the permit is valid and safe in this very beat.
    pub fn due(
        &mut self,
        lives: bool,
        now: MachineTime,
        alpaca: &Alpaca,
    ) -> Option<impl Future<Output = Result<(), AlpacaError>> + Send + use<>> {
        if !self.is_due(lives, now) {
            return None;
        }
        let (action, parameters) = self.action.clone()?;
        let alpaca = alpaca.at_once();
        Some(async move { alpaca.put("action", &[("Action", &action), ("Parameters", &parameters)]).await })
    }

    fn is_due(&mut self, lives: bool, now: MachineTime) -> bool {
        let Some(limit_s) = self.limit_s.filter(|_| lives) else { return false };
        let period = Duration::from_secs_f64((limit_s / PER_LIMIT).clamp(0.5, 900.0));
        let due = self.last.is_none_or(|last| now.since(last) >= period);
        if due {
            self.last = Some(now);
        }
        due
    }

    /// What a feeding came to.
    pub fn fed(&self, node: &Node, dome: &Device, result: Result<(), AlpacaError>) {
        match result {
            Ok(()) => node.alerts.clear(AlertKind::Watchdog, &dome.name),
            Err(error) => {
                let cause = format!("the watchdog of dome {} was not fed: {error}", dome.name);
                node.alerts.raise(AlertKind::Watchdog, &dome.name, &cause);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_fed_four_times_in_its_limit_and_only_while_the_permit_lives() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let mut dog = Watchdog { limit_s: Some(120.0), action: Some(("feed".to_owned(), String::new())), last: None };
        let fed: Vec<u64> = (0..=120).filter(|second| dog.is_due(true, at(*second))).collect();
        assert_eq!(fed, [0, 30, 60, 90, 120]);
        assert!((121..400).all(|second| !dog.is_due(false, at(second))), "starved");
        assert!(dog.is_due(true, at(400)));
    }
}
