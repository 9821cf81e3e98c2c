//! The header of a frame's file, and pieces of the file.

use std::io::{Read as _, Seek as _, SeekFrom};

use contract::archived_frame::{
    ArchiveRefusal, Base64, CardValue, FilePiece, FrameHeader, HduCards, HeaderCard, MOST_CARDS, MOST_PIECE_BYTES,
    NotGiven,
};
use fits::card::Value;
use fits::cards::{Line, read_cards};
use fits::{Fault, FitsError};

use super::found::{OpenedFile, version};
use super::refused;

/// The cards of all parts of a file, or of one, from 1.
pub fn header(opened: &OpenedFile, hdu: Option<u32>) -> Result<FrameHeader, ArchiveRefusal> {
    let found = read_cards(&opened.path, hdu.map(|hdu| hdu as usize)).map_err(|error| damaged(&opened.name, &error))?;
    let mut room = MOST_CARDS;
    let mut truncated = false;
    let mut hdus = Vec::with_capacity(found.len().min(room));
    for part in found {
        truncated |= part.cards.len() > room || room == 0;
        if room == 0 {
            break;
        }
        let cards: Vec<HeaderCard> = part.cards.into_iter().take(room).map(card).collect();
        room -= cards.len();
        hdus.push(HduCards { number: u32::try_from(part.hdu).unwrap_or(u32::MAX), cards });
    }
    Ok(FrameHeader { version: opened.version.clone(), hdus, truncated })
}

fn card(line: Line) -> HeaderCard {
    let value = match line.value {
        Value::Logical(value) => CardValue::Logical(value),
        Value::Whole(value) => CardValue::Whole(value),
        Value::Number(value) => CardValue::Number(value),
        Value::Text(value) => CardValue::Text(value),
        Value::Undefined => CardValue::Nothing,
    };
    HeaderCard { keyword: line.keyword, value, comment: line.comment }
}

/// A piece of a file; none of its bytes where it begins at the end.
pub fn piece(mut opened: OpenedFile, from: u64, most: u32) -> Result<FilePiece, ArchiveRefusal> {
    let Some(left) = opened.bytes.checked_sub(from) else {
        let detail = format!("{} has {} bytes; expected a piece that begins before", opened.name, opened.bytes);
        return Err(refused(NotGiven::OutOfRange, detail));
    };
    let length = left.min(u64::from(most.min(MOST_PIECE_BYTES)));
    let mut bytes = vec![0; usize::try_from(length).unwrap_or_default()];
    let unreadable = |name: &str, error: std::io::Error| {
        refused(NotGiven::FileDamaged, format!("the file {name} cannot be read: {error}"))
    };
    let read = opened.file.seek(SeekFrom::Start(from)).and_then(|_| opened.file.read_exact(&mut bytes));
    read.map_err(|error| unreadable(&opened.name, error))?;
    let after = opened.file.metadata().map_err(|error| unreadable(&opened.name, error))?;
    if version(&after) != opened.version {
        return Err(refused(NotGiven::Busy, "the header of the file is being completed; ask again"));
    }
    let name = opened.name.rsplit('/').next().unwrap_or_default().to_owned();
    Ok(FilePiece { version: opened.version, name, file_bytes: opened.bytes, from, bytes: Base64(bytes) })
}

/// The fault of a file, without the folder of images.
pub fn damaged(name: &str, error: &FitsError) -> ArchiveRefusal {
    let reason = match error.fault {
        Fault::NoSuchHdu { .. } => NotGiven::OutOfRange,
        Fault::TooLarge { .. } => NotGiven::TooLarge,
        _ => NotGiven::FileDamaged,
    };
    refused(reason, format!("the file {name} {}", error.fault))
}
