//! What a device is asked: everything on connecting, and the polled properties again and again.

use std::collections::HashSet;
use std::sync::Arc;

use bus::Clock;
use config::Common;
use contract::device::Description;
use contract::{NoData, Payload as _};
use serde_json::Value;
use units::Utc;

use crate::alpaca::{Alpaca, AlpacaError, value};
use crate::driver::{Capabilities, Driver, Now};
use crate::readings::member;
use crate::simulated::is_simulated;

/// So many calls in a row without a whole answer and the link is lost.
const LOST_AFTER: usize = 2;

/// An answer, under the ASCOM name of its property.
pub type Answer = (String, Result<Value, AlpacaError>, Utc);

/// What connecting brought.
pub struct Greeting<D: Driver> {
    /// The device's own words and the fixed rows of the FITS-header table.
    pub answers: Vec<Answer>,
    /// It answers `devicestate`.
    pub device_state: bool,
    /// What it can do.
    pub description: Description<Capabilities<D>>,
}

/// What one poll brought.
pub struct Poll {
    /// When it began.
    pub began: Now,
    /// Same, for timers.
    pub began_at: tokio::time::Instant,
    /// The answers.
    pub answers: Vec<Answer>,
    /// The link is lost, for this reason.
    pub lost: Option<AlpacaError>,
    /// All polled properties were asked for.
    pub full: bool,
    /// `devicestate` is answered no more.
    pub device_state: bool,
}

impl Poll {
    /// The server denies, in HTTP's words, every property of the device: there is no such device any more.
    pub fn denied(&self) -> Option<&AlpacaError> {
        let mut errors = self.answers.iter().map(|(_, answer, _)| answer.as_ref().err());
        let denied = |error: Option<&AlpacaError>| matches!(error, Some(AlpacaError::Http { .. }));
        let all = self.full && errors.clone().all(denied);
        errors.next_back().flatten().filter(|_| all)
    }
}

/// What must be known to ask.
#[derive(Clone)]
pub struct Questions {
    /// The device.
    pub alpaca: Alpaca,
    /// The clock for stamps.
    pub clock: Clock,
}

impl Questions {
    /// Connects a device and asks what does not change.
    pub async fn greet<D: Driver>(
        &self,
        driver: Arc<D>,
        common: &Common,
        fixed: &[String],
    ) -> Result<Greeting<D>, AlpacaError> {
        if common.connect {
            self.connect().await?;
        }
        let own = ["Name", "DriverVersion", "DriverInfo", "InterfaceVersion"].map(str::to_owned);
        let mut answers: Vec<Answer> = Vec::new();
        let mut silent = 0;
        for property in own.iter().chain(fixed.iter().filter(|name| !own.contains(name))) {
            let answer = self.ask(property).await;
            if let Err(error) = &answer
                && (error.is_transport() || error.is_not_connected())
            {
                silent += 1;
                if silent >= LOST_AFTER {
                    return Err(error.clone());
                }
            }
            answers.push((property.clone(), answer, self.clock.utc()));
        }
        let device_state = match self.alpaca.get("devicestate").await {
            Ok(state) => state.is_array(),
            Err(error) if error.is_transport() => return Err(error),
            Err(_) => false,
        };
        let can = driver.capabilities(&self.alpaca).await?;
        let text = |name: &str| {
            let answer = answers.iter().find(|(property, ..)| property == name).map(|(_, answer, _)| answer);
            answer.and_then(|answer| value::text(answer.as_ref().ok()?).ok()).unwrap_or_default()
        };
        let version = text("InterfaceVersion").parse().unwrap_or(0);
        let driver = [text("DriverInfo"), text("DriverVersion")].join(" ").trim().to_owned();
        let description = Description {
            server: common.server.clone(),
            number: common.number,
            device_name: text("Name"),
            driver,
            interface_version: version,
            simulated: is_simulated(&common.server).await.unwrap_or(false),
            can,
        };
        tracing::debug!(kind = Capabilities::<D>::NAME, device = %common.name, device_state, "connected");
        Ok(Greeting { answers, device_state, description })
    }

    async fn connect(&self) -> Result<(), AlpacaError> {
        match self.alpaca.put("connected", &[("Connected", "True")]).await {
            Ok(()) => Ok(()),
            Err(error) if error.is_not_implemented() => Ok(()),
            Err(error) => {
                // slow hardware answers late, and some drivers refuse what is already so
                let connected = self.alpaca.get("connected").await.ok().and_then(|answer| value::flag(&answer).ok());
                if connected == Some(true) { Ok(()) } else { Err(error) }
            }
        }
    }

    /// Reads one property.
    pub async fn ask(&self, property: &str) -> Result<Value, AlpacaError> {
        let (member, parameters) = member(property);
        let parameters: Vec<(&str, &str)> = parameters.iter().map(|(name, value)| (*name, value.as_str())).collect();
        self.alpaca.get_with(&member, &parameters).await
    }

    /// Polls these properties, `devicestate` first where the device has it.
    pub async fn poll(self, wanted: Vec<String>, full: bool, device_state: bool) -> Poll {
        let began = Now { machine: self.clock.machine(), sky: self.clock.sky() };
        let began_at = tokio::time::Instant::now();
        let mut poll = Poll { began, began_at, answers: Vec::new(), lost: None, full, device_state };
        let mut silent = 0;
        if device_state && wanted.len() > 1 {
            match self.alpaca.get("devicestate").await {
                Ok(state) => poll.answers = self.matched(&wanted, &state),
                Err(error) if error.is_transport() => silent = 1,
                Err(error) if error.is_not_connected() => {
                    poll.lost = Some(error);
                    return poll;
                }
                Err(_) => poll.device_state = false,
            }
        }
        let answered: HashSet<String> = poll.answers.iter().map(|(property, ..)| property.clone()).collect();
        let mut spoke = !answered.is_empty();
        for property in wanted.into_iter().filter(|property| !answered.contains(property)) {
            let answer = self.ask(&property).await;
            match &answer {
                Err(error) if error.is_not_connected() => {
                    poll.lost = Some(error.clone());
                    return poll;
                }
                Err(error) if error.is_transport() => silent += 1,
                Ok(_) | Err(_) => (silent, spoke) = (0, true),
            }
            let failed = answer.as_ref().err().filter(|_| silent >= LOST_AFTER).cloned();
            poll.answers.push((property, answer, self.clock.utc()));
            if failed.is_some() {
                poll.lost = failed;
                return poll;
            }
        }
        if !spoke && silent > 0 {
            poll.lost = poll.answers.pop().and_then(|(_, answer, _)| answer.err());
        }
        poll
    }

    /// The wanted properties that a `devicestate` answer holds; nulls are asked for singly.
    fn matched(&self, wanted: &[String], state: &Value) -> Vec<Answer> {
        let at_utc = self.clock.utc();
        let mut answers = Vec::new();
        for entry in state.as_array().into_iter().flatten().filter_map(Value::as_object) {
            let field = |name: &str| entry.iter().find(|(key, _)| key.eq_ignore_ascii_case(name)).map(|(_, v)| v);
            let (Some(name), Some(value)) = (field("Name").and_then(Value::as_str), field("Value")) else { continue };
            if let Some(property) = wanted.iter().find(|property| property.eq_ignore_ascii_case(name))
                && !value.is_null()
                && !answers.iter().any(|(have, ..): &Answer| have == property)
            {
                answers.push((property.clone(), Ok(value.clone()), at_utc));
            }
        }
        answers
    }
}

/// The reason that stands for every property of a lost device.
pub fn lost_reason(error: &AlpacaError) -> NoData {
    error.no_data()
}
