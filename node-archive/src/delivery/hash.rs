//! The hash of a file, read from its disk.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use sha2::{Digest as _, Sha256};

use super::manifest::Held;

/// Bytes that are hashed in one go.
const CHUNK: usize = 1 << 20;

/// Reads a file to its end. Blocks.
pub fn hash_file(path: &Path) -> io::Result<Held> {
    hash(&mut File::open(path)?)
}

/// Reads a file to its end from the disk itself, as far as the system lets go of what it has in memory. Blocks.
pub fn hash_from_disk(path: &Path) -> io::Result<Held> {
    let mut file = File::open(path)?;
    #[cfg(target_os = "linux")]
    {
        let _ = file.sync_all();
        let _ = rustix::fs::fadvise(&file, 0, None, rustix::fs::Advice::DontNeed);
    }
    hash(&mut file)
}

/// Reads to the end.
pub fn hash(from: &mut impl Read) -> io::Result<Held> {
    let (mut hasher, mut chunk, mut bytes) = (Sha256::new(), vec![0; CHUNK], 0);
    loop {
        let read = match from.read(&mut chunk) {
            Ok(0) => break,
            Ok(read) => read,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        hasher.update(&chunk[..read]);
        bytes += read as u64;
    }
    Ok(Held { bytes, sha256: hex(&hasher.finalize()) })
}

/// Bytes as hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
