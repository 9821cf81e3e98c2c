//! The share of an exposure's light that the slit leaves, and the fate of the frame: arithmetic only.
//!
//! ```text
//!  loses nothing, or no more than LITTLE: counted                  (a visible loss is reported with the frame)
//!  has lost more, and most of its light is still to come: ended    (it would be repeated anyway)
//!  has lost more, and most of its light is in: kept and repeated   (a flagged frame is better than none)
//! ```

/// A frame that loses no more of its light than this is as good as any: thin cloud takes more.
const LITTLE: f64 = 0.1;
/// A frame with so much of its light in is not thrown away any more.
const MOST: f64 = 0.75;
/// Less than this is not reported: the sum is not better than that.
const SEEN: f64 = 0.01;

/// What a frame is worth once it is exposed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Worth {
    /// Nothing was hidden.
    Whole,
    /// It counts, with so much of its light lost, 0 to 1.
    Dimmed(f64),
    /// It has lost so much that it is taken again.
    Spoilt(f64),
}

/// The light of one exposure, summed from what is seen of the slit now and then.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    exposure_s: f64,
    /// When the slit was seen last, s from the start of the exposure.
    seen_s: f64,
    lost_s: f64,
    free: f64,
    /// Since when a part is hidden, without a look in between at which all was free.
    hidden_since_s: Option<f64>,
}

impl Light {
    /// The light of an exposure that begins, or is first seen, at `seen_s` from its start.
    pub fn new(exposure_s: f64, seen_s: f64) -> Self {
        Self { exposure_s, seen_s: seen_s.clamp(0.0, exposure_s), lost_s: 0.0, free: 1.0, hidden_since_s: None }
    }

    /// Notes that now, so long from the start of the exposure, s, the slit leaves this part of the aperture free.
    pub fn look(&mut self, now_s: f64, free: f64) {
        let now_s = now_s.clamp(self.seen_s, self.exposure_s);
        let free = if free.is_finite() { free.clamp(0.0, 1.0) } else { 0.0 };
        // How it went in between is not known: evenly.
        self.lost_s += (now_s - self.seen_s) * (1.0 - 0.5 * (self.free + free));
        (self.seen_s, self.free) = (now_s, free);
        self.hidden_since_s = if free < 1.0 { self.hidden_since_s.or(Some(now_s)) } else { None };
    }

    /// The part of the whole exposure's light that is lost by now, 0 to 1.
    pub fn lost(&self) -> f64 {
        if self.exposure_s > 0.0 { self.lost_s / self.exposure_s } else { 0.0 }
    }

    /// Should the exposure end early? Only when a part has been hidden for `sure_s` without a break, so that a late
    /// report is not taken for a fault. A dome that does not recover within `timeout_s` is not waited for.
    pub fn is_hopeless(&self, sure_s: f64, timeout_s: f64) -> bool {
        let Some(since_s) = self.hidden_since_s else { return false };
        let (hidden_s, left_s) = (self.seen_s - since_s, self.exposure_s - self.seen_s);
        let too_much = self.lost() > LITTLE || hidden_s >= timeout_s;
        let at_the_end = (self.lost_s + left_s * (1.0 - self.free)) / self.exposure_s;
        let is_in = (self.seen_s - self.lost_s) / self.exposure_s;
        // A frame that is being read out is not ended.
        left_s > 0.0 && hidden_s >= sure_s && too_much && at_the_end > LITTLE && is_in < MOST
    }

    /// What the frame is worth, once it is exposed.
    pub fn worth(&self) -> Worth {
        match self.lost() {
            lost if lost > LITTLE => Worth::Spoilt(lost),
            lost if lost > SEEN => Worth::Dimmed(lost),
            _ => Worth::Whole,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An exposure that is looked at each second while `free` gives what the slit leaves.
    fn exposed(exposure_s: f64, free: impl Fn(f64) -> f64) -> (Light, Option<f64>) {
        let mut light = Light::new(exposure_s, 0.0);
        let seconds = (1..=exposure_s as u32).map(f64::from);
        let ended = seconds.into_iter().find(|now_s| {
            light.look(*now_s, free(*now_s));
            light.is_hopeless(2.0, 300.0)
        });
        (light, ended)
    }

    fn wall_from(from_s: f64) -> impl Fn(f64) -> f64 {
        move |now_s| if now_s < from_s { 1.0 } else { 0.0 }
    }

    #[test]
    fn a_frame_that_looks_out_free_is_whole_and_goes_on() {
        assert_eq!(exposed(600.0, |_| 1.0), (Light { free: 1.0, seen_s: 600.0, ..Light::new(600.0, 0.0) }, None));
        assert_eq!(exposed(600.0, |_| 1.0).0.worth(), Worth::Whole);
    }

    #[test]
    fn a_young_frame_behind_the_wall_is_ended_when_a_tenth_is_lost() {
        let (light, ended) = exposed(600.0, wall_from(100.0));
        assert!((158.0..=163.0).contains(&ended.unwrap()), "{light:?}");
        assert!(matches!(light.worth(), Worth::Spoilt(lost) if lost < 0.11));
    }

    #[test]
    fn a_frame_that_is_nearly_done_is_let_end_and_counts_if_little_is_lost() {
        let (light, ended) = exposed(600.0, wall_from(570.0));
        assert_eq!(ended, None);
        assert!(matches!(light.worth(), Worth::Dimmed(lost) if (0.045..0.06).contains(&lost)), "{light:?}");
        let (light, ended) = exposed(600.0, wall_from(480.0));
        assert_eq!(ended, None, "four fifths are in");
        assert!(matches!(light.worth(), Worth::Spoilt(lost) if (0.19..0.21).contains(&lost)), "{light:?}");
    }

    #[test]
    fn a_dome_that_comes_back_in_time_costs_only_what_it_hid() {
        let (light, ended) = exposed(600.0, |s| if (100.0..140.0).contains(&s) { 0.0 } else { 1.0 });
        assert_eq!(ended, None);
        assert!(matches!(light.worth(), Worth::Dimmed(lost) if (0.06..0.07).contains(&lost)), "{light:?}");
    }

    #[test]
    fn a_sliver_that_is_hidden_for_long_is_no_reason_to_end() {
        let (light, ended) = exposed(3600.0, |_| 0.95);
        assert_eq!(ended, None);
        assert!(matches!(light.worth(), Worth::Dimmed(lost) if (0.045..0.055).contains(&lost)), "{light:?}");
    }

    #[test]
    fn an_hour_does_not_wait_longer_for_the_dome_than_any_exposure() {
        assert_eq!(exposed(7200.0, wall_from(1000.0)).1, Some(1300.0));
    }

    #[test]
    fn one_look_at_a_late_azimuth_ends_nothing() {
        let mut light = Light::new(10.0, 0.0);
        light.look(2.0, 0.0);
        assert!(!light.is_hopeless(2.0, 300.0));
        light.look(4.0, 0.0);
        assert!(light.is_hopeless(2.0, 300.0));
        light.look(4.1, 1.0);
        assert!(!light.is_hopeless(0.0, 300.0));
    }

    #[test]
    fn nonsense_loses_no_more_than_there_is() {
        let mut light = Light::new(0.0, 5.0);
        light.look(3.0, 0.0);
        assert_eq!((light.lost(), light.is_hopeless(0.0, 0.0), light.worth()), (0.0, false, Worth::Whole));
        let mut light = Light::new(10.0, 0.0);
        light.look(1e9, -3.0);
        light.look(-1e9, f64::NAN);
        assert!(light.lost() <= 1.0, "{light:?}");
    }

    fn rank(light: &Light) -> u32 {
        match light.worth() {
            Worth::Whole => 0,
            Worth::Dimmed(_) => 1,
            Worth::Spoilt(_) => 2,
        }
    }

    #[test]
    fn what_is_hidden_for_longer_never_makes_a_frame_better() {
        let ranks: Vec<u32> = (0..=900).map(|from| rank(&exposed(600.0, wall_from(f64::from(from))).0)).collect();
        assert!(ranks.is_sorted_by(|early, late| early >= late), "{ranks:?}");
    }

    mod proof {
        use super::*;

        // A random property.
        proptest::proptest! {
            #[test]
            fn what_is_hidden_for_longer_never_makes_a_frame_better(from in 0.0..600.0_f64, later in 0.0..300.0_f64) {
                let (early, late) = (exposed(600.0, wall_from(from)).0, exposed(600.0, wall_from(from + later)).0);
                proptest::prop_assert!(rank(&early) >= rank(&late));
            }
        }
    }
}
