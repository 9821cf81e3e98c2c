//! The primary header of a FITS file as it stands on disk: read, changed in memory, with its checksum.
//!
//! Layout and checksum are those of the FITS standard 4.0, sections 4.2 and 4.4.2.7 and appendix J.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::card::{Card, printable};

/// FITS files are made of blocks of so many bytes.
const BLOCK: usize = 2880;
const CARD: usize = 80;
const CARDS_PER_BLOCK: usize = BLOCK / CARD;
/// A header longer than this is none; ours have about 100 cards, and a block takes 36.
const MOST_BLOCKS: usize = 1000;
/// Room for more cards, where a header has to grow.
const SPARE_BLOCKS: usize = 1;
/// The characters of one card of history.
const HISTORY_LENGTH: usize = 72;

/// The cards of a header, and how long it is on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// Before the end, without the blank ones that keep room.
    cards: Vec<[u8; CARD]>,
    blocks: usize,
}

impl Header {
    /// Reads the header of a file; `None` if it has none with an end.
    pub fn read(path: &Path) -> std::io::Result<Option<Self>> {
        Self::read_from(File::open(path)?)
    }

    /// Reads the header with which these bytes begin; `None` if it has no end.
    pub fn read_from(mut file: impl Read) -> std::io::Result<Option<Self>> {
        let (mut cards, mut block) = (Vec::<[u8; CARD]>::new(), [0; BLOCK]);
        for blocks in 1..=MOST_BLOCKS {
            match file.read_exact(&mut block) {
                Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => return Ok(None),
                read => read?,
            }
            let (in_block, _) = block.as_chunks::<CARD>();
            let end = in_block.iter().position(|card| card.starts_with(b"END     "));
            cards.extend(&in_block[..end.unwrap_or(CARDS_PER_BLOCK)]);
            if end.is_some() {
                let used = cards.iter().rposition(|card| !card.trim_ascii().is_empty()).map_or(0, |last| last + 1);
                cards.truncate(used);
                return Ok(Some(Self { cards, blocks }));
            }
        }
        Ok(None)
    }

    /// The cards that are not blank, without trailing blanks.
    pub fn cards(&self) -> impl Iterator<Item = String> {
        let written = self.cards.iter().map(|card| card.trim_ascii_end()).filter(|card| !card.is_empty());
        written.map(|card| String::from_utf8_lossy(card).into_owned())
    }

    /// The keywords that have a value.
    pub fn keywords(&self) -> BTreeSet<String> {
        self.cards().filter(|card| card.get(8..10) == Some("= ")).map(|card| card[..8].trim_end().to_owned()).collect()
    }

    /// The value of a keyword as it is written; the inside of the quotes for a text.
    pub fn value(&self, keyword: &str) -> Option<String> {
        let start = format!("{keyword:<8}= ");
        let card = self.cards().find(|card| card.starts_with(&start))?;
        let value = card[10..].trim_start();
        match value.strip_prefix('\'') {
            Some(text) => {
                let marked = text.replace("''", "\u{1}");
                let inside = marked.split('\'').next().unwrap_or_default();
                Some(inside.trim_end().replace('\u{1}', "'"))
            }
            None => Some(value.split('/').next().unwrap_or_default().trim().to_owned()),
        }
    }

    /// Sets a keyword in place, or adds it at the end; a number that is not finite is left out.
    pub fn set(&mut self, card: &Card) {
        let Some(record) = card.record().and_then(|record| record.into_bytes().try_into().ok()) else { return };
        let start = format!("{:<8}= ", card.keyword);
        match self.cards.iter_mut().find(|have| have.starts_with(start.as_bytes())) {
            Some(have) => *have = record,
            None => self.cards.push(record),
        }
    }

    /// Takes out the keywords with a value that are not to stay.
    pub fn retain(&mut self, stays: impl Fn(&str) -> bool) {
        self.cards.retain(|card| {
            let keyword =
                card.get(8..10).filter(|sign| *sign == b"= ").and_then(|_| std::str::from_utf8(&card[..8]).ok());
            keyword.is_none_or(|keyword| stays(keyword.trim_end()))
        });
    }

    /// Adds a line to the history, unless it stands there.
    pub fn add_history(&mut self, text: &str) {
        for part in printable(text).as_bytes().chunks(HISTORY_LENGTH) {
            let mut card = [b' '; CARD];
            card[..8].copy_from_slice(b"HISTORY ");
            card[8..8 + part.len()].copy_from_slice(part);
            if !self.cards.contains(&card) {
                self.cards.push(card);
            }
        }
    }

    /// Brings CHECKSUM up to date with the DATASUM that stands here; a header without one has no checksum to keep.
    pub fn update_checksum(&mut self) {
        let Some(data_sum) = self.value("DATASUM").and_then(|sum| sum.parse().ok()) else { return };
        let card = |value: &str| Card::new("CHECKSUM", value.into(), "ones' complement of the sum of this HDU");
        self.set(&card("0000000000000000"));
        let sum = add(sum(&self.to_bytes()), data_sum);
        self.set(&card(&encode(!sum)));
    }

    /// The header as it is to stand on disk: as long as it was, or longer where its cards need it.
    pub fn to_bytes(&self) -> Vec<u8> {
        let needed = (self.cards.len() + 1).div_ceil(CARDS_PER_BLOCK);
        let blocks = if needed <= self.blocks { self.blocks } else { needed + SPARE_BLOCKS };
        let mut bytes = self.cards.as_flattened().to_vec();
        bytes.resize(blocks * BLOCK, b' ');
        // The block with the end is the last one, whatever room is before it.
        let end = self.cards.len().max((blocks - 1) * CARDS_PER_BLOCK) * CARD;
        bytes[end..end + 3].copy_from_slice(b"END");
        bytes
    }

    /// Its length on disk before any change, bytes.
    pub fn length(&self) -> usize {
        self.blocks * BLOCK
    }
}

/// Ones' complement sum of 32-bit words, most significant byte first.
fn sum(bytes: &[u8]) -> u32 {
    bytes.as_chunks().0.iter().fold(0, |total, word| add(total, u32::from_be_bytes(*word)))
}

fn add(a: u32, b: u32) -> u32 {
    let (sum, carried) = a.overflowing_add(b);
    sum + u32::from(carried)
}

/// The 16 letters and digits of a checksum, whose own sum, where CHECKSUM stands, is `value`.
fn encode(value: u32) -> String {
    let mut text = [0; 16];
    for (place, byte) in value.to_be_bytes().into_iter().enumerate() {
        // Four characters that add up to the byte and four times '0'.
        let mut four = [byte / 4 + b'0'; 4];
        four[0] += byte % 4;
        // Adjacent characters move apart until no punctuation is left between digits, capitals and small letters.
        while four.iter().any(|c| (0x3a..=0x40).contains(c) || (0x5b..=0x60).contains(c)) {
            for pair in four.as_chunks_mut::<2>().0 {
                if pair.iter().any(|c| (0x3a..=0x40).contains(c) || (0x5b..=0x60).contains(c)) {
                    pair[0] += 1;
                    pair[1] -= 1;
                }
            }
        }
        for (row, c) in four.into_iter().enumerate() {
            // The text begins at the card's column 12, the last of a word, so all moves one to the right.
            text[(row * 4 + place + 1) % 16] = c;
        }
    }
    text.iter().map(|c| char::from(*c)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sum_is_written_as_letters_and_digits_that_add_up_to_it() {
        // The example of the FITS standard 4.0, appendix J.
        assert_eq!(encode(!868_229_149), "hcHjjc9ghcEghc9g");
        for value in [0, 1, 0x0a0b_0c0d, 0x7fff_ffff, 0xdead_beef, u32::MAX] {
            let text = encode(value);
            assert!(text.bytes().all(|c| c.is_ascii_alphanumeric()), "{text}");
            let mut turned = text.into_bytes();
            turned.rotate_left(1);
            let zeros = sum(&[b'0'; 16]);
            let told = add(sum(&turned), !zeros);
            assert!(told == value || (told == u32::MAX && value == 0), "{told:x} for {value:x}");
        }
    }

    #[test]
    fn a_header_grows_by_whole_blocks_and_keeps_its_end_last() {
        let mut header = Header { cards: Vec::new(), blocks: 1 };
        for i in 0..35 {
            header.set(&Card::new(&format!("K{i}"), crate::card::CardValue::Int(i), ""));
        }
        assert_eq!(header.to_bytes().len(), BLOCK);
        header.add_history(&"long ".repeat(20));
        header.add_history(&"long ".repeat(20));
        assert_eq!(header.cards().filter(|card| card.starts_with("HISTORY")).count(), 2, "two cards, once");
        let bytes = header.to_bytes();
        assert_eq!(bytes.len(), 3 * BLOCK);
        assert!(bytes[2 * BLOCK..].starts_with(b"END "));
    }
}
