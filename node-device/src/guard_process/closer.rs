//! Closes one dome by Alpaca with the last-good copy, without the node and without the bus; `interlock::Closer`
//! decides.

use std::sync::Arc;
use std::time::Duration;

use alpaca::{Alpaca, AlpacaError, http_client, value};
use bus::MachineTime;
use contract::device::dome::Shutter;
use contract::device::telescope::Fields;
use contract::observatory::AlertKind;
use contract::{BootId, Chunk, Datum, Kind};
use futures_util::future::{join, join_all};
use interlock::guard::{Alarm, Settings};
use interlock::watch::Who;
use interlock::{CloserEffect, CloserEvent, KnownMounts, ParkReading, Parked, Request};
use tokio::task::JoinSet;

use super::copy::{DomeCopy, Target, seconds};
use crate::close_request;
use crate::shutter_status::shutter_status;

/// The coordinates of a mount are waited for no longer: its flags must not become too old to count.
const COORDINATES: Duration = Duration::from_secs(2);

/// What the servers have answered.
enum ServerAnswer {
    /// The shutter, and when it was asked for.
    Shutter(Result<Shutter, AlpacaError>, MachineTime),
    /// What was read of each mount, and when they were asked.
    Parked(Vec<ParkReading>, MachineTime),
    /// A request to close.
    Closed(Request, Result<(), AlpacaError>),
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
    /// What is known of each of them.
    parked: Vec<Parked>,
    state: interlock::Closer,
    answers: JoinSet<ServerAnswer>,
}

impl Closer {
    /// For a dome of the copy of a telescope; none where there is no HTTP client, which is logged.
    pub fn new(dome: &DomeCopy, telescope: &Chunk) -> Option<Self> {
        match Self::open(dome, telescope) {
            Ok(closer) => Some(closer),
            Err(error) => {
                tracing::error!(dome = %dome.name, %error, "no HTTP client; this dome cannot be closed");
                None
            }
        }
    }

    fn open(dome: &DomeCopy, telescope: &Chunk) -> Result<Self, AlpacaError> {
        let http = http_client()?;
        let device = |target: &Target, kind| Alpaca::new(http.clone(), &target.server, kind, target.number);
        let mounts = dome.mounts.iter().map(|mount| Ok((device(mount, Kind::Telescope)?, mount.connect)));
        let settings = Settings {
            boot_id: BootId::fresh(),
            telescopes: dome.telescopes.clone(),
            permit_valid: dome.permit_valid(),
            policy: dome.policy,
            parked_within: seconds(dome.parked_within_s),
            travel: seconds(dome.travel_timeout_s),
        };
        let known = KnownMounts {
            some: !dome.mounts.is_empty(),
            // A mount in a file of another telescope is not known.
            all: dome.telescopes.iter().all(|under| under == telescope),
        };
        Ok(Self {
            alpaca: device(&dome.target, Kind::Dome)?.at_once(),
            mounts: mounts.collect::<Result<_, AlpacaError>>()?,
            parked: vec![Parked::default(); dome.mounts.len()],
            state: interlock::Closer::new(settings, known),
            dome: dome.clone(),
            answers: JoinSet::new(),
        })
    }

    /// The shutter is proven closed by a reading of the last seconds.
    pub fn is_verified_closed(&self, now: MachineTime) -> bool {
        self.state.is_verified_closed(now)
    }

    /// Why a dome that the configuration names no more need not be looked after any longer, if so.
    pub fn is_let_go(&self, now: MachineTime) -> Option<&'static str> {
        self.state.is_let_go(now)
    }

    /// Does the end of this process wait until a dome that no configuration names is closed?
    pub fn holds_up_the_end(&self, now: MachineTime) -> bool {
        self.state.holds_up_the_end(now)
    }

    /// One round, by which process guards the dome.
    pub fn step(&mut self, who: Who, now: MachineTime) -> Vec<Word> {
        let mut words = self.take_answers(now);
        let effects = self.state.step(who, now);
        self.perform(effects, &mut words);
        words
    }

    /// One round for a dome that the configuration names no more.
    pub fn leave(&mut self, now: MachineTime) -> Vec<Word> {
        let mut words = self.take_answers(now);
        let effects = self.state.leave(now);
        self.perform(effects, &mut words);
        words
    }

    /// Takes what the servers have answered since.
    fn take_answers(&mut self, now: MachineTime) -> Vec<Word> {
        let mut words = Vec::new();
        while let Some(answer) = self.answers.try_join_next() {
            let event = match answer {
                Ok(ServerAnswer::Shutter(read, asked)) => {
                    if let Err(error) = &read {
                        tracing::debug!(dome = %self.dome.name, %error, "the shutter was not read");
                    }
                    CloserEvent::Looked(read.ok().map(|shutter| (shutter, asked)))
                }
                Ok(ServerAnswer::Parked(readings, asked)) => {
                    for (parked, reading) in self.parked.iter_mut().zip(readings) {
                        let place = reading.place.map(|place| place.answered(now));
                        *parked = parked.after(ParkReading { place, ..reading }, asked);
                    }
                    CloserEvent::Mounts(self.parked.iter().all(|parked| parked.is_parked()), asked)
                }
                Ok(ServerAnswer::Closed(request, result)) => {
                    let answer = close_request::answer_of(&result);
                    words.extend(result.err().map(|error| Word::Failed(request.name(), error.to_string())));
                    CloserEvent::Answered(answer)
                }
                // A request that panicked must not count as one that is under way.
                Err(_) => CloserEvent::Lost,
            };
            self.state.take(event, now);
        }
        words
    }

    fn perform(&mut self, effects: Vec<CloserEffect>, words: &mut Vec<Word>) {
        for effect in effects {
            let (alpaca, connect) = (self.alpaca.clone(), self.dome.target.connect);
            match effect {
                CloserEffect::Raise(alarm) => words.push(Word::Alarm(alarm, true)),
                CloserEffect::Clear(alarm) => words.push(Word::Alarm(alarm, false)),
                CloserEffect::Look { asked } => {
                    self.answers.spawn(async move { ServerAnswer::Shutter(shutter(&alpaca, connect).await, asked) });
                }
                CloserEffect::AskMounts { asked, park } => {
                    let mounts = Arc::new(self.mounts.clone());
                    self.answers.spawn(async move {
                        // One that hangs delays no other's park, and no answer becomes old behind it.
                        let each = mounts.iter().map(|(mount, connect)| parked(mount.at_once(), *connect, park, asked));
                        ServerAnswer::Parked(join_all(each).await, asked)
                    });
                }
                CloserEffect::Send(request) => {
                    words.push(Word::Sent(request.name()));
                    let closing = async move {
                        ServerAnswer::Closed(request, close_request::send(&alpaca, request, connect).await)
                    };
                    self.answers.spawn(closing);
                }
            }
        }
    }
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

async fn shutter(alpaca: &Alpaca, connect: bool) -> Result<Shutter, AlpacaError> {
    shutter_status(&get(alpaca, connect, "shutterstatus").await?)
}

/// What a mount, asked at `asked`, tells of its park; one that does not say that it is parked is asked to park where
/// `orders` is true.
async fn parked(mount: Alpaca, connect: bool, orders: bool, asked: MachineTime) -> ParkReading {
    let mut fields = Fields { at_park: flag(get(&mount, connect, "atpark").await), ..Fields::default() };
    if fields.parked() == Some(true) {
        let flags = join(mount.get("slewing"), mount.get("tracking"));
        let late = tokio::time::sleep(COORDINATES);
        let ((slewing, tracking), read) = with_what_comes(flags, coordinates(&mount), late).await;
        fields = Fields { slewing: flag(slewing), tracking: flag(tracking), at_park: fields.at_park, ..read };
    }
    let reading = ParkReading::of(&fields, |_| asked);
    if orders && reading.says_parked != Some(true) {
        if fields.tracking.known() == Some(&true) {
            // It says that it is parked, and a second park may do nothing.
            let _ = mount.put("tracking", &[("Tracking", "False")]).await;
        }
        if let Err(error) = close_request::put(&mount, connect, "park").await {
            tracing::warn!(%error, "a mount was asked to park and refused");
        }
    }
    reading
}

/// The flags, and the coordinates if they come before it is too `late`: both are asked for at once, and the first answer must
/// not become too old to count.
async fn with_what_comes<T>(
    flags: impl Future<Output = T>,
    coordinates: impl Future<Output = Fields>,
    late: impl Future<Output = ()>,
) -> (T, Fields) {
    let coordinates = async {
        tokio::select! {
            biased;
            fields = coordinates => fields,
            () = late => Fields::default(),
        }
    };
    join(flags, coordinates).await
}

/// Where a mount points: right ascension and declination only where it does not tell altitude and azimuth.
async fn coordinates(mount: &Alpaca) -> Fields {
    let (altitude, azimuth) = join(mount.get("altitude"), mount.get("azimuth")).await;
    let fields = Fields { altitude_deg: number(altitude), azimuth_deg: number(azimuth), ..Fields::default() };
    if fields.altitude_deg.known().is_some() && fields.azimuth_deg.known().is_some() {
        return fields;
    }
    let (ra, dec) = join(mount.get("rightascension"), mount.get("declination")).await;
    Fields { ra_deg: number(ra).map(|hours| hours * 15.0), dec_deg: number(dec), ..fields }
}

fn number(answer: Result<serde_json::Value, AlpacaError>) -> Datum<f64> {
    answer.map_err(|error| error.no_data()).and_then(|answer| value::number(&answer)).into()
}

fn flag(answer: Result<serde_json::Value, AlpacaError>) -> Datum<bool> {
    answer.map_err(|error| error.no_data()).and_then(|answer| value::flag(&answer)).into()
}

impl Word {
    /// Logs it; `set_alert` publishes the alert of an alarm, or that it is over.
    pub fn report(self, dome: &str, mut set_alert: impl FnMut(AlertKind, Option<String>)) {
        match self {
            Self::Sent(what) => tracing::warn!(dome, what, "the guard process acts"),
            Self::Failed(what, error) => tracing::warn!(dome, what, error, "the guard process's command failed"),
            Self::Alarm(alarm, is_raised) => {
                let (kind, cause) = alert(alarm, dome);
                if is_raised {
                    tracing::error!(dome, "{cause}");
                }
                set_alert(kind, is_raised.then_some(cause));
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

#[cfg(test)]
mod tests {
    use std::future::{pending, ready};

    use futures_util::FutureExt as _;

    use super::*;

    #[test]
    fn a_slow_server_that_gives_no_coordinates_yet_holds_up_no_flags_and_says_of_none_that_it_has_none() {
        let (altitude_deg, azimuth_deg) = (Datum::Known(5.0), Datum::Known(180.0));
        let place = Fields { altitude_deg, azimuth_deg, ..Fields::default() };
        let asked = MachineTime::from_boot(Duration::from_secs(100));
        let read = |answer: Option<(&str, Fields)>| {
            let (flags, fields) = answer.unwrap();
            let reading = ParkReading::of(&Fields { at_park: Datum::Known(true), ..fields }, |_| asked);
            (flags.to_owned(), reading.place.is_some(), reading.has_none)
        };
        let told = with_what_comes(ready("flags"), ready(place), pending()).now_or_never();
        assert_eq!(read(told), ("flags".to_owned(), true, false));
        let slow = with_what_comes(ready("flags"), pending(), ready(())).now_or_never();
        assert_eq!(read(slow), ("flags".to_owned(), false, false), "it is not taken for a mount without coordinates");
        let slower = with_what_comes(ready("flags"), pending(), pending()).now_or_never();
        assert!(slower.is_none(), "there is time yet");
    }
}
