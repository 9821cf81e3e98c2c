//! One observatory of the predecessor becomes one file per telescope, and one for the shared devices.

use std::collections::{BTreeMap, BTreeSet};

use contract::{Address, Kind};

use super::block::{Block, GuideStart, chunk};
use super::entry::Notes;

/// The content of one `observatory.toml`.
#[derive(Debug, Clone, Default)]
pub struct File {
    /// Telescope's name in the key tree, or `shared`.
    pub telescope: String,
    /// Its devices, in the order of the old file.
    pub blocks: Vec<Block>,
    /// Names of the shared devices that apply to it, by kind.
    pub shared: BTreeMap<Kind, Vec<String>>,
    /// Limits on the shared weather.
    pub limits: Vec<String>,
    /// Dwell of the shared safety monitors, min.
    pub dwell_min: Option<f64>,
}

impl File {
    /// The old names of the cameras in it.
    pub fn cameras(&self) -> impl Iterator<Item = &Block> {
        self.blocks.iter().filter(|block| block.kind == Kind::Camera)
    }
}

/// Kinds that several telescopes may share here.
const SHARED: [Kind; 3] = [Kind::SafetyMonitor, Kind::ObservingConditions, Kind::Dome];

/// Distributes the devices of a site; the file of the shared devices, where there is one, comes last.
pub fn distribute(blocks: Vec<Block>, site: &str, notes: &mut Notes) -> Vec<File> {
    let mounts: Vec<&Block> = blocks.iter().filter(|block| block.kind == Kind::Telescope).collect();
    if mounts.len() < 2 {
        let telescope = chunk(mounts.first().map_or(site, |mount| &mount.old_name));
        return vec![File { telescope: free(telescope, &[]), blocks, ..File::default() }];
    }
    let mut files: Vec<File> = Vec::new();
    let mut place_of: BTreeMap<String, usize> = BTreeMap::new();
    for (index, mount) in mounts.iter().enumerate() {
        place_of.insert(mount.old_name.clone(), index);
        let telescope = free(chunk(&mount.old_name), &files);
        files.push(File { telescope, ..File::default() });
    }
    let owners = owners(&blocks, &place_of);
    let mut shared = File { telescope: Address::SHARED.to_owned(), ..File::default() };
    for (block, owners) in blocks.into_iter().zip(owners) {
        let is_weather = matches!(block.kind, Kind::SafetyMonitor | Kind::ObservingConditions);
        if is_weather || (SHARED.contains(&block.kind) && owners.len() > 1) {
            share(block, &owners, &mut files, &mut shared);
            continue;
        }
        let place = format!("{} {}", block.kind.ascom(), block.old_name);
        let telescope = owners.first().copied().unwrap_or(0);
        if owners.len() != 1 {
            let why = match owners.len() {
                0 => "belongs to no telescope",
                _ => {
                    "belongs to several telescopes, which is possible here for domes, weather and safety monitors only"
                }
            };
            notes
                .add(block.line, format!("{place}: {why}; it was put into the file of {}", files[telescope].telescope));
        }
        files[telescope].blocks.push(block);
    }
    if !shared.blocks.is_empty() {
        files.push(shared);
    }
    files
}

/// Gives the pulse calibration of a mount to the one camera that it guides; the predecessor stored it by mount.
pub fn give_calibrations(blocks: &mut [Block], notes: &mut Notes) {
    let mounts: Vec<(String, GuideStart)> = blocks
        .iter_mut()
        .filter_map(|block| block.guide_start.take().map(|start| (block.old_name.clone(), start)))
        .collect();
    for (mount, start) in mounts {
        let is_on = |block: &Block| block.kind == Kind::Camera && block.pairs.get(&Kind::Telescope) == Some(&mount);
        let cameras = blocks.iter().filter(|block| is_on(block)).count();
        match blocks.iter_mut().find(|block| is_on(block)) {
            Some(camera) if cameras == 1 => {
                let from = "PIX2TIME and DIRECTIONS, until pulses or a solved frame give better values";
                camera.lines.of(start.line).key("guide_calibration", start.text, from);
            }
            _ => notes.add(
                start.line,
                format!(
                    "Telescope {mount}: guider: {cameras} cameras are paired with it, and nothing names the one whose stars PIX2TIME is of; \
                     not carried over"
                ),
            ),
        }
    }
}

/// Puts a device into the shared file, and its name into the files of the telescopes that use it.
fn share(mut block: Block, owners: &BTreeSet<usize>, files: &mut [File], shared: &mut File) {
    // Weather and monitors apply to all: the predecessor had one verdict per observatory.
    let of_all = block.kind != Kind::Dome;
    let limits: Vec<String> = std::mem::take(&mut block.limits).into_iter().map(|(_, limit)| limit).collect();
    let dwell_min = block.dwell_min.take();
    let under = |index: &usize| of_all || owners.contains(index);
    let mut chunks = Vec::new();
    for (_, file) in files.iter_mut().enumerate().filter(|(index, _)| under(index)) {
        file.shared.entry(block.kind).or_default().push(block.name.clone());
        let new: Vec<String> = limits.iter().filter(|limit| !file.limits.contains(limit)).cloned().collect();
        file.limits.extend(new);
        file.dwell_min = file.dwell_min.into_iter().chain(dwell_min).reduce(f64::max);
        chunks.push(file.telescope.clone());
    }
    if block.kind == Kind::Dome {
        // When one telescope closes, the dome over others does not turn.
        block.lines.without(super::devices::PARK_AT_CLOSE);
        super::devices::telescopes_under(&mut block.lines, &chunks);
    }
    shared.blocks.push(block);
}

/// The telescopes that each device works with, as indices.
fn owners(blocks: &[Block], place_of: &BTreeMap<String, usize>) -> Vec<BTreeSet<usize>> {
    let telescope_of = |camera: &Block| camera.pairs.get(&Kind::Telescope).and_then(|name| place_of.get(name)).copied();
    let of = |block: &Block| -> BTreeSet<usize> {
        match block.kind {
            Kind::Telescope => place_of.get(&block.old_name).copied().into_iter().collect(),
            Kind::Camera => telescope_of(block).into_iter().collect(),
            kind => {
                let cameras = blocks.iter().filter(|other| other.pairs.get(&kind) == Some(&block.old_name));
                let under = block.telescopes.iter().filter_map(|name| place_of.get(name)).copied();
                cameras.filter_map(telescope_of).chain(under).collect()
            }
        }
    };
    blocks.iter().map(of).collect()
}

/// A name that no other file has.
fn free(wanted: String, files: &[File]) -> String {
    let taken = |name: &str| name == Address::SHARED || files.iter().any(|file| file.telescope == name);
    let names = std::iter::once(wanted.clone()).chain((2..).map(|n| format!("{wanted}-{n}")));
    names.into_iter().find(|name| !taken(name)).unwrap_or(wanted)
}
