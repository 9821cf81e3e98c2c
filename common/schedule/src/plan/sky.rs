//! The sky over a site at any instant of a plan: one observer every half hour, turned with the Earth in between.

use std::collections::BTreeMap;

use config::Place as Configured;
use sky::{EarthOrientation, Observer, Place, SkyError};
use units::Utc;

/// For this long one observer is turned with the Earth; the Sun does not move meanwhile, so its crossings are good to 3
/// s.
const SLOT_US: i64 = 1_800_000_000;
/// So many observers are stored: more than a night has.
const MOST_SLOTS: usize = 200;
/// Crossings of the Sun are looked for in steps of this, s, ...
const STEP_S: f64 = 300.0;
/// ... and narrowed down to this, s.
const PRECISION_S: f64 = 0.5;

/// The sky over a site.
#[derive(Debug, Clone)]
pub struct Sky {
    place: Place,
    orientation: EarthOrientation,
    built: BTreeMap<i64, Observer>,
}

impl Sky {
    /// Of a site.
    ///
    /// # Errors
    /// The place is none on Earth.
    pub fn of(place: &Configured) -> Result<Self, SkyError> {
        let (place, orientation) = place.on_earth()?;
        Ok(Self { place, orientation, built: BTreeMap::new() })
    }

    /// The place of the site, and the orientation of the Earth.
    pub fn site(&self) -> (Place, EarthOrientation) {
        (self.place, self.orientation)
    }

    /// The sky at an instant.
    ///
    /// # Errors
    /// Outside 1972 to 2099.
    pub fn at(&mut self, at: Utc) -> Result<Observer, SkyError> {
        let slot = at.micros().div_euclid(SLOT_US);
        if self.built.len() >= MOST_SLOTS && !self.built.contains_key(&slot) {
            self.built.clear();
        }
        let observer = match self.built.entry(slot) {
            std::collections::btree_map::Entry::Occupied(known) => known.into_mut(),
            std::collections::btree_map::Entry::Vacant(place) => {
                let middle = Utc::from_micros(slot.saturating_mul(SLOT_US).saturating_add(SLOT_US / 2));
                place.insert(Observer::new(&self.place, &self.orientation, middle)?)
            }
        };
        observer.turned_to(at)
    }

    /// The Sun's altitude, deg.
    ///
    /// # Errors
    /// As [`Self::at`].
    pub fn sun_deg(&mut self, at: Utc) -> Result<f64, SkyError> {
        Ok(self.at(at)?.sun().altitude.degrees())
    }

    /// Spans from `from` to `to` during which the Sun stands at `most_deg` or below.
    ///
    /// # Errors
    /// As [`Self::at`].
    pub fn sun_below(&mut self, most_deg: f64, from: Utc, to: Utc) -> Result<Vec<(Utc, Utc)>, SkyError> {
        let mut spans = Vec::new();
        let (mut at, mut was_below) = (from, self.sun_deg(from)? <= most_deg);
        let mut began = was_below.then_some(from);
        while at < to {
            let next = at.plus_seconds(STEP_S).min(to);
            let is_below = self.sun_deg(next)? <= most_deg;
            if is_below != was_below {
                let crossing = self.crossing(most_deg, at, next, was_below)?;
                match began.take() {
                    Some(start) => spans.push((start, crossing)),
                    None => began = Some(crossing),
                }
            }
            (at, was_below) = (next, is_below);
        }
        spans.extend(began.map(|start| (start, to)));
        Ok(spans)
    }

    /// The first instant at which the Sun stands on the other side of an altitude than at `before`.
    fn crossing(&mut self, deg: f64, mut before: Utc, mut after: Utc, was_below: bool) -> Result<Utc, SkyError> {
        while after.seconds_since(before) > PRECISION_S {
            let middle = before.plus_seconds(0.5 * after.seconds_since(before));
            match (self.sun_deg(middle)? <= deg) == was_below {
                true => before = middle,
                false => after = middle,
            }
        }
        Ok(after)
    }
}
