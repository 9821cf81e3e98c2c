//! The header of a FITS file, read as plainly as FITS allows: nothing of Starmesh's own reading judges its writing.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

/// The keywords of a FITS file's first header with their values as they are written.
pub fn header(path: &Path) -> anyhow::Result<HashMap<String, String>> {
    let bytes = std::fs::read(path)?;
    let cards = bytes.chunks(80).take_while(|card| !card.starts_with(b"END     ")).map(String::from_utf8_lossy);
    let read = |card: Cow<'_, str>| {
        let (keyword, rest) = card.split_once("= ")?;
        Some((keyword.trim().to_owned(), rest.split(" / ").next()?.trim().to_owned()))
    };
    Ok(cards.filter_map(read).collect())
}
