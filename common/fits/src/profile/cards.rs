//! The cards of a header as they are in a file: each one is kept to the byte until it is replaced.

use std::io::{ErrorKind, Read};

use crate::card::{self, Card, LENGTH, Value};
use crate::hdu::BLOCK;

/// A header longer than this is none; ours have about 200 cards, and a block takes 36.
const MOST_BLOCKS: usize = 1000;
/// Characters of a keyword that is no ESO hierarchical one.
const KEYWORD_LENGTH: usize = 8;

/// A keyword with its value and comment, or a commentary card.
#[derive(Debug, Clone, PartialEq)]
pub struct CardEntry {
    /// The keyword; of a hierarchical one all its words, such as `ESO OBS PROG ID`.
    pub keyword: String,
    /// Its value; absent on a commentary card (COMMENT, HISTORY).
    pub value: Option<Value>,
    /// Its comment, in which units are in brackets.
    pub comment: String,
    /// The bytes in the file; more than one record where a text goes on in CONTINUE cards.
    records: Vec<[u8; LENGTH]>,
}

/// The cards of a header, without END and without the blank ones that keep room.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CardList {
    /// In the file's order.
    pub entries: Vec<CardEntry>,
}

impl CardEntry {
    /// A card as this program writes it; `None` when the value has no form in FITS, or does not fit a card.
    pub fn new(keyword: &str, value: Value, comment: &str) -> Option<Self> {
        let written = match &value {
            Value::Logical(logical) => format!("{:>20}", if *logical { "T" } else { "F" }),
            Value::Whole(whole) => format!("{whole:>20}"),
            Value::Number(number) => format!("{:>20}", number_text(*number)?),
            Value::Text(text) if is_printable(text) => format!("{:<20}", format!("'{:<8}'", text.replace('\'', "''"))),
            Value::Text(_) | Value::Undefined => return None,
        };
        let mut record = if keyword.len() <= KEYWORD_LENGTH && !keyword.contains(' ') {
            format!("{keyword:<KEYWORD_LENGTH$}= {written}")
        } else {
            format!("HIERARCH {keyword} = {}", written.trim_start())
        };
        if record.trim_end().len() > LENGTH {
            return None;
        }
        if !comment.is_empty() && record.len() + 4 <= LENGTH {
            record.push_str(" / ");
            record.extend(comment.chars().map(|c| if is_printable_char(c) { c } else { '?' }));
        }
        let mut bytes = [b' '; LENGTH];
        bytes.iter_mut().zip(record.bytes()).for_each(|(byte, c)| *byte = c);
        let comment = comment.to_owned();
        Some(Self { keyword: keyword.to_owned(), value: Some(value), comment, records: vec![bytes] })
    }

    /// The bytes in the file.
    pub fn bytes(&self) -> &[u8] {
        self.records.as_flattened()
    }

    /// What stands in the place of the value where it is nothing that FITS knows, such as `NaN`.
    pub fn value_without_form(&self) -> Option<String> {
        let record = self.records.first().filter(|_| self.value == Some(Value::Undefined))?;
        let text: String = record.iter().map(|byte| char::from(*byte)).collect();
        let field = text.split_once('=')?.1.split('/').next()?.trim().to_owned();
        // A card may have no value, and a complex number is one that images do not need.
        (!field.is_empty() && !field.starts_with('(')).then_some(field)
    }

    fn of(record: [u8; LENGTH]) -> Self {
        let (keyword, value, comment) = match card::read(&record) {
            Card::Value(keyword, value) => (keyword, Some(value), comment(&record)),
            Card::End | Card::Continue(_) | Card::Comment => {
                let word = String::from_utf8_lossy(&record[..KEYWORD_LENGTH]).trim().to_owned();
                (word, None, String::new())
            }
        };
        Self { keyword, value, comment, records: vec![record] }
    }
}

impl CardList {
    /// Reads the header with which these bytes begin, and its length on disk in bytes; `None` if it has no end.
    ///
    /// # Errors
    /// The error of the system.
    pub fn read(mut file: impl Read) -> std::io::Result<Option<(Self, usize)>> {
        let (mut entries, mut block) = (Vec::<CardEntry>::new(), [0; BLOCK]);
        for blocks in 1..=MOST_BLOCKS {
            match file.read_exact(&mut block) {
                Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
                read => read?,
            }
            for record in block.as_chunks::<LENGTH>().0 {
                match (card::read(record), entries.last_mut()) {
                    (Card::End, _) => return Ok(Some((Self { entries }, blocks * BLOCK))),
                    (Card::Continue(more), Some(CardEntry { value: Some(Value::Text(text)), records, .. }))
                        if text.ends_with('&') =>
                    {
                        text.pop();
                        text.push_str(&more);
                        records.push(*record);
                    }
                    _ if record.trim_ascii().is_empty() => {}
                    _ => entries.push(CardEntry::of(*record)),
                }
            }
        }
        Ok(None)
    }

    /// The card of a keyword; the first, where there are several.
    pub fn entry(&self, keyword: &str) -> Option<&CardEntry> {
        self.entries.iter().find(|entry| entry.keyword == keyword && entry.value.is_some())
    }

    /// The value of a keyword, where it is there and has one.
    pub fn value(&self, keyword: &str) -> Option<&Value> {
        self.entry(keyword)?.value.as_ref().filter(|value| **value != Value::Undefined)
    }

    /// The text of a keyword, where it is one that is not empty.
    pub fn text(&self, keyword: &str) -> Option<&str> {
        match self.value(keyword)? {
            Value::Text(text) if !text.trim().is_empty() => Some(text.trim()),
            _ => None,
        }
    }

    /// The number of a keyword, whole or not.
    pub fn number(&self, keyword: &str) -> Option<f64> {
        match self.value(keyword)? {
            Value::Whole(whole) => Some(*whole as f64),
            Value::Number(number) => Some(*number),
            Value::Logical(_) | Value::Text(_) | Value::Undefined => None,
        }
    }

    /// Puts a card in the place of the one with its keyword, or at the end.
    pub fn set(&mut self, card: CardEntry) {
        match self.entries.iter_mut().find(|entry| entry.keyword == card.keyword && entry.value.is_some()) {
            Some(entry) => *entry = card,
            None => self.entries.push(card),
        }
    }

    /// The header as it is in a file, with its END, in whole blocks.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes: Vec<u8> = self.entries.iter().flat_map(|entry| entry.bytes()).copied().collect();
        bytes.extend_from_slice(b"END");
        bytes.resize(bytes.len().div_ceil(BLOCK) * BLOCK, b' ');
        bytes
    }
}

/// The text after the value of a card.
fn comment(record: &[u8; LENGTH]) -> String {
    let text: String = record.iter().map(|byte| char::from(*byte)).collect();
    let Some((_, rest)) = text.split_once('=') else { return String::new() };
    let behind = match rest.trim_start().strip_prefix('\'') {
        // Two quotes are one of the text; the last single one closes it.
        Some(quoted) => quoted.replace("''", "  ").split_once('\'').map(|(_, behind)| behind.to_owned()),
        None => Some(rest.to_owned()),
    };
    behind.and_then(|behind| Some(behind.split_once('/')?.1.trim().to_owned())).unwrap_or_default()
}

/// The shortest digits that read back as the same number, with a decimal point and a capital E.
fn number_text(value: f64) -> Option<String> {
    let digits = value.is_finite().then(|| format!("{value:?}"))?;
    Some(match digits.split_once('e') {
        Some((mantissa, exponent)) if mantissa.contains('.') => format!("{mantissa}E{exponent}"),
        Some((mantissa, exponent)) => format!("{mantissa}.0E{exponent}"),
        None => digits,
    })
}

fn is_printable_char(c: char) -> bool {
    c == ' ' || c.is_ascii_graphic()
}

/// Whether a text has only the characters that FITS has.
pub fn is_printable(text: &str) -> bool {
    text.chars().all(is_printable_char)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn card(keyword: &str, value: Value, comment: &str) -> Option<String> {
        let entry = CardEntry::new(keyword, value, comment)?;
        Some(String::from_utf8(entry.bytes().to_vec()).unwrap().trim_end().to_owned())
    }

    #[test]
    fn cards_are_written_as_the_standard_has_them() {
        let written = |keyword, value, comment| card(keyword, value, comment).unwrap();
        assert_eq!(written("RLEVEL", Value::Whole(0), "raw"), "RLEVEL  =                    0 / raw");
        assert_eq!(written("UTC", Value::Number(1e-7), ""), "UTC     =               1.0E-7");
        let name = Value::Text("O'Neil".to_owned());
        assert_eq!(written("OBSERVER", name, "who"), "OBSERVER= 'O''Neil '           / who");
        let id = || Value::Text("112.25XK.001".to_owned());
        assert_eq!(
            written("ESO OBS PROG ID", id(), "programme"),
            "HIERARCH ESO OBS PROG ID = '112.25XK.001'       / programme"
        );
        assert_eq!(written("EXTEND", Value::Logical(true), ""), "EXTEND  =                    T");
    }

    #[test]
    fn what_fits_has_no_form_for_is_not_written() {
        assert_eq!(card("A", Value::Number(f64::NAN), ""), None);
        assert_eq!(card("A", Value::Text("Bar\u{e9}".to_owned()), ""), None);
        assert_eq!(card("A", Value::Text("x".repeat(69)), ""), None);
        assert_eq!(card("A", Value::Undefined, ""), None);
        assert!(card("A", Value::Text("x".repeat(68)), "no room for this").is_some());
    }

    #[test]
    fn a_header_is_read_back_to_the_byte() {
        let mut text = String::new();
        for record in [
            "SIMPLE  =                    T / FITS",
            "OBSERVER= 'O''Neil / me'       / who = it",
            "LONGTEXT= 'begins here and &'",
            "CONTINUE  'ends here'",
            "HIERARCH ESO TEL ALT = 45.25 / [deg] altitude",
            "HISTORY not known = nothing",
        ] {
            text.push_str(&format!("{record:80}"));
        }
        text.push_str(&format!("{:80}{:80}END", "", ""));
        let bytes = format!("{text:2880}").into_bytes();
        let (list, length) = CardList::read(bytes.as_slice()).unwrap().unwrap();
        assert_eq!(length, BLOCK);
        assert_eq!(list.text("OBSERVER"), Some("O'Neil / me"));
        assert_eq!(list.entry("OBSERVER").unwrap().comment, "who = it");
        assert_eq!(list.text("LONGTEXT"), Some("begins here and ends here"));
        assert_eq!(list.number("ESO TEL ALT"), Some(45.25));
        assert_eq!(list.entry("ESO TEL ALT").unwrap().comment, "[deg] altitude");
        assert!(list.entries.last().unwrap().value.is_none());
        let written = list.to_bytes();
        assert_eq!(written[..480], bytes[..480]);
        assert!(written[480..].starts_with(b"END   "));
        assert_eq!(CardList::read(&bytes[..80]).unwrap(), None);
    }
}
