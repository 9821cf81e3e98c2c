//! The header of a frame's file as it stands on disk: read, changed in memory, with its checksum. Where the image is in
//! compressed tiles, it is the header of the table that holds them.
//!
//! Layout and checksum are those of the FITS standard 4.0, sections 4.2 and 4.4.2.7 and appendix J.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use fits::checksum::{add, encode, sum};
use fits::restore::{self, FirstHeaders};

use crate::card::{Card, printable};

/// FITS files are made of blocks of so many bytes.
const BLOCK: usize = 2880;
const CARD: usize = 80;
const CARDS_PER_BLOCK: usize = BLOCK / CARD;
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
    /// What stands before it in the file: the empty first part of a file with tiles.
    before: Vec<u8>,
}

impl Header {
    /// Reads the header of a file; `None` if it has none with an end.
    pub fn read(path: &Path) -> std::io::Result<Option<Self>> {
        Self::read_from(File::open(path)?)
    }

    /// Reads the header with which these bytes begin; `None` if it has no end.
    pub fn read_from(mut file: impl Read) -> std::io::Result<Option<Self>> {
        let Some(FirstHeaders { first, table }) = FirstHeaders::read(&mut file)? else { return Ok(None) };
        let (before, own) = table.map_or((Vec::new(), first.clone()), |table| (first, table));
        Ok(Some(Self { before, ..Self::of(&own) }))
    }

    /// The header of these blocks, which has an end.
    fn of(bytes: &[u8]) -> Self {
        let records = bytes.as_chunks::<CARD>().0;
        let end = records.iter().position(|card| card.starts_with(b"END     ")).unwrap_or(records.len());
        let used = records[..end].iter().rposition(|card| !card.trim_ascii().is_empty()).map_or(0, |last| last + 1);
        Self { cards: records[..used].to_vec(), blocks: bytes.len() / BLOCK, before: Vec::new() }
    }

    /// Whether the image is in compressed tiles.
    pub fn is_tiled(&self) -> bool {
        !self.before.is_empty()
    }

    /// The header of the plain image.
    pub fn plain(self) -> Self {
        if self.is_tiled() { Self::of(&restore::header(&self.own_bytes())) } else { self }
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

    /// Adds lines to the history that do not stand there, and takes out others that begin so.
    pub fn renew_history(&mut self, begins: &[&str], lines: &[String]) {
        let wanted: Vec<[u8; CARD]> = lines.iter().flat_map(|line| history(line)).collect();
        let mut is_own = false;
        self.cards.retain(|card| {
            let Some(text) = card.strip_prefix(b"HISTORY ") else {
                is_own = false;
                return true;
            };
            // Behind a blank the line of the card before goes on.
            if text[0] != b' ' {
                is_own = begins.iter().any(|begin| text.starts_with(begin.as_bytes()));
            }
            !is_own || wanted.contains(card)
        });
        for card in wanted {
            if !self.cards.contains(&card) {
                self.cards.push(card);
            }
        }
    }

    /// Brings CHECKSUM up to date with the DATASUM that stands here; a header without one has no checksum to keep.
    pub fn update_checksum(&mut self) {
        let Some(data_sum) = self.value("DATASUM").and_then(|sum| sum.parse().ok()) else { return };
        let card =
            |keyword: &str, value: &str| Card::new(keyword, value.into(), "ones' complement of the sum of this HDU");
        const NONE: &str = "0000000000000000";
        if self.is_tiled()
            && let Some(sum_of_pixels) = self.value("ZDATASUM").and_then(|sum| sum.parse().ok())
        {
            // The sum of the plain file, which gets it back when it is restored.
            self.set(&card("ZHECKSUM", NONE));
            let sum = add(sum(&restore::header(&self.own_bytes())), sum_of_pixels);
            self.set(&card("ZHECKSUM", &encode(!sum)));
        }
        self.set(&card("CHECKSUM", NONE));
        let sum = add(sum(&self.own_bytes()), data_sum);
        self.set(&card("CHECKSUM", &encode(!sum)));
    }

    /// All up to the data as it is to stand on disk: as long as it was, or longer where its cards need it.
    pub fn to_bytes(&self) -> Vec<u8> {
        [self.before.as_slice(), &self.own_bytes()].concat()
    }

    fn own_bytes(&self) -> Vec<u8> {
        let needed = (self.cards.len() + 1).div_ceil(CARDS_PER_BLOCK);
        let blocks = if needed <= self.blocks { self.blocks } else { needed + SPARE_BLOCKS };
        let mut bytes = self.cards.as_flattened().to_vec();
        bytes.resize(blocks * BLOCK, b' ');
        // The block with the end is the last one, whatever room is before it.
        let end = self.cards.len().max((blocks - 1) * CARDS_PER_BLOCK) * CARD;
        bytes[end..end + 3].copy_from_slice(b"END");
        bytes
    }

    /// Bytes up to the data on disk before any change.
    pub fn length(&self) -> usize {
        self.before.len() + self.blocks * BLOCK
    }
}

/// The cards of a line of history.
fn history(line: &str) -> Vec<[u8; CARD]> {
    fn card(begin: &[u8], part: &[u8]) -> [u8; CARD] {
        let mut card = [b' '; CARD];
        for (place, byte) in card.iter_mut().zip(begin.iter().chain(part)) {
            *place = *byte;
        }
        card
    }
    let line = printable(line);
    let (first, rest) = line.as_bytes().split_at(line.len().min(HISTORY_LENGTH));
    let further = rest.chunks(HISTORY_LENGTH - 1).map(|part| card(b"HISTORY  ", part));
    std::iter::once(card(b"HISTORY ", first)).chain(further).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_no_more_goes_with_all_its_cards_and_what_is_said_again_stays_in_its_place() {
        let mut header = Header { cards: Vec::new(), blocks: 1, before: Vec::new() };
        let (why, other) = (format!("not solved: {}", "clouds ".repeat(20)), "made by hand".to_owned());
        header.renew_history(&[], &[why.clone(), other.clone(), "not solved: 2 stars".to_owned()]);
        let before = header.clone();
        header.renew_history(&["not solved: "], &["not solved: 2 stars".to_owned(), why]);
        assert_eq!(header, before);
        header.renew_history(&["not solved: "], &[]);
        assert_eq!(header.cards().collect::<Vec<_>>(), [format!("HISTORY {other}")]);
    }

    #[test]
    fn a_header_grows_by_whole_blocks_and_keeps_its_end_last() {
        let mut header = Header { cards: Vec::new(), blocks: 1, before: Vec::new() };
        for i in 0..35 {
            header.set(&Card::new(&format!("K{i}"), crate::card::CardValue::Int(i), ""));
        }
        assert_eq!(header.to_bytes().len(), BLOCK);
        let long = ["long ".repeat(20)];
        header.renew_history(&[], &long);
        header.renew_history(&[], &long);
        assert_eq!(header.cards().filter(|card| card.starts_with("HISTORY")).count(), 2, "two cards, once");
        let bytes = header.to_bytes();
        assert_eq!(bytes.len(), 3 * BLOCK);
        assert!(bytes[2 * BLOCK..].starts_with(b"END "));
    }
}
