//! Texts that people wrote, from bytes: UTF-8, or words about what it is instead.

/// Why bytes are no text.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {what}")]
pub struct NotUtf8 {
    /// Line of the first byte at fault, from 1.
    pub line: usize,
    /// In words, with what to do.
    pub what: String,
}

/// The text of a file; a byte order mark of UTF-8 stays.
///
/// # Errors
/// The bytes are no UTF-8.
pub fn utf8(bytes: Vec<u8>) -> Result<String, NotUtf8> {
    let zeros = bytes.iter().take(200).filter(|byte| **byte == 0).count();
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") || 3 * zeros > bytes.len().min(200) {
        let what =
            "the file is written in UTF-16, which editors on Windows call \"Unicode\"; save it as UTF-8".to_owned();
        return Err(NotUtf8 { line: 1, what });
    }
    String::from_utf8(bytes).map_err(|error| {
        let good = error.utf8_error().valid_up_to();
        let before = error.as_bytes().get(..good).unwrap_or_default();
        let line = before.iter().filter(|byte| **byte == b'\n').count() + 1;
        let byte = error.as_bytes().get(good).copied().unwrap_or_default();
        let latin = char::from(byte);
        let found = if latin.is_alphanumeric() || "\u{b0}\u{b5}\u{b1}".contains(latin) {
            format!("the byte {byte:#04x}, which is \"{latin}\" in Latin-1")
        } else {
            format!("the byte {byte:#04x}")
        };
        NotUtf8 { line, what: format!("this is not UTF-8: {found}; save the file as UTF-8") }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_encodings_are_named_with_the_line() {
        assert_eq!(utf8("é\n".as_bytes().to_vec()).unwrap(), "é\n");
        let latin = utf8(b"a\nb\n{\"object\": \"Andr\xe9\"}".to_vec()).unwrap_err().to_string();
        assert_eq!(
            latin,
            "line 3: this is not UTF-8: the byte 0xe9, which is \"é\" in Latin-1; save the file as UTF-8"
        );
        let wide = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
        assert!(utf8(wide("\u{feff}{}")).unwrap_err().what.contains("UTF-16"));
        assert!(utf8(wide("{\"object\": 1}")).unwrap_err().what.contains("UTF-16"));
    }
}
