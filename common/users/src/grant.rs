//! Where rights hold.

use std::fmt;
use std::str::FromStr;

use contract::{Address, Chunk, Right};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A text that is no grant.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is no grant: expected viewer, observer, operator or engineer, alone or with the telescopes that it is for, such as \
     operator:paranal/callisto or operator:paranal/*"
)]
pub struct BadGrant(String);

/// A right on a telescope, on all of a site, or on all.
///
/// As text `operator`, `operator:paranal/*` or `operator:paranal/callisto`.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[schemars(with = "String")]
#[serde(try_from = "String", into = "String")]
pub struct Grant {
    /// What it gives.
    pub right: Right,
    /// The only site it is for.
    pub site: Option<Chunk>,
    /// The only telescope of the site it is for.
    pub telescope: Option<Chunk>,
}

impl Grant {
    /// A right on all telescopes.
    pub const fn everywhere(right: Right) -> Self {
        Self { right, site: None, telescope: None }
    }

    /// Does it hold at this telescope?
    pub fn is_for(&self, address: &Address) -> bool {
        self.site.as_ref().is_none_or(|site| *site == address.site)
            && self.telescope.as_ref().is_none_or(|telescope| *telescope == address.telescope)
    }

    /// What both give: the lesser right, on the telescopes that both are for.
    pub fn meet(&self, other: &Self) -> Option<Self> {
        let narrower = |one: &Option<Chunk>, two: &Option<Chunk>| match (one, two) {
            (Some(one), Some(two)) if one != two => None,
            (Some(chunk), _) | (None, Some(chunk)) => Some(Some(chunk.clone())),
            (None, None) => Some(None),
        };
        let site = narrower(&self.site, &other.site)?;
        let telescope = narrower(&self.telescope, &other.telescope)?;
        Some(Self { right: self.right.min(other.right), site, telescope })
    }

    /// Does one of these give all that this one does?
    pub fn is_within(&self, grants: &[Self]) -> bool {
        grants.iter().any(|grant| grant.meet(self).as_ref() == Some(self))
    }
}

impl FromStr for Grant {
    type Err = BadGrant;

    fn from_str(text: &str) -> Result<Self, BadGrant> {
        let bad = || BadGrant(text.to_owned());
        let (word, place) = text.split_once(':').unwrap_or((text, "*/*"));
        let right = Right::ALL.into_iter().find(|right| right.word() == word).ok_or_else(bad)?;
        let (site, telescope) = place.split_once('/').ok_or_else(bad)?;
        let chunk = |text: &str| if text == "*" { Ok(None) } else { text.parse().map(Some).map_err(|_| bad()) };
        match (chunk(site)?, chunk(telescope)?) {
            (None, Some(_)) => Err(bad()),
            (site, telescope) => Ok(Self { right, site, telescope }),
        }
    }
}

impl TryFrom<String> for Grant {
    type Error = BadGrant;

    fn try_from(text: String) -> Result<Self, BadGrant> {
        text.parse()
    }
}

impl From<Grant> for String {
    fn from(grant: Grant) -> Self {
        grant.to_string()
    }
}

impl fmt::Display for Grant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let any = |chunk: &Option<Chunk>| chunk.as_ref().map_or("*", Chunk::as_str).to_owned();
        match &self.site {
            None => write!(f, "{}", self.right),
            Some(_) => write!(f, "{}:{}/{}", self.right, any(&self.site), any(&self.telescope)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_grants_meet_in_the_lesser_right_on_what_both_are_for() {
        let grant = |text: &str| text.parse::<Grant>().unwrap();
        for (one, two, both) in [
            ("operator", "viewer:paranal/*", Some("viewer:paranal/*")),
            ("viewer", "operator:paranal/io", Some("viewer:paranal/io")),
            ("operator:paranal/*", "operator:paranal/io", Some("operator:paranal/io")),
            ("operator:paranal/*", "operator:teide/*", None),
            ("operator:paranal/io", "operator:paranal/callisto", None),
        ] {
            for (one, two) in [(one, two), (two, one)] {
                assert_eq!(grant(one).meet(&grant(two)), both.map(grant), "{one} {two}");
            }
        }
        let own = ["viewer", "operator:paranal/*"].map(grant);
        for (wanted, within) in [
            ("viewer:teide/io", true),
            ("operator:paranal/io", true),
            ("operator", false),
            ("engineer:paranal/io", false),
        ] {
            assert_eq!(grant(wanted).is_within(&own), within, "{wanted}");
        }
    }

    #[test]
    fn a_grant_is_read_as_it_is_written() {
        for text in ["viewer", "operator:paranal/*", "engineer:paranal/callisto"] {
            assert_eq!(text.parse::<Grant>().unwrap().to_string(), text);
        }
        assert_eq!("observer:*/*".parse::<Grant>().unwrap().to_string(), "observer");
        for bad in [
            "",
            "root",
            "operator:",
            "operator:paranal",
            "operator:*/callisto",
            "Operator",
            "operator:a/b/c",
            "operator:Paranal/*",
        ] {
            assert!(bad.parse::<Grant>().is_err(), "{bad:?}");
        }
    }
}
