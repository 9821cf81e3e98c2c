//! The text of keys: written from the pieces that the table declares, and read back by them.

use std::fmt;

use crate::keys::ROOT;
use crate::row::Piece;
use crate::table::{Key, Topic};
use crate::{Address, Kind, Name, Role};

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.alone().fmt(f)
    }
}

impl Key {
    /// The key without its first chunks, which name the version of the contract.
    pub fn path(&self) -> String {
        self.alone().path()
    }

    /// Reads a key as it came from the bus; `None` for keys that are not of this version of the contract.
    pub fn parse(text: &str) -> Option<Self> {
        Self::from_path(text.strip_prefix(ROOT)?.strip_prefix('/')?)
    }

    /// Reads what [`Self::path`] wrote.
    pub fn from_path(path: &str) -> Option<Self> {
        let chunks: Vec<&str> = path.split('/').collect();
        let [site, telescope, chunks @ ..] = chunks.as_slice() else { return None };
        let address = Address::new(site, telescope).ok()?;
        Topic::ALL.iter().find_map(|topic| read(*topic, &address, chunks))
    }
}

/// The key of this topic with these chunks after its address.
fn read(topic: Topic, address: &Address, chunks: &[&str]) -> Option<Key> {
    let pieces = topic.row().pieces;
    if pieces.len() != chunks.len() {
        return None;
    }
    let (mut kind, mut name, mut role) = (None, None, None);
    for (piece, chunk) in pieces.iter().zip(chunks) {
        match piece {
            Piece::Word(word) | Piece::Part(word) if word == chunk => {}
            Piece::Word(_) | Piece::Part(_) => return None,
            Piece::Kind(kinds) => kind = Some(chunk.parse::<Kind>().ok().filter(|kind| kinds.contains(kind))?),
            Piece::Name(_) => name = Some(chunk.parse::<Name>().ok()?),
            Piece::Role => role = Some(Role::ALL.into_iter().find(|role| role.word() == *chunk)?),
        }
    }
    topic.key(address.clone(), kind, name, role)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BadKey, Keys, NodeTopic, Part};

    fn address() -> Address {
        Address::new("paranal", "callisto").unwrap()
    }

    /// The keys of a topic, of each kind and each role.
    fn keys_of(topic: Topic) -> Vec<Key> {
        let name: Name = "dome_1".parse().unwrap();
        let kinds: Vec<Kind> = if topic.kinds().is_empty() { vec![Kind::Dome] } else { topic.kinds().to_vec() };
        let each = |(kind, role)| topic.key(address(), Some(kind), Some(name.clone()), Some(role)).unwrap();
        let mut keys: Vec<Key> = kinds.iter().flat_map(|kind| Role::ALL.map(|role| each((*kind, role)))).collect();
        keys.dedup();
        keys
    }

    fn every_key() -> Vec<Key> {
        Topic::ALL.iter().flat_map(|topic| keys_of(*topic)).collect()
    }

    /// Is the key in the set, by zenoh's rules for one `*` per chunk?
    fn is_in(key: &Key, keys: Keys<'_>) -> bool {
        let (key, keys) = (key.to_string(), keys.to_string());
        key.split('/').count() == keys.split('/').count()
            && key.split('/').zip(keys.split('/')).all(|(chunk, word)| word == "*" || word == chunk)
    }

    #[test]
    fn every_key_has_exactly_one_row() {
        for key in every_key() {
            let rows: Vec<_> = Topic::ALL.iter().filter(|topic| is_in(&key, topic.everywhere())).collect();
            assert_eq!(rows, [&key.topic()], "{key}");
            let read: Vec<_> =
                Topic::ALL.iter().filter_map(|topic| read(*topic, &address(), &chunks(&key.path()))).collect();
            assert_eq!(read, [key]);
        }
    }

    fn chunks(path: &str) -> Vec<&str> {
        path.split('/').skip(2).collect()
    }

    #[test]
    fn every_key_reads_back_as_itself() {
        for key in every_key() {
            assert_eq!(Key::parse(&key.to_string()), Some(key.clone()), "{key}");
            assert_eq!(Key::from_path(&key.path()), Some(key.clone()), "{key}");
            assert_eq!(key.address(), &address());
        }
    }

    #[test]
    fn foreign_keys_are_no_keys() {
        for text in [
            "",
            "starmesh/v1",
            "starmesh/v2/a/b/archive/stored",
            "starmesh/v1/A/b/archive/stored",
            "starmesh/v1/a/b/x",
            "starmesh/v1/a/b/archive/stored/x",
            "starmesh/v1/a/b/device/dome/d/frame",
            "starmesh/v1/a/b/device/camera/d/guard",
            "starmesh/v1/a/b/device/dome/d/record",
            "starmesh/v1/a/b/node/king/main/state",
            "starmesh/v1/a/b/observatory/*/state",
        ] {
            assert_eq!(Key::parse(text), None, "{text}");
        }
    }

    #[test]
    fn a_subscriber_gets_the_keys_that_it_chose_and_no_others() -> Result<(), BadKey> {
        let (own, sister) = (address(), Address::new("paranal", "io")?);
        let (main, dome): (Name, Name) = ("main".parse()?, "dome".parse()?);
        let site = own.site.clone();
        for (keys, text) in [
            (Topic::Guard.on_site(&site), "starmesh/v1/paranal/*/device/dome/*/guard"),
            (Topic::State.on_site(&site).of_kind(Kind::Telescope), "starmesh/v1/paranal/*/device/telescope/*/state"),
            (Topic::Frame.at(&own), "starmesh/v1/paranal/callisto/device/camera/*/frame"),
            (Topic::Facts.at(&sister), "starmesh/v1/paranal/io/observatory/frame/*/facts"),
            (Topic::Permit.on_site(&site).named(&dome), "starmesh/v1/paranal/*/observatory/permit/dome"),
            (Topic::Observatory(Part::Lease).everywhere(), "starmesh/v1/*/*/observatory/lease/state"),
            (Topic::every_part(), "starmesh/v1/*/*/observatory/*/state"),
            (Topic::Node(NodeTopic::State).everywhere(), "starmesh/v1/*/*/node/*/*/state"),
            (
                Topic::Node(NodeTopic::State).at(&own).of_role(Role::Archive),
                "starmesh/v1/paranal/callisto/node/archive/*/state",
            ),
            (
                Topic::Node(NodeTopic::Diary).at(&own).of_role(Role::Web).named(&main),
                "starmesh/v1/paranal/callisto/node/web/main/diary",
            ),
        ] {
            assert_eq!(keys.to_string(), text);
        }
        for topic in Topic::ALL {
            assert!(keys_of(*topic).iter().all(|key| is_in(key, topic.at(&own)) && !is_in(key, topic.at(&sister))));
        }
        Ok(())
    }
}
