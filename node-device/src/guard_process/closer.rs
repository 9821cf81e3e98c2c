//! Closes one dome by Alpaca with the last-good copy, without the node and without the bus.

use std::sync::Arc;
use std::time::Duration;

use alpaca::{Alpaca, AlpacaError, http_client};
use bus::MachineTime;
use config::CloseWithMount;
use contract::device::dome::Shutter;
use contract::observatory::AlertKind;
use contract::{BootId, Chunk, Kind};
use futures_util::future::join_all;
use interlock::guard::{Alarm, Deed, Guard, Settings};
use tokio::task::JoinSet;

use super::copy::{DomeCopy, Target, seconds};
use crate::shutter_status::shutter_status;

/// A reading that is older proves nothing.
const FRESH: Duration = Duration::from_secs(5);
/// Shutter and mounts are asked so often while this process closes, or looks whether it has to.
const LOOK: Duration = Duration::from_secs(1);
/// A mount that does not park is asked again so often.
const PARK_AGAIN: Duration = Duration::from_secs(30);

/// What the servers have answered.
pub enum Answer {
    /// The shutter, and when it was asked for.
    Shutter(Result<Shutter, AlpacaError>, MachineTime),
    /// Whether all mounts are parked, and when they were asked.
    Parked(bool, MachineTime),
    /// A command, by its name.
    Done(&'static str, Result<(), AlpacaError>),
}

/// What closing has come to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Word {
    /// Something that a person must know, or need not any more.
    Alarm(Alarm, bool),
    /// A command went out.
    Sent(&'static str),
    /// A command failed.
    Failed(&'static str, String),
}

/// The hands and eyes for one dome.
pub struct Closer {
    /// What is known of it.
    pub dome: DomeCopy,
    alpaca: Alpaca,
    mounts: Vec<(Alpaca, bool)>,
    /// No mount under the dome is in a file of another telescope.
    knows_all_mounts: bool,
    guard: Guard,
    answers: JoinSet<Answer>,
    shutter: Option<(Shutter, MachineTime)>,
    parked: Option<(bool, MachineTime)>,
    asked_at: Option<MachineTime>,
    asked_park_at: Option<MachineTime>,
    looking: bool,
    asking_mounts: bool,
    acting: bool,
    has_looked: bool,
}

impl Closer {
    /// For a dome of the copy of a telescope.
    pub fn new(dome: &DomeCopy, telescope: &Chunk, now: MachineTime) -> Result<Self, AlpacaError> {
        let http = http_client()?;
        let device = |target: &Target, kind| Alpaca::new(http.clone(), &target.server, kind, target.number);
        let mounts = dome.mounts.iter().map(|mount| Ok((device(mount, Kind::Telescope)?, mount.connect)));
        Ok(Self {
            alpaca: device(&dome.target, Kind::Dome)?.at_once(),
            mounts: mounts.collect::<Result<_, AlpacaError>>()?,
            knows_all_mounts: dome.telescopes.iter().all(|under| under == telescope),
            guard: guard(dome, now),
            dome: dome.clone(),
            answers: JoinSet::new(),
            shutter: None,
            parked: None,
            asked_at: None,
            asked_park_at: None,
            looking: false,
            asking_mounts: false,
            acting: false,
            has_looked: false,
        })
    }

    /// The shutter is proven closed by a reading of the last seconds.
    pub fn is_verified_closed(&self, now: MachineTime) -> bool {
        self.guard.is_closed(now)
    }

    /// Its server has reported the state of the shutter, at least once.
    pub fn has_answered(&self) -> bool {
        self.shutter.is_some()
    }

    /// Takes what the servers have answered since.
    pub fn take_answers(&mut self, now: MachineTime, words: &mut Vec<Word>) {
        while let Some(answer) = self.answers.try_join_next() {
            match answer {
                Ok(Answer::Shutter(read, asked)) => {
                    (self.looking, self.has_looked) = (false, true);
                    match read {
                        Ok(shutter) => self.shutter = Some((shutter, asked)),
                        Err(error) => tracing::debug!(dome = %self.dome.name, %error, "the shutter was not read"),
                    }
                }
                Ok(Answer::Parked(parked, asked)) => {
                    self.asking_mounts = false;
                    self.parked = Some((parked, asked));
                }
                Ok(Answer::Done(what, result)) => {
                    self.acting = false;
                    // Without an answer, the server may have received it all the same.
                    if !result.as_ref().is_err_and(AlpacaError::is_unknown_outcome) {
                        self.guard.close_answered(result.is_ok(), now);
                    }
                    if let Err(error) = result {
                        words.push(Word::Failed(what, error.to_string()));
                    }
                }
                // A request that panicked must not count as one that is under way.
                Err(_) => (self.looking, self.asking_mounts, self.acting) = (false, false, false),
            }
        }
    }

    /// This process does not look after the dome: what it had begun is forgotten.
    pub fn rest(&mut self, now: MachineTime, words: &mut Vec<Word>) {
        if self.asked_at.is_some() {
            words.extend(self.guard.standing().map(|alarm| Word::Alarm(alarm, false)));
            self.guard = guard(&self.dome, now);
            (self.asked_at, self.asked_park_at, self.has_looked) = (None, None, false);
        }
    }

    /// This process looks after the dome: it is closed, and closed again, until it is read to be closed.
    pub fn close(&mut self, now: MachineTime, words: &mut Vec<Word>) {
        let due = self.asked_at.is_none_or(|at| now.since(at) >= LOOK);
        if due && !self.looking {
            (self.looking, self.asked_at) = (true, Some(now));
            let (alpaca, connect) = (self.alpaca.clone(), self.dome.target.connect);
            self.answers.spawn(async move { Answer::Shutter(shutter(&alpaca, connect).await, now) });
        }
        // A shutter that may be closed already is looked at first; a server that is away does not prevent the attempt.
        if !self.has_looked {
            return;
        }
        let waits = self.dome.policy != CloseWithMount::Beside;
        let is_closed = self.is_verified_closed(now);
        if waits && !is_closed {
            self.ask_mounts(now, due);
        }
        let mounts_parked = self.parked.is_some_and(|(parked, at)| parked && now.since(at) <= FRESH);
        let parked = !waits || (self.knows_all_mounts && mounts_parked);
        for deed in self.guard.look(now, self.fresh(now), parked) {
            match deed {
                // It holds nothing, because it gives nothing free.
                Deed::Raise(Alarm::Hold | Alarm::Uncommanded) | Deed::Clear(Alarm::Hold | Alarm::Uncommanded) => {}
                Deed::Raise(alarm) => words.push(Word::Alarm(alarm, true)),
                Deed::Clear(alarm) => words.push(Word::Alarm(alarm, false)),
                Deed::Close | Deed::AbortThenClose if self.acting => {}
                Deed::Close | Deed::AbortThenClose => {
                    self.acting = true;
                    let stop_first = deed == Deed::AbortThenClose;
                    let what = if stop_first { "abort_then_close_shutter" } else { "close_shutter" };
                    words.push(Word::Sent(what));
                    let (alpaca, connect) = (self.alpaca.clone(), self.dome.target.connect);
                    let closing = async move { Answer::Done(what, close(&alpaca, stop_first, connect).await) };
                    self.answers.spawn(closing);
                }
            }
        }
    }

    fn ask_mounts(&mut self, now: MachineTime, due: bool) {
        if !due || self.asking_mounts || self.mounts.is_empty() {
            return;
        }
        self.asking_mounts = true;
        let orders = self.asked_park_at.is_none_or(|at| now.since(at) >= PARK_AGAIN);
        if orders {
            self.asked_park_at = Some(now);
        }
        let mounts = Arc::new(self.mounts.clone());
        self.answers.spawn(async move {
            // One that hangs delays no other's park, and no answer becomes old behind it.
            let each = mounts.iter().map(|(mount, connect)| parked(mount.at_once(), *connect, orders));
            Answer::Parked(join_all(each).await.into_iter().all(|is_parked| is_parked), now)
        });
    }

    fn fresh(&self, now: MachineTime) -> Option<(Shutter, MachineTime)> {
        self.shutter.filter(|(_, asked)| now.since(*asked) <= FRESH)
    }
}

/// A guard that no permit ever reaches: it closes.
fn guard(dome: &DomeCopy, now: MachineTime) -> Guard {
    let settings = Settings {
        boot_id: BootId::fresh(),
        telescopes: dome.telescopes.clone(),
        permit_valid: dome.permit_valid(),
        policy: dome.policy,
        parked_within: seconds(dome.parked_within_s),
        travel: seconds(dome.travel_timeout_s),
    };
    Guard::new(settings, Default::default(), now).with_grace_until(MachineTime::from_boot(Duration::ZERO))
}

async fn get(alpaca: &Alpaca, connect: bool, member: &str) -> Result<serde_json::Value, AlpacaError> {
    match alpaca.get(member).await {
        Err(error) if connect && error.is_not_connected() => {
            // The second try shows whether it connected.
            let _ = alpaca.put("connected", &[("Connected", "True")]).await;
            alpaca.get(member).await
        }
        answered => answered,
    }
}

async fn put(alpaca: &Alpaca, connect: bool, member: &str) -> Result<(), AlpacaError> {
    match alpaca.put(member, &[]).await {
        Err(error) if connect && error.is_not_connected() => {
            let _ = alpaca.put("connected", &[("Connected", "True")]).await;
            alpaca.put(member, &[]).await
        }
        answered => answered,
    }
}

async fn shutter(alpaca: &Alpaca, connect: bool) -> Result<Shutter, AlpacaError> {
    shutter_status(&get(alpaca, connect, "shutterstatus").await?)
}

async fn close(alpaca: &Alpaca, stop_first: bool, connect: bool) -> Result<(), AlpacaError> {
    if stop_first {
        // Closing follows whether it stopped or not.
        let _ = alpaca.put("abortslew", &[]).await;
    }
    put(alpaca, connect, "closeshutter").await
}

/// Whether a mount is parked; one that is not is asked to park where `orders` is true.
async fn parked(mount: Alpaca, connect: bool, orders: bool) -> bool {
    if get(&mount, connect, "atpark").await.is_ok_and(|answer| answer == serde_json::Value::Bool(true)) {
        return true;
    }
    if orders && let Err(error) = put(&mount, connect, "park").await {
        tracing::warn!(%error, "a mount was asked to park and refused");
    }
    false
}

impl Word {
    /// Logs it; `tell` publishes the alert of an alarm, or that it is over.
    pub fn report(self, dome: &str, mut tell: impl FnMut(AlertKind, Option<String>)) {
        match self {
            Self::Sent(what) => tracing::warn!(dome, what, "the guard process acts"),
            Self::Failed(what, error) => tracing::warn!(dome, what, error, "the guard process's command failed"),
            Self::Alarm(alarm, is_raised) => {
                let (kind, cause) = alert(alarm, dome);
                if is_raised {
                    tracing::error!(dome, "{cause}");
                }
                tell(kind, is_raised.then_some(cause));
            }
        }
    }
}

/// The alert of an alarm.
pub fn alert(alarm: Alarm, name: &str) -> (AlertKind, String) {
    match alarm {
        Alarm::NotClosed => {
            (AlertKind::DomeNotClosed, format!("dome {name} should be closed and is not verified closed"))
        }
        Alarm::MountNotParked => {
            (AlertKind::DomeWaitsForMount, format!("dome {name} must close and waits for its mount to park"))
        }
        Alarm::Uncommanded => {
            (AlertKind::DomeUncommandedOpen, format!("dome {name} opened and nobody had commanded it"))
        }
        Alarm::Hold => (AlertKind::DomeHeld, format!("the guard process closed dome {name}")),
        Alarm::Contradicts(what) => (AlertKind::DomeContradicts, format!("dome {name}: {}", what.cause())),
    }
}
