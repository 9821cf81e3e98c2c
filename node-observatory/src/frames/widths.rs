//! Which widths of stars are believed, frame after frame of one camera.
//!
//! Pure. One frame whose stars are much wider or narrower than before may show cosmic rays, a gust or a cloud's edge:
//! it teaches nothing. Frames that follow one another and agree are the new state: the focus or the seeing has changed.

use contract::observatory::FrameFacts;

/// Narrower than this no star can be, px: it is what a pixel makes of a point.
const NARROWEST_PX: f64 = 0.68;
/// A width agrees with another one when neither is wider by more than this ratio.
const SAME: f64 = 1.5;
/// So many frames, one after the other, that agree among themselves are believed against what was known.
const AGREED: usize = 3;
/// A width whose standard error is more than this share of it does not count.
const UNSURE: f64 = 0.25;

/// What is known of the width of a camera's stars.
#[derive(Debug, Clone, Default)]
pub struct Widths {
    known_px: Option<f64>,
    /// Widths since the last one that was believed; they agree among themselves.
    rivals_px: Vec<f64>,
}

impl Widths {
    /// Takes a measured frame in. Answers the widths that are believed now, in the order of their frames: its own, that
    /// of some frames before it too, or none (yet).
    pub fn observe_facts(&mut self, facts: &FrameFacts) -> Vec<f64> {
        // A trailed star is wide for another reason.
        let fwhm_px = facts.fwhm_px.filter(|_| facts.trailed != Some(true));
        fwhm_px.map_or_else(Vec::new, |fwhm_px| self.observe(fwhm_px, facts.fwhm_error_px))
    }

    fn observe(&mut self, fwhm_px: f64, error_px: Option<f64>) -> Vec<f64> {
        let is_sure = error_px.is_none_or(|error| error <= UNSURE * fwhm_px);
        if !(fwhm_px.is_finite() && fwhm_px >= NARROWEST_PX && is_sure) {
            return Vec::new();
        }
        if self.known_px.is_none_or(|known| is_same(known, fwhm_px)) {
            self.known_px = Some(fwhm_px);
            self.rivals_px.clear();
            return vec![fwhm_px];
        }
        if !self.rivals_px.iter().all(|rival| is_same(*rival, fwhm_px)) {
            self.rivals_px.clear();
        }
        self.rivals_px.push(fwhm_px);
        if self.rivals_px.len() < AGREED {
            return Vec::new();
        }
        self.known_px = Some(fwhm_px);
        std::mem::take(&mut self.rivals_px)
    }

    /// The width that is believed, px.
    pub fn known_px(&self) -> Option<f64> {
        self.known_px
    }
}

fn is_same(a: f64, b: f64) -> bool {
    a.max(b) <= SAME * a.min(b)
}

#[cfg(test)]
mod tests;
