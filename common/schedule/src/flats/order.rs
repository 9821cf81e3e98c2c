//! Chooses the next filter: a pure function of what is known of the filters' light.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::exposure::Ready;

/// In which order the filters of a row are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// The one whose light runs out first: at dusk the least sensitive, at dawn the most sensitive.
    #[default]
    ByNeed,
    /// As they are listed.
    Listed,
}

/// The trend of the light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trend {
    /// Dusk.
    Fades,
    /// Dawn.
    Brightens,
    /// A panel.
    Stays,
}

/// The state of one filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Frames are wanted of it, and it was not given up.
    pub is_wanted: bool,
    /// Whether it can be used now, as far as known.
    pub ready: Option<Ready>,
    /// It was measured only just, so that `ready` is not a guess.
    pub is_fresh: bool,
    /// How long until a frame can be begun, s.
    pub wait_s: f64,
}

/// The next step; the number is that of the filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Next {
    /// Measure how bright it is.
    Sound(usize),
    /// Take a frame of so many s.
    Take(usize, f64),
    /// Wait so many s for it.
    Wait(usize, f64),
    /// No frame of it can be had any more; true: because it is too bright.
    GiveUp(usize, bool),
    /// No frame is wanted any more.
    Done,
}

/// A wait is no shorter than this, s, so that a guess that is always a little early does no harm, ...
const WAIT_LEAST_S: f64 = 5.0;
/// ... and no longer: the guess is only as good as the sky is clear.
const WAIT_MOST_S: f64 = 60.0;

/// The next step; `current` is the filter of the last frame, which is finished before another is begun.
pub fn next(order: Order, trend: Trend, filters: &[Candidate], current: Option<usize>) -> Next {
    let wanted = || filters.iter().enumerate().filter(|(_, filter)| filter.is_wanted);
    match order {
        Order::Listed => wanted().next().map_or(Next::Done, |(index, filter)| of_one(trend, index, filter)),
        Order::ByNeed => {
            if let Some((index, _)) = wanted().find(|(_, filter)| filter.ready.is_none()) {
                return Next::Sound(index);
            }
            let each = || wanted().map(|(index, filter)| of_one(trend, index, filter));
            // How long its light will last, in arbitrary units: by the exposure that it takes now.
            let lasts = |filter: &Candidate| match (filter.ready, trend) {
                (Some(Ready::Now(exposure_s)), Trend::Fades) => -exposure_s,
                (Some(Ready::Now(exposure_s)), Trend::Brightens | Trend::Stays) => exposure_s,
                _ => f64::INFINITY,
            };
            let takes = || wanted().filter(|(_, filter)| matches!(filter.ready, Some(Ready::Now(_))));
            let begun = takes().find(|(index, _)| Some(*index) == current);
            let first = takes().min_by(|(_, a), (_, b)| lasts(a).total_cmp(&lasts(b)));
            if let Some(hopeless) = each().find(|next| matches!(next, Next::GiveUp(..))) {
                return hopeless;
            }
            if let Some((index, filter)) = begun.or(first) {
                return of_one(trend, index, filter);
            }
            let wait = |next: &Next| if let Next::Wait(_, wait_s) = next { *wait_s } else { 0.0 };
            each().min_by(|a, b| wait(a).total_cmp(&wait(b))).unwrap_or(Next::Done)
        }
    }
}

fn of_one(trend: Trend, index: usize, filter: &Candidate) -> Next {
    let is_hopeful = |ready| match ready {
        Ready::TooBright => trend == Trend::Fades,
        Ready::TooDark => trend == Trend::Brightens,
        Ready::Now(_) => true,
    };
    match filter.ready {
        None => Next::Sound(index),
        Some(Ready::Now(exposure_s)) if filter.is_fresh => Next::Take(index, exposure_s),
        Some(Ready::Now(_)) => Next::Sound(index),
        Some(ready) if is_hopeful(ready) => Next::Wait(index, filter.wait_s.clamp(WAIT_LEAST_S, WAIT_MOST_S)),
        Some(ready) if filter.is_fresh => Next::GiveUp(index, ready == Ready::TooBright),
        Some(_) => Next::Sound(index),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filter(ready: Ready) -> Candidate {
        Candidate { is_wanted: true, ready: Some(ready), is_fresh: true, wait_s: 0.0 }
    }

    fn waits(ready: Ready, wait_s: f64) -> Candidate {
        Candidate { wait_s, ..filter(ready) }
    }

    const UNSEEN: Candidate = Candidate { is_wanted: true, ready: None, is_fresh: false, wait_s: 0.0 };
    const DONE: Candidate = Candidate { is_wanted: false, ..UNSEEN };

    #[test]
    fn as_listed_the_first_that_is_wanted_decides_alone() {
        let listed = |trend, filters: &[Candidate]| next(Order::Listed, trend, filters, None);
        assert_eq!(listed(Trend::Fades, &[]), Next::Done);
        assert_eq!(listed(Trend::Fades, &[DONE, UNSEEN, filter(Ready::Now(3.0))]), Next::Sound(1));
        assert_eq!(listed(Trend::Fades, &[DONE, filter(Ready::Now(3.0))]), Next::Take(1, 3.0));
        let bright = [waits(Ready::TooBright, 30.0), filter(Ready::Now(3.0))];
        assert_eq!(listed(Trend::Fades, &bright), Next::Wait(0, 30.0));
        assert_eq!(listed(Trend::Brightens, &bright), Next::GiveUp(0, true));
        let dark = [waits(Ready::TooDark, f64::INFINITY)];
        assert_eq!(listed(Trend::Fades, &dark), Next::GiveUp(0, false));
        assert_eq!(listed(Trend::Brightens, &dark), Next::Wait(0, 60.0));
        assert_eq!(listed(Trend::Stays, &dark), Next::GiveUp(0, false));
    }

    #[test]
    fn by_need_all_are_seen_first_and_then_the_one_whose_light_runs_out_first_is_taken() {
        let need = |trend, filters: &[Candidate]| next(Order::ByNeed, trend, filters, None);
        assert_eq!(need(Trend::Fades, &[filter(Ready::Now(3.0)), UNSEEN]), Next::Sound(1));
        let three = [filter(Ready::Now(3.0)), filter(Ready::Now(20.0)), waits(Ready::TooBright, 100.0)];
        assert_eq!(need(Trend::Fades, &three), Next::Take(1, 20.0), "the least sensitive of those that can be taken");
        assert_eq!(next(Order::ByNeed, Trend::Fades, &three, Some(0)), Next::Take(0, 3.0), "what is begun is finished");
        assert_eq!(next(Order::ByNeed, Trend::Fades, &three, Some(2)), Next::Take(1, 20.0));
        let three = [filter(Ready::Now(3.0)), filter(Ready::Now(20.0)), waits(Ready::TooDark, 100.0)];
        assert_eq!(need(Trend::Brightens, &three), Next::Take(0, 3.0), "the most sensitive");
        let hopeless = [filter(Ready::Now(3.0)), filter(Ready::TooDark)];
        assert_eq!(need(Trend::Fades, &hopeless), Next::GiveUp(1, false));
        let waiting = [waits(Ready::TooBright, 200.0), waits(Ready::TooBright, 12.0), waits(Ready::TooBright, 1.0)];
        assert_eq!(need(Trend::Fades, &waiting[..2]), Next::Wait(1, 12.0));
        assert_eq!(need(Trend::Fades, &waiting), Next::Wait(2, 5.0));
        assert_eq!(need(Trend::Fades, &[DONE]), Next::Done);
    }

    #[test]
    fn what_was_seen_long_ago_is_seen_again_before_it_is_taken_or_given_up() {
        for ready in [Ready::Now(3.0), Ready::TooDark] {
            let old = Candidate { is_fresh: false, ..filter(ready) };
            for order in [Order::Listed, Order::ByNeed] {
                assert_eq!(next(order, Trend::Fades, &[old], None), Next::Sound(0), "{ready:?}");
            }
        }
    }
}
