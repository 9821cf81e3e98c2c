//! Polls a device: everything on connecting, and the polled properties again and again.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

use alpaca::{Abilities, Alpaca, AlpacaError, STATUS_DEADLINE, value};
use bus::Clock;
use config::Common;
use contract::device::DeviceDescription;
use contract::{NoData, Payload as _};
use futures_util::StreamExt as _;
use serde_json::Value;
use units::Utc;

use crate::driver::{Capabilities, Driver};
use crate::now::Now;
use crate::readings::member;
use crate::simulated::is_simulated;

/// So many calls in a row without a whole answer and the link is lost.
pub const LOST_AFTER: usize = 2;

/// Questions to a slow device that are under way at one time.
pub const LANES: usize = 6;
/// A device that has fallen silent is asked so often whether it answers again.
const KNOCK_EVERY: Duration = Duration::from_millis(250);
/// An answer that is read so long after it was asked for waited in a process that was stalled.
const TOO_OLD: Duration = Duration::from_secs(3);

/// An answer.
#[derive(Debug)]
pub struct PropertyAnswer {
    /// The ASCOM name of its property.
    pub property: String,
    /// What came.
    pub result: Result<Value, AlpacaError>,
    /// Sky time of the answer.
    pub at_utc: Utc,
    /// When it was asked for.
    pub asked: Now,
}

/// What connecting brought.
pub struct Greeting<D: Driver> {
    /// The device's own words and the fixed rows of the FITS-header table.
    pub answers: Vec<PropertyAnswer>,
    /// It answers `devicestate`.
    pub device_state: bool,
    /// What it can do.
    pub description: DeviceDescription<Capabilities<D>>,
    /// What of that was read.
    pub abilities: Abilities,
}

/// What one poll brought.
pub struct Poll {
    /// When it began.
    pub began: Now,
    /// Same, for timers.
    pub began_at: tokio::time::Instant,
    /// The answers.
    pub answers: Vec<PropertyAnswer>,
    /// The link is lost, for this reason.
    pub lost: Option<AlpacaError>,
    /// All polled properties were asked for.
    pub full: bool,
    /// `devicestate` is answered no more.
    pub device_state: bool,
    /// Several questions at once were too many for the server.
    pub crowded: bool,
    /// The properties left unasked, as the answers before took too long, and are published first, or one did not come.
    pub unasked: Vec<String>,
}

/// What a poll asks, and how.
pub struct Wanted {
    /// These properties.
    pub properties: Vec<String>,
    /// They are all that decides.
    pub full: bool,
    /// `devicestate` is asked first.
    pub device_state: bool,
    /// So many questions at once.
    pub lanes: usize,
    /// Once the answers have taken so long, or one did not come, they are published before more is asked.
    pub publish_after: Option<Duration>,
}

impl Poll {
    /// The first property to which no whole answer came.
    pub fn silent(&self) -> Option<&String> {
        let is_silent = |answer: &&PropertyAnswer| answer.result.as_ref().is_err_and(AlpacaError::is_transport);
        let single = self.answers.iter().find(is_silent).map(|answer| &answer.property);
        // All of them were asked for at once.
        let all = self.lost.as_ref().is_some_and(AlpacaError::is_transport).then(|| self.unasked.first()).flatten();
        single.or(all)
    }

    /// The server denies, in HTTP's words, every property of the device: there is no such device any more.
    pub fn denied(&self) -> Option<&AlpacaError> {
        let mut errors = self.answers.iter().map(|answer| answer.result.as_ref().err());
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
        let mut answers: Vec<PropertyAnswer> = Vec::new();
        let mut silent = 0;
        for property in own.iter().chain(fixed.iter().filter(|name| !own.contains(name))) {
            let answer = self.ask(property).await;
            if let Err(error) = &answer.result
                && (error.is_transport() || error.is_not_connected())
            {
                silent += 1;
                if silent >= LOST_AFTER {
                    return Err(error.clone());
                }
            }
            answers.push(answer);
        }
        let device_state = match self.alpaca.get("devicestate").await {
            Ok(state) => state.is_array(),
            Err(error) if error.is_transport() => return Err(error),
            Err(_) => false,
        };
        driver.connected();
        let mut abilities = Abilities::of(self.alpaca.clone());
        let can = driver.capabilities(&mut abilities).await?;
        let text = |name: &str| {
            let answer = answers.iter().find(|answer| answer.property == name);
            answer.and_then(|answer| value::text(answer.result.as_ref().ok()?).ok()).unwrap_or_default()
        };
        let version = text("InterfaceVersion").parse().unwrap_or(0);
        let driver = [text("DriverInfo"), text("DriverVersion")].join(" ").trim().to_owned();
        let description = DeviceDescription {
            server: common.server.clone(),
            number: common.number,
            device_name: text("Name"),
            driver,
            interface_version: version,
            simulated: is_simulated(&common.server).await.unwrap_or(false),
            can,
            unread: abilities.unread().clone(),
        };
        tracing::debug!(kind = Capabilities::<D>::NAME, device = %common.name, device_state, "connected");
        Ok(Greeting { answers, device_state, description, abilities })
    }

    async fn connect(&self) -> Result<(), AlpacaError> {
        match self.alpaca.put("connected", &[("Connected", "True")]).await {
            Ok(()) => Ok(()),
            Err(error) if error.is_not_implemented() => Ok(()),
            Err(error) => {
                // Slow hardware answers late, and some drivers refuse what is already so.
                let connected = self.alpaca.get("connected").await.ok().and_then(|answer| value::flag(&answer).ok());
                if connected == Some(true) { Ok(()) } else { Err(error) }
            }
        }
    }

    fn now(&self) -> Now {
        Now { machine: self.clock.machine(), sky: self.clock.sky() }
    }

    /// Reads one property.
    pub async fn ask(&self, property: &str) -> PropertyAnswer {
        let (member, parameters) = member(property);
        let parameters: Vec<(&str, &str)> = parameters.iter().map(|(name, value)| (*name, value.as_str())).collect();
        let mut asked = self.now();
        let mut result = self.alpaca.get_noting(&member, &parameters, || asked = self.now()).await;
        let took = self.clock.machine().since(asked.machine);
        if result.is_ok() && took > TOO_OLD {
            // Timers do not run while a process is stopped or a host sleeps; this clock does.
            let detail = format!("the answer was {:.1} s old when it was read", took.as_secs_f64());
            result = Err(AlpacaError::Value(NoData::new("stale", detail)));
        }
        PropertyAnswer { property: property.to_owned(), result, at_utc: self.clock.utc(), asked }
    }

    /// Polls properties, `devicestate` first where the device has it.
    pub async fn poll(self, wanted: Wanted) -> Poll {
        let Wanted { properties, full, device_state, lanes, publish_after } = wanted;
        let (began, began_at) = (self.now(), tokio::time::Instant::now());
        let (answers, unasked) = (Vec::new(), Vec::new());
        let mut poll = Poll { began, began_at, answers, lost: None, full, device_state, crowded: false, unasked };
        let mut silent = 0;
        if device_state && properties.len() > 1 {
            match self.alpaca.get("devicestate").await {
                Ok(state) => poll.answers = self.matched(&properties, &state, began),
                Err(error) if error.is_timeout() && publish_after.is_some() => {
                    (poll.lost, poll.unasked) = (Some(error), properties);
                    return poll;
                }
                Err(error) if error.is_transport() => silent = 1,
                Err(error) if error.is_not_connected() => {
                    poll.lost = Some(error);
                    return poll;
                }
                Err(_) => poll.device_state = false,
            }
        }
        let answered: HashSet<String> = poll.answers.iter().map(|answer| answer.property.clone()).collect();
        let mut spoke = !answered.is_empty();
        let mut left: Vec<String> = properties.into_iter().filter(|property| !answered.contains(property)).collect();
        if lanes > 1 && left.len() > 1 {
            let answers = self.ask_at_once(&left, lanes).await;
            let timed_out = |answer: &PropertyAnswer| answer.result.as_ref().is_err_and(AlpacaError::is_transport);
            // A property that timed out while others did not may have waited behind them: it is asked again by itself.
            poll.crowded = answers.iter().any(timed_out);
            let (failed, good): (Vec<PropertyAnswer>, Vec<PropertyAnswer>) = answers.into_iter().partition(timed_out);
            spoke |= !good.is_empty();
            poll.answers.extend(good);
            // A device that answered nothing is not waited for a second time.
            if !spoke && publish_after.is_some() {
                poll.lost = failed.first().and_then(|answer| answer.result.as_ref().err()).cloned();
                poll.unasked = left;
                return poll;
            }
            left = failed.into_iter().map(|answer| answer.property).collect();
        }
        let mut left = left.into_iter();
        while let Some(property) = left.next() {
            let answer = self.ask(&property).await;
            match &answer.result {
                Err(error) if error.is_not_connected() => {
                    poll.lost = Some(error.clone());
                    return poll;
                }
                Err(error) if error.is_transport() => silent += 1,
                Ok(_) | Err(_) => (silent, spoke) = (0, true),
            }
            let failed = answer.result.as_ref().err().filter(|_| silent >= LOST_AFTER).cloned();
            poll.answers.push(answer);
            if failed.is_some() {
                poll.lost = failed;
                return poll;
            }
            if publish_after.is_some_and(|limit| silent > 0 || began_at.elapsed() > limit) {
                poll.unasked = left.by_ref().collect();
            }
        }
        if !spoke && silent > 0 {
            poll.lost = poll.answers.last().and_then(|answer| answer.result.as_ref().err()).cloned();
        }
        poll
    }

    /// Asks for a property each quarter of a second, beside what else is asked, until an answer of any kind comes. One that does
    /// not come `within` this time is not waited for: a server that was away may never give it. Each next one is waited for
    /// twice as long: a slow server must not drown in questions that nobody waits for.
    pub async fn until_answered(self, property: &str, mut within: Duration) {
        let (member, parameters) = member(property);
        let parameters: Vec<(&str, &str)> = parameters.iter().map(|(name, value)| (*name, value.as_str())).collect();
        let alpaca = self.alpaca.at_once();
        loop {
            let next = tokio::time::Instant::now() + KNOCK_EVERY;
            let answer = tokio::time::timeout(within, alpaca.get_with(&member, &parameters)).await;
            if answer.is_ok_and(|answer| !answer.is_err_and(|error| error.is_transport())) {
                return;
            }
            within = (within * 2).min(STATUS_DEADLINE);
            tokio::time::sleep_until(next).await;
        }
    }

    /// Asks for several properties at a time, each with a deadline and a connection of its own.
    async fn ask_at_once(&self, properties: &[String], lanes: usize) -> Vec<PropertyAnswer> {
        let own = Self { alpaca: self.alpaca.at_once(), clock: self.clock.clone() };
        let asking = properties.iter().cloned().map(|property| {
            let own = own.clone();
            async move { own.ask(&property).await }
        });
        futures_util::stream::iter(asking).buffer_unordered(lanes).collect().await
    }

    /// The wanted properties that a `devicestate` answer holds; nulls, and what it contains twice, are asked for
    /// singly.
    fn matched(&self, wanted: &[String], state: &Value, asked: Now) -> Vec<PropertyAnswer> {
        let at_utc = self.clock.utc();
        let (mut answers, mut twice): (Vec<PropertyAnswer>, HashSet<String>) = (Vec::new(), HashSet::new());
        for entry in state.as_array().into_iter().flatten().filter_map(Value::as_object) {
            let field = |name: &str| entry.iter().find(|(key, _)| key.eq_ignore_ascii_case(name)).map(|(_, v)| v);
            let (Some(name), Some(value)) = (field("Name").and_then(Value::as_str), field("Value")) else { continue };
            if let Some(property) = wanted.iter().find(|property| property.eq_ignore_ascii_case(name))
                && !value.is_null()
            {
                if answers.iter().any(|answer| answer.property == *property) {
                    twice.insert(property.clone());
                }
                answers.push(PropertyAnswer { property: property.clone(), result: Ok(value.clone()), at_utc, asked });
            }
        }
        let too_old = self.clock.machine().since(asked.machine) > TOO_OLD;
        answers.retain(|answer| !too_old && !twice.contains(&answer.property));
        answers
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use contract::Kind;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    use super::*;

    fn questions(listener: &TcpListener) -> Questions {
        let server = listener.local_addr().unwrap().to_string();
        let alpaca = Alpaca::new(alpaca::http_client().unwrap(), &server, Kind::ObservingConditions, 0).unwrap();
        Questions { alpaca, clock: Clock::machine_clock() }
    }

    #[tokio::test]
    async fn a_server_that_hangs_is_waited_for_once_and_what_decides_is_asked_anew() {
        // The system takes the connections, and nobody answers.
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let properties = ["RainRate", "WindSpeed", "Humidity"].map(str::to_owned);
        let poll = |device_state, lanes| {
            let publish_after = Some(Duration::from_secs(60));
            let wanted = Wanted { properties: properties.to_vec(), full: true, device_state, lanes, publish_after };
            questions(&listener).poll(wanted)
        };
        let (single, state, several) = tokio::join!(poll(false, 1), poll(true, 1), poll(false, LANES));
        for (case, poll, answers, unasked) in [
            ("one by one", single, 1, &properties[1..]),
            ("devicestate first", state, 0, &properties[..]),
            ("several at once", several, 0, &properties[..]),
        ] {
            assert!(poll.lost.as_ref().is_some_and(AlpacaError::is_timeout), "{case}: {:?}", poll.lost);
            assert_eq!((poll.answers.len(), &poll.unasked[..]), (answers, unasked), "{case}");
            assert_eq!(poll.silent(), Some(&properties[0]), "{case}");
        }
    }

    /// A server, and what asks it.
    fn server() -> (tokio::net::TcpListener, Questions) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let asking = questions(&listener);
        listener.set_nonblocking(true).unwrap();
        (tokio::net::TcpListener::from_std(listener).unwrap(), asking)
    }

    async fn is_answered(asking: Questions) {
        let limit = Duration::from_secs(60);
        tokio::time::timeout(limit, asking.until_answered("RainRate", KNOCK_EVERY)).await.unwrap();
    }

    #[tokio::test]
    async fn a_device_that_was_silent_is_asked_until_it_answers() {
        let (listener, asking) = server();
        tokio::spawn(async move {
            let mut hang = Vec::new();
            loop {
                let (mut stream, _) = listener.accept().await.unwrap();
                if hang.len() < 2 {
                    hang.push(stream);
                    continue;
                }
                // Its client may have given it up.
                let _ = stream.read(&mut [0; 4096]).await;
                let _ = stream.write_all(b"HTTP/1.1 500 Starting\r\nContent-Length: 0\r\n\r\n").await;
            }
        });
        is_answered(asking).await;
    }

    #[tokio::test]
    async fn a_server_that_answers_slowly_one_after_the_other_is_not_drowned_in_questions() {
        let (listener, asking) = server();
        tokio::spawn(async move {
            loop {
                let (mut stream, _) = listener.accept().await.unwrap();
                let _ = stream.read(&mut [0; 4096]).await;
                tokio::time::sleep(KNOCK_EVERY * 3).await;
                let _ = stream.write_all(b"HTTP/1.1 500 Slow\r\nContent-Length: 0\r\n\r\n").await;
            }
        });
        is_answered(asking).await;
    }
}
