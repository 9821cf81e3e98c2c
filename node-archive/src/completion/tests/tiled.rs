//! Files with compressed tiles: the plain file behind them is the one that would have been written.

use super::*;
use crate::fits::is_restored_whole;

fn pixels_of(shape: &Shape) -> Vec<u8> {
    let count = shape.pixels().unwrap() as u32;
    let number = |n: u32| n.wrapping_mul(2_654_435_761);
    (0..count)
        .flat_map(|n| match shape.pixel {
            Pixel::U16 => (number(n) as u16).to_le_bytes().to_vec(),
            Pixel::I32 => (number(n) as i32).to_le_bytes().to_vec(),
            Pixel::F64 if n < 8 => {
                let odd = [f64::NAN, 0.0, -7.5, f64::MIN, 1.0 / 3.0, f64::MAX, -f64::NAN, f64::MIN_POSITIVE];
                odd[n as usize].to_le_bytes().to_vec()
            }
            Pixel::F64 => (f64::from(number(n)) * 1e-3).to_le_bytes().to_vec(),
        })
        .collect()
}

/// Writes a frame as the archive does, plain or in tiles.
fn written(path: &Path, shape: &Shape, tiled: bool, room: usize) {
    let mut fits = if tiled { FitsFile::in_memory(path, shape) } else { FitsFile::create(path, shape) }.unwrap();
    fits.set(&Card::new("OBJECT", "Rigel".into(), "object")).unwrap();
    fits.reserve(room).unwrap();
    fits.write_pixels(shape, &pixels_of(shape)).unwrap();
    fits.write_checksums().unwrap();
    if tiled { fits.compress_to(path, shape.pixel) } else { fits.close() }.unwrap();
}

pub(super) fn new_tiled_file(folder: &Path, room: usize) -> PathBuf {
    let path = folder.join("a [1] frame.fits.fz");
    written(&path, &SHAPE, true, room);
    path
}

/// Cards without those of the sums, whose comments have the time of the clock, and the pixels.
fn content(file: &[u8]) -> (Vec<String>, Vec<u8>) {
    let header = Header::read_from(file).unwrap().unwrap();
    let cards = header.cards().filter(|card| !card.starts_with("CHECKSUM") && !card.starts_with("DATASUM"));
    (cards.collect(), file[header.length()..].to_vec())
}

#[test]
fn the_plain_file_behind_the_tiles_is_the_one_that_would_have_been_written() {
    for (pixel, planes) in [(Pixel::U16, 1), (Pixel::I32, 1), (Pixel::F64, 1), (Pixel::U16, 3), (Pixel::F64, 3)] {
        let folder = tempfile::tempdir().unwrap();
        let (plain, tiled) = (folder.path().join("a.fits"), folder.path().join("a.fits.fz"));
        let shape = Shape { pixel, planes, ..SHAPE };
        written(&plain, &shape, false, 100);
        written(&tiled, &shape, true, 100);
        for step in ["new", "complete", "complete again"] {
            let (wanted, file) = (std::fs::read(&plain).unwrap(), std::fs::read(&tiled).unwrap());
            let restored = fits::restore::plain_file(&tiled).unwrap().unwrap();
            let ((cards, pixels), (wanted_cards, wanted_pixels)) = (content(&restored), content(&wanted));
            assert_eq!(cards, wanted_cards, "{shape:?}, {step}");
            let differs = pixels.iter().zip(&wanted_pixels).position(|(one, other)| one != other);
            assert!(pixels.len() == wanted_pixels.len() && differs.is_none(), "{shape:?}, {step}, byte {differs:?}");
            let right = [&wanted, &restored, &file].map(|bytes| is_checksum_right(bytes));
            assert_eq!(right, [true; 3], "{shape:?}, {step}: plain, restored, in tiles");
            assert!(restored.len().abs_diff(wanted.len()) <= 2880, "at most one block of room more or less");
            complete_file(&plain, &plan()).unwrap();
            complete_file(&tiled, &plan()).unwrap();
        }
    }
}

#[test]
fn numbers_that_funpack_would_not_restore_stay_in_plain_files() {
    let shape = Shape { pixel: Pixel::F64, ..SHAPE };
    let with = |number: f64| -> Vec<u8> { [1.0, number].iter().flat_map(|number| number.to_le_bytes()).collect() };
    for number in [0.0, -7.5, f64::NAN, f64::MAX, f64::MIN_POSITIVE] {
        assert!(is_restored_whole(&shape, &with(number)), "{number}");
    }
    for number in [-0.0, f64::INFINITY, f64::NEG_INFINITY, 5e-324, -1e-310] {
        assert!(!is_restored_whole(&shape, &with(number)), "{number}");
    }
    assert!(is_restored_whole(&SHAPE, &with(f64::INFINITY)), "whole numbers have no such values");
}

#[test]
fn completing_in_place_moves_no_tile() {
    let folder = tempfile::tempdir().unwrap();
    let path = new_tiled_file(folder.path(), 100);
    let (data, length) = (data_of(&path), std::fs::metadata(&path).unwrap().len());
    complete_file(&path, &plan()).unwrap();
    assert_complete(&path, &data);
    assert_eq!(std::fs::metadata(&path).unwrap().len(), length);
}

#[test]
fn a_header_without_room_grows_before_the_tiles() {
    let folder = tempfile::tempdir().unwrap();
    let path = new_tiled_file(folder.path(), 0);
    let (data, length) = (data_of(&path), std::fs::metadata(&path).unwrap().len());
    complete_file(&path, &plan()).unwrap();
    assert_complete(&path, &data);
    assert!(std::fs::metadata(&path).unwrap().len() > length);
    let restored = fits::restore::plain_file(&path).unwrap().unwrap();
    assert!(is_checksum_right(&restored));
}

#[test]
fn a_cube_of_tiled_frames_is_that_of_the_plain_ones() {
    let folder = tempfile::tempdir().unwrap();
    let cube = |tiled: bool| {
        let names =
            ["a.fits", "b.fits"].map(|name| folder.path().join(format!("{name}{}", if tiled { ".fz" } else { "" })));
        for (name, object) in names.iter().zip(["Rigel", "Mira"]) {
            written(name, &SHAPE, tiled, 100);
            let cards = vec![Card::new("OBJECT", object.into(), "object")];
            complete_file(name, &Plan { cards, ..Plan::default() }).unwrap();
        }
        let target = folder.path().join(format!("cube-{tiled}.fits"));
        fits::cube::write_cube(&names, &target).unwrap();
        std::fs::read(target).unwrap()
    };
    assert!(cube(true) == cube(false));
}

#[test]
fn damaged_tiles_are_found_and_never_restored() {
    let folder = tempfile::tempdir().unwrap();
    let path = new_tiled_file(folder.path(), 100);
    let good = std::fs::read(&path).unwrap();
    let first = read_header(&path).unwrap().length();
    for at in [first, first + 400, first + 2000] {
        let mut bad = good.clone();
        bad[at] ^= 0x10;
        std::fs::write(&path, &bad).unwrap();
        let refused = fits::restore::plain_file(&path).unwrap_err().to_string();
        assert!(refused.contains("DATASUM"), "{refused}");
    }
    std::fs::write(&path, &good[..good.len() - 2880]).unwrap();
    assert!(fits::restore::plain_file(&path).unwrap_err().to_string().contains("cut short"));
}
