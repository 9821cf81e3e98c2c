//! What a header gets once the telemetry around its exposure is there.

use std::collections::BTreeSet;

use config::header::{Dtype, HeaderRow, HeaderTable, Source};
use contract::device::camera::Frame;
use contract::device::telescope::EquatorialSystem;
use contract::{Kind, Scalar};
use sky::{Icrs, SkyError};
use units::Angle;

use super::value::typed;
use super::{is_left_to_fits, target};
use crate::astronomy::{self, Exposure};
use crate::card::{Card, CardValue};
use crate::interpolate::{Around, Rule, value_at};
use crate::plan::Plan;
use crate::sensor::{is_constant, was_lost};
use crate::stored_header::Header;

/// The begin of the lines of history that name what was not polled near the exposure.
const UNKNOWN: &str = "not known at DATE-OBS";

/// All that is known when a header is completed.
pub struct Later<'a> {
    /// The frame.
    pub frame: &'a Frame,
    /// The site.
    pub place: &'a config::Place,
    /// Frame that the mount's coordinates are in.
    pub mount: EquatorialSystem,
    /// A poll further from the start of the exposure is not used, sky s.
    pub holds_s: f64,
    /// Keywords that the file has already.
    pub present: &'a BTreeSet<String>,
    /// Those of which an earlier completion said that they are not known; absent at the first one.
    pub unknown_before: Option<&'a BTreeSet<String>>,
    /// The polls of a property around the start; `None` where no such device is paired with the camera.
    pub around: &'a dyn Fn(Kind, &str) -> Option<Around>,
}

/// Properties that completing a header of this table needs.
pub fn needed(table: &HeaderTable) -> impl Iterator<Item = (Kind, &str)> {
    table.rows.iter().filter(|row| !row.fixed).filter_map(|row| match &row.source {
        Source::Property(kind, property) => Some((*kind, property.as_str())),
        _ => None,
    })
}

/// Whether the shutter was closed during the exposure.
fn is_dark(frame: &Frame) -> bool {
    let kind = frame.purpose.image_type.to_ascii_lowercase();
    kind.starts_with("bias") || kind.starts_with("dark")
}

/// Computes what a header lacks.
pub fn completion(table: &HeaderTable, later: &Later<'_>) -> Result<Plan, SkyError> {
    let frame = later.frame;
    let mut exposure = Exposure::new(later.place, frame.started_utc, frame.exposure_s, target(frame))?;
    let has_target = exposure.target().is_some();
    if !has_target && let Some(pointing) = later.pointing(&exposure) {
        exposure.point_to(pointing);
    }
    let mut plan = Plan::default();
    let mut missing = Vec::new();
    // A frame with a closed shutter has no direction, whatever the mount reports.
    let is_dark = is_dark(frame);
    let has_none = |keyword: &str| is_dark && astronomy::OF_DIRECTION.contains(&keyword);
    let rows = table.rows.iter().filter(|row| !is_left_to_fits(&row.keyword) && !has_none(&row.keyword));
    for row in rows {
        let keyword = row.keyword.as_str();
        let value = match &row.source {
            Source::Property(Kind::Telescope, _) if matches!(keyword, "RA" | "DEC") => {
                if has_target {
                    continue;
                }
                let place = exposure.target();
                place.map(|place| CardValue::Float(if keyword == "RA" { place.ra } else { place.dec }.degrees()))
            }
            Source::Property(..) if row.fixed && later.present.contains(keyword) => continue,
            // What was read at another time may be the setting of another exposure.
            Source::Property(Kind::Camera, property) if row.fixed && !is_constant(property) => {
                if !was_lost(frame, property) {
                    continue;
                }
                None
            }
            Source::Property(kind, property) => {
                let Some(around) = (later.around)(*kind, property) else { continue };
                if around.before.is_empty() && around.after.is_empty() && around.received_since {
                    // The device was there and has no such sensor.
                    continue;
                }
                later.polled(row, *kind, property, &around)
            }
            Source::Computed if astronomy::KEYWORDS.contains(&keyword) => {
                if keyword == "AIRMASS" && !has_target {
                    later.polled_airmass()
                } else {
                    exposure.keyword(keyword)
                }
            }
            _ => continue,
        };
        match value {
            Some(value) if !matches!(value, CardValue::Float(number) if !number.is_finite()) => {
                plan.cards.push(Card::new(keyword, value, &row.comment));
            }
            _ if later.is_missing(keyword) => missing.push(keyword),
            _ => {}
        }
    }
    for (keyword, comment) in astronomy::MIDDLE {
        if !has_none(keyword)
            && !table.rows.iter().any(|row| row.keyword == keyword)
            && let Some(value) = exposure.keyword(keyword)
        {
            plan.cards.push(Card::new(keyword, value, comment));
        }
    }
    if has_target
        && !is_dark
        && let Some((altitude, azimuth)) = exposure.direction()
    {
        let what = "of target at start, unrefracted";
        plan.cards.push(Card::new("OBJALT", CardValue::Float(altitude), &format!("[deg] altitude {what}")));
        plan.cards.push(Card::new("OBJAZ", CardValue::Float(azimuth), &format!("[deg] azimuth {what}")));
    }
    plan.history = missing_lines(&missing);
    plan.own_history = vec![UNKNOWN];
    Ok(plan)
}

/// The keywords of which an earlier completion of this header said that they are not known; absent where there was none.
pub fn unknown_before(table: &HeaderTable, stored: &Header) -> Option<BTreeSet<String>> {
    let present = stored.keywords();
    let is_ours = |keyword: &str| {
        table.rows.iter().find(|row| row.keyword == keyword).is_none_or(|row| row.source == Source::Computed)
    };
    let is_complete = astronomy::KEYWORDS.iter().any(|keyword| present.contains(*keyword) && is_ours(keyword));
    let said = |card: String| {
        let keywords = card.strip_prefix("HISTORY ")?.strip_prefix(UNKNOWN)?.strip_prefix(": ")?;
        Some(keywords.split(", ").map(str::to_owned).collect::<Vec<_>>())
    };
    is_complete.then(|| stored.cards().filter_map(said).flatten().collect())
}

impl Later<'_> {
    /// Whether a keyword without a value is one that should have one: telemetry that is forgotten by now takes nothing back.
    fn is_missing(&self, keyword: &str) -> bool {
        !self.present.contains(keyword) && self.unknown_before.is_none_or(|before| before.contains(keyword))
    }

    fn interpolated(&self, kind: Kind, property: &str, dtype: Dtype, around: &Around) -> Option<Scalar> {
        let start = self.frame.started_utc;
        let exposure = (start, start.plus_seconds(self.frame.exposure_s));
        value_at(Rule::of(kind, property, dtype), around, exposure, self.holds_s)
    }

    fn polled(&self, row: &HeaderRow, kind: Kind, property: &str, around: &Around) -> Option<CardValue> {
        if row.fixed {
            // It does not change, so any poll will do.
            let sample = around.before.first().or(around.after.first())?;
            return Some(typed(row, &sample.value));
        }
        let value = self.interpolated(kind, property, row.dtype, around)?;
        let is_hours = (kind, property) == (Kind::Telescope, "RightAscension");
        Some(match (typed(row, &value), is_hours) {
            (CardValue::Float(hours), true) => CardValue::Float(Angle::from_hours(hours).degrees()),
            (value, _) => value,
        })
    }

    /// The direction that the mount reported, in ICRS.
    fn pointing(&self, exposure: &Exposure) -> Option<Icrs> {
        let number = |property| {
            let around = (self.around)(Kind::Telescope, property)?;
            self.interpolated(Kind::Telescope, property, Dtype::Float, &around)?.number()
        };
        let ra_deg = Angle::from_hours(number("RightAscension")?).degrees();
        let dec_deg = number("Declination")?;
        match self.mount {
            EquatorialSystem::Topocentric => Some(exposure.of_date_to_icrs(ra_deg, dec_deg)),
            EquatorialSystem::J2000 | EquatorialSystem::Other => Some(Icrs::from_degrees(ra_deg, dec_deg)),
            EquatorialSystem::J2050 | EquatorialSystem::B1950 => None,
        }
    }

    /// Airmass of the direction that the mount reported, for frames without a target.
    fn polled_airmass(&self) -> Option<CardValue> {
        let around = (self.around)(Kind::Telescope, "Altitude")?;
        let altitude = self.interpolated(Kind::Telescope, "Altitude", Dtype::Float, &around)?.number()?;
        sky::airmass(Angle::from_degrees(altitude)).map(CardValue::Float)
    }
}

fn missing_lines(missing: &[&str]) -> Vec<String> {
    missing.chunks(5).map(|keywords| format!("{UNKNOWN}: {}", keywords.join(", "))).collect()
}
