//! Reads the file of a schedule.

use std::io::{self, Read as _};
use std::path::Path;

use crate::parse::MOST_BYTES;

/// A text of at most [`MOST_BYTES`] bytes, whatever the file contains, and also if it changes meanwhile.
pub fn read_text(path: &Path) -> io::Result<String> {
    let mut bytes = Vec::new();
    std::fs::File::open(path)?.take(MOST_BYTES as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > MOST_BYTES {
        return Err(io::Error::other(format!("more than {MOST_BYTES} bytes, which no schedule has")));
    }
    config::utf8(bytes).map_err(io::Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_of_a_file_is_read_than_a_schedule_may_have() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("schedule.jsonl");
        std::fs::write(&path, " ".repeat(5_000_001)).unwrap();
        assert!(read_text(&path).unwrap_err().to_string().contains("more than 5000000 bytes"));
        std::fs::write(&path, b"{\"object\": \"\xff\"}").unwrap();
        assert!(read_text(&path).unwrap_err().to_string().contains("not UTF-8"));
        // A file that never ends.
        #[cfg(unix)]
        assert!(read_text(Path::new("/dev/zero")).unwrap_err().to_string().contains("more than"));
    }
}
