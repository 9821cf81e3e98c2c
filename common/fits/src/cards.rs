//! Every card of a file's headers, with its comment, in the file's order.

use std::fs::File;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use crate::card::{self, Card, Value};
use crate::error::{Fault, FitsError};
use crate::hdu::{BLOCK, data_length, shape};
use crate::header::Header;
use crate::restore::next_header;
use crate::unpack::Source;

/// Parts of a file that are looked at.
const MOST_HDUS: usize = 10_000;

/// The header of one part.
#[derive(Debug, Clone, PartialEq)]
pub struct HeaderCards {
    /// Its place in the file, from 1.
    pub hdu: usize,
    /// Its cards, without END and blank ones.
    pub cards: Vec<Line>,
}

/// A card with its comment.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// COMMENT and HISTORY have no value; what is no card of the standard is a line without a keyword.
    pub keyword: String,
    /// [`Value::Undefined`] where it has none.
    pub value: Value,
    /// The text after the value, or that of a comment.
    pub comment: String,
}

/// The headers of a file, or that of one part, from 1. Data that are cut short do not matter.
///
/// # Errors
/// [`FitsError`] when the file cannot be read, is no FITS, has a broken header, or has no such part.
pub fn read_cards(file: &Path, wanted: Option<usize>) -> Result<Vec<HeaderCards>, FitsError> {
    of_file(file, wanted).map_err(|fault| FitsError { file: file.to_owned(), fault })
}

fn of_file(file: &Path, wanted: Option<usize>) -> Result<Vec<HeaderCards>, Fault> {
    let mut opened = File::open(file)?;
    let mut head = Vec::new();
    (&mut opened).take(BLOCK as u64).read_to_end(&mut head)?;
    opened.rewind()?;
    if head.starts_with(b"SIMPLE  =") {
        return of_plain(file, opened, wanted);
    }
    let length = opened.metadata()?.len();
    let mut source = Source::new(opened, Some(length))?;
    source.fill_all()?;
    of_plain(file, Cursor::new(source.into_bytes()), wanted)
}

fn of_plain(file: &Path, mut from: impl Read + Seek, wanted: Option<usize>) -> Result<Vec<HeaderCards>, Fault> {
    let mut found = Vec::new();
    let mut hdus = 0;
    for hdu in 1..=MOST_HDUS {
        let Some(bytes) = next_header(&mut from)? else {
            if hdu == 1 {
                return Err(Fault::Header { hdu, problem: "expected a card END".to_owned() });
            }
            break;
        };
        // After the last part there may be any bytes (section 3.5).
        if hdu > 1 && !bytes.starts_with(b"XTENSION") {
            break;
        }
        hdus = hdu;
        if wanted.is_none_or(|wanted| wanted == hdu) {
            found.push(HeaderCards { hdu, cards: lines(&bytes) });
        }
        if wanted == Some(hdu) {
            break;
        }
        let broken = |problem: String| Fault::Header { hdu, problem };
        let Some((header, _)) = Header::read(file, &bytes) else {
            return Err(broken("expected a card END".to_owned()));
        };
        let length = data_length(&header, &shape(&header, "").map_err(broken)?).map_err(broken)?;
        let padded = length.div_ceil(BLOCK as u64).saturating_mul(BLOCK as u64);
        from.seek(SeekFrom::Current(i64::try_from(padded).unwrap_or(i64::MAX)))?;
    }
    match wanted {
        Some(wanted) if found.is_empty() => Err(Fault::NoSuchHdu { hdu: wanted, hdus }),
        _ => Ok(found),
    }
}

fn lines(header: &[u8]) -> Vec<Line> {
    let mut lines: Vec<Line> = Vec::new();
    for record in header.chunks_exact(card::LENGTH) {
        match card::read(record) {
            Card::End => break,
            Card::Value(keyword, value) => lines.push(Line { keyword, value, comment: card::comment(record) }),
            Card::Continue(more) => {
                if let Some(Line { value: Value::Text(text), comment, .. }) = lines.last_mut()
                    && text.ends_with('&')
                {
                    text.pop();
                    text.push_str(&more);
                    let rest = card::comment(record);
                    if !rest.is_empty() && !comment.is_empty() {
                        comment.push(' ');
                    }
                    comment.push_str(&rest);
                }
            }
            Card::Comment => {
                let text: String = record.iter().map(|byte| char::from(*byte)).collect();
                let text = text.trim_end_matches([' ', '\0']);
                let split = text.char_indices().nth(8).map_or(text.len(), |(at, _)| at);
                let (keyword, comment) = text.split_at(split);
                if !text.is_empty() {
                    let (keyword, comment) = (keyword.trim().to_owned(), comment.to_owned());
                    lines.push(Line { keyword, value: Value::Undefined, comment });
                }
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(cards: &[&str]) -> Vec<u8> {
        let mut bytes: Vec<u8> = cards.iter().map(|card| format!("{card:<80}")).collect::<String>().into_bytes();
        bytes.resize(bytes.len().div_ceil(BLOCK) * BLOCK, b' ');
        bytes
    }

    fn file() -> Vec<u8> {
        let mut bytes = header(&[
            "SIMPLE  =                    T / conforms to FITS",
            "BITPIX  =                   16",
            "NAXIS   =                    2",
            "NAXIS1  =                    3 / [px] columns",
            "NAXIS2  =                    2",
            "EXTEND  =                    T",
            "OBJECT  = 'O''Neill / me'      / with a / in it",
            "LONG    = 'first &' / one",
            "CONTINUE  'second' / two",
            "WINDDIR =                      / [deg] no reading",
            "",
            "COMMENT   two blanks first",
            "HISTORY a = b",
            "HIERARCH ESO TEL ALT = 45.25 / [deg]",
            "END",
        ]);
        bytes.resize(bytes.len() + BLOCK, 0);
        bytes.extend(header(&[
            "XTENSION= 'IMAGE   '",
            "BITPIX  = 8",
            "NAXIS   = 0",
            "PCOUNT  = 0",
            "GCOUNT  = 1",
            "END",
        ]));
        bytes.extend(b"trailing bytes of a tape");
        bytes
    }

    fn read(bytes: &[u8], wanted: Option<usize>) -> Result<Vec<HeaderCards>, String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        read_cards(file.path(), wanted).map_err(|error| error.fault.to_string())
    }

    #[test]
    fn every_card_comes_with_its_value_and_comment_in_order() {
        let found = read(&file(), None).unwrap();
        assert_eq!(found.iter().map(|hdu| hdu.cards.len()).collect::<Vec<_>>(), [12, 5]);
        let line = |keyword: &str| found[0].cards.iter().find(|line| line.keyword == keyword).unwrap();
        let text = |text: &str| Value::Text(text.to_owned());
        assert_eq!(
            (&line("SIMPLE").value, line("SIMPLE").comment.as_str()),
            (&Value::Logical(true), "conforms to FITS")
        );
        assert_eq!((&line("OBJECT").value, line("OBJECT").comment.as_str()), (&text("O'Neill / me"), "with a / in it"));
        assert_eq!((&line("LONG").value, line("LONG").comment.as_str()), (&text("first second"), "one two"));
        assert_eq!((&line("WINDDIR").value, line("WINDDIR").comment.as_str()), (&Value::Undefined, "[deg] no reading"));
        assert_eq!(line("COMMENT").comment, "  two blanks first");
        assert_eq!(line("HISTORY").comment, "a = b");
        assert_eq!(
            (&line("ESO TEL ALT").value, line("ESO TEL ALT").comment.as_str()),
            (&Value::Number(45.25), "[deg]")
        );
        assert_eq!(read(&file(), Some(2)).unwrap(), [found[1].clone()]);
    }

    #[test]
    fn what_is_cut_or_broken_or_not_there_is_an_error() {
        let whole = file();
        assert_eq!(read(&whole[..BLOCK + 100], None).unwrap().len(), 1, "only data are missing");
        for (bytes, complaint) in [
            (&whole[..400], "END"),
            (&b""[..], "empty"),
            (&b"no FITS at all"[..], "not FITS"),
            (&header(&["SIMPLE  = T", "BITPIX  = 7", "NAXIS   = 0", "END"])[..], "BITPIX is 7"),
        ] {
            let fault = read(bytes, None).unwrap_err();
            assert!(fault.contains(complaint), "{fault}");
        }
        let fault = read(&whole, Some(9)).unwrap_err();
        assert!(fault.contains("no HDU 9") && fault.contains('2'), "{fault}");
        assert!(read(&whole, Some(0)).is_err());
    }
}
