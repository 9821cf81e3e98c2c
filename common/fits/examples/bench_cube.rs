//! How fast frames become a cube, and in how much memory: `cargo run --release -p fits --example bench_cube -- [FRAMES] [SIDE_PX]`.
//! The frames are made first, in a folder that goes afterwards; the disk's own speed is measured by copying as many bytes.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::Instant;

fn main() -> io::Result<()> {
    let mut numbers = std::env::args().skip(1).map(|word| word.parse::<usize>().unwrap_or(0));
    let (frames, side_px) = (numbers.next().unwrap_or(10_121), numbers.next().unwrap_or(256));
    let folder = tempfile::tempdir()?;
    let files: Vec<PathBuf> = (0..frames).map(|n| frame(folder.path(), n, side_px)).collect::<io::Result<_>>()?;
    let before_kib = peak_kib();
    let cube = folder.path().join("cube.fits");
    let began = Instant::now();
    let written = fits::cube::write_cube(&files, &cube).map_err(io::Error::other)?;
    let took_s = began.elapsed().as_secs_f64();
    let began = Instant::now();
    let mut copy = File::create(folder.path().join("copy"))?;
    io::copy(&mut File::open(&cube)?, &mut copy)?;
    copy.sync_all()?;
    let copied_s = began.elapsed().as_secs_f64();
    let megabytes = written.bytes as f64 / 1e6;
    println!(
        "| frames | pixels | columns | MB | s | frames/s | MB/s | copy of the cube, s | peak memory, MiB | of it before, MiB |"
    );
    println!("|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|");
    println!(
        "| {frames} | {side_px} x {side_px} | {} | {megabytes:.0} | {took_s:.1} | {:.0} | {:.0} | {copied_s:.1} | {:.0} | {:.0} |",
        written.columns,
        frames as f64 / took_s,
        megabytes / took_s,
        peak_kib() as f64 / 1024.0,
        before_kib as f64 / 1024.0
    );
    Ok(())
}

/// A frame with about as many keywords as an archive's: 60 that vary, 40 that do not.
fn frame(folder: &Path, number: usize, side_px: usize) -> io::Result<PathBuf> {
    let mut cards = vec![
        "SIMPLE  =                    T".to_owned(),
        "BITPIX  =                   16".to_owned(),
        "NAXIS   =                    2".to_owned(),
        format!("NAXIS1  = {side_px:>20}"),
        format!("NAXIS2  = {side_px:>20}"),
        "BZERO   =              32768.0".to_owned(),
        format!("DATE-OBS= '2026-11-21T{:02}:{:02}:{:02}'", number / 3600 % 24, number / 60 % 60, number % 60),
    ];
    cards.extend((0..60).map(|k| format!("VARY{k:<4}= {:>20} / [deg] telemetry", (number * 7 + k) as f64 * 0.001)));
    cards.extend((0..40).map(|k| format!("SAME{k:<4}= '{k:<8}'           / the same in all frames")));
    cards.push("END".to_owned());
    let mut bytes: Vec<u8> = cards.iter().flat_map(|card| format!("{card:<80}").into_bytes()).collect();
    bytes.resize(bytes.len().next_multiple_of(2880), b' ');
    bytes.extend((0..side_px * side_px * 2).map(|n| (n ^ number) as u8));
    bytes.resize(bytes.len().next_multiple_of(2880), 0);
    let path = folder.join(format!("{number:05}.fits"));
    File::create(&path)?.write_all(&bytes)?;
    Ok(path)
}

/// The most memory that this process had; 0 where the system does not show it.
fn peak_kib() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|text| text.trim().trim_end_matches("kB").trim().parse().ok()).unwrap_or(0)
}
