//! What an archive wants of a FITS file: a profile renames, adds, removes and checks keywords.
//!
//! A profile is a data file (`profile/*.toml`), embedded in the program: which keyword, from which keyword of our files,
//! of which form, and which rule of the archive asks for it. [`check`] finds what breaks the rules of a profile in a
//! file, [`convert`] makes the header of a delivered copy, and [`deliver_copy`] writes that copy: the pixels bit for bit,
//! the name by the profile, under a temporary name first, and never over another file.
//!
//! Nothing is invented: a value that our file does not have and that cannot be computed from it is missing in the copy
//! too, and a copy that an archive would refuse is not written.

mod cards;
mod check;
mod computed;
mod convert;
mod deliver;
mod page;
mod source;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use serde::Deserialize;

use crate::card::Value;

pub use cards::{CardEntry, CardList};
pub use check::{Violation, check, warnings};
pub use convert::{convert, file_name};
pub use deliver::{Checked, CopyPlan, Delivered, DeliveryError, check_copy, check_given, deliver_copy, plan_copy};
pub use page::page;

/// Which profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ProfileName {
    /// Files as the archive node writes them, and as the predecessor did.
    #[default]
    Astra,
    /// Files as the archive node writes them, with what the programs of others read.
    Plain,
    /// The ESO archive.
    Eso,
    /// Archives that run LCO's `ocs-archive`.
    Lco,
}

/// All profiles.
pub const PROFILES: [ProfileName; 4] = [ProfileName::Astra, ProfileName::Plain, ProfileName::Eso, ProfileName::Lco];

/// Not the name of a profile.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no profile; expected astra, plain, eso or lco")]
pub struct UnknownProfile(String);

/// A profile that cannot be used; the tests prove that the embedded ones can.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the embedded profile {name} cannot be used: {fault}; this is a fault of the program: please report it")]
pub struct ProfileError {
    name: ProfileName,
    fault: String,
}

/// What an archive wants.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// Whose files these are, in one sentence.
    pub about: String,
    /// Name of a delivered copy; `{KEYWORD}` and `{@computed}` are filled in.
    pub file_name: String,
    /// Whether the header is delivered as it is.
    #[serde(default)]
    pub unchanged: bool,
    /// Whether what breaks its rules is only reported by a check: a copy is made all the same, where FITS itself allows it.
    #[serde(default)]
    pub advice: bool,
    /// Whether COMMENT and HISTORY are delivered.
    pub commentary: bool,
    /// Keywords of our files that are delivered as they are; `*` at the end of one stands for any rest.
    pub keep: Vec<String>,
    /// Keywords that are not delivered.
    #[serde(default)]
    pub drop: Vec<DroppedKeyword>,
    /// Keywords that have a rule.
    #[serde(default)]
    pub keyword: Vec<KeywordRule>,
    /// What makes the archive show a frame of the sky to everybody at once.
    #[serde(default)]
    pub public: Vec<PublicRule>,
}

/// A value that makes a frame public at once.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublicRule {
    /// Of which keyword.
    pub name: String,
    /// The texts of which its value has one.
    #[serde(default)]
    pub contains: Vec<String>,
    /// Its value is a time that comes so soon after the exposure, d.
    #[serde(default)]
    pub within_days: Option<f64>,
    /// The rule of the archive.
    pub rule: String,
}

/// A keyword that must not be in a file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DroppedKeyword {
    /// Which; `*` at the end stands for any rest.
    pub name: String,
    /// Why.
    pub rule: String,
}

/// What a profile wants of a keyword.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeywordRule {
    /// Which.
    pub name: String,
    /// On which frames.
    #[serde(default)]
    pub when: When,
    /// The keywords of our file whose value it takes, the first that has one; those with `@` are computed.
    #[serde(default)]
    pub from: Vec<String>,
    /// What becomes of the texts of `from`: `*` is any other text, and as a value the text as it is.
    #[serde(default)]
    pub map: BTreeMap<String, String>,
    /// Whether its text becomes capital letters.
    #[serde(default)]
    pub upper: bool,
    /// Its value where `from` gives none.
    #[serde(default)]
    pub value: Option<Constant>,
    /// Whether it must be there.
    #[serde(default)]
    pub required: bool,
    /// What its value looks like.
    pub form: Form,
    /// The texts that it may have.
    #[serde(default)]
    pub one_of: Vec<String>,
    /// The texts that the archive takes for no value.
    #[serde(default)]
    pub none_of: Vec<String>,
    /// The smallest and the largest number that it may have.
    #[serde(default)]
    pub range: Option<[f64; 2]>,
    /// Most characters of its text.
    #[serde(default)]
    pub max_chars: Option<usize>,
    /// Its comment in a delivered copy.
    pub comment: String,
    /// The rule of the archive.
    pub rule: String,
}

/// The frames on which a rule holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum When {
    /// All.
    #[default]
    Always,
    /// Those of the sky that are no flats.
    Light,
    /// Bias, dark, flat, and the tests of flats.
    Calibration,
    /// Those with a plate solution.
    Solved,
}

/// What a value looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Form {
    /// Any text.
    Text,
    /// A text of letters, digits, `-`, `_` and `+`.
    Name,
    /// A number.
    Number,
    /// A whole number.
    Whole,
    /// T or F.
    Logical,
    /// `2026-11-21T03:00:00.123`, UTC.
    DateTime,
    /// `20261121`.
    Day,
    /// `03:00:00.123`, hours of time or of right ascension.
    Hours,
    /// `-24:37:01.2`, degrees.
    Degrees,
}

/// A value in a profile.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum Constant {
    /// A whole number.
    Whole(i64),
    /// A number.
    Number(f64),
    /// A text.
    Text(String),
}

impl Constant {
    fn value(&self) -> Value {
        match self {
            Self::Whole(whole) => Value::Whole(*whole),
            Self::Number(number) => Value::Number(*number),
            Self::Text(text) => Value::Text(text.clone()),
        }
    }
}

impl KeywordRule {
    /// Whether the archive takes this value for none.
    fn is_none(&self, value: &Value) -> bool {
        matches!(value, Value::Text(text) if text.trim().is_empty() || self.none_of.iter().any(|none| none == text.trim()))
    }
}

impl ProfileName {
    /// As people write it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Astra => "astra",
            Self::Plain => "plain",
            Self::Eso => "eso",
            Self::Lco => "lco",
        }
    }
}

impl fmt::Display for ProfileName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

impl FromStr for ProfileName {
    type Err = UnknownProfile;

    fn from_str(text: &str) -> Result<Self, UnknownProfile> {
        PROFILES.into_iter().find(|name| name.word() == text).ok_or_else(|| UnknownProfile(text.to_owned()))
    }
}

impl Profile {
    /// The embedded profile of a name.
    ///
    /// # Errors
    /// Its file has a fault, which a test of this crate would have found.
    pub fn load(name: ProfileName) -> Result<Self, ProfileError> {
        let text = match name {
            ProfileName::Astra => include_str!("profile/astra.toml"),
            ProfileName::Plain => include_str!("profile/plain.toml"),
            ProfileName::Eso => include_str!("profile/eso.toml"),
            ProfileName::Lco => include_str!("profile/lco.toml"),
        };
        toml::from_str(text).map_err(|error| ProfileError { name, fault: error.to_string() })
    }

    /// The rules of a keyword that hold on frames like these.
    fn rules<'a>(&'a self, keyword: &'a str, cards: &'a CardList) -> impl Iterator<Item = &'a KeywordRule> {
        self.keyword.iter().filter(move |rule| rule.name == keyword && rule.when.holds(cards))
    }

    /// Whether a keyword is a text by some rule, be it one that takes its value from this keyword. RA and DEC may be
    /// numbers, too.
    fn wants_text(&self, keyword: &str) -> bool {
        let is_about = |rule: &&KeywordRule| rule.name == keyword || rule.from.iter().any(|source| source == keyword);
        let is_text = |rule: &KeywordRule| matches!(rule.form, Form::Text | Form::Name | Form::Day | Form::DateTime);
        self.keyword.iter().filter(is_about).any(is_text)
    }

    /// Why a keyword is not delivered, where the profile has a reason.
    fn dropped(&self, keyword: &str) -> Option<&DroppedKeyword> {
        self.drop.iter().find(|dropped| matches(&dropped.name, keyword))
    }

    /// Whether a keyword without a rule is delivered.
    fn keeps(&self, keyword: &str) -> bool {
        self.keep.iter().any(|pattern| matches(pattern, keyword))
    }
}

impl When {
    fn holds(self, cards: &CardList) -> bool {
        let is_calibration = || matches!(computed::kind(cards), Some("bias" | "dark" | "flat" | "test"));
        match self {
            Self::Always => true,
            Self::Light => !is_calibration(),
            Self::Calibration => is_calibration(),
            Self::Solved => !is_calibration() && cards.text("CTYPE1").is_some_and(|kind| kind.starts_with("RA--")),
        }
    }
}

/// Whether a keyword fits a pattern, in which `*` at the end stands for any rest.
fn matches(pattern: &str, keyword: &str) -> bool {
    match pattern.strip_suffix('*') {
        Some(begins) => keyword.starts_with(begins),
        None => keyword == pattern,
    }
}

/// Keywords about the structure of the file, which every profile delivers as they are.
fn is_structural(keyword: &str) -> bool {
    matches!(keyword, "SIMPLE" | "BITPIX" | "NAXIS" | "EXTEND" | "BZERO" | "BSCALE" | "BLANK")
        || keyword.strip_prefix("NAXIS").is_some_and(|axis| axis.bytes().all(|byte| byte.is_ascii_digit()))
}

/// The sums of the HDU, which are computed for every copy.
const SUMS: [&str; 2] = ["CHECKSUM", "DATASUM"];

/// Whether a keyword is about world coordinates; WCSAXES comes before all of them (FITS Standard 4.0, section 8.2).
fn is_world(keyword: &str) -> bool {
    const PLAIN: [&str; 5] = ["WCSAXES", "RADESYS", "EQUINOX", "LONPOLE", "LATPOLE"];
    PLAIN.contains(&keyword) || is_coordinate(keyword)
}

/// Whether a keyword is about the axes of the world coordinates.
fn is_coordinate(keyword: &str) -> bool {
    const BEGINS: [&str; 9] = ["CTYPE", "CUNIT", "CRVAL", "CRPIX", "CDELT", "CROTA", "CD", "PC", "PV"];
    let is_axis = |rest: &str| {
        !rest.is_empty() && rest.bytes().all(|byte| byte.is_ascii_digit() || byte == b'_') && !rest.starts_with('_')
    };
    let is_distortion = |rest: &str| matches!(rest, "ORDER" | "DMAX") || is_axis(rest);
    BEGINS.iter().any(|begins| keyword.strip_prefix(begins).is_some_and(is_axis))
        || ["A_", "B_", "AP_", "BP_"].iter().any(|begins| keyword.strip_prefix(begins).is_some_and(is_distortion))
}
