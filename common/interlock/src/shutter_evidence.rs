//! Is the shutter closed? A conclusion from what was asked of it and from its status before and after; pure.
//!
//! A status alone proves nothing: a controller that was restarted reports "closed" by default, and a status that does
//! not change any more shows for ever what was true once. So, whatever may have opened the shutter since it was last
//! proven closed, it is closed only if
//!
//! - it was asked to close since then, and a reading that was asked for *after* that request is closed, and
//! - its status changed on the way (it was something else before the request, or it was closing). Where
//!   nothing changed, the device must have accepted the request, and the time that the shutter needs must be over: then
//!   nothing more can be done by machine, and a contradiction is an alert.

use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;

use contract::device::dome::Shutter;
use units::MachineTime;

/// A status that changed from closed to something else, by itself, is watched for so long.
const FLIPS_WITHIN: Duration = Duration::from_secs(60);
/// So many of these changes make a status that flips.
const FLIPS: usize = 2;
/// A status that flips must be closed for so long.
const STEADY: Duration = Duration::from_secs(5);
/// A shutter that takes at least so long to open does not close within a quarter of that time.
const MEASURED: Duration = Duration::from_secs(4);
/// Added to twice the measured way.
const MARGIN: Duration = Duration::from_secs(5);
/// The status of a shutter that was asked to move shows it within this time.
const ANSWERS: Duration = Duration::from_secs(5);
/// ASCOM's numbers end at 4. Two different numbers up to 100 are a percentage, and then 1 is not "closed".
const PERCENT: std::ops::RangeInclusive<i64> = 5..=100;

/// What does not fit together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Contradiction {
    /// An opening was accepted, and the status has been closed ever since.
    StuckAtClosed,
    /// The status turned to closed, and nobody saw the shutter move or had asked it to.
    ClosedUnseen,
    /// The status turned to closed much sooner than this shutter moves.
    TooFast,
    /// The status changes again and again although nobody asks for it.
    Flips,
    /// The status is a percentage and none of ASCOM's values.
    Percent,
}

impl Contradiction {
    /// The text of the alert.
    pub fn cause(self) -> &'static str {
        match self {
            Self::StuckAtClosed => "it was opened, and its status has been closed ever since",
            Self::ClosedUnseen => {
                "its status turned to closed although nobody had asked for it and it was not seen to move"
            }
            Self::TooFast => "its status turned to closed much sooner than this shutter moves",
            Self::Flips => "its status changes again and again although nobody asks for it",
            Self::Percent => "its ShutterStatus is a percentage and not one of ASCOM's numbers, so 1 is not \"closed\"",
        }
    }
}

/// What may have opened it since it was last proven closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Doubt {
    /// Nothing is known of the time before.
    Birth,
    /// An opening was accepted.
    Opened { at: MachineTime },
    /// Its status was something else than closed, and nobody here had opened it.
    SeenOpen,
    /// Nothing: it is proven closed and its status has been closed since.
    None,
}

/// A reading of the status, and when it was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct StatusReading {
    shutter: Shutter,
    asked: MachineTime,
}

/// Requests to close since the doubt began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Requests {
    first: MachineTime,
    last: MachineTime,
    /// The first that the device accepted.
    accepted: Option<MachineTime>,
}

/// All that is known of one shutter.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct ShutterEvidence {
    travel: Duration,
    doubt: Doubt,
    before_opening: Doubt,
    newest: Option<StatusReading>,
    /// Its status was something else than closed since the doubt began.
    was_other: bool,
    /// Its status was closing, or an error on its way, since it was last open.
    was_moving: bool,
    /// Since when its status is closed without a break.
    closed_since: Option<MachineTime>,
    requests: Option<Requests>,
    /// How long it took to open last, as far as that was seen.
    opens_within: Option<Duration>,
    /// It was seen open since the newest opening.
    was_open: bool,
    /// Its status was closed when it was opened, so that its way can be measured.
    from_closed: bool,
    flips: VecDeque<MachineTime>,
    percents: BTreeSet<i64>,
    /// Of the last proof; holds until the status was seen to follow again.
    unproven: Option<Contradiction>,
}

impl ShutterEvidence {
    /// Nothing is known; a shutter that moves longer than `travel` is stuck.
    pub fn new(travel: Duration) -> Self {
        Self {
            travel,
            doubt: Doubt::Birth,
            before_opening: Doubt::Birth,
            newest: None,
            was_other: false,
            was_moving: false,
            closed_since: None,
            requests: None,
            opens_within: None,
            was_open: false,
            from_closed: false,
            flips: VecDeque::new(),
            percents: BTreeSet::new(),
            unproven: None,
        }
    }

    /// An opening was accepted: from now on it may be open, whatever its status.
    pub fn opening(&mut self, now: MachineTime) {
        if !matches!(self.doubt, Doubt::Opened { .. }) {
            self.before_opening = self.doubt;
        }
        self.begin(Doubt::Opened { at: now });
        self.from_closed = self.reports_closed();
        self.flips.clear();
    }

    /// The device refused the opening: what was true before it is true still, unless the shutter was seen to move.
    pub fn opening_refused(&mut self) {
        if matches!(self.doubt, Doubt::Opened { .. }) && !self.was_other {
            self.doubt = self.before_opening;
        }
    }

    fn begin(&mut self, doubt: Doubt) {
        self.doubt = doubt;
        (self.was_other, self.was_moving, self.was_open) = (false, false, false);
        self.requests = None;
    }

    /// A request to close leaves for the device.
    pub fn close_sent(&mut self, now: MachineTime) {
        match &mut self.requests {
            Some(requests) => requests.last = now,
            None => self.requests = Some(Requests { first: now, last: now, accepted: None }),
        }
    }

    /// The device answered a request to close; one that it refused is none.
    pub fn close_answered(&mut self, accepted: bool, now: MachineTime) {
        match &mut self.requests {
            Some(requests) if accepted => {
                requests.accepted.get_or_insert(now);
            }
            Some(requests) if requests.accepted.is_none() && !self.was_moving => self.requests = None,
            _ => {}
        }
    }

    /// A status that is none of ASCOM's numbers was read.
    pub fn odd_number(&mut self, number: i64) {
        if PERCENT.contains(&number) {
            self.percents.insert(number);
        }
    }

    /// The status was read; `asked` is when it was asked for. A reading that is no newer changes nothing.
    pub fn read(&mut self, shutter: Shutter, asked: MachineTime) {
        if self.newest.is_some_and(|newest| asked <= newest.asked) {
            return;
        }
        let before = self.newest.replace(StatusReading { shutter, asked });
        if shutter == Shutter::Closed {
            self.closed_since.get_or_insert(asked);
        } else {
            self.seen_other(shutter, asked, before);
        }
        if self.is_concluded(asked) {
            self.conclude();
        }
    }

    fn seen_other(&mut self, shutter: Shutter, asked: MachineTime, before: Option<StatusReading>) {
        let was_closed = before.is_some_and(|before| before.shutter == Shutter::Closed);
        self.closed_since = None;
        if let Doubt::Opened { at } = self.doubt {
            // A reading that was under way when the opening was accepted proves nothing about it.
            if asked < at {
                return;
            }
            if shutter == Shutter::Open && !self.was_open && self.from_closed {
                self.opens_within = Some(asked.since(at));
            }
            if was_closed && (self.was_other || asked.since(at) > self.travel) {
                self.flip(asked);
            }
        } else {
            if was_closed {
                self.flip(asked);
            }
            if self.doubt == Doubt::None {
                self.begin(Doubt::SeenOpen);
            }
        }
        self.was_other = true;
        self.was_open |= shutter == Shutter::Open;
        self.was_moving = shutter == Shutter::Closing || (self.was_moving && shutter == Shutter::Error);
        if shutter == Shutter::Open && self.unproven == Some(Contradiction::StuckAtClosed) {
            self.unproven = None;
        }
    }

    fn flip(&mut self, at: MachineTime) {
        self.flips.push_back(at);
        while self.flips.front().is_some_and(|first| at.since(*first) > FLIPS_WITHIN) || self.flips.len() > 8 {
            self.flips.pop_front();
        }
    }

    /// Is it proven closed, by a reading that was asked for at most `fresh` ago?
    pub fn is_closed(&self, now: MachineTime, fresh: Duration) -> bool {
        let newest = self.newest.filter(|newest| now.since(newest.asked) <= fresh);
        newest.is_some_and(|newest| newest.shutter == Shutter::Closed) && self.doubt == Doubt::None
    }

    /// Is its status closed, asked at most `fresh` ago, and does nothing that is known contradict it?
    pub fn is_credible(&self, now: MachineTime, fresh: Duration) -> bool {
        let newest = self.newest.filter(|newest| now.since(newest.asked) <= fresh);
        let reports_closed = newest.is_some_and(|newest| newest.shutter == Shutter::Closed);
        reports_closed && !self.is_doubted() && !self.speaks_percent()
    }

    /// Its status was closed after a request, or nobody can have opened it: what the newest reading, asked for then,
    /// comes to.
    fn is_concluded(&self, asked: MachineTime) -> bool {
        let Some(since) = self.closed_since else { return false };
        if self.speaks_percent() || (self.flips_at(asked) && asked.since(since) < STEADY) {
            return false;
        }
        if self.doubt == Doubt::None {
            return true;
        }
        let Some(requests) = self.requests.filter(|requests| asked >= requests.first) else { return false };
        let waited = requests.accepted.is_some_and(|at| asked.since(at) >= self.way());
        match self.doubt {
            Doubt::Birth if !self.was_other => requests.accepted.is_some_and(|at| asked >= at),
            _ if !self.was_other => waited,
            _ if self.was_moving => true,
            _ if since < requests.first => waited,
            _ => {
                !self.is_too_fast(since, requests)
                    || asked.since(requests.first) >= self.opens_within.unwrap_or_default()
            }
        }
    }

    /// The time that it surely needs to close: by the way that it took to open, where that was seen.
    fn way(&self) -> Duration {
        self.opens_within.map_or(self.travel, |within| (within * 2 + MARGIN).min(self.travel))
    }

    fn is_too_fast(&self, since: MachineTime, requests: Requests) -> bool {
        let opens_within = self.opens_within.filter(|within| self.was_open && *within >= MEASURED);
        opens_within.is_some_and(|within| since.since(requests.first) < within / 4)
    }

    fn conclude(&mut self) {
        if self.doubt == Doubt::None {
            return;
        }
        let birth = self.doubt == Doubt::Birth && !self.was_other;
        let (since, requests) = (self.closed_since, self.requests);
        let early = since.zip(requests).is_some_and(|(since, requests)| since < requests.first);
        let fast = since.zip(requests).is_some_and(|(since, requests)| self.is_too_fast(since, requests));
        self.unproven = if birth {
            None
        } else if !self.was_other {
            Some(Contradiction::StuckAtClosed)
        } else if self.was_moving {
            None
        } else if early {
            Some(Contradiction::ClosedUnseen)
        } else {
            fast.then_some(Contradiction::TooFast)
        };
        self.doubt = Doubt::None;
        self.requests = None;
    }

    fn flips_at(&self, now: MachineTime) -> bool {
        self.flips.iter().filter(|at| now.since(**at) <= FLIPS_WITHIN).count() >= FLIPS
    }

    /// A status that is a percentage can prove nothing.
    pub fn speaks_percent(&self) -> bool {
        self.percents.len() > 1
    }

    /// A request to close was sent, and since then its status was closing: nothing need disturb it.
    pub fn is_on_its_way(&self, now: MachineTime) -> bool {
        let closing = self.newest.is_some_and(|newest| newest.shutter == Shutter::Closing);
        closing && self.requests.is_some_and(|requests| now.since(requests.last) < self.travel)
    }

    /// Its status is closed, and was not proven: asking again does no harm, stopping it might.
    pub fn reports_closed(&self) -> bool {
        self.newest.is_some_and(|newest| newest.shutter == Shutter::Closed)
    }

    /// It may be open for another reason than that nothing is known of the time before.
    pub fn is_doubted(&self) -> bool {
        match self.doubt {
            Doubt::None => false,
            Doubt::Birth => self.was_other,
            Doubt::Opened { .. } | Doubt::SeenOpen => true,
        }
    }

    /// What does not fit together now.
    pub fn contradiction(&self, now: MachineTime) -> Option<Contradiction> {
        if self.speaks_percent() {
            return Some(Contradiction::Percent);
        }
        if self.flips_at(now) {
            return Some(Contradiction::Flips);
        }
        let closed_since = self.closed_since?;
        match self.doubt {
            Doubt::Opened { at } if !self.was_other => {
                let asked = self.requests.is_some_and(|requests| now.since(requests.first) >= ANSWERS);
                (asked || now.since(at) >= self.way()).then_some(Contradiction::StuckAtClosed)
            }
            Doubt::Opened { .. } | Doubt::SeenOpen if self.was_other && !self.was_moving => match self.requests {
                None => Some(Contradiction::ClosedUnseen),
                Some(requests) if closed_since < requests.first => Some(Contradiction::ClosedUnseen),
                Some(requests) if self.is_too_fast(closed_since, requests) => Some(Contradiction::TooFast),
                Some(_) => None,
            },
            _ => self.unproven,
        }
    }
}
