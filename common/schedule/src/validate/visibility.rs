//! Checks whether a row's target can be observed over its whole window: altitude, horizon, Sun and Moon.

use config::Horizon;
use contract::observatory::{Check, Finding};
use sky::Body;
use units::Utc;

use super::KnownFacts;
use super::duration::{Estimate, estimate, length};
use super::sky_table::{Eye, Moment, SkyTable, Slot, Vector, angle_deg, chord, dot, slot_of};
use crate::action::Place as Aim;
use crate::fault::{Right as _, warning};
use crate::fields::when;
use crate::horizon_limits;
use crate::names::Found;
use crate::row::Row;

/// A row that loses more of its window to the Sun than this is reported, s.
const SLACK_S: f64 = 60.0;

/// The target of a row, by its place or by its name; none where it does not move the telescope.
pub(super) fn aim(row: &Row, known: &KnownFacts) -> Option<Aim> {
    if !row.action.needs().mount {
        return None;
    }
    row.action.looks_at().or_else(|| match known.names.find(row.action.lookup_name()?, row.start).ok()? {
        Found::Place(place) => Some(Aim::Icrs(place)),
        Found::Body(body) => Some(Aim::Moving(body)),
    })
}

/// The direction of a row when it begins.
pub(super) fn target(row: &Row, known: &KnownFacts, sky: &mut SkyTable) -> Option<Vector> {
    sky.direction(&aim(row, known)?, row.start)
}

/// Names that are not known yet: the altitude of these targets is checked once they are.
pub(super) fn unchecked(rows: &[Row], known: &KnownFacts) -> Vec<String> {
    let mut unchecked = Vec::new();
    for row in rows.iter().filter(|row| row.action.needs().mount) {
        if let Some(name) = row.action.lookup_name()
            && let Err(why) = known.names.find(name, row.start)
        {
            let line = row.line;
            unchecked
                .push(format!("altitude, Sun and Moon of line {line}: {why}; it is checked once the name is known"));
        }
    }
    unchecked
}

/// The highest that a place that is fixed among the stars gets at this site, degrees.
fn highest_deg(aim: Option<&Aim>, known: &KnownFacts) -> Option<f64> {
    match aim? {
        Aim::Icrs(place) => Some(90.0 - (known.config.place.latitude_deg - place.dec.degrees()).abs()),
        Aim::Moving(_) | Aim::Horizontal(_) => None,
    }
}

/// Rows whose targets, or whose sky, cannot be observed over the whole window.
pub(super) fn check(rows: &[Row], known: &KnownFacts, sky: &mut SkyTable) -> Vec<Finding> {
    rows.iter().flat_map(|row| look(row, known, sky)).collect()
}

/// The times when a condition was not met.
#[derive(Default)]
struct Bad {
    moments: usize,
    bad: usize,
    begins: bool,
    ends: bool,
    first_bad: Option<Utc>,
    last_bad: Option<Utc>,
    first_good: Option<Utc>,
    last_good: Option<Utc>,
    /// The largest deviation, in its own unit, with the value and the limit at that time.
    worst: Option<(f64, f64, f64)>,
}

impl Bad {
    /// `off` above 0 is bad; `value` and `limit` are stored for the worst.
    fn note(&mut self, at: Utc, off: f64, value: f64, limit: f64) {
        let is_bad = off > 0.0;
        self.begins |= is_bad && self.moments == 0;
        self.ends = is_bad;
        self.moments += 1;
        if is_bad {
            self.bad += 1;
            self.first_bad = self.first_bad.or(Some(at));
            self.last_bad = Some(at);
        } else {
            self.first_good = self.first_good.or(Some(at));
            self.last_good = Some(at);
        }
        if self.worst.is_none_or(|(worst, ..)| off > worst) {
            self.worst = Some((off, value, limit));
        }
    }

    /// Empty where it is reported already.
    fn is_known_otherwise(&self, is_reported: bool) -> &Self {
        const NONE: &Bad = &Bad {
            moments: 0,
            bad: 0,
            begins: false,
            ends: false,
            first_bad: None,
            last_bad: None,
            first_good: None,
            last_good: None,
            worst: None,
        };
        if is_reported { NONE } else { self }
    }

    fn is_all(&self) -> bool {
        self.bad == self.moments
    }

    /// Such as `until 2026-11-21T03:00:00Z`, the field, and the right value.
    fn span(&self) -> Option<(String, Option<&'static str>, Option<String>)> {
        let at = |time: Option<Utc>| time.map(when).unwrap_or_default();
        let later = || format!("start_time at least {}", at(self.first_good));
        let sooner = || format!("end_time at most {}", at(self.last_good));
        Some(match (self.bad, self.begins, self.ends) {
            (0, ..) => return None,
            _ if self.is_all() => ("over the whole window".to_owned(), None, None),
            (_, true, true) => {
                let words = format!("but from {} to {}", at(self.first_good), at(self.last_good));
                (words, None, Some(format!("{}, {}", later(), sooner())))
            }
            (_, true, false) => (format!("until {}", at(self.first_good)), Some("start_time"), Some(later())),
            (_, false, true) => (format!("from {} on", at(self.first_bad)), Some("end_time"), Some(sooner())),
            (_, false, false) => (format!("from {} to {}", at(self.first_bad), at(self.last_bad)), None, None),
        })
    }
}

/// The conditions of one row.
#[derive(Default)]
struct Looked {
    low: Bad,
    hidden: Bad,
    high: Bad,
    west: Bad,
    sunlit: Bad,
    /// Smallest chord to the Moon while both are up, when, and its lit part.
    moon: Option<(f64, Utc, f64)>,
}

fn look(row: &Row, known: &KnownFacts, sky: &mut SkyTable) -> Vec<Finding> {
    if !row.action.needs().safe {
        return Vec::new();
    }
    let begins = target(row, known, sky);
    let aimed = aim(row, known);
    let mount = known.mount(row);
    let check = &known.config.schedule.check;
    let limits = mount.map(|mount| &mount.limits);
    let low_deg = horizon_limits::altitude_min_deg(&known.config, mount);
    let (low, high) = (low_deg.to_radians().sin(), check.altitude_max_deg.to_radians().sin());
    let west_h = limits.and_then(|limits| limits.hour_angle_max_h);
    let horizon = mount.and_then(|mount| known.horizons.get(&mount.common.name));
    let sun_deg = known.config.safety.sun_altitude_max_deg;
    let sun = sun_deg.to_radians().sin();
    let mut looked = Looked::default();
    let path = Path::of(aimed.as_ref(), sky);
    let (mut place, mut placed) = (begins, slot_of(row.start));
    let is_known = sky.walk(row.start, row.end, |now, slot| {
        let height = dot(&now.zenith, &slot.sun);
        looked.sunlit.note(now.at, height - sun, height, sun);
        if let Some(path) = path.as_ref().filter(|path| path.is_fast() || slot_of(now.at) != placed) {
            placed = slot_of(now.at);
            place = path.at(now.at).or(place);
        }
        let Some(place) = &place else { return };
        let height = dot(&now.zenith, place);
        looked.low.note(now.at, low - height, height, low);
        looked.high.note(now.at, height - high, height, high);
        if let Some(horizon) = horizon {
            looked.hidden.note_hidden(now, place, height, horizon);
        }
        if let Some(west_h) = west_h {
            let hour_angle_h = slot.hour_angle_h(now, place);
            looked.west.note(now.at, hour_angle_h - west_h, hour_angle_h, west_h);
        }
        looked.note_moon(now, slot, place, height > low);
    });
    if !is_known {
        return Vec::new();
    }
    let mut findings = Vec::new();
    findings.extend(too_sunny(row, &looked.sunlit, known, sun_deg));
    let name = row.action.object().unwrap_or(row.action.name());
    let altitude = |sin: f64| sin.clamp(-1.0, 1.0).asin().to_degrees();
    // Half a degree for refraction and the sky's slow turning.
    let never = highest_deg(aimed.as_ref(), known).filter(|highest_deg| highest_deg + 0.5 < low_deg);
    findings.extend(never.map(|highest_deg| never_up(row, name, highest_deg, low_deg)));
    let low = looked.low.is_known_otherwise(never.is_some());
    findings.extend(finding(row, low, |_, value, _| {
        let low = format!("{name} stands below {low_deg:.0} deg");
        (low, format!(", {:.1} deg at the lowest", altitude(value)))
    }));
    findings.extend(finding(row, &looked.hidden, |_, altitude_deg, limit_deg| {
        let there = format!(", at the worst {altitude_deg:.1} deg where the horizon is {limit_deg:.1} deg");
        (format!("{name} stands behind the horizon of the site"), there)
    }));
    findings.extend(finding(row, &looked.high, |_, value, _| {
        let high = format!("{name} stands above {:.0} deg", check.altitude_max_deg);
        (high, format!(", {:.1} deg at the highest", altitude(value)))
    }));
    findings.extend(finding(row, &looked.west, |_, hour_angle_h, limit_h| {
        let west = format!("{name} stands beyond the mount's hour angle of {limit_h:.1} h");
        (west, format!(", {hour_angle_h:.1} h at the farthest"))
    }));
    let moon = looked.moon.map(|(apart, at, lit)| (angle_deg(apart), at, lit));
    findings.extend(moon.filter(|(apart_deg, ..)| *apart_deg < check.moon_distance_min_deg).map(|moon| {
        let (apart_deg, at, lit) = moon;
        let what = format!(
            "{name} stands {apart_deg:.1} deg from the Moon, which is {:.0} % lit, at {}",
            100.0 * lit,
            when(at)
        );
        let found = warning(Check::Moon, row.written.parameter("ra"), Some("ra"), what);
        found.right(format!("at least {:.0} deg (schedule.check.moon_distance_min_deg)", check.moon_distance_min_deg))
    }));
    findings
}

/// A target that moves among the stars, followed every half hour; a satellite at every look.
struct Path {
    body: Body,
    eye: Eye,
}

impl Path {
    fn of(aim: Option<&Aim>, sky: &SkyTable) -> Option<Self> {
        match aim? {
            Aim::Moving(body) => Some(Self { body: body.clone(), eye: sky.eye() }),
            Aim::Icrs(_) | Aim::Horizontal(_) => None,
        }
    }

    fn is_fast(&self) -> bool {
        matches!(self.body, Body::Satellite(_))
    }

    fn at(&self, at: Utc) -> Option<Vector> {
        self.eye.sees(&self.body, at)
    }
}

impl Bad {
    /// Compares with the horizon, which is read only where it can hide the target; `height` is the sine of the
    /// altitude.
    fn note_hidden(&mut self, now: &Moment, place: &Vector, height: f64, horizon: &Horizon) {
        let altitude_deg = height.clamp(-1.0, 1.0).asin().to_degrees();
        if altitude_deg > horizon.highest_deg() {
            return self.note(now.at, f64::NEG_INFINITY, altitude_deg, 0.0);
        }
        let azimuth_deg = dot(&now.east, place).atan2(dot(&now.north, place)).to_degrees();
        let limit_deg = horizon.altitude_deg(azimuth_deg);
        self.note(now.at, limit_deg - altitude_deg, altitude_deg, limit_deg);
    }
}

impl Looked {
    fn note_moon(&mut self, now: &Moment, slot: &Slot, place: &Vector, is_up: bool) {
        if !is_up || dot(&now.zenith, &slot.moon) <= 0.0 {
            return;
        }
        let apart = chord(place, &slot.moon);
        if self.moon.is_none_or(|(least, ..)| apart < least) {
            self.moon = Some((apart, now.at, slot.moon_lit));
        }
    }
}

/// A target that is never high enough at this site, whatever the night.
fn never_up(row: &Row, name: &str, highest_deg: f64, low_deg: f64) -> Finding {
    let what = if highest_deg < 0.0 {
        format!("{name} never rises at this site: it stays {:.1} deg or more below the horizon", -highest_deg)
    } else {
        format!("{name} never rises above {low_deg:.0} deg at this site: {highest_deg:.1} deg at the highest")
    };
    let found = warning(Check::Visibility, row.written.parameter("dec"), Some("dec"), what);
    found.right("no time helps; is the sign of dec right?")
}

/// The Sun only delays a row: that is reported where the row loses too much.
fn too_sunny(row: &Row, sunlit: &Bad, known: &KnownFacts, sun_deg: f64) -> Option<Finding> {
    let (words, field, right) = sunlit.span()?;
    let Estimate { needs_s, until_end } = estimate(row, &known.config.schedule.check);
    let (first, last) = (sunlit.first_good.unwrap_or(row.start), sunlit.last_good.unwrap_or(row.start));
    let dark_s = last.seconds_since(first);
    let lost_s = row.end.seconds_since(row.start) - dark_s;
    let enough = if until_end { lost_s <= SLACK_S } else { dark_s >= needs_s };
    if !sunlit.is_all() && enough {
        return None;
    }
    let field = field.unwrap_or("start_time");
    let cost = if sunlit.is_all() { ": it will not run".to_owned() } else { format!(": {} are lost", length(lost_s)) };
    let what = format!("the Sun stands above {sun_deg:.0} deg {words}{cost}");
    let found = warning(Check::Sun, row.written.field(field), Some(field), what);
    Some(match right {
        Some(right) => found.right(right),
        None => found,
    })
}

/// The finding for a target that cannot be observed; `describe` gives the words before and after the span of time.
fn finding(row: &Row, bad: &Bad, describe: impl Fn(f64, f64, f64) -> (String, String)) -> Option<Finding> {
    let (words, field, right) = bad.span()?;
    let (off, value, limit) = bad.worst?;
    let (before, after) = describe(off, value, limit);
    let (at, field) = match field {
        Some(field) => (row.written.field(field), field),
        None => (row.written.parameter("ra"), "ra"),
    };
    let never = if bad.is_all() { ": it cannot be observed" } else { "" };
    let found = warning(Check::Visibility, at, Some(field), format!("{before} {words}{after}{never}"));
    Some(match right {
        Some(right) => found.right(right),
        None => found.right("give it another time"),
    })
}
