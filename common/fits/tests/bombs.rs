//! Files that announce or hold far more than they are: refused before they fill the memory.
#![allow(clippy::unwrap_used, clippy::panic)] // Helpers of tests are tests too.

use std::io::Read;
use std::path::Path;

use fits::{Fault, FitsError, Part, Pixels};

/// A header of these cards.
fn header(cards: &[&str]) -> Vec<u8> {
    let text: String = cards.iter().chain([&"END"]).map(|card| format!("{card:80}")).collect();
    let mut bytes = text.into_bytes();
    bytes.resize(bytes.len().div_ceil(2880) * 2880, b' ');
    bytes
}

fn image(width: u64, height: u64) -> Vec<u8> {
    let axes = [format!("NAXIS1  = {width}"), format!("NAXIS2  = {height}")];
    header(&["SIMPLE  = T", "BITPIX  = 16", "NAXIS   = 2", &axes[0], &axes[1]])
}

/// These bytes and so many zeros behind them, packed.
fn packed(how: &str, head: &[u8], zeros: u64) -> Vec<u8> {
    let mut all = head.chain(std::io::repeat(0).take(zeros));
    if how == "gzip" {
        let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::copy(&mut all, &mut packed).unwrap();
        packed.finish().unwrap()
    } else {
        let mut packed = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
        std::io::copy(&mut all, &mut packed).unwrap();
        packed.finish().unwrap()
    }
}

fn refused(bytes: Vec<u8>) -> FitsError {
    match fits::parse(Path::new("night/bomb.fits"), bytes) {
        Ok(image) => panic!("taken: {} x {} px", image.width_px, image.height_px),
        Err(error) => error,
    }
}

/// Greatest memory of this process so far, MB.
#[cfg(target_os = "linux")]
fn peak_mb() -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find(|line| line.starts_with("VmHWM:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
}

/// All in one test: the memory is that of the process.
#[test]
#[cfg(target_os = "linux")]
fn bombs_are_refused_before_they_fill_the_memory() {
    const ZEROS: u64 = 1 << 20;
    let absurd = image(400_000, 400_000);
    let endless = format!("{:80}{:80}", "SIMPLE  = T", "BITPIX  = 16").into_bytes();
    for how in ["gzip", "bzip2"] {
        // Packed files may follow one another: 300 MB of zeros.
        let zeros = packed(how, b"", ZEROS).repeat(300);
        let with_zeros = |head: &[u8]| [packed(how, head, 23_040 - 2880), zeros.clone()].concat();
        let cases = [
            (zeros.clone(), "is not FITS"),
            (with_zeros(&image(100, 100)), "goes on behind the 23040 bytes that its headers announce"),
            (with_zeros(&absurd), "HDU 1 has 400000 x 400000 px, at most 536870912 are taken"),
            (packed(how, &image(20_000, 20_000), 1000), "its header announces"),
            (with_zeros(&endless), "expected a card END"),
        ];
        let before = peak_mb();
        for (bytes, words) in cases {
            let message = refused(bytes).to_string();
            // bzip2 has no such bound: the missing bytes show at the end of the file.
            let cut = how == "bzip2" && message.contains("is cut short: HDU 1 should end at byte 800002880");
            assert!(message.contains(words) || cut, "{how}: {message}");
        }
        assert!(peak_mb() - before < 100.0, "{how}: {} MB more", peak_mb() - before);
    }
}

#[test]
fn a_sound_packed_image_may_have_something_behind_it() {
    for how in ["gzip", "bzip2"] {
        let taken = fits::parse(Path::new("a.fits"), packed(how, &image(100, 100), 20_000 + 1_000_000)).unwrap();
        assert_eq!((taken.width_px, taken.pixels.len()), (100, 10_000));
        // The sum at the end is proven although no byte of the image is missing.
        let mut bytes = packed(how, &image(100, 100), 23_040);
        let last = bytes.len() - if how == "gzip" { 6 } else { 3 };
        bytes[last] ^= 0x55;
        assert!(matches!(refused(bytes).fault, Fault::Packed { .. }), "{how}");
    }
}

#[test]
fn tiles_that_announce_more_than_they_can_hold_are_refused() {
    let primary = header(&["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 0"]);
    let table = ["XTENSION= 'BINTABLE'", "BITPIX  = 8", "NAXIS   = 2", "NAXIS1  = 8", "NAXIS2  = 1", "PCOUNT  = 100"];
    let tiles = ["ZIMAGE  = T", "ZBITPIX = 16", "ZNAXIS  = 2", "ZNAXIS1 = 20000", "ZNAXIS2 = 20000"];
    let how = ["ZTILE1  = 20000", "ZTILE2  = 20000", "ZCMPTYPE= 'RICE_1'"];
    let message = refused([primary, header(&[&table[..], &tiles, &how].concat()), vec![0; 2880]].concat()).to_string();
    assert!(message.contains("ZNAXISn announce 400000000 px, too many for 108 bytes of tiles"), "{message}");
}

/// Two images behind an empty first part.
fn two_chips() -> Vec<u8> {
    let chip = |value: u8| {
        let mut bytes = header(&["XTENSION= 'IMAGE'", "BITPIX  = 8", "NAXIS   = 2", "NAXIS1  = 4", "NAXIS2  = 3"]);
        bytes.extend([value; 12]);
        bytes.resize(2 * 2880, 0);
        bytes
    };
    [header(&["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 0", "EXTEND  = T"]), chip(7), chip(9)].concat()
}

#[test]
fn an_image_is_chosen_by_its_hdu_and_the_others_are_reported() {
    let folder = tempfile::TempDir::new().unwrap();
    for how in ["", "gzip"] {
        let file = folder.path().join("chips.fits");
        std::fs::write(&file, if how.is_empty() { two_chips() } else { packed(how, &two_chips(), 0) }).unwrap();
        let first = fits::read(&file).unwrap();
        assert_eq!((first.hdu, first.other_hdus, first.pixels), (2, vec![3], Pixels::U16(vec![7; 12])));
        let second = fits::read_part(&file, Part::Hdu(3)).unwrap();
        assert_eq!((second.hdu, second.other_hdus, second.pixels), (3, vec![2], Pixels::U16(vec![9; 12])));
        for hdu in [1, 4] {
            let message = fits::read_part(&file, Part::Hdu(hdu)).unwrap_err().to_string();
            assert!(
                message.ends_with(&format!(
                    "has no image in HDU {hdu}; images are in HDU 2, 3; the first header is HDU 1"
                )),
                "{message}"
            );
        }
    }
}

#[test]
fn three_planes_are_a_colour_image_and_others_a_cube() {
    let cube = |planes: u8| {
        let third = format!("NAXIS3  = {planes}");
        let cards = ["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 3", "NAXIS1  = 2", "NAXIS2  = 1", &third];
        let mut bytes = header(&cards);
        bytes.extend((0..planes).flat_map(|plane| [30 * plane, if plane == 1 { 250 } else { 10 }]));
        fits::parse(Path::new("colour.fits"), bytes)
    };
    let colour = cube(3).unwrap();
    assert_eq!((colour.planes, colour.width_px, colour.height_px), (3, 2, 1));
    // A mean, and of a pixel that is saturated in one plane the greatest.
    assert_eq!(colour.pixels, Pixels::F32(vec![30.0, 250.0]));
    for planes in [2, 4] {
        let message = cube(planes).unwrap_err().to_string();
        assert!(message.contains(&format!("HDU 1 has the axes 2 x 1 x {planes}, expected two, or three")), "{message}");
    }
}
