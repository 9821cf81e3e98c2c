//! Values that a profile asks for and that follow from other keywords of our files.

use units::{Angle, Utc};

use super::cards::CardList;
use crate::card::Value;

/// Most rows of a schedule, so that each has a number of its own in a night.
const ROWS: i64 = 10_000;
/// Longest text of one card.
const LONGEST_TEXT: usize = 68;

type Compute = fn(&CardList, &str) -> Option<Value>;

/// The values that profiles may ask for, and what each is.
pub(super) const COMPUTED: [(&str, Compute, &str); 15] = [
    ("@file_name", |_, file| Some(text(file)), "the name of our file"),
    ("@file_tail", |_, file| Some(text(tail(file))), "the name of our file, its last 68 characters"),
    (
        "@kind",
        |cards, _| kind(cards).map(text),
        "science, acquisition, technical, test, bias, dark or flat, of IMAGETYP and ASTRATYP",
    ),
    ("@letter", |cards, _| letter(cards).map(text), "LCO's letter of the kind: e, g, x, b, d or f"),
    ("@start", |cards, _| Some(text(start(cards)?.strftime("%Y-%m-%dT%H_%M_%S.%3f"))), "DATE-OBS to the millisecond"),
    ("@start_digits", |cards, _| Some(text(start(cards)?.strftime("%H%M%S%3f"))), "time of DATE-OBS, only digits"),
    ("@mjd_obs", |cards, _| Some(Value::Number(start(cards)?.mjd())), "of DATE-OBS"),
    ("@mjd_end", |cards, _| Some(Value::Number(end(cards)?.mjd())), "of DATE-OBS and EXPTIME"),
    ("@date_end", |cards, _| Some(text(end(cards)?.strftime("%Y-%m-%dT%H:%M:%S.%6f"))), "of DATE-OBS and EXPTIME"),
    ("@ut_stop", |cards, _| Some(text(end(cards)?.strftime("%H:%M:%S.%3f"))), "of DATE-OBS and EXPTIME"),
    ("@utc_s", |cards, _| utc_s(cards).map(Value::Number), "seconds since midnight, of DATE-OBS"),
    ("@day_obs", |cards, _| day_obs(cards).map(text), "date of the evening: NIGHT, else of DATE-OBS and LONG-OBS"),
    ("@block", |cards, _| block(cards).map(Value::Whole), "10000 x MJD of the evening + SCHEDROW"),
    ("@ra_hours", |cards, _| ra_hours(cards).map(text), "RA as hours, minutes, seconds"),
    ("@dec_degrees", |cards, _| dec_degrees(cards).map(text), "DEC as degrees, minutes, seconds"),
];

/// A computed value of a header; `file` is the name of the file that it is in.
pub(super) fn computed(name: &str, cards: &CardList, file: &str) -> Option<Value> {
    COMPUTED.iter().find(|(known, ..)| *known == name).and_then(|(_, compute, _)| compute(cards, file))
}

/// The kind of a frame: bias, dark or flat; acquisition for what shows whether the target is in the field; technical for
/// what observes the telescope itself; test for what shows how bright a flat would be; else science.
pub(super) fn kind(cards: &CardList) -> Option<&'static str> {
    let image_type = cards.text("IMAGETYP")?.to_ascii_lowercase();
    let action = cards.text("ASTRATYP").unwrap_or_default();
    let is_technical = matches!(action, "autofocus" | "calibrate_guiding" | "pointing_model" | "guiding");
    Some(match image_type.split_whitespace().next()? {
        "bias" => "bias",
        "dark" => "dark",
        "flat" => "flat",
        "acquisition" => "acquisition",
        "test" => "test",
        "light" | "object" | "science" if is_technical => "technical",
        // Of a release before acquisition frames had a type of their own.
        "light" | "object" | "science" if action == "pointing" => "acquisition",
        "light" | "object" | "science" => "science",
        _ => return None,
    })
}

fn letter(cards: &CardList) -> Option<&'static str> {
    Some(match kind(cards)? {
        "bias" => "b",
        "dark" => "d",
        "flat" => "f",
        "acquisition" => "g",
        "technical" | "test" => "x",
        _ => "e",
    })
}

/// The beginning of the exposure.
fn start(cards: &CardList) -> Option<Utc> {
    time(cards.text("DATE-OBS")?)
}

/// A time as headers have it, UTC; a date alone is midnight.
pub(super) fn time(text: &str) -> Option<Utc> {
    let text = text.trim_end_matches('Z');
    let whole = if text.contains('T') { format!("{text}Z") } else { format!("{text}T00:00:00Z") };
    whole.parse().ok()
}

fn end(cards: &CardList) -> Option<Utc> {
    let exposure_s = cards.number("EXPTIME").filter(|exposure_s| (0.0..1e7).contains(exposure_s))?;
    Some(start(cards)?.plus_seconds(exposure_s))
}

fn utc_s(cards: &CardList) -> Option<f64> {
    let start = start(cards)?;
    let midnight: Utc = start.strftime("%Y-%m-%dT00:00:00Z").parse().ok()?;
    // To the microsecond, as DATE-OBS has it.
    Some((start.seconds_since(midnight) * 1e6).round() / 1e6)
}

/// The evening of the night in which the exposure began, from local mean noon to noon: its MJD.
fn evening(cards: &CardList) -> Option<i64> {
    let night = cards.text("NIGHT").and_then(|night| {
        let (year, month, day) = (night.get(..4)?, night.get(4..6)?, night.get(6..8)?);
        time(&format!("{year}-{month}-{day}")).filter(|_| night.len() == 8)
    });
    if let Some(night) = night {
        return Some(night.mjd().round() as i64);
    }
    let longitude_deg = cards.number("LONG-OBS").filter(|deg| (-360.0..=360.0).contains(deg))?;
    // A longitude of 289.6 deg is 70.4 deg west, and its clocks are behind.
    let signed_deg = Angle::from_degrees(longitude_deg).wrapped_signed().degrees();
    Some((start(cards)?.mjd() + signed_deg / 360.0 - 0.5).floor() as i64)
}

fn day_obs(cards: &CardList) -> Option<String> {
    let days = evening(cards)? as f64 - start(cards)?.mjd();
    // The middle of that day, so that no rounding leads into another one.
    Some(start(cards)?.plus_seconds((days + 0.5) * 86_400.0).strftime("%Y%m%d"))
}

fn block(cards: &CardList) -> Option<i64> {
    let row = cards.number("SCHEDROW")?;
    let row = (row.fract() == 0.0 && (0.0..ROWS as f64).contains(&row)).then_some(row as i64)?;
    Some(evening(cards)? * ROWS + row)
}

fn ra_hours(cards: &CardList) -> Option<String> {
    let ra_deg = cards.number("RA").filter(|deg| (0.0..=360.0).contains(deg))?;
    // Rounded first, so that no 60 appears; 0.1 ms are 1.5 milliarcseconds.
    let units = (ra_deg / 15.0 * 3600.0 * 1e4).round() as u64 % (24 * 3600 * 10_000);
    let (seconds, rest) = (units / 10_000, units % 10_000);
    Some(format!("{:02}:{:02}:{:02}.{rest:04}", seconds / 3600, seconds / 60 % 60, seconds % 60))
}

fn dec_degrees(cards: &CardList) -> Option<String> {
    let dec_deg = cards.number("DEC").filter(|deg| (-90.0..=90.0).contains(deg))?;
    let units = (dec_deg.abs() * 3600.0 * 1e3).round() as u64;
    let sign = if dec_deg < 0.0 { '-' } else { '+' };
    let (seconds, rest) = (units / 1000, units % 1000);
    Some(format!("{sign}{:02}:{:02}:{:02}.{rest:03}", seconds / 3600, seconds / 60 % 60, seconds % 60))
}

/// The end of a file's name: its time, which comes last, is its own.
fn tail(file: &str) -> &str {
    let first = file.len().saturating_sub(LONGEST_TEXT);
    (first..=file.len()).find_map(|at| file.get(at..)).unwrap_or_default()
}

fn text(text: impl Into<String>) -> Value {
    Value::Text(text.into())
}
