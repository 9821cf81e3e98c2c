//! The last-good copy: what the guard process needs to close an enclosure, as it was when everything last worked.

use std::collections::BTreeMap;
use std::time::Duration;

use config::{CloseWithMount, Observatory};
use contract::{Chunk, Kind, Name};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

/// The form of the file; another one is not read.
const FORM: u32 = 1;
/// A larger file is no copy.
pub const MOST_BYTES: u64 = 1 << 20;

/// One Alpaca device.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// `host:port`.
    pub server: String,
    /// Device number.
    pub number: u32,
    /// False: never send Connected = true.
    pub connect: bool,
}

/// What is needed to close one dome.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DomeCopy {
    /// Its name.
    pub name: Name,
    /// Where it answers.
    pub target: Target,
    /// Must the mount be parked before the shutter moves?
    pub policy: CloseWithMount,
    /// How long to wait for that, s.
    pub parked_within_s: f64,
    /// How long a permit lasts, s.
    pub permit_valid_s: f64,
    /// A shutter that moves longer is stuck, s.
    pub travel_timeout_s: f64,
    /// Telescopes under it.
    pub telescopes: Vec<Chunk>,
    /// Mounts under it, as far as the same file names them.
    pub mounts: Vec<Target>,
}

/// The copy of one device node that serves enclosures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Copy {
    /// The site.
    pub site: Chunk,
    /// The telescope.
    pub telescope: Chunk,
    /// The domes of the node.
    pub domes: Vec<DomeCopy>,
    /// Domes that the configuration does not name any more, at their old addresses, until they are let go.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub leaving: Vec<DomeCopy>,
    /// Peers on the bus, for alerts.
    pub connect: Vec<String>,
    /// Whether peers are looked for by multicast.
    pub multicast: bool,
    /// The highest token known of each telescope.
    pub tokens: BTreeMap<String, u64>,
}

/// A file: the copy as text, with what proves that it is whole.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sealed {
    form: u32,
    /// Counts up with each writing, so that the newest of several is known without a clock.
    number: u64,
    sha256: String,
    copy: String,
}

impl Copy {
    /// What a configuration contains of the domes of a node; none where it serves none.
    pub fn of(config: &Observatory, id: &str) -> Option<Self> {
        let domes: Vec<DomeCopy> = config
            .dome
            .iter()
            .filter(|dome| dome.common.node_id(Kind::Dome) == id)
            .map(|dome| DomeCopy {
                name: dome.common.name.clone(),
                target: target(&dome.common),
                policy: dome.close_with_mount,
                parked_within_s: dome.parked_within_s,
                permit_valid_s: dome.permit_valid_s,
                travel_timeout_s: dome.travel_timeout_s,
                telescopes: match dome.telescopes.as_slice() {
                    [] => vec![config.place.telescope.clone()],
                    several => several.to_vec(),
                },
                mounts: config.telescope.iter().map(|mount| target(&mount.common)).collect(),
            })
            .collect();
        (!domes.is_empty()).then(|| Self {
            site: config.place.site.clone(),
            telescope: config.place.telescope.clone(),
            domes,
            leaving: Vec::new(),
            connect: config.bus.meeting_points(),
            multicast: config.bus.multicast,
            tokens: BTreeMap::new(),
        })
    }

    /// Takes the tokens that the device node reports. One that has lost its file reports lower ones until its next grant.
    pub fn raise_tokens(&mut self, reported: BTreeMap<String, u64>) {
        for (telescope, token) in reported {
            let known = self.tokens.entry(telescope).or_default();
            *known = token.max(*known);
        }
    }

    /// Whether both close the same domes in the same way; tokens and the bus do not matter for that.
    pub fn closes_as(&self, other: &Self) -> bool {
        self.domes == other.domes
    }

    /// The names of the domes that are at the same address in the other copy.
    pub fn at_the_same_server(&self, other: &Self) -> Vec<String> {
        let is_known = |dome: &&DomeCopy| other.domes.iter().any(|o| o.name == dome.name && o.target == dome.target);
        self.domes.iter().filter(is_known).map(|dome| dome.name.to_string()).collect()
    }

    /// The bytes of a file.
    pub fn sealed(&self, number: u64) -> Option<Vec<u8>> {
        let copy = serde_json::to_string(self).ok()?;
        let sealed = Sealed { form: FORM, number, sha256: proof(number, &copy), copy };
        serde_json::to_vec(&sealed).ok()
    }

    /// Reads the bytes of a file; none where they are not whole or contain nothing that could close a dome.
    pub fn unsealed(bytes: &[u8]) -> Option<(u64, Self)> {
        let sealed: Sealed = serde_json::from_slice(bytes).ok()?;
        if sealed.form != FORM || sealed.sha256 != proof(sealed.number, &sealed.copy) {
            return None;
        }
        let copy = serde_json::from_str::<Self>(&sealed.copy);
        // Whole, and written by another version: nobody may take that for a file that is not there.
        let copy = copy.inspect_err(|error| tracing::error!(%error, "the guard's copy on disk cannot be used")).ok()?;
        let sane = |dome: &DomeCopy| {
            let all = [dome.parked_within_s, dome.permit_valid_s, dome.travel_timeout_s];
            all.iter().all(|seconds| seconds.is_finite() && *seconds >= 0.0) && !dome.target.server.is_empty()
        };
        (!copy.domes.is_empty() && copy.domes.iter().chain(&copy.leaving).all(sane)).then_some((sealed.number, copy))
    }
}

impl DomeCopy {
    /// How long a permit lasts.
    pub fn permit_valid(&self) -> Duration {
        seconds(self.permit_valid_s)
    }
}

/// A duration of the configuration; at most a day.
pub fn seconds(s: f64) -> Duration {
    Duration::from_secs_f64(s.clamp(0.0, 86_400.0))
}

fn target(common: &config::Common) -> Target {
    Target { server: common.server.clone(), number: common.number, connect: common.connect }
}

fn proof(number: u64, copy: &str) -> String {
    let hash = Sha256::digest(format!("{FORM} {number} {copy}").as_bytes());
    hash.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A copy of one dome.
    pub fn copy() -> Copy {
        let text = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0.0\nlongitude_deg = 0.0\nelevation_m = 0.0\n\
                    [[telescope]]\nname = \"m\"\nserver = \"h:2\"\n\
                    [[dome]]\nname = \"d\"\nserver = \"h:1\"\nnumber = 3\nclose_with_mount = \"parked_only\"\n";
        Copy::of(&config::parse(text, std::path::Path::new(".")).unwrap(), "enclosure").unwrap()
    }

    #[test]
    fn a_copy_is_read_back_as_it_was_written() {
        let copy = copy();
        assert_eq!((copy.domes[0].target.number, copy.domes[0].mounts.len()), (3, 1));
        assert_eq!(Copy::unsealed(&copy.sealed(7).unwrap()), Some((7, copy)));
    }

    #[test]
    fn a_copy_keeps_the_highest_token_of_each_telescope() {
        let mut copy = copy();
        for (reported, known) in [(0, 0), (41, 41), (0, 41), (42, 42)] {
            copy.raise_tokens(BTreeMap::from([("t".to_owned(), reported)]));
            assert_eq!(copy.tokens["t"], known);
        }
    }

    #[test]
    fn a_copy_knows_the_dome_of_today_and_the_one_that_is_not_let_go_yet() {
        let mut now = copy();
        let mut before = now.domes[0].clone();
        before.target.server = "old:1".to_owned();
        now.leaving = vec![before];
        assert_eq!(Copy::unsealed(&now.sealed(8).unwrap()), Some((8, now.clone())));
        // A copy of a version that knew no such domes.
        let text = String::from_utf8(copy().sealed(7).unwrap()).unwrap();
        assert!(!text.contains("leaving") && Copy::unsealed(text.as_bytes()).is_some());
    }

    #[test]
    fn a_copy_that_was_cut_or_changed_anywhere_is_none() {
        let bytes = copy().sealed(7).unwrap();
        for length in 0..bytes.len() {
            assert_eq!(Copy::unsealed(&bytes[..length]), None, "{length} bytes of it");
        }
        for at in 0..bytes.len() {
            for bit in [1, 4, 32] {
                let mut spoilt = bytes.clone();
                spoilt[at] ^= bit;
                assert_eq!(Copy::unsealed(&spoilt), None, "byte {at}");
            }
        }
    }

    #[test]
    fn another_dome_of_the_file_is_another_nodes() {
        let text = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0.0\nlongitude_deg = 0.0\nelevation_m = 0.0\n\
                    [[dome]]\nname = \"d\"\nserver = \"h:1\"\n[[dome]]\nname = \"e\"\nserver = \"h:1\"\nnumber = 1\nnode = \"pc\"\n";
        let config = config::parse(text, std::path::Path::new(".")).unwrap();
        let names = |id| Copy::of(&config, id).map(|copy| copy.domes.iter().map(|d| d.name.to_string()).collect());
        let names: [Option<Vec<String>>; 3] = ["enclosure", "pc", "main"].map(names);
        assert_eq!(names, [Some(vec!["d".to_owned()]), Some(vec!["e".to_owned()]), None]);
    }
}
