//! The loop: the observatory node's own sequence begins and ends rows, and the clock jumps from event to event.

use std::collections::BTreeMap;
use std::sync::Arc;

use ::sky::{SkyError, night_date};
use contract::observatory::{RowBegun, RowStatus};
use safety::objection::{Objection, stands_against};
use units::{Angle, Utc};

use super::overheads::TimedPart;
use super::planned::{PlannedNight, PlannedRow, heights};
use super::simulated_run::{Halt, SimulatedRun};
use super::world::World;
use super::{Site, steps};
use crate::row::{Row, RowId};
use crate::sequence::{Sequence, passed_words};

/// The longest forecast, s; a year has one file for each night.
const LONGEST_S: f64 = 400.0 * 86_400.0;
/// With the Sun so far down the sky is dark, deg.
const DARK_DEG: f64 = -18.0;
const DAY_S: f64 = 86_400.0;

/// A row at work.
struct AtWork {
    ends: Utc,
    id: RowId,
    index: usize,
    status: RowStatus,
}

struct Forecast<'a> {
    site: &'a mut Site,
    sequence: Sequence,
    world: World,
    /// When the sky is safe, in order.
    safe: Vec<(Utc, Utc)>,
    /// No forecast goes beyond.
    last: Utc,
    at_work: Vec<AtWork>,
    /// Until when rows wait for their target, by place.
    hidden: BTreeMap<usize, Utc>,
    rows: Vec<PlannedRow>,
    light: Vec<(Utc, Utc)>,
}

/// Plans a schedule's rows.
///
/// # Errors
/// No sky is known of the schedule's time, such as before 1972.
pub fn forecast(rows: Vec<Row>, site: &mut Site) -> Result<PlannedNight, SkyError> {
    let nothing = PlannedNight { rows: Vec::new(), open_s: 0.0, closed: None, dark_s: 0.0, dark_exposed_s: 0.0 };
    Ok(forecast_while(rows, site, &|| true)?.unwrap_or(nothing))
}

/// Plans a schedule's rows while `goes_on`, which is asked before each row; absent where it was given up.
///
/// # Errors
/// As of [`forecast`].
pub fn forecast_while(
    rows: Vec<Row>,
    site: &mut Site,
    goes_on: &dyn Fn() -> bool,
) -> Result<Option<PlannedNight>, SkyError> {
    let planned: Vec<PlannedRow> = rows.iter().enumerate().map(|(index, row)| PlannedRow::of(row, index)).collect();
    let starts = rows.iter().map(|row| row.start).min();
    let Some((first, end)) = starts.zip(rows.iter().map(|row| row.end).max()) else {
        let (open_s, closed, dark_s, dark_exposed_s) = (0.0, None, 0.0, 0.0);
        return Ok(Some(PlannedNight { rows: planned, open_s, closed, dark_s, dark_exposed_s }));
    };
    let last = end.min(first.plus_seconds(LONGEST_S));
    let sun_deg = site.config.safety.sun_altitude_max_deg;
    // A second more, so that a row that ends with the last window still finds the sky as it is.
    let below = site.sky.sun_below(sun_deg, first, last.plus_seconds(1.0))?;
    let safe = without(below, &site.unsafe_spans);
    let mut sequence = Sequence::default();
    sequence.take(Arc::new(rows), |_| None);
    let (world, at_work, light) = (World::default(), Vec::new(), Vec::new());
    let hidden = BTreeMap::new();
    let mut forecast = Forecast { site, sequence, world, safe, last, at_work, hidden, rows: planned, light };
    // Cooling may begin before noon, and headers may be completed until the next evening: that is no second night.
    let sky = || forecast.sequence.rows().iter().filter(|row| row.action.needs().safe);
    let (dark_from, dark_to) = (sky().map(|row| row.start).min(), sky().map(|row| row.end).max());
    let begins = forecast.go_on_from(first);
    if !forecast.run(begins, goes_on) {
        return Ok(None);
    }
    let Forecast { site, world, rows, light, .. } = forecast;
    let dark = dark(site, dark_from.unwrap_or(first), dark_to.map_or(last, |to| to.min(last)))?;
    let dark_s = dark.iter().map(|(from, to)| to.seconds_since(*from)).sum();
    let dark_exposed_s = common_s(&dark, light);
    Ok(Some(PlannedNight { rows, open_s: world.open_s(), closed: world.closed, dark_s, dark_exposed_s }))
}

impl Forecast<'_> {
    /// Takes over what has happened already; returns when the forecast begins.
    fn go_on_from(&mut self, first: Utc) -> Utc {
        let Some(begun) = self.site.begun.clone() else { return first };
        let begins = first.max(begun.at_utc);
        if begun.open {
            self.world.open(begins);
        }
        for RowBegun { row, status, frames } in begun.rows {
            let index = row as usize;
            // Nothing works at it here; it goes on where its sky is safe.
            let status = if status == RowStatus::Running { RowStatus::Interrupted } else { status };
            self.sequence.set(index, status);
            if let Some(planned) = self.rows.get_mut(index) {
                (planned.status, planned.frames) = (status, frames);
            }
        }
        begins
    }

    /// Works as the observatory node does, with a clock that jumps; false where it was given up.
    fn run(&mut self, first: Utc, goes_on: &dyn Fn() -> bool) -> bool {
        let mut now = first;
        loop {
            if !goes_on() {
                return false;
            }
            self.end_rows(now);
            if self.safe_until(now).is_none() {
                self.world.close(now, self.site.overheads.span(TimedPart::Close).value);
            }
            self.skip_passed(now);
            while goes_on() && self.start_next(now) {}
            if self.sequence.is_over() {
                break;
            }
            let Some(next) = self.next_event(now) else { break };
            now = next;
        }
        self.world.close(now, self.site.overheads.span(TimedPart::Close).value);
        // A window longer than the plan.
        for row in self.rows.iter_mut().filter(|row| row.status == RowStatus::Pending) {
            row.status = RowStatus::Skipped;
            row.note("the plan ends before its window does");
        }
        true
    }

    /// The time until which the sky is safe, if it is now.
    fn safe_until(&self, now: Utc) -> Option<Utc> {
        self.safe.iter().find(|(from, to)| *from <= now && now < *to).map(|(_, to)| *to)
    }

    fn end_rows(&mut self, now: Utc) {
        let (ended, left) = std::mem::take(&mut self.at_work).into_iter().partition(|row| row.ends <= now);
        self.at_work = left;
        let ended: Vec<AtWork> = ended;
        for AtWork { id, index, status, .. } in ended {
            self.sequence.end(&id, status);
            if let Some(row) = self.rows.get_mut(index) {
                row.status = status;
            }
        }
    }

    fn skip_passed(&mut self, now: Utc) {
        for index in self.sequence.passed(now) {
            let why = self.why_not(index);
            let status = self.sequence.statuses().get(index).copied().unwrap_or(RowStatus::Pending);
            self.sequence.set(index, RowStatus::Skipped);
            if let Some(row) = self.rows.get_mut(index) {
                row.status = RowStatus::Skipped;
                row.note(&passed_words(status, row.frames));
                row.note(&why);
            }
        }
    }

    /// Why a row did not run in its window.
    fn why_not(&mut self, index: usize) -> String {
        let Some(row) = self.rows.get(index) else { return String::new() };
        let (start, end) = row.window;
        let safe = self.safe.iter().any(|(from, to)| *from < end && start < *to);
        if row.needs_safe && !safe {
            let most_deg = self.site.config.safety.sun_altitude_max_deg;
            return match self.site.sky.sun_deg(start.plus_seconds(0.5 * end.seconds_since(start))) {
                Ok(sun_deg) if sun_deg > most_deg => {
                    format!(
                        "the Sun stands above {most_deg} deg over its whole window ({sun_deg:.0} deg in the middle)"
                    )
                }
                _ => "the sky is not safe in its window".to_owned(),
            };
        }
        let runs = |other: &&PlannedRow| other.index != index && other.span().is_some_and(|(_, until)| until > start);
        let others = self.rows.iter().filter(runs);
        let last = others.filter_map(|other| Some((other.span()?.1, other))).max_by_key(|(until, _)| *until);
        match last {
            Some((until, other)) => {
                let what = other.object.as_deref().unwrap_or(other.action);
                format!("{what} (line {}) goes on until {}", other.line, until.strftime("%H:%M"))
            }
            None => String::new(),
        }
    }

    fn start_next(&mut self, now: Utc) -> bool {
        let safe_until = self.safe_until(now);
        let sky = || safe_until.is_none().then(|| Objection::Unsafe("the sky is not safe".to_owned()));
        let hidden = |index| self.hidden.get(&index).is_some_and(|clear| now < *clear);
        let may =
            |index, row: &Row| !hidden(index) && stands_against(true, true, row.action.needs().safe, sky).is_none();
        let Some(index) = self.sequence.next(now, may) else { return false };
        let Some(row) = self.sequence.begin(index) else { return false };
        let Some(planned) = self.rows.get_mut(index) else { return false };
        let mut ends = vec![(self.last.plus_seconds(LONGEST_S), Halt::Failed("the plan ends".to_owned()))];
        ends.extend(safe_until.filter(|_| row.action.needs().safe).map(|until| (until, Halt::Interrupted)));
        let mut run = SimulatedRun::new(&row, (now, planned.frames), self.site, &mut self.world, ends);
        let outcome = steps::foresee(&row.action, &mut run);
        if row.action.needs().mount {
            run.stand_still();
        }
        let status = match &outcome {
            Ok(()) => RowStatus::Finished,
            Err(Halt::Hidden(clear, _)) => {
                self.hidden.insert(index, *clear);
                RowStatus::Interrupted
            }
            Err(Halt::Interrupted) => RowStatus::Interrupted,
            Err(Halt::Failed(_)) => RowStatus::Failed,
        };
        let (until, looked) = (run.now, run.looked);
        planned.runs.push((now, until));
        (planned.frames, planned.exposed_s) = (run.taken, planned.exposed_s + run.exposed_s);
        planned.bytes += run.bytes;
        run.notes.iter().for_each(|words| planned.note(words));
        self.light.append(&mut run.light);
        match &outcome {
            Err(Halt::Failed(why)) => planned.note(why),
            Err(Halt::Hidden(clear, why)) => planned.note(&format!("waits until {}: {why}", clear.strftime("%H:%M"))),
            Ok(()) | Err(Halt::Interrupted) => {}
        }
        if let Some(span) = planned.span() {
            planned.heights = heights(row.action.looks_at(), looked, span, self.site);
        }
        self.at_work.push(AtWork { ends: until, id: row.id, index, status });
        true
    }

    /// The next instant at which anything can change: a row ends, a window opens or has passed, the sky changes.
    fn next_event(&self, now: Utc) -> Option<Utc> {
        let ends = self.at_work.iter().map(|row| row.ends);
        let waits = |status| matches!(status, RowStatus::Pending | RowStatus::Interrupted);
        let waiting = self.sequence.rows().iter().zip(self.sequence.statuses()).filter(|(_, status)| waits(**status));
        // A window has passed only after its end.
        let windows = waiting.flat_map(|(row, _)| [row.start, Utc::from_micros(row.end.micros().saturating_add(1))]);
        let sky = self.safe.iter().flat_map(|(from, to)| [*from, *to]).chain(self.hidden.values().copied());
        // A row that ends at once is ended in the next look, at the same time.
        let at_once = self.at_work.iter().any(|row| row.ends <= now).then_some(now);
        at_once.or(ends.chain(windows).chain(sky).filter(|at| *at > now && *at <= self.horizon()).min())
    }

    /// Nothing is searched after this.
    fn horizon(&self) -> Utc {
        let ends = self.at_work.iter().map(|row| row.ends).max();
        ends.map_or(self.last, |ends| ends.max(self.last)).plus_seconds(1.0)
    }
}

/// Spans without the parts that others cover.
fn without(mut spans: Vec<(Utc, Utc)>, taken: &[(Utc, Utc)]) -> Vec<(Utc, Utc)> {
    for (from, to) in taken {
        let cut = |(start, end): (Utc, Utc)| [(start, end.min(*from)), (start.max(*to), end)];
        spans = spans.into_iter().flat_map(cut).filter(|(start, end)| start < end).collect();
    }
    spans
}

/// The dark of all nights that are touched, from local noon to local noon.
fn dark(site: &mut Site, first: Utc, last: Utc) -> Result<Vec<(Utc, Utc)>, SkyError> {
    let longitude = Angle::from_degrees(site.config.place.longitude_deg);
    let noon = night_date(longitude, first).noon(longitude);
    let days = (last.seconds_since(noon) / DAY_S).ceil().max(1.0);
    site.sky.sun_below(DARK_DEG, noon, noon.plus_seconds(days * DAY_S))
}

/// How long spans, in order and apart, are covered by others, s; where two of those overlap it counts once.
fn common_s(spans: &[(Utc, Utc)], mut others: Vec<(Utc, Utc)>) -> f64 {
    others.sort();
    let mut all: BTreeMap<Utc, Utc> = BTreeMap::new();
    let mut open: Option<(Utc, Utc)> = None;
    for (from, to) in others {
        match &mut open {
            Some((_, end)) if from <= *end => *end = (*end).max(to),
            _ => all.extend(open.replace((from, to))),
        }
    }
    all.extend(open);
    let both = |(from, to): (&Utc, &Utc)| -> f64 {
        let within = spans.iter().map(|(start, end)| (*end).min(*to).seconds_since((*start).max(*from)).max(0.0));
        within.sum()
    };
    all.iter().map(both).sum()
}
