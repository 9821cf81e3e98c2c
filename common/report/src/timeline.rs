//! From the records of a night to claims on its time, and to the pieces of it.

use std::collections::BTreeMap;

use contract::observatory::{Posture, RowState, RowStatus, Verdict};
use units::Utc;

use crate::claim::{Claim, Piece, Rank, divide};
use crate::class::{Class, Group, device_in, of_frame, of_step, of_timed};
use crate::events::{Doing, Held, NightEvents, Reason, VerdictRecord};

/// States that come more often than this, sky seconds at speed 1, follow each other without a gap.
const GAPLESS_S: f64 = 15.0;
/// A pause of the runner between two actions is overhead while it is shorter, sky seconds at speed 1.
const BETWEEN_ROWS_S: f64 = 10.0;
/// The first samples of an incarnation: where one of them is known, so is when it began.
const FIRST_SEQ: u64 = 10;
/// An observatory node that has started acts within this, sky seconds at speed 1.
const START_S: f64 = 10.0;
/// A kind is at most so long, letters: reasons come from schedules and devices.
const MOST_LETTERS: usize = 100;

/// The time of a night, divided.
#[derive(Debug, Clone, PartialEq)]
pub struct Timeline {
    /// When it begins.
    pub from: Utc,
    /// When it ends.
    pub to: Utc,
    /// Its pieces, in order, without a gap.
    pub pieces: Vec<Piece>,
}

/// Divides the time of a night.
pub fn timeline(events: &NightEvents) -> Timeline {
    let (from, to) = span(events);
    let claims = Claims { from, events, doings: gapless(&events.doings, |state| state.speed), list: Vec::new() }.all();
    let pieces = divide(ms(from, to), &claims);
    Timeline { from, to, pieces }
}

fn ms(from: Utc, at: Utc) -> i64 {
    // `as` saturates.
    (at.seconds_since(from) * 1000.0).round() as i64
}

/// From sunset, or what happened before it, to sunrise, or what happened after it; never beyond the night, nor beyond
/// now.
fn span(events: &NightEvents) -> (Utc, Utc) {
    let is_busy = |doing: &&Held<Doing>| !doing.state.actions.is_empty() || doing.state.posture == Posture::Open;
    let busy = events.doings.iter().filter(is_busy).map(|doing| (doing.from, doing.until));
    let lit = events.frames.iter().map(|frame| (frame.started, frame.started.plus_seconds(frame.exposure_s.max(0.0))));
    let all = || busy.clone().chain(lit.clone()).chain(events.dark);
    let from = all().map(|(from, _)| from).min().unwrap_or(events.from).max(events.from).min(events.to);
    let to = all().map(|(_, to)| to).max().unwrap_or(from).min(events.to);
    let newest = events.doings.iter().map(|doing| (doing.until, doing.state.speed)).max_by_key(|(until, _)| *until);
    // What has happened since the newest state is not known yet.
    let now = match newest {
        Some((until, speed)) if events.now.seconds_since(until) <= GAPLESS_S * speed.max(1.0) => until.min(events.now),
        _ => events.now,
    };
    (from, to.min(now).max(from))
}

/// The states in order, each until the next one where nothing is missing between them.
fn gapless<T>(states: &[Held<T>], speed: impl Fn(&T) -> f64) -> Vec<(Utc, Utc, &Held<T>)> {
    let mut sorted: Vec<&Held<T>> = states.iter().collect();
    sorted.sort_by_key(|held| held.from);
    let mut found: Vec<(Utc, Utc, &Held<T>)> = Vec::with_capacity(sorted.len());
    for (index, held) in sorted.iter().enumerate() {
        let mut until = held.until.max(held.from);
        if let Some(next) = sorted.get(index + 1) {
            let gap_s = next.from.seconds_since(until);
            if gap_s <= 0.0 || (next.boot == held.boot && gap_s <= GAPLESS_S * speed(&held.state).max(1.0)) {
                until = next.from;
            }
        }
        found.push((held.from, until, held));
    }
    found
}

struct Claims<'a> {
    from: Utc,
    events: &'a NightEvents,
    doings: Vec<(Utc, Utc, &'a Held<Doing>)>,
    list: Vec<Claim>,
}

impl Claims<'_> {
    fn add(&mut self, (from, to): (Utc, Utc), rank: Rank, class: Class) {
        let kind: String = class.kind.chars().take(MOST_LETTERS).collect();
        let (from_ms, to_ms) = (ms(self.from, from), ms(self.from, to));
        self.list.push(Claim { from_ms, to_ms, rank, class: Class { group: class.group, kind } });
    }

    /// Adds what an action did; between sunrise and sunset it goes before everything but light.
    fn add_work(&mut self, (from, to): (Utc, Utc), rank: Rank, class: &Class) {
        let (sunset, sunrise) = self.events.dark.unwrap_or((self.events.to, self.events.to));
        self.add((from, to), rank, class.clone());
        for daylight in [(from, to.min(sunset)), (from.max(sunrise), to)] {
            if daylight.0 < daylight.1 {
                self.add(daylight, Rank::WorkInDaylight, class.clone());
            }
        }
    }

    fn all(mut self) -> Vec<Claim> {
        let events = self.events;
        for frame in &events.frames {
            let Some(class) = of_frame(&frame.action, &frame.image_type) else { continue };
            let lit = (frame.started, frame.started.plus_seconds(frame.exposure_s.max(0.0)));
            match class.group {
                Group::OpenShutter => self.add(lit, Rank::Light, class),
                _ => self.add_work(lit, Rank::Timed, &class),
            }
        }
        let (sunset, sunrise) = events.dark.unwrap_or((events.to, events.to));
        let day = Class::new(Group::Daytime, "the Sun was up");
        self.add((events.from, sunset), Rank::Daytime, day.clone());
        self.add((sunrise, events.to), Rank::Daytime, day);
        for (from, until, held) in gapless(&events.verdicts, |_| self.speed()) {
            if let Some(class) = of_verdict(&held.state) {
                self.add((from, until), Rank::Verdict, class);
            }
        }
        for timed in &events.timed {
            let began = timed.until.plus_seconds(-timed.took_s.max(0.0));
            self.add_work((began, timed.until), Rank::Timed, &of_timed(&timed.part));
        }
        let doings = self.doings.clone();
        for (index, (from, until, held)) in doings.iter().enumerate() {
            for action in &held.state.actions {
                let class = of_step(&action.action, &action.step);
                let rank = if class.group == Group::Fault { Rank::Fault } else { Rank::Step };
                self.add_work((*from, *until), rank, &class);
            }
            if held.state.actions.is_empty() {
                self.idle((*from, *until), &held.state);
            }
            if let Some((next, _, after)) = doings.get(index + 1)
                && after.boot != held.boot
                && after.seq <= FIRST_SEQ
                && *next > *until
            {
                let restart = Class::new(Group::Fault, "restart of the observatory node");
                self.add((*until, *next), Rank::Fault, restart);
            }
        }
        if let Some((first, _, _)) = doings.first().filter(|(_, _, held)| held.seq <= FIRST_SEQ) {
            let absent = Class::new(Group::Fault, "the observatory node did not run");
            self.add((events.from, *first), Rank::Fault, absent);
        }
        let mut before: Option<&str> = None;
        for (from, _, held) in &doings {
            if before != Some(held.boot.as_str()) && held.seq <= FIRST_SEQ {
                let until = from.plus_seconds(START_S * held.state.speed.max(1.0));
                self.add((*from, until), Rank::Between, Class::new(Group::Fault, "start of the observatory node"));
            }
            before = Some(&held.boot);
        }
        self.between_rows(&doings);
        self.list
    }

    fn speed(&self) -> f64 {
        self.events.doings.first().map_or(1.0, |held| held.state.speed)
    }

    /// Short pauses between two actions.
    fn between_rows(&mut self, doings: &[(Utc, Utc, &Held<Doing>)]) {
        let mut ended: Option<Utc> = None;
        for (from, until, held) in doings {
            if held.state.actions.is_empty() {
                continue;
            }
            if let Some(ended) = ended
                && *from > ended
                && from.seconds_since(ended) <= BETWEEN_ROWS_S * held.state.speed.max(1.0)
            {
                self.add((ended, *from), Rank::Between, Class::new(Group::Overhead, "between rows"));
            }
            ended = Some(*until);
        }
    }

    /// Why nothing was under way, piece by piece.
    fn idle(&mut self, (from, until): (Utc, Utc), doing: &Doing) {
        let events = self.events;
        let mut cuts = vec![from, until];
        let inside = |at: &Utc| *at > from && *at < until;
        cuts.extend(events.rows.iter().flat_map(|c| [c.at, c.row.start_utc, c.row.end_utc]).filter(inside));
        cuts.extend(events.schedules.iter().map(|held| held.from).filter(inside));
        cuts.extend(events.alerts.iter().flat_map(|a| [Some(a.raised_utc), a.cleared_utc]).flatten().filter(inside));
        cuts.sort_unstable();
        cuts.dedup();
        for piece in cuts.windows(2) {
            let [from, until] = piece else { continue };
            if let Some(class) = why_idle(events, *from, doing) {
                let rank = if class.group == Group::Fault { Rank::Fault } else { Rank::Idle };
                self.add((*from, *until), rank, class);
            }
        }
    }
}

/// The class of a verdict; absent where the sky could be exposed.
fn of_verdict(verdict: &VerdictRecord) -> Option<Class> {
    let is_close = verdict.verdict == Verdict::Unsafe;
    if !is_close && verdict.suspended.is_empty() {
        return None;
    }
    let reasons: Vec<&Reason> = verdict.reasons.iter().chain(&verdict.suspended).collect();
    let of = |input: &str| reasons.iter().find(|reason| reason.input == input);
    if of("sun").is_some() {
        return Some(Class::new(Group::Daytime, "the Sun was above its limit"));
    }
    let is_own = |reason: &&&Reason| {
        !reason.is_missing
            && reason.input != "stay closed"
            && !reason.input.ends_with("/frozen")
            && !reason.input.starts_with("node/")
            && !matches!(reason.input.as_str(), "configuration" | "safety inputs")
    };
    if let Some(weather) = reasons.iter().find(is_own) {
        return Some(Class::new(Group::Weather, weather.input.clone()));
    }
    if of("stay closed").is_some() {
        return Some(Class::new(Group::Idle, "a person ordered to stay closed"));
    }
    let kind = reasons.first().map_or("no reason was recorded", |reason| reason.input.as_str());
    Some(Class::new(Group::Fault, kind))
}

/// Why nothing was under way from this instant on; absent where no record explains it.
fn why_idle(events: &NightEvents, at: Utc, doing: &Doing) -> Option<Class> {
    let idle = |kind: &str| Some(Class::new(Group::Idle, kind));
    match doing.posture {
        Posture::Opening => return Some(Class::new(Group::Overhead, "dome opening")),
        Posture::Closing => return Some(Class::new(Group::Overhead, "dome closing")),
        Posture::Unknown => return Some(Class::new(Group::Fault, "dome: whether it is closed was not known")),
        Posture::Open | Posture::Closed => {}
    }
    if !doing.robotic {
        return idle("the robotic switch was off");
    }
    let Some(schedule) = events.schedules.iter().filter(|held| held.from <= at).max_by_key(|held| held.from) else {
        return idle("no schedule was active");
    };
    if schedule.state.rows == 0 {
        let refused = schedule.state.refused.is_some();
        return idle(if refused { "the schedule was refused" } else { "the schedule had no rows" });
    }
    if doing.ended {
        return idle("the schedule had ended");
    }
    let mut rows: BTreeMap<u32, &RowState> = BTreeMap::new();
    for change in events.rows.iter().take_while(|change| change.at <= at) {
        rows.insert(change.row.row, &change.row);
    }
    rows.retain(|row, _| *row < schedule.state.rows);
    let is_left = |row: &&&RowState| matches!(row.status, RowStatus::Pending | RowStatus::Interrupted);
    let due: Vec<&RowState> =
        rows.values().filter(is_left).filter(|row| row.start_utc <= at && at < row.end_utc).copied().collect();
    if due.is_empty() {
        let waits = rows.values().any(|row| row.status == RowStatus::Pending && row.start_utc > at);
        return idle(if waits { "no row was due yet" } else { "no row was left" });
    }
    if let Some(device) = due.iter().find_map(|row| device_in(&row.detail)) {
        return Some(Class::new(Group::Fault, device));
    }
    let is_active = |raised: Utc, cleared: Option<Utc>| raised <= at && cleared.is_none_or(|cleared| cleared > at);
    let mut alerts = events.alerts.iter().filter(|alert| is_active(alert.raised_utc, alert.cleared_utc));
    if let Some(alert) = alerts.find(|alert| matches!(alert.priority.as_str(), "critical" | "high")) {
        return Some(Class::new(Group::Fault, alert.id.clone()));
    }
    let detail = due.iter().map(|row| row.detail.as_str()).find(|detail| !detail.is_empty())?;
    if detail.contains("stands clear from") {
        return idle("a row waited for its target to rise");
    }
    idle(&format!("a row waited: {detail}"))
}
