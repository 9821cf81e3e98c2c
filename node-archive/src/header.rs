//! The content of a header: the cards of a new file, and those that telemetry adds afterwards.
//!
//! The site's table decides which keywords there are, in its order. To add one that Starmesh computes, add a row to
//! [`COMPUTED`] (known when the file is made) or to [`crate::astronomy`] (computed afterwards).
//!
//! RA and DEC are always ICRS: those of the target as it was requested, or else those that the mount reported,
//! transformed from its own frame.

mod bayer;
mod later;
mod place;
mod value;

use config::header::{Dtype, HeaderRow, HeaderTable, Source};
use contract::device::camera::{Frame, Pixel};
use contract::{Kind, Scalar};
use sky::Icrs;
use units::Utc;

pub use self::later::{Later, completion, needed, unknown_before};
use self::place::{LOWER_M, site};
pub use self::value::with_names;
use self::value::{in_unit, literal, typed};
use crate::astronomy::{self, fits_date};
use crate::card::{Card, CardValue};
use crate::sensor::Sensor;
use crate::{quality, solution};

/// The value of the ASTRA keyword.
pub const PROGRAM: &str = concat!("Starmesh ", env!("CARGO_PKG_VERSION"));
/// The file structure's own keywords, and BLANK: with BZERO 32768 it would turn pixels of 0 ADU into undefined ones.
const LEFT_TO_FITS: [&str; 14] = [
    "SIMPLE", "BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "NAXIS3", "EXTEND", "BZERO", "BSCALE", "BLANK", "CHECKSUM",
    "DATASUM", "END", "PCOUNT",
];
/// Words at the begin of cards that are no keywords with a value.
const COMMENTARY: [&str; 4] = ["COMMENT", "HISTORY", "CONTINUE", "HIERARCH"];
/// Room that a new file keeps beyond the rows of the table: what was measured (24), a plate solution with its
/// distortion (73), the history, the odd keyword.
const SPARE_CARDS: usize = 128;

/// Whether no table decides about a keyword: the file's structure, compressed or not.
fn is_left_to_fits(keyword: &str) -> bool {
    LEFT_TO_FITS.contains(&keyword) || COMMENTARY.contains(&keyword) || fits::restore::is_about_tiles(keyword)
}

/// All that is known when a file is made.
pub struct HeaderFacts<'a> {
    /// The frame.
    pub frame: &'a Frame,
    /// The site.
    pub place: &'a config::Place,
    /// Sky time of writing.
    pub written: Utc,
    /// What the configuration says of the sensor.
    pub sensor: Sensor,
    /// Newest value of a property of the camera or of a device paired with it.
    pub newest: &'a dyn Fn(Kind, &str) -> Option<Scalar>,
}

type Compute = fn(&HeaderFacts<'_>) -> Option<CardValue>;

/// Keywords that Starmesh knows when a file is made, with the comment for a table that does not list them.
const COMPUTED: [(&str, Compute, &str); 37] = [
    ("DATE-OBS", |k| Some(CardValue::Text(fits_date(k.frame.started_utc))), "UTC at start of exposure"),
    ("DATE", |k| Some(CardValue::Text(fits_date(k.written))), "UTC when the file was written"),
    ("EXPTIME", |k| Some(CardValue::Float(k.frame.exposure_s)), "[s] exposure time"),
    ("IMAGETYP", |k| Some(k.frame.purpose.image_type.as_str().into()), "type of the frame"),
    ("OBJECT", |k| k.frame.purpose.object.as_deref().map(CardValue::from), "object"),
    ("FILTER", |k| k.frame.purpose.filter.as_deref().map(CardValue::from), "filter in the beam"),
    ("ASTRA", |_| Some(PROGRAM.into()), "program and version"),
    ("ASTRATYP", |k| Some(k.frame.purpose.action.as_str().into()), "type of the action"),
    ("FRAMEID", |k| Some(k.frame.id.0.as_str().into()), "id of the frame"),
    ("RA", |k| Some(CardValue::Float(target(k.frame)?.ra.degrees())), "[deg] RA of the target at DATE-OBS, ICRS"),
    ("DEC", |k| Some(CardValue::Float(target(k.frame)?.dec.degrees())), "[deg] DEC of the target at DATE-OBS, ICRS"),
    ("RADESYS", |_| Some("ICRS".into()), "frame of RA and DEC"),
    ("XPIXSZ", |k| Some(CardValue::Float(k.number(Kind::Camera, "PixelSizeX")? * f64::from(k.frame.bin))), ""),
    ("YPIXSZ", |k| Some(CardValue::Float(k.number(Kind::Camera, "PixelSizeY")? * f64::from(k.frame.bin))), ""),
    ("APTAREA", |k| Some(CardValue::Float(k.positive(Kind::Telescope, "ApertureArea")?)), ""),
    ("APTDIA", |k| Some(CardValue::Float(k.positive(Kind::Telescope, "ApertureDiameter")?)), ""),
    ("FOCALLEN", |k| Some(CardValue::Float(k.positive(Kind::Telescope, "FocalLength")?)), ""),
    ("GAIN", |k| k.gain().map(CardValue::Float), "electrons per adu"),
    ("EGAIN", |k| k.gain().map(CardValue::Float), "electrons per adu"),
    ("RDNOISE", |k| k.sensor.read_noise_e.map(CardValue::Float), "read noise, electrons rms"),
    ("SATURATE", |k| k.saturation().map(CardValue::Float), "[adu] pixels from here on are saturated"),
    ("ROWORDER", |_| Some("TOP-DOWN".into()), "the first row of the file is the top one"),
    ("BAYERPAT", |k| k.bayer_px().map(|_| "RGGB".into()), "colours of the pixels of a 2 x 2 pattern"),
    ("XBAYROFF", |k| k.bayer_px().map(|[x, _]| CardValue::Int(x)), "column of the pattern that the first column is"),
    ("YBAYROFF", |k| k.bayer_px().map(|[_, y]| CardValue::Int(y)), "row of the pattern that the first row is"),
    ("SWCREATE", |_| Some(PROGRAM.into()), "program and version"),
    ("OBSGEO-L", |k| Some(CardValue::Float(k.place.longitude_deg)), "[deg] longitude of the site, east positive"),
    ("OBSGEO-B", |k| Some(CardValue::Float(k.place.latitude_deg)), "[deg] latitude of the site, north positive"),
    ("OBSGEO-H", |k| Some(CardValue::Float(k.place.elevation_m - LOWER_M)), "[m] above the ellipsoid of IAU 1976"),
    ("OBSGEO-X", |k| k.geocentric(0), "[m] geocentric place of the site, ITRS"),
    ("OBSGEO-Y", |k| k.geocentric(1), "[m] geocentric place of the site, ITRS"),
    ("OBSGEO-Z", |k| k.geocentric(2), "[m] geocentric place of the site, ITRS"),
    ("INSTRUME", |k| Some(k.frame.camera.as_str().into()), ""),
    ("OBSERVAT", |k| Some(k.place.site.as_str().into()), "site"),
    ("NIGHT", |k| night(k.frame).map(CardValue::from), "date of the evening of the night"),
    ("SCHEDROW", |k| Some(CardValue::Int(k.frame.purpose.row?.into())), "row of the schedule, the first is 0"),
    ("PROGID", |k| k.frame.purpose.programme.as_deref().map(CardValue::from), "programme of the schedule's row"),
];

/// The keywords of [`COMPUTED`] that every file has, whatever the table lists.
const ALWAYS: [&str; 12] = [
    "DATE-OBS", "DATE", "EXPTIME", "IMAGETYP", "ASTRA", "ASTRATYP", "FRAMEID", "RA", "DEC", "RADESYS", "OBJECT",
    "PROGID",
];

/// The keywords of [`COMPUTED`] that every file has, unless the table gives them another value. Archives ask for them.
const UNLESS_GIVEN: [&str; 11] = [
    "OBSERVAT", "NIGHT", "SCHEDROW", "GAIN", "EGAIN", "RDNOISE", "SATURATE", "ROWORDER", "BAYERPAT", "XBAYROFF",
    "YBAYROFF",
];

/// A pixel of this share of the largest value of the driver is clipped.
const CLIPPED: f64 = 0.99;

impl HeaderFacts<'_> {
    fn number(&self, kind: Kind, property: &str) -> Option<f64> {
        (self.newest)(kind, property)?.number().filter(|number| number.is_finite())
    }

    /// A number that is none where a driver reports 0 for what it does not know.
    fn positive(&self, kind: Kind, property: &str) -> Option<f64> {
        self.number(kind, property).filter(|number| *number > 0.0)
    }

    fn gain(&self) -> Option<f64> {
        self.sensor.electrons_per_adu.or_else(|| self.positive(Kind::Camera, "ElectronsPerADU"))
    }

    /// No pixel of a file is above what its numbers can hold.
    fn saturation(&self) -> Option<f64> {
        let holds_adu = if self.frame.pixel == Pixel::U16 { f64::from(u16::MAX) } else { f64::INFINITY };
        let given = self.sensor.saturation_adu.map(|adu| adu.min(holds_adu));
        // Clipped pixels have the driver's largest value, or a little less once a bias is taken off: programs that look for
        // what is above the keyword would see none of them.
        given.or_else(|| Some((CLIPPED * self.positive(Kind::Camera, "MaxADU")?.min(holds_adu)).floor()))
    }
}

/// The target that the frame was taken for.
fn target(frame: &Frame) -> Option<Icrs> {
    let (ra, dec) = (frame.purpose.ra_deg?, frame.purpose.dec_deg?);
    Icrs::from_degrees(ra, dec).checked().ok()
}

/// The night that the frame was taken in, `YYYYMMDD`.
fn night(frame: &Frame) -> Option<&str> {
    Some(frame.purpose.night.as_str()).filter(|night| !night.is_empty())
}

/// Rows of a table that will leave no trace in a header, and why.
pub fn check(table: &HeaderTable) -> Vec<String> {
    let mut notes: Vec<String> =
        table.repeated.iter().map(|keyword| format!("{keyword}: another row of it stands above")).collect();
    let is_commentary = |row: &&HeaderRow| COMMENTARY.contains(&row.keyword.as_str());
    notes
        .extend(table.rows.iter().filter(is_commentary).map(|row| format!("{}: it has no value in FITS", row.keyword)));
    for row in table.rows.iter().filter(|row| !is_left_to_fits(&row.keyword)) {
        let known = COMPUTED.iter().any(|(keyword, ..)| *keyword == row.keyword)
            || astronomy::KEYWORDS.contains(&row.keyword.as_str())
            || quality::makes(&row.keyword)
            || solution::makes(&row.keyword);
        match &row.source {
            Source::Computed if !known => notes.push(format!("{}: no keyword that Starmesh computes", row.keyword)),
            Source::Static(text) if !text.is_empty() && literal(row.dtype, text).is_none() => {
                let expected = match row.dtype {
                    Dtype::Str => "text",
                    Dtype::Int => "whole number",
                    Dtype::Float => "number",
                    Dtype::Bool => "true or false",
                };
                notes.push(format!("{}: {text:?} is no {expected}", row.keyword));
            }
            _ => {}
        }
    }
    notes
}

/// The keywords that every file has, whatever the table lists, with their comments.
pub fn of_every_file() -> impl Iterator<Item = (&'static str, &'static str)> {
    let is_always = |keyword: &str| ALWAYS.contains(&keyword) || UNLESS_GIVEN.contains(&keyword);
    COMPUTED.iter().filter(move |(keyword, ..)| is_always(keyword)).map(|(keyword, _, comment)| (*keyword, *comment))
}

/// Cards that a new file of this table should keep room for.
pub fn room(table: &HeaderTable) -> usize {
    table.rows.len() + SPARE_CARDS
}

/// The header of a new file, in the table's order, then what every file has.
pub fn base(table: &HeaderTable, known: &HeaderFacts<'_>) -> Vec<Card> {
    let mut cards: Vec<Card> = Vec::new();
    for row in table.rows.iter().filter(|row| !is_left_to_fits(&row.keyword)) {
        if let Some(value) = base_value(row, known)
            && !cards.iter().any(|card| card.keyword == row.keyword)
        {
            cards.push(Card::new(&row.keyword, value, &row.comment));
        }
    }
    for (keyword, compute, comment) in COMPUTED.iter().filter(|(keyword, ..)| ALWAYS.contains(keyword)) {
        if let Some(value) = compute(known) {
            match cards.iter_mut().find(|card| card.keyword == *keyword) {
                Some(card) => {
                    // The comment in a table is about the telescope's RA; with a target these are the target's.
                    card.comment =
                        if matches!(*keyword, "RA" | "DEC") { (*comment).to_owned() } else { card.comment.clone() };
                    card.value = value;
                }
                None => cards.push(Card::new(keyword, value, comment)),
            }
        }
    }
    // A table may take one of them from a property that is filled in later, such as GAIN from the camera's setting.
    let is_elsewhere = |keyword: &str| {
        let is_own = |row: &HeaderRow| row.keyword == keyword && matches!(row.source, Source::Property(..));
        table.rows.iter().any(is_own)
    };
    for (keyword, compute, comment) in COMPUTED.iter().filter(|(keyword, ..)| UNLESS_GIVEN.contains(keyword)) {
        if let Some(value) = compute(known)
            && !is_elsewhere(keyword)
            && !cards.iter().any(|card| card.keyword == *keyword)
        {
            cards.push(Card::new(keyword, value, comment));
        }
    }
    cards
}

fn base_value(row: &HeaderRow, known: &HeaderFacts<'_>) -> Option<CardValue> {
    let keyword = row.keyword.as_str();
    let compute = || COMPUTED.iter().find(|(name, ..)| *name == keyword).and_then(|(_, compute, _)| compute(known));
    match &row.source {
        // Known even where the table has it filled in later: dates, and a target's place.
        Source::Computed => Some(in_unit(row, compute()?)),
        Source::Property(Kind::Telescope, _) if matches!(keyword, "RA" | "DEC") => compute(),
        // Computed keywords use the configured site, so the header contains the configured site.
        Source::Property(Kind::Telescope, property) if row.fixed && site(known.place, property).is_some() => {
            site(known.place, property).map(CardValue::Float)
        }
        Source::Property(kind, property) if row.fixed => {
            (known.newest)(*kind, property).map(|value| typed(row, &value))
        }
        Source::Static(text) if text.is_empty() => match keyword {
            "TELESCOP" => Some(known.place.telescope.as_str().into()),
            "INSTRUME" => compute(),
            _ => None,
        },
        Source::Static(text) => literal(row.dtype, &with_names(text, known.place, &known.frame.camera)),
        Source::Metadata(key) => {
            let text = known.frame.purpose.metadata.get(key)?;
            let value = literal(row.dtype, text);
            if value.is_none() {
                tracing::warn!(keyword, text, expected = ?row.dtype, "the action's metadata do not fit the header table");
            }
            value
        }
        Source::Library | Source::Property(..) => None,
    }
}

#[cfg(test)]
mod tests;
