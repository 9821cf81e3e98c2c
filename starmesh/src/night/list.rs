//! `starmesh night list`: the nights that have frames.

use node_archive::night::Night;

use super::Archive;
use crate::console::line;

pub(super) fn run(archive: &Archive) -> anyhow::Result<()> {
    let Some((oldest, newest)) = archive.reader.span_of_frames()? else {
        return line(format_args!("no frame is stored yet"));
    };
    let place = &archive.config.place;
    let (mut night, last) = (Night::at(oldest, place), Night::at(newest, place));
    line(format_args!("{:8}  {:>6}  {:>8}  {:>8}", "night", "frames", "complete", "GB"))?;
    while night.date <= last.date {
        let frames = archive.reader.frames(night.from, night.to)?;
        if !frames.is_empty() {
            let complete = frames.iter().filter(|frame| frame.is_complete).count();
            let bytes: u64 = frames.iter().map(|frame| frame.image.bytes).sum();
            line(format_args!("{:8}  {:>6}  {complete:>8}  {:>8.2}", night.date, frames.len(), bytes as f64 / 1e9))?;
        }
        night = Night::new(night.date.next(), place);
    }
    Ok(())
}
