//! The key tree, spelled here and nowhere else.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, de};

use crate::device::Kind;

/// First chunks of every key.
pub const ROOT: &str = "starmesh/v1";

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
        #[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
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
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
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

    /// The address of the devices that this telescope shares with its neighbours.
    pub fn shared(&self) -> Self {
        Self { site: self.site.clone(), telescope: Chunk(Self::SHARED.to_owned()) }
    }

    /// A device at this address.
    pub fn device(&self, kind: Kind, name: &Name) -> Device {
        Device { address: self.clone(), kind, name: name.clone() }
    }

    /// Everything that is said at this address, as a zenoh key expression.
    pub fn everything(&self) -> String {
        format!("{ROOT}/{}/{}/**", self.site, self.telescope)
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
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

/// The states that an observatory node publishes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Part {
    /// The verdict and why.
    Safety,
    /// Who commands.
    Lease,
    /// Posture and what is being done.
    Night,
    /// The rows of the schedule and how far they are.
    Schedule,
    /// What needs a person.
    Alerts,
    /// Where the telescope looks, and what was learnt of it.
    Pointing,
    /// The guide loop.
    Guiding,
    /// The focus run.
    Focus,
    /// What people have ordered and what holds until it ends.
    Standing,
    /// What solved frames taught of the optics.
    Optics,
    /// What focus runs taught.
    FocusLearnt,
}

impl Part {
    /// All parts.
    pub const ALL: [Self; 11] = [
        Self::Safety,
        Self::Lease,
        Self::Night,
        Self::Schedule,
        Self::Alerts,
        Self::Pointing,
        Self::Guiding,
        Self::Focus,
        Self::Standing,
        Self::Optics,
        Self::FocusLearnt,
    ];

    /// As it stands in a key.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Safety => "safety",
            Self::Lease => "lease",
            Self::Night => "night",
            Self::Schedule => "schedule",
            Self::Alerts => "alerts",
            Self::Pointing => "pointing",
            Self::Guiding => "guiding",
            Self::Focus => "focus",
            Self::Standing => "standing",
            Self::Optics => "optics",
            Self::FocusLearnt => "focus-learnt",
        }
    }
}

/// What a node says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum NodeTopic {
    /// Health.
    State,
    /// Its own alerts.
    Alerts,
    /// Log lines.
    Diary,
    /// Who ordered and moved what.
    Audit,
    /// Question and answer about its audit (queryable).
    AuditSince,
    /// Liveliness token.
    Alive,
}

impl NodeTopic {
    /// All topics.
    pub const ALL: [Self; 6] = [Self::State, Self::Alerts, Self::Diary, Self::Audit, Self::AuditSince, Self::Alive];

    /// As it stands in a key.
    pub const fn word(self) -> &'static str {
        match self {
            Self::State => "state",
            Self::Alerts => "alerts",
            Self::Diary => "diary",
            Self::Audit => "audit",
            Self::AuditSince => "audit-since",
            Self::Alive => "alive",
        }
    }
}

/// A key of the tree; `Display` writes it, [`Key::parse`] reads it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Key {
    /// What a device can do.
    Capabilities(Device),
    /// What is true of a device now.
    State(Device),
    /// Asks a device to do something (queryable).
    Command(Device),
    /// A camera has a frame ready.
    Frame(Device),
    /// A dome's guard speaks.
    Guard(Device),
    /// Question and answer about what a weather station or a set of switches said before (queryable).
    Record(Device),
    /// A state of the observatory node.
    Observatory(Address, Part),
    /// May this dome be open?
    Permit(Address, Name),
    /// What was measured on a frame.
    Facts(Address, Name),
    /// What guiding did about a frame.
    Correction(Address),
    /// Where the stars of a field stood that guiding holds.
    GuideReference(Address),
    /// A focus run has ended.
    FocusRun(Address),
    /// A person's order (queryable).
    Order(Address),
    /// Question and answer about the actions that a schedule may ask for (queryable).
    Actions(Address),
    /// What is wrong with a schedule? (queryable)
    ScheduleCheck(Address),
    /// A file is safe on the archive's disk.
    Stored(Address),
    /// Question and answer about the past (queryable).
    History(Address),
    /// A node speaks of itself.
    Node(Address, Role, Name, NodeTopic),
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let device = |f: &mut fmt::Formatter<'_>, d: &Device, word: &str| {
            write!(f, "{ROOT}/{}/device/{}/{}/{word}", d.address, d.kind, d.name)
        };
        match self {
            Self::Capabilities(d) => device(f, d, "capabilities"),
            Self::State(d) => device(f, d, "state"),
            Self::Command(d) => device(f, d, "command"),
            Self::Frame(d) => device(f, d, "frame"),
            Self::Guard(d) => device(f, d, "guard"),
            Self::Record(d) => device(f, d, "record"),
            Self::Observatory(a, part) => write!(f, "{ROOT}/{a}/observatory/{}/state", part.word()),
            Self::Permit(a, dome) => write!(f, "{ROOT}/{a}/observatory/permit/{dome}"),
            Self::Correction(a) => write!(f, "{ROOT}/{a}/observatory/guiding/correction"),
            Self::Facts(a, frame) => write!(f, "{ROOT}/{a}/observatory/frame/{frame}/facts"),
            Self::GuideReference(a) => write!(f, "{ROOT}/{a}/observatory/guiding/reference"),
            Self::FocusRun(a) => write!(f, "{ROOT}/{a}/observatory/focus/run"),
            Self::Order(a) => write!(f, "{ROOT}/{a}/observatory/order"),
            Self::Actions(a) => write!(f, "{ROOT}/{a}/observatory/actions"),
            Self::ScheduleCheck(a) => write!(f, "{ROOT}/{a}/observatory/schedule/check"),
            Self::Stored(a) => write!(f, "{ROOT}/{a}/archive/stored"),
            Self::History(a) => write!(f, "{ROOT}/{a}/archive/history"),
            Self::Node(a, role, id, topic) => write!(f, "{ROOT}/{a}/node/{role}/{id}/{}", topic.word()),
        }
    }
}

impl Key {
    /// The address that the key lies under.
    pub fn address(&self) -> &Address {
        match self {
            Self::Capabilities(d)
            | Self::State(d)
            | Self::Command(d)
            | Self::Frame(d)
            | Self::Guard(d)
            | Self::Record(d) => &d.address,
            Self::Observatory(a, _)
            | Self::Permit(a, _)
            | Self::Facts(a, _)
            | Self::Correction(a)
            | Self::GuideReference(a)
            | Self::FocusRun(a)
            | Self::Order(a)
            | Self::Actions(a)
            | Self::ScheduleCheck(a)
            | Self::Stored(a)
            | Self::History(a)
            | Self::Node(a, ..) => a,
        }
    }

    /// Reads a key as it came from the bus; `None` for keys that are not of this version of the contract.
    pub fn parse(text: &str) -> Option<Self> {
        let chunks: Vec<&str> = text.strip_prefix(ROOT)?.strip_prefix('/')?.split('/').collect();
        let [site, telescope, rest @ ..] = chunks.as_slice() else { return None };
        let address = Address::new(site, telescope).ok()?;
        match rest {
            ["device", kind, name, word] => {
                let device = Device { address, kind: kind.parse().ok()?, name: name.parse().ok()? };
                match *word {
                    "capabilities" => Some(Self::Capabilities(device)),
                    "state" => Some(Self::State(device)),
                    "command" => Some(Self::Command(device)),
                    "frame" if device.kind == Kind::Camera => Some(Self::Frame(device)),
                    "guard" if device.kind == Kind::Dome => Some(Self::Guard(device)),
                    "record" if device.kind.keeps_record() => Some(Self::Record(device)),
                    _ => None,
                }
            }
            ["observatory", "permit", dome] => Some(Self::Permit(address, dome.parse().ok()?)),
            ["observatory", "frame", id, "facts"] => Some(Self::Facts(address, id.parse().ok()?)),
            ["observatory", "guiding", "correction"] => Some(Self::Correction(address)),
            ["observatory", "guiding", "reference"] => Some(Self::GuideReference(address)),
            ["observatory", "focus", "run"] => Some(Self::FocusRun(address)),
            ["observatory", "order"] => Some(Self::Order(address)),
            ["observatory", "actions"] => Some(Self::Actions(address)),
            ["observatory", "schedule", "check"] => Some(Self::ScheduleCheck(address)),
            ["observatory", part, "state"] => {
                Part::ALL.into_iter().find(|p| p.word() == *part).map(|part| Self::Observatory(address, part))
            }
            ["archive", "stored"] => Some(Self::Stored(address)),
            ["archive", "history"] => Some(Self::History(address)),
            ["node", role, id, topic] => {
                let role = Role::ALL.into_iter().find(|r| r.word() == *role)?;
                let topic = NodeTopic::ALL.into_iter().find(|t| t.word() == *topic)?;
                Some(Self::Node(address, role, id.parse().ok()?, topic))
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_reads_back_as_itself() {
        let address = Address::new("paranal", "callisto").unwrap();
        let name: Name = "dome_1".parse().unwrap();
        let mut keys = vec![
            Key::Permit(address.clone(), name.clone()),
            Key::Facts(address.clone(), name.clone()),
            Key::Correction(address.clone()),
            Key::GuideReference(address.clone()),
            Key::FocusRun(address.clone()),
            Key::Order(address.clone()),
            Key::Actions(address.clone()),
            Key::ScheduleCheck(address.clone()),
            Key::Stored(address.clone()),
            Key::History(address.clone()),
            Key::Frame(address.device(Kind::Camera, &name)),
            Key::Guard(address.device(Kind::Dome, &name)),
            Key::Record(address.device(Kind::ObservingConditions, &name)),
            Key::Record(address.device(Kind::Switch, &name)),
        ];
        for kind in Kind::ALL {
            let device = address.device(kind, &name);
            keys.extend([Key::Capabilities(device.clone()), Key::State(device.clone()), Key::Command(device)]);
        }
        keys.extend(Part::ALL.map(|part| Key::Observatory(address.clone(), part)));
        for role in Role::ALL {
            keys.extend(NodeTopic::ALL.map(|topic| Key::Node(address.clone(), role, name.clone(), topic)));
        }
        for key in keys {
            assert_eq!(Key::parse(&key.to_string()), Some(key.clone()), "{key}");
        }
    }

    #[test]
    fn foreign_keys_are_no_keys() {
        for text in ["", "starmesh/v2/a/b/archive/stored", "starmesh/v1/A/b/archive/stored", "starmesh/v1/a/b/x"] {
            assert_eq!(Key::parse(text), None, "{text}");
        }
    }

    #[test]
    fn names_that_would_break_a_key_are_refused() {
        for text in ["", "a/b", "@x", "a*", "a b", "-x", "ä"] {
            assert!(text.parse::<Name>().is_err(), "{text}");
        }
        assert!("Alpha".parse::<Chunk>().is_err());
    }
}
