//! The old files as text, whatever encoding they were written in.

use std::io::Read as _;
use std::path::Path;

use anyhow::Context as _;

use super::entry::Notes;

/// No more of a file is read: the parser refuses a file that is so large.
const MOST_BYTES: u64 = 5_000_001;

/// Reads a file; one that is not UTF-8 is noted.
pub fn read(path: &Path, notes: &mut Notes) -> anyhow::Result<String> {
    let mut bytes = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(MOST_BYTES).read_to_end(&mut bytes));
    read.with_context(|| format!("cannot read {}", path.display()))?;
    let (text, other) = decoded(&bytes);
    if let Some(encoding) = other {
        notes.add(0, format!("{}: is no UTF-8; it was read as {encoding}", path.display()));
    }
    Ok(text)
}

/// The text without its byte order mark, and its encoding where that is not UTF-8.
fn decoded(bytes: &[u8]) -> (String, Option<&'static str>) {
    let utf16 = |bytes: &[u8], unit: fn([u8; 2]) -> u16| -> String {
        let (pairs, _) = bytes.as_chunks::<2>();
        char::decode_utf16(pairs.iter().map(|pair| unit(*pair))).map(|c| c.unwrap_or('\u{fffd}')).collect()
    };
    match bytes {
        [0xff, 0xfe, rest @ ..] => (utf16(rest, u16::from_le_bytes), Some("UTF-16")),
        [0xfe, 0xff, rest @ ..] => (utf16(rest, u16::from_be_bytes), Some("UTF-16")),
        [0xef, 0xbb, 0xbf, rest @ ..] => (utf8(rest).0, utf8(rest).1),
        _ => utf8(bytes),
    }
}

/// UTF-8, or else the Western European encoding of Windows, whose bytes are characters of the same number but for
/// quotes and dashes.
fn utf8(bytes: &[u8]) -> (String, Option<&'static str>) {
    match std::str::from_utf8(bytes) {
        Ok(text) => (text.to_owned(), None),
        Err(_) => (bytes.iter().map(|byte| char::from(*byte)).collect(), Some("Windows-1252")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_whatever_editor_wrote_it() {
        assert_eq!(decoded("\u{feff}a: 1 # \u{b0}C\n".as_bytes()), ("a: 1 # \u{b0}C\n".to_owned(), None));
        assert_eq!(decoded(b"t: -30 # \xb0C"), ("t: -30 # \u{b0}C".to_owned(), Some("Windows-1252")));
        let wide: Vec<u8> = [0xff, 0xfe].into_iter().chain("a: 1".encode_utf16().flat_map(u16::to_le_bytes)).collect();
        assert_eq!(decoded(&wide), ("a: 1".to_owned(), Some("UTF-16")));
        assert_eq!(decoded(b""), (String::new(), None));
    }
}
