//! What breaks the rules of a profile.

use std::fmt;
use std::path::Path;

use super::cards::{CardList, is_printable};
use super::computed::{kind, time};
use super::convert::convert;
use super::source::{LaterHdu, SourceFile};
use super::{Form, KeywordRule, Profile, PublicRule, SUMS, When, is_coordinate, is_structural};
use crate::card::Value;
use crate::checksum::{WHOLE, add, sum};
use crate::error::{Fault, FitsError};

/// A keyword that is not as it should be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// Which.
    pub keyword: String,
    /// Its value; absent where the keyword is missing.
    pub found: Option<String>,
    /// What was expected.
    pub expected: String,
    /// Whose rule it is.
    pub rule: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = self.found.as_deref().unwrap_or("missing");
        write!(f, "{} is {found}; expected {}. Rule: {}", self.keyword, self.expected, self.rule)
    }
}

const STANDARD: &str = "FITS Standard 4.0";

/// Finds what breaks the rules of a profile in a file, and of FITS itself as far as archives refuse it.
///
/// # Errors
/// The file cannot be read, or is no FITS file with an image in its first part.
pub fn check(file: &Path, profile: &Profile) -> Result<Vec<Violation>, FitsError> {
    let failed = |fault: Fault| FitsError { file: file.to_owned(), fault };
    let mut source = SourceFile::open(file).map_err(failed)?;
    let mut found = violations(&source.cards, profile);
    let data_sum = source.sum_of_data(|_| Ok(())).map_err(failed)?;
    found.extend(wrong_sums(&source.cards, sum(&source.header), data_sum));
    while let Some(later) = source.next_hdu(|_| Ok(())).map_err(failed)? {
        found.extend(wrong_sums_behind(&later));
    }
    Ok(found)
}

/// What a person should know before the copy of a file is delivered: why its archive would show it to everybody at once.
///
/// # Errors
/// The file cannot be read, or is no FITS file with an image in its first part.
pub fn warnings(file: &Path, profile: &Profile) -> Result<Vec<String>, FitsError> {
    let source = SourceFile::open(file).map_err(|fault| FitsError { file: file.to_owned(), fault })?;
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(public_at_once(&convert(&source.cards, &name, profile), profile))
}

/// Why an archive would show a frame of the sky with this header to everybody at once.
pub(super) fn public_at_once(cards: &CardList, profile: &Profile) -> Vec<String> {
    if !When::Light.holds(cards) {
        return Vec::new();
    }
    let broken =
        |rule: &&PublicRule| cards.text(&rule.name).is_some_and(|text| rule.is_broken_by(text, cards.text("DATE-OBS")));
    profile.public.iter().filter(broken).map(|rule| rule.warning(cards.text(&rule.name).unwrap_or_default())).collect()
}

impl PublicRule {
    /// Does a value make a frame public that was begun at a time, where that is known?
    pub fn is_broken_by(&self, value: &str, date_obs: Option<&str>) -> bool {
        let begun = date_obs.and_then(time);
        let days = || Some(time(value)?.seconds_since(begun?) / 86_400.0);
        self.contains.iter().any(|part| value.contains(part))
            || self.within_days.is_some_and(|within| days().is_some_and(|days| days < within))
    }

    /// What is reported of a value that breaks it.
    pub fn warning(&self, value: &str) -> String {
        format!("a frame of the sky becomes public at once: {} is '{value}'. Rule: {}", self.name, self.rule)
    }
}

/// Finds what breaks the rules of a profile in a header; its sums are not looked at.
pub(super) fn violations(cards: &CardList, profile: &Profile) -> Vec<Violation> {
    let mut found = of_standard(cards);
    for entry in &cards.entries {
        let keyword = entry.keyword.as_str();
        let value = entry.value.as_ref().map(written);
        if entry.value.is_none() {
            if !profile.commentary && !found.iter().any(|known| known.keyword == keyword) {
                let expected = "no commentary cards".to_owned();
                let rule = "the profile delivers no COMMENT and no HISTORY".to_owned();
                found.push(Violation { keyword: keyword.to_owned(), found: Some("there".to_owned()), expected, rule });
            }
        } else if let Some(dropped) = profile.dropped(keyword) {
            let (expected, rule) = ("no such keyword".to_owned(), dropped.rule.clone());
            found.push(Violation { keyword: keyword.to_owned(), found: value, expected, rule });
        } else if let Some(rules) = some(profile.rules(keyword, cards)) {
            found.extend(rules.iter().find_map(|rule| wrong_value(rule, entry.value.as_ref())));
        } else if !(profile.keeps(keyword) || is_structural(keyword) || SUMS.contains(&keyword)) {
            let rule = "a delivered file has the keywords of its profile and no others (docs/fits.md)".to_owned();
            let expected = "no such keyword".to_owned();
            found.push(Violation { keyword: keyword.to_owned(), found: value, expected, rule });
        }
    }
    for rule in profile.keyword.iter().filter(|rule| rule.required && rule.when.holds(cards)) {
        if cards.entry(&rule.name).is_none() {
            let (expected, text) = (rule.expected(), rule.rule.clone());
            found.push(Violation { keyword: rule.name.clone(), found: None, expected, rule: text });
        }
    }
    if kind(cards).is_none() {
        let expected = "Light Frame, Acquisition Frame, Bias Frame, Dark Frame, Flat Frame or Test Frame".to_owned();
        let rule = "the rules of a frame depend on its type".to_owned();
        let is_blank = |value: &&Value| matches!(value, Value::Text(text) if text.trim().is_empty());
        let value = cards.value("IMAGETYP").filter(|value| !is_blank(value)).map(written);
        found.push(Violation { keyword: "IMAGETYP".to_owned(), found: value, expected, rule });
    }
    found
}

fn some<'a>(rules: impl Iterator<Item = &'a KeywordRule>) -> Option<Vec<&'a KeywordRule>> {
    let rules: Vec<_> = rules.collect();
    (!rules.is_empty()).then_some(rules)
}

/// What archives refuse of any header: keywords twice, characters that FITS has not, coordinates in two forms.
pub(super) fn of_standard(cards: &CardList) -> Vec<Violation> {
    let mut found = Vec::new();
    let mut report = |keyword: &str, value: String, expected: &str, section: &str| {
        let (keyword, expected, rule) = (keyword.to_owned(), expected.to_owned(), format!("{STANDARD}, {section}"));
        found.push(Violation { keyword, found: Some(value), expected, rule });
    };
    let valued: Vec<&str> =
        cards.entries.iter().filter(|entry| entry.value.is_some()).map(|entry| entry.keyword.as_str()).collect();
    for (at, keyword) in valued.iter().enumerate() {
        if valued[..at].contains(keyword) {
            report(keyword, "there twice".to_owned(), "one card", "section 4.4");
        }
    }
    for entry in &cards.entries {
        if !is_printable(&String::from_utf8_lossy(entry.bytes())) {
            report(&entry.keyword, "a card with other characters".to_owned(), "printable ASCII", "section 4.1.2.1");
        }
        if let Some(field) = entry.value_without_form() {
            report(&entry.keyword, field, "a number, T or F, a text in quotes, or no value", "section 4.2");
        }
    }
    let first = valued.iter().find(|keyword| is_coordinate(keyword));
    let axes = valued.iter().position(|keyword| *keyword == "WCSAXES");
    if let (Some(axes), Some(first)) = (axes, first)
        && valued[..axes].contains(first)
    {
        report("WCSAXES", format!("behind {first}"), "before all other keywords of world coordinates", "section 8.2");
    }
    let matrix = |begins: &str| {
        let is_of = |keyword: &&&str| {
            is_coordinate(keyword) && keyword.strip_prefix(begins).is_some_and(|axes| axes.contains('_'))
        };
        valued.iter().find(is_of)
    };
    if let (Some(pc), Some(cd)) = (matrix("PC"), matrix("CD")) {
        report(pc, format!("there next to {cd}"), "PCi_j or CDi_j, never both", "section 8.1.2");
    }
    found
}

/// What is wrong with DATASUM and CHECKSUM.
pub(super) fn wrong_sums(cards: &CardList, header_sum: u32, data_sum: u32) -> Vec<Violation> {
    let mut found = Vec::new();
    let mut report = |keyword: &str, value: Option<String>, expected: String| {
        let rule = format!("{STANDARD}, section 4.4.2.7; archives refuse a file without it or with another sum");
        found.push(Violation { keyword: keyword.to_owned(), found: value, expected, rule });
    };
    match cards.text("DATASUM") {
        Some(text) if text.parse() == Ok(data_sum) => {}
        other => report("DATASUM", other.map(str::to_owned), format!("{data_sum}, the sum of the pixels")),
    }
    match cards.text("CHECKSUM") {
        Some(_) if matches!(add(header_sum, data_sum), 0 | WHOLE) => {}
        other => report("CHECKSUM", other.map(str::to_owned), "the sum of header and pixels".to_owned()),
    }
    found
}

/// What is wrong with the sums of a part behind the first one, where it has any.
pub(super) fn wrong_sums_behind(later: &LaterHdu) -> Vec<Violation> {
    let mut found = wrong_sums(&later.cards, later.header_sum, later.data_sum);
    found.retain(|violation| violation.found.is_some());
    found.iter_mut().for_each(|violation| violation.keyword.push_str(&format!(" of HDU {}", later.number)));
    found
}

/// What is wrong with the value of a keyword that has a rule.
fn wrong_value(rule: &KeywordRule, value: Option<&Value>) -> Option<Violation> {
    let value = value?;
    let text = match value {
        Value::Text(text) => Some(text.trim()),
        _ => None,
    };
    let number = match value {
        Value::Whole(whole) => Some(*whole as f64),
        Value::Number(number) => Some(*number),
        _ => None,
    };
    let is_name = |text: &str| text.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_+".contains(&byte));
    let has_form = match rule.form {
        Form::Text => text.is_some(),
        Form::Name => text.is_some_and(is_name),
        Form::Number => number.is_some(),
        Form::Whole => matches!(value, Value::Whole(_)),
        Form::Logical => matches!(value, Value::Logical(_)),
        Form::DateTime => text.is_some_and(is_date_time),
        Form::Day => text.is_some_and(is_day),
        Form::Hours => text.is_some_and(|text| is_sexagesimal(text, 24)),
        Form::Degrees => text.is_some_and(|text| is_sexagesimal(text.strip_prefix(['+', '-']).unwrap_or(text), 360)),
    };
    let is_one = rule.one_of.is_empty() || text.is_some_and(|text| rule.one_of.iter().any(|one| one == text));
    let is_in_range = rule.range.is_none_or(|[low, high]| number.is_some_and(|number| (low..=high).contains(&number)));
    let is_short = rule.max_chars.is_none_or(|most| text.is_some_and(|text| text.len() <= most));
    let is_upper = !rule.upper || text.is_some_and(|text| text == text.to_ascii_uppercase());
    if has_form && !rule.is_none(value) && is_one && is_in_range && is_short && is_upper {
        return None;
    }
    let (keyword, expected, text) = (rule.name.clone(), rule.expected(), rule.rule.clone());
    Some(Violation { keyword, found: Some(written(value)), expected, rule: text })
}

/// `2026-11-21T03:00:00.123` and no other form of ISO 8601: no zone, no comma, nothing left out (section 9.1.1).
fn is_date_time(text: &str) -> bool {
    const FORM: &[u8; 19] = b"0000-00-00T00:00:00";
    let (whole, fraction) = text.split_once('.').unwrap_or((text, "0"));
    let is_of_form = |(byte, form): (u8, &u8)| if *form == b'0' { byte.is_ascii_digit() } else { byte == *form };
    let has_form = whole.len() == FORM.len() && whole.bytes().zip(FORM).all(is_of_form);
    let has_fraction = !fraction.is_empty() && fraction.bytes().all(|byte| byte.is_ascii_digit());
    has_form && has_fraction && time(text).is_some()
}

fn is_day(text: &str) -> bool {
    let date = |text: &str| time(&format!("{}-{}-{}", text.get(..4)?, text.get(4..6)?, text.get(6..)?));
    text.len() == 8 && text.bytes().all(|byte| byte.is_ascii_digit()) && date(text).is_some()
}

/// `12:34:56.7`, with the first part below `most`.
fn is_sexagesimal(text: &str, most: u32) -> bool {
    // Numbers of Rust may have signs and exponents, these have none.
    if !text.bytes().all(|byte| byte.is_ascii_digit() || b":.".contains(&byte)) {
        return false;
    }
    let parts: Vec<&str> = text.split(':').collect();
    let whole = |text: &str, most: u32| text.parse::<u32>().is_ok_and(|part| part < most);
    let is_seconds = |text: &str| text.parse::<f64>().is_ok_and(|seconds| (0.0..60.0).contains(&seconds));
    matches!(parts.as_slice(), [first, minutes, seconds] if whole(first, most) && whole(minutes, 60) && is_seconds(seconds))
}

impl KeywordRule {
    /// What its value should be, in words.
    pub(super) fn expected(&self) -> String {
        let mut words = match self.form {
            Form::Text => "a text".to_owned(),
            Form::Name => "a text of letters, digits, `-`, `_` and `+`".to_owned(),
            Form::Number => "a number".to_owned(),
            Form::Whole => "a whole number".to_owned(),
            Form::Logical => "T or F".to_owned(),
            Form::DateTime => "a time such as 2026-11-21T03:00:00.123".to_owned(),
            Form::Day => "a date such as 20261121".to_owned(),
            Form::Hours => "hours such as 03:00:00.123".to_owned(),
            Form::Degrees => "degrees such as -24:37:01.2".to_owned(),
        };
        if !self.one_of.is_empty() {
            words = self.one_of.join(" or ");
        }
        if !self.none_of.is_empty() {
            words.push_str(&format!(", not {}", self.none_of.join(" or ")));
        }
        if self.upper {
            words.push_str(", in capital letters");
        }
        match self.range {
            Some([low, high]) if low == high => words = format!("the number {low}"),
            Some([low, high]) => words.push_str(&format!(" from {low} to {high}")),
            None => {}
        }
        if let Some(most) = self.max_chars {
            words.push_str(&format!(" of at most {most} characters"));
        }
        words
    }
}

/// A value as people read it.
fn written(value: &Value) -> String {
    match value {
        Value::Logical(logical) => if *logical { "T" } else { "F" }.to_owned(),
        Value::Whole(whole) => whole.to_string(),
        Value::Number(number) => number.to_string(),
        Value::Text(text) => format!("'{text}'"),
        Value::Undefined => "without a value".to_owned(),
    }
}
