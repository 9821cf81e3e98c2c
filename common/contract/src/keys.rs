//! Sets of keys of one topic, as zenoh key expressions.

use std::fmt;

use crate::row::Piece;
use crate::{Address, Chunk, Device, Kind, Name, Role};

/// First chunks of every key.
pub(crate) const ROOT: &str = "starmesh/v1";

/// The key expression of everything on the bus, whatever its version.
pub const EVERYTHING: &str = "starmesh/**";

/// The keys of one topic; whatever is not chosen is a wildcard. `Display` writes the key expression.
#[derive(Debug, Clone, Copy)]
pub struct Keys<'a> {
    pieces: &'static [Piece],
    site: Option<&'a Chunk>,
    telescope: Option<&'a Chunk>,
    kind: Option<Kind>,
    name: Option<&'a Name>,
    role: Option<Role>,
    every_part: bool,
}

impl<'a> Keys<'a> {
    pub(crate) fn of(pieces: &'static [Piece]) -> Self {
        Self { pieces, site: None, telescope: None, kind: None, name: None, role: None, every_part: false }
    }

    /// Those of one site.
    pub fn on_site(self, site: &'a Chunk) -> Self {
        Self { site: Some(site), ..self }
    }

    /// Those of one telescope.
    pub fn at(self, address: &'a Address) -> Self {
        Self { site: Some(&address.site), telescope: Some(&address.telescope), ..self }
    }

    /// Those of one kind of device.
    pub fn of_kind(self, kind: Kind) -> Self {
        Self { kind: Some(kind), ..self }
    }

    /// Those with this name of a device, node or frame.
    pub fn named(self, name: &'a Name) -> Self {
        Self { name: Some(name), ..self }
    }

    /// Those of the nodes of one role.
    pub fn of_role(self, role: Role) -> Self {
        Self { role: Some(role), ..self }
    }

    /// Those of all parts of the observatory node.
    pub(crate) fn of_every_part(self) -> Self {
        Self { every_part: true, ..self }
    }

    pub(crate) fn of_device(self, device: &'a Device) -> Self {
        self.at(&device.address).of_kind(device.kind).named(&device.name)
    }

    /// The key expression without its first chunks, which name the version of the contract.
    pub(crate) fn path(&self) -> String {
        let any = |chunk: Option<&str>| chunk.unwrap_or("*").to_owned();
        let mut path = any(self.site.map(Chunk::as_str)) + "/" + &any(self.telescope.map(Chunk::as_str));
        for piece in self.pieces {
            path.push('/');
            path.push_str(match piece {
                Piece::Part(_) if self.every_part => "*",
                Piece::Word(word) | Piece::Part(word) => word,
                Piece::Kind([only]) => only.word(),
                Piece::Kind(_) => self.kind.map_or("*", Kind::word),
                Piece::Name(_) => self.name.map_or("*", Name::as_str),
                Piece::Role => self.role.map_or("*", Role::word),
            });
        }
        path
    }
}

impl fmt::Display for Keys<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{ROOT}/{}", self.path())
    }
}
