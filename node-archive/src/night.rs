//! A night of a telescope: its span of time and the frames that were stored in it.

use contract::observatory::FrameFacts;
use sky::NightDate;
use units::{Angle, Utc};

use crate::database::StoredImage;

/// A night of a telescope, from local mean noon to local mean noon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Night {
    /// The date of its evening.
    pub date: NightDate,
    /// The noon at which it begins.
    pub from: Utc,
    /// The noon at which it ends.
    pub to: Utc,
}

impl Night {
    /// The night of this date at a place.
    pub fn new(date: NightDate, place: &config::Place) -> Self {
        let longitude = Angle::from_degrees(place.longitude_deg);
        Self { date, from: date.noon(longitude), to: date.next().noon(longitude) }
    }

    /// The night to which an instant belongs at a place.
    pub fn at(instant: Utc, place: &config::Place) -> Self {
        Self::new(sky::night_date(Angle::from_degrees(place.longitude_deg), instant), place)
    }
}

/// A stored frame with everything that the archive knows of it.
#[derive(Debug, Clone, PartialEq)]
pub struct NightFrame {
    /// The file and the announcement.
    pub image: StoredImage,
    /// All keywords are in the header.
    pub is_complete: bool,
    /// What was measured, or why nothing was; absent where no facts arrived.
    pub facts: Option<FrameFacts>,
}
