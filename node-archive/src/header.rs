//! The content of a header: the cards of a new file, and those that telemetry adds afterwards.
//!
//! The site's table decides which keywords there are, in its order. To add one that Starmesh computes, add a row to
//! [`COMPUTED`] (known when the file is made) or to [`crate::astronomy`] (computed afterwards).
//!
//! RA and DEC are always ICRS: those of the target as it was requested, or else those that the mount reported,
//! transformed from its own frame.

use std::collections::BTreeSet;

use config::header::{Dtype, HeaderRow, HeaderTable, Source};
use contract::device::camera::{Frame, Pixel};
use contract::device::telescope::EquatorialSystem;
use contract::{Kind, Scalar};
use sky::{Icrs, SkyError};
use units::{Angle, Utc};

use crate::astronomy::{self, Exposure, fits_date};
use crate::card::{Card, CardValue};
use crate::interpolate::{Rule, Sample, value_at};
use crate::plan::Plan;
use crate::sensor::{Sensor, is_constant, was_lost};
use crate::stored_header::Header;
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
/// The begin of the lines of history that name what was not polled near the exposure.
pub const UNKNOWN: &str = "not known at DATE-OBS";
/// Room that a new file keeps beyond the rows of the table: what was measured (24), a plate solution with its
/// distortion (73), the history, the odd keyword.
const SPARE_CARDS: usize = 128;

/// Whether no table decides about a keyword: the file's structure, compressed or not.
fn is_left_to_fits(keyword: &str) -> bool {
    LEFT_TO_FITS.contains(&keyword) || COMMENTARY.contains(&keyword) || fits::restore::is_about_tiles(keyword)
}

/// The ellipsoid of IAU 1976, which FITS has for OBSGEO-H (Rots et al. 2015, A&A 574, A36, section 4.1.3), is so much larger than
/// that of WGS 84, m.
const LOWER_M: f64 = 3.0;

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

/// ASCOM's `SensorType` of a sensor whose pixels see red and green, and in the next row green and blue.
const RGGB: f64 = 2.0;

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

    /// Where in the pattern of a one-shot colour sensor the frame begins: column and row, 0 or 1; absent where no pixel of the
    /// file is one of such a sensor.
    fn bayer_px(&self) -> Option<[i64; 2]> {
        let Frame { bin, planes, origin_px: [x, y], .. } = *self.frame;
        let offset = |property, origin: u32| {
            Some((self.number(Kind::Camera, property)? + f64::from(origin)).rem_euclid(2.0) as i64)
        };
        let has_pattern = bin == 1 && planes == 1 && self.number(Kind::Camera, "SensorType")? == RGGB;
        if has_pattern { Some([offset("BayerOffsetX", x)?, offset("BayerOffsetY", y)?]) } else { None }
    }

    /// A coordinate of the site in the Earth's frame, m.
    fn geocentric(&self, axis: usize) -> Option<CardValue> {
        let place_m = self.place.on_earth().ok()?.0.geocentric_m();
        // Sites are known to the centimetre at best.
        place_m.get(axis).map(|m| CardValue::Float((m * 100.0).round() / 100.0))
    }
}

/// The target that the frame was taken for.
fn target(frame: &Frame) -> Option<Icrs> {
    let (ra, dec) = (frame.purpose.ra_deg?, frame.purpose.dec_deg?);
    Icrs::from_degrees(ra, dec).checked().ok()
}

/// Whether the shutter was closed during the exposure.
fn is_dark(frame: &Frame) -> bool {
    let kind = frame.purpose.image_type.to_ascii_lowercase();
    kind.starts_with("bias") || kind.starts_with("dark")
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

/// Lengths are in the unit that the comment of their row names: drivers report metres, and many programs read mm.
fn in_unit(row: &HeaderRow, value: CardValue) -> CardValue {
    let factor = match row.keyword.as_str() {
        "FOCALLEN" | "APTDIA" if row.comment.starts_with("[mm]") => 1e3,
        "APTAREA" if row.comment.starts_with("[mm2]") => 1e6,
        _ => return value,
    };
    match value {
        // Whole nanometres: a factor leaves long tails.
        CardValue::Float(number) => CardValue::Float((number * factor * 1e6).round() / 1e6),
        other => other,
    }
}

/// A text of the table with the names of site, telescope and camera in the places for them.
pub fn with_names(text: &str, place: &config::Place, camera: &str) -> String {
    text.replace("{site}", place.site.as_str())
        .replace("{telescope}", place.telescope.as_str())
        .replace("{camera}", camera)
}

fn site(place: &config::Place, property: &str) -> Option<f64> {
    match property {
        "SiteLatitude" => Some(place.latitude_deg),
        "SiteLongitude" => Some(place.longitude_deg),
        "SiteElevation" => Some(place.elevation_m),
        _ => None,
    }
}

/// Text of the table or of a schedule as the type that the table asks for.
fn literal(dtype: Dtype, text: &str) -> Option<CardValue> {
    match dtype {
        Dtype::Str => Some(text.into()),
        Dtype::Int => text.parse().ok().map(CardValue::Int),
        Dtype::Float => text.parse().ok().filter(|number: &f64| number.is_finite()).map(CardValue::Float),
        Dtype::Bool => match text.to_ascii_lowercase().as_str() {
            "true" | "1" => Some(CardValue::Logical(true)),
            "false" | "0" => Some(CardValue::Logical(false)),
            _ => None,
        },
    }
}

/// The words of ASCOM's numbers, for a row of the table that asks for a text.
fn words(kind: Kind, property: &str) -> &'static [&'static str] {
    match (kind, property) {
        (Kind::Telescope, "SideOfPier" | "DestinationSideOfPier") => &["East", "West"],
        (Kind::Dome, "ShutterStatus") => &["open", "closed", "opening", "closing", "error"],
        (Kind::Camera, "CameraState") => &["idle", "waiting", "exposing", "reading", "download", "error"],
        (Kind::Camera, "SensorType") => &["monochrome", "color", "RGGB", "CMYG", "CMYG2", "LRGB"],
        (Kind::CoverCalibrator, "CoverState") => &["none", "closed", "moving", "open", "unknown", "error"],
        _ => &[],
    }
}

/// A device's value as the type that the table asks for, where it can be that; else as it is.
fn typed(row: &HeaderRow, value: &Scalar) -> CardValue {
    if let (Dtype::Str, Source::Property(kind, property), Some(number)) = (row.dtype, &row.source, value.number()) {
        let words = words(*kind, property);
        let word = (number.fract() == 0.0 && number >= 0.0).then(|| words.get(number as usize)).flatten();
        // Those of no word are ASCOM's -1, "unknown".
        return match (words.is_empty(), word) {
            (true, _) => CardValue::Text(value.to_string()),
            (false, word) => CardValue::Text(word.copied().unwrap_or("unknown").to_owned()),
        };
    }
    match (row.dtype, value.number()) {
        (Dtype::Float, Some(number)) => CardValue::Float(number),
        (Dtype::Int, Some(number)) => CardValue::Int(number.round() as i64),
        (Dtype::Bool, Some(number)) => CardValue::Logical(number != 0.0),
        (Dtype::Str, _) => CardValue::Text(value.to_string()),
        (_, None) => CardValue::of(value),
    }
}

/// The polls around an instant.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Around {
    /// The last value before it.
    pub before: Option<Sample>,
    /// The first value at it or after it.
    pub after: Option<Sample>,
    /// The device has published a state after the instant, with a value or without.
    pub received_since: bool,
}

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
                if around.before.is_none() && around.after.is_none() && around.received_since {
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
        let rule = Rule::of(kind, property, dtype);
        let (before, after) = (around.before.as_ref(), around.after.as_ref());
        value_at(rule, before, after, self.frame.started_utc, self.holds_s)
    }

    fn polled(&self, row: &HeaderRow, kind: Kind, property: &str, around: &Around) -> Option<CardValue> {
        if row.fixed {
            // It does not change, so any poll will do.
            let sample = around.before.as_ref().or(around.after.as_ref())?;
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

#[cfg(test)]
mod tests;
