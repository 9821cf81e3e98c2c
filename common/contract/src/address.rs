//! The names that keys are made of: sites, telescopes, devices, nodes.

use std::fmt;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, de};

use crate::device::Kind;

/// A text that cannot stand in a key.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is no {what}: expected {expected}")]
pub struct BadKey {
    text: String,
    what: &'static str,
    expected: &'static str,
}

macro_rules! chunk {
    ($(#[$doc:meta])* $name:ident, $what:literal, $expected:literal, $accepts:expr) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, JsonSchema, Serialize)]
        #[serde(transparent)]
        pub struct $name(String);

        impl $name {
            /// As text.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl FromStr for $name {
            type Err = BadKey;
            fn from_str(text: &str) -> Result<Self, BadKey> {
                let accepts: fn(&str) -> bool = $accepts;
                if accepts(text) && text.len() <= 63 {
                    Ok(Self(text.to_owned()))
                } else {
                    Err(BadKey { text: text.to_owned(), what: $what, expected: $expected })
                }
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                String::deserialize(deserializer)?.parse().map_err(de::Error::custom)
            }
        }
    };
}

chunk!(
    /// Name of a site or a telescope: `[a-z0-9][a-z0-9-]*`.
    Chunk, "site or telescope id", "small letters, digits and '-', beginning with a letter or digit, at most 63 characters",
    |text| {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit();
        text.starts_with(plain) && text.chars().all(|c| plain(c) || c == '-')
    }
);

chunk!(
    /// Name of a device, a node or a frame: a plain chunk of letters, digits, `_`, `-` and `.`.
    Name, "name", "letters, digits, '_', '-' or '.', beginning with a letter or digit, at most 63 characters",
    |text| {
        let plain = |c: char| c.is_ascii_alphanumeric();
        text.starts_with(plain) && text.chars().all(|c| plain(c) || matches!(c, '_' | '-' | '.'))
    }
);

/// A telescope's place in the tree; devices shared by a site live under the telescope `shared`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, JsonSchema, Serialize, Deserialize)]
pub struct Address {
    /// The site.
    pub site: Chunk,
    /// The telescope.
    pub telescope: Chunk,
}

impl Address {
    /// Name of the telescope that holds a site's shared devices.
    pub const SHARED: &'static str = "shared";

    /// From two texts.
    pub fn new(site: &str, telescope: &str) -> Result<Self, BadKey> {
        Ok(Self { site: site.parse()?, telescope: telescope.parse()? })
    }

    /// The address of the devices that this telescope shares with others.
    pub fn shared(&self) -> Self {
        Self { site: self.site.clone(), telescope: Chunk(Self::SHARED.to_owned()) }
    }

    /// A device at this address.
    pub fn device(&self, kind: Kind, name: &Name) -> Device {
        Device { address: self.clone(), kind, name: name.clone() }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.site, self.telescope)
    }
}

/// One device on the bus.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Device {
    /// Where it stands.
    pub address: Address,
    /// What it is.
    pub kind: Kind,
    /// Its configured name.
    pub name: Name,
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.address, self.kind, self.name)
    }
}

/// The four roles of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Bridges Alpaca devices.
    Device,
    /// Runs one telescope.
    Observatory,
    /// Keeps telemetry and files.
    Archive,
    /// Serves people.
    Web,
}

impl Role {
    /// All roles.
    pub const ALL: [Self; 4] = [Self::Device, Self::Observatory, Self::Archive, Self::Web];

    /// As it stands in a key.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Device => "device",
            Self::Observatory => "observatory",
            Self::Archive => "archive",
            Self::Web => "web",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_would_break_a_key_are_refused() {
        for text in ["", "a/b", "@x", "a*", "a b", "-x", "ä"] {
            assert!(text.parse::<Name>().is_err(), "{text}");
        }
        assert!("Alpha".parse::<Chunk>().is_err());
    }
}
