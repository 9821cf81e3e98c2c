//! Feeds the dome's own watchdog, as `interlock::Watchdog` decides.
//!
//! It closes the dome when the device node or its whole host is dead. Feeding it for a dead commander would defeat it,
//! so each feeding needs a beat of the guard's own loop with a living permit.

use alpaca::{Alpaca, AlpacaError};
use contract::Device;
use contract::observatory::AlertKind;
use node::Node;

/// How a dome's watchdog is fed.
#[derive(Debug)]
pub struct Feeder {
    limit_s: Option<f64>,
    action: Option<(String, String)>,
}

impl Feeder {
    /// As configured.
    pub fn of(dome: &config::Dome) -> Self {
        let action = dome.watchdog_action.clone().map(|action| (action, dome.watchdog_parameters.clone()));
        Self { limit_s: dome.watchdog_s, action }
    }

    /// A dome that was not fed for this time closes, s; none where the dome has no watchdog.
    pub fn limit_s(&self) -> Option<f64> {
        self.limit_s
    }

    /// Raises the alert of a dome that has none.
    pub fn report(&self, node: &Node, dome: &Device) {
        if self.limit_s.is_none() {
            let cause = format!("dome {} has no watchdog of its own, or none is configured", dome.name);
            node.alerts.raise(AlertKind::NoWatchdog, &dome.name, &cause);
        }
    }

    /// One feeding, where it is known how.
    pub fn feed(&self, alpaca: &Alpaca) -> Option<impl Future<Output = Result<(), AlpacaError>> + Send + use<>> {
        let (action, parameters) = self.action.clone()?;
        let alpaca = alpaca.at_once();
        Some(async move { alpaca.put("action", &[("Action", &action), ("Parameters", &parameters)]).await })
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
