//! One star in eight bytes.
//!
//! First word: x (low half) and y of the star within its cell, in 1/65536 of the cell's side.
//! Second word: magnitude + 2 in units of 0.02 (10 bits, low), then proper motion in RA cos(dec) and in Dec,
//! mas/yr, two's complement of 11 bits each; -1024 in both means "look among the fast movers".

use units::Angle;

use crate::healpix::{self, FacePoint};

const STEPS: f64 = 65_536.0;
const FAST: i32 = -1024;
/// Greatest proper motion that a record itself can hold, mas/yr.
pub(super) const MAX_MOTION_MAS: i32 = 1023;

/// A packed star.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Record {
    place: u32,
    rest: u32,
}

impl Record {
    pub(super) fn from_words(place: u32, rest: u32) -> Self {
        Self { place, rest }
    }

    /// Packs a star; `motion_mas` None marks a fast mover.
    pub(super) fn pack(order: u8, ra: Angle, dec: Angle, mag: f64, motion_mas: Option<(i32, i32)>) -> (u64, Self) {
        let point = healpix::face_point(ra, dec);
        let cell = healpix::cell(order, point);
        let corner = healpix::corner(order, cell);
        let scale = STEPS * f64::from(1_u32 << order);
        let step = |offset: f64| ((offset * scale) as u32).min(0xFFFF);
        let place = step(point.x - corner.x) | step(point.y - corner.y) << 16;
        let mag = ((mag + 2.0) * 50.0).round().clamp(0.0, 1023.0) as u32;
        let (pm_ra, pm_dec) = motion_mas.unwrap_or((FAST, FAST));
        let bits = |pm: i32| pm.cast_unsigned() & 0x7FF;
        (cell, Self { place, rest: mag | bits(pm_ra) << 10 | bits(pm_dec) << 21 })
    }

    pub(super) fn words(self) -> [u32; 2] {
        [self.place, self.rest]
    }

    pub(super) fn mag(self) -> f64 {
        f64::from(self.rest & 0x3FF) * 0.02 - 2.0
    }

    /// Proper motion in RA cos(dec) and in Dec, mas/yr; None for a fast mover.
    pub(super) fn motion_mas(self) -> Option<(f64, f64)> {
        // shifting up and back down again brings the sign with it
        let pm_ra = (self.rest << 11).cast_signed() >> 21;
        let pm_dec = self.rest.cast_signed() >> 21;
        (pm_ra != FAST || pm_dec != FAST).then_some((f64::from(pm_ra), f64::from(pm_dec)))
    }

    /// Where it stands on the faces of the sphere.
    pub(super) fn position(self, order: u8, cell: u64) -> FacePoint {
        let corner = healpix::corner(order, cell);
        let scale = STEPS * f64::from(1_u32 << order);
        let middle = |step: u32| (f64::from(step) + 0.5) / scale;
        FacePoint {
            face: corner.face,
            x: corner.x + middle(self.place & 0xFFFF),
            y: corner.y + middle(self.place >> 16),
        }
    }
}
