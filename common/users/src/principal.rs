//! Callers.

use std::fmt;

use contract::Address;
use schemars::JsonSchema;
use serde::Serialize;

use crate::{Grant, Right};

/// How somebody proved to be who they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Way {
    /// By a password, once, and then by the cookie of a session.
    Session,
    /// By a token, as programs do.
    Token,
    /// A proxy in front of us did.
    Proxy,
    /// Not at all: nothing is asked here.
    Open,
}

/// The caller, a person or a program, and what they may do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Principal {
    /// The user's name.
    pub name: String,
    /// How they proved it.
    pub way: Way,
    /// What they may do; nothing where empty.
    pub grants: Vec<Grant>,
}

impl Principal {
    /// Somebody who is asked nothing and may do everything, as on this host before users are made.
    pub fn open(name: impl Into<String>) -> Self {
        Self { name: name.into(), way: Way::Open, grants: vec![Grant::everywhere(Right::Engineer)] }
    }

    /// The highest right at a telescope. A right at any telescope of a site reads what the site shares.
    pub fn right_at(&self, address: &Address) -> Option<Right> {
        let is_shared = address.telescope.as_str() == Address::SHARED;
        let right = |grant: &Grant| match grant.is_for(address) {
            true => Some(grant.right),
            false => (is_shared && grant.site.as_ref() == Some(&address.site)).then_some(Right::Viewer),
        };
        self.grants.iter().filter_map(right).max()
    }

    /// The highest right at any telescope: what is not of one telescope, such as the list of all, asks for it.
    pub fn right_anywhere(&self) -> Option<Right> {
        self.grants.iter().map(|grant| grant.right).max()
    }

    /// The highest right that holds everywhere: users and settings ask for it.
    pub fn right_everywhere(&self) -> Option<Right> {
        self.grants.iter().filter(|grant| grant.site.is_none()).map(|grant| grant.right).max()
    }
}

impl fmt::Display for Principal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grant_reaches_exactly_what_it_names() {
        let grants = ["viewer", "operator:paranal/*", "engineer:paranal/callisto"].map(|text| text.parse().unwrap());
        let ana = Principal { name: "ana".to_owned(), way: Way::Token, grants: grants.into() };
        let at = |site, telescope| ana.right_at(&Address::new(site, telescope).unwrap());
        assert_eq!(at("paranal", "callisto"), Some(Right::Engineer));
        let io = Principal { grants: vec!["operator:paranal/io".parse().unwrap()], ..ana.clone() };
        let of_io = |site, telescope| io.right_at(&Address::new(site, telescope).unwrap());
        assert_eq!((of_io("paranal", "shared"), of_io("teide", "shared")), (Some(Right::Viewer), None));
        assert_eq!(at("paranal", "io"), Some(Right::Operator));
        assert_eq!(at("teide", "callisto"), Some(Right::Viewer));
        assert_eq!((ana.right_anywhere(), ana.right_everywhere()), (Some(Right::Engineer), Some(Right::Viewer)));
        let nobody = Principal { grants: vec![], ..ana.clone() };
        assert_eq!((nobody.right_at(&Address::new("teide", "io").unwrap()), nobody.right_anywhere()), (None, None));
        assert_eq!(Principal::open("local").right_at(&Address::new("a", "b").unwrap()), Some(Right::Engineer));
    }
}
