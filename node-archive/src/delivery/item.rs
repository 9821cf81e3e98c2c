//! A file to be sent, and what all kinds of destinations report of one.

use std::collections::HashMap;
use std::net::{ToSocketAddrs as _, UdpSocket};
use std::path::PathBuf;

use super::manifest::Held;

/// A manifest of a night with 100,000 frames has about 60 MB; nothing larger is read whole.
pub const MOST_BYTES: u64 = 64 << 20;
/// Characters of another program's words that are quoted.
const QUOTED: usize = 300;

/// What is reported of a file that is no manifest.
pub fn too_large(name: &str) -> String {
    format!("{name} at the destination has more than {} MB, and is no manifest: move it away", MOST_BYTES >> 20)
}

/// The beginning of another program's words.
pub fn short_text(text: &str) -> String {
    match text.char_indices().nth(QUOTED) {
        Some((end, _)) => format!("{}...", text.get(..end).unwrap_or_default()),
        None => text.to_owned(),
    }
}

/// A file to be sent.
#[derive(Debug, Clone)]
pub struct Item {
    /// The file here; it does not change while it is sent, or the change is noticed.
    pub file: PathBuf,
    /// Its name there, relative to the destination's folder, with `/`.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// Its SHA-256.
    pub sha256: String,
}

/// What a destination has of some names; names that it does not have are absent.
pub type Holdings = HashMap<String, Held>;

/// Is this the name or address of a host that is this one?
pub fn is_this_machine(host: &str) -> bool {
    let addresses = (host, 0).to_socket_addrs().into_iter().flatten();
    // Only an own address can be bound.
    addresses.map(|address| address.ip()).any(|ip| ip.is_loopback() || UdpSocket::bind((ip, 0)).is_ok())
}

/// What is reported of a name that somebody else took while files were sent.
pub fn taken(name: &str) -> String {
    format!("{name} is at the destination with other bytes, and was not overwritten: move it away there")
}
