//! The configuration that `--force` replaces: what a person named in it stays, and what does not stay is said.

use std::collections::BTreeMap;
use std::path::Path;

use alpaca::discovery::Found;
use contract::{Address, Kind, Name};

/// What an earlier file has that the new one may lack.
#[derive(Debug, Default)]
pub struct Before {
    address: Option<Address>,
    /// The names of its devices, by kind, server and number.
    names: BTreeMap<(Kind, String, u32), Name>,
    /// Why it could not be read.
    unread: Option<String>,
}

impl Before {
    /// Reads a file; nothing where there is none.
    pub fn read(path: &Path) -> Self {
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Self::default(),
            Err(error) => return Self { unread: Some(error.to_string()), ..Self::default() },
        };
        match config::parse(&text, path.parent().unwrap_or(path)) {
            Ok(config) => {
                let key = |(kind, common): &(Kind, &config::Common)| (*kind, common.server.clone(), common.number);
                let devices = config.devices();
                let names = devices.iter().map(|device| (key(device), device.1.name.clone())).collect();
                Self { address: Some(config.address()), names, unread: None }
            }
            Err(error) => Self { unread: Some(error.to_string()), ..Self::default() },
        }
    }

    /// The block of a device with the name that it had.
    pub fn named(&self, device: &Found, block: String) -> String {
        let Some(name) = self.names.get(&(device.kind, device.server.clone(), device.number)) else { return block };
        let renamed = |line: &str| match line.starts_with("name = ") {
            true => format!("name = \"{name}\"\n"),
            false => format!("{line}\n"),
        };
        block.lines().map(renamed).collect()
    }

    /// For a person: what the new file has not of this one, which is called `aside` now.
    pub fn lost(&self, new: &config::Observatory, aside: &Path) -> Vec<String> {
        let aside = aside.display();
        if let Some(why) = &self.unread {
            let why = why.lines().next().unwrap_or_default();
            return vec![format!("{aside} cannot be read ({why}): copy the names that were given there")];
        }
        let of = |(kind, common): &(Kind, &config::Common)| (*kind, common.server.clone(), common.number);
        let there: Vec<(Kind, String, u32)> = new.devices().iter().map(of).collect();
        let other = self.address.as_ref().filter(|before| **before != new.address());
        let renamed = other.map(|before| {
            format!("the telescope is {} now, and was {before}: --site and --telescope name it", new.address())
        });
        let gone = self.names.iter().filter(|(device, _)| !there.contains(device));
        let gone = gone.map(|((kind, server, number), name)| {
            format!("{kind} \"{name}\" ({server} number {number}) is not in use in the new file")
        });
        let all = format!("limits and all else that was written into {aside} are not taken over: copy what is needed");
        renamed.into_iter().chain(gone).chain([all]).collect()
    }
}
