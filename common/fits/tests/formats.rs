//! Files that cfitsio wrote, of every type and packing, read back value by value.
#![allow(clippy::unwrap_used, clippy::panic)] // Helpers of tests are tests too.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use fits::{Image, Pixels};
use fitsio::FitsFile;
use fitsio::images::{ImageDescription, ImageType, WriteImage};
use tempfile::TempDir;

const WIDTH: usize = 37;
const HEIGHT: usize = 23;

/// Counts that use all 16 bits.
fn counts() -> Vec<u16> {
    (0..WIDTH * HEIGHT).map(|n| (n * 7919 % 65_536) as u16).collect()
}

/// Writes an image with cfitsio; `how` is its way to name a compression, such as `[compress]`.
fn write<T: WriteImage>(file: &Path, how: &str, kind: ImageType, values: &[T]) -> PathBuf {
    let description = ImageDescription { data_type: kind, dimensions: &[HEIGHT, WIDTH] };
    let name = format!("{}{how}", file.display());
    // With a compression the image is an extension: the primary holds none.
    let mut fits = FitsFile::create(&name).with_custom_primary(&description).open().unwrap();
    let hdu = if how.is_empty() { fits.primary_hdu().unwrap() } else { fits.hdu(1).unwrap() };
    hdu.write_key(&mut fits, "EXPTIME", 12.5).unwrap();
    hdu.write_key(&mut fits, "FILTER", "RGGB").unwrap();
    hdu.write_image(&mut fits, values).unwrap();
    drop(fits);
    file.to_owned()
}

fn check(file: &Path, expected: &Pixels) -> Image {
    let image = fits::read(file).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((image.width_px, image.height_px), (WIDTH, HEIGHT), "{}", file.display());
    assert_eq!(image.header.number("EXPTIME"), Ok(12.5));
    assert_eq!(image.header.text("FILTER"), Ok("RGGB"));
    assert!(image.pixels == *expected, "{}: other pixels", file.display());
    image
}

#[test]
fn sixteen_bits_without_sign_stay_as_they_are_in_every_packing() {
    let folder = TempDir::new().unwrap();
    let expected = Pixels::U16(counts());
    for (name, how) in [
        ("plain.fits", ""),
        ("packed.fits.gz", ""),
        ("rice.fits.fz", "[compress R]"),
        ("gzip.fits.fz", "[compress G 37,5]"),
        ("hcompress.fits.fz", "[compress HS]"),
        ("tiles.fits.fz", "[compress R 16,16]"),
    ] {
        let file = write(&folder.path().join(name), how, ImageType::UnsignedShort, &counts());
        let image = check(&file, &expected);
        assert_eq!((image.bitpix, image.hdu), (16, if how.is_empty() { 1 } else { 2 }), "{name}");
        let first = std::fs::read(&file).unwrap()[..2].to_owned();
        assert_eq!(first == [0x1f, 0x8b], name.ends_with(".gz"), "{name}: cfitsio packs by the name");
        // The same once more inside of bzip2 and of gzip, whatever the name is.
        let mut bzip2 = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
        bzip2.write_all(&std::fs::read(&file).unwrap()).unwrap();
        let packed = folder.path().join(format!("{name}.bz2"));
        std::fs::write(&packed, bzip2.finish().unwrap()).unwrap();
        if !name.ends_with(".gz") {
            check(&packed, &expected);
        }
    }
}

#[test]
fn every_bitpix_is_read_plain_and_in_tiles() {
    let folder = TempDir::new().unwrap();
    let wide: Vec<i64> = counts().iter().map(|count| (i64::from(*count) - 30_000) * 100).collect();
    let floats: Vec<f32> = wide.iter().map(|value| *value as f32).collect();
    // Numbers that f32 holds, so that all comparisons are exact.
    let expected = Pixels::F32(floats.clone());
    for (n, how) in ["", "[compress G]"].iter().enumerate() {
        let path = |name: &str| folder.path().join(format!("{name}{n}.fits"));
        let longs: Vec<i32> = wide.iter().map(|value| *value as i32).collect();
        let file = write(&path("long"), how, ImageType::Long, &longs);
        assert_eq!(check(&file, &expected).bitpix, 32);
        let bytes: Vec<u8> = counts().iter().map(|count| (count >> 8) as u8).collect();
        let file = write(&path("byte"), how, ImageType::UnsignedByte, &bytes);
        assert_eq!(check(&file, &Pixels::U16(bytes.iter().copied().map(u16::from).collect())).bitpix, 8);
        let shorts: Vec<i16> = counts().iter().map(|count| count.cast_signed()).collect();
        let file = write(&path("short"), how, ImageType::Short, &shorts);
        assert_eq!(check(&file, &Pixels::F32(shorts.iter().copied().map(f32::from).collect())).bitpix, 16);
    }
    // cfitsio has no 64-bit tiles, and floats in tiles lose bits unless it is asked to keep them.
    let file = write(&folder.path().join("longlong.fits"), "", ImageType::LongLong, &wide);
    assert_eq!(check(&file, &expected).bitpix, 64);
    let file = write(&folder.path().join("float.fits"), "", ImageType::Float, &floats);
    assert_eq!(check(&file, &expected).bitpix, -32);
    let doubles: Vec<f64> = wide.iter().map(|value| *value as f64).collect();
    let file = write(&folder.path().join("double.fits"), "", ImageType::Double, &doubles);
    assert_eq!(check(&file, &expected).bitpix, -64);
    let file = write(&folder.path().join("float.fits.fz"), "[compress G; q 0]", ImageType::Float, &floats);
    assert_eq!(check(&file, &expected).bitpix, -32);
}

/// A file by hand: cards and data, in whole blocks.
fn by_hand(cards: &[&str], data: &[u8]) -> Vec<u8> {
    let mut bytes: Vec<u8> = cards.iter().chain([&"END"]).flat_map(|card| format!("{card:80}").into_bytes()).collect();
    bytes.resize(bytes.len().div_ceil(2880) * 2880, b' ');
    bytes.extend(data);
    bytes.resize(bytes.len().div_ceil(2880) * 2880, 0);
    bytes
}

const FOUR: [&str; 5] = ["SIMPLE  = T", "BITPIX  = 16", "NAXIS   = 2", "NAXIS1  = 2", "NAXIS2  = 2"];

#[test]
fn numbers_are_scaled_and_blanks_have_no_value() {
    let data: Vec<u8> = [-32_768_i16, -1, 0, 1000].iter().flat_map(|number| number.to_be_bytes()).collect();
    let cards = |more: &[&'static str]| [&FOUR, more].concat();
    let pixels = |cards: &[&str]| fits::parse(Path::new("hand.fits"), by_hand(cards, &data)).unwrap().pixels;
    let scaled = pixels(&cards(&["BSCALE  = 0.5", "BZERO   = 1500."]));
    assert_eq!(scaled, Pixels::F32(vec![-14_884.0, 1499.5, 1500.0, 2000.0]));
    assert_eq!(pixels(&cards(&["BZERO   = 32768"])), Pixels::U16(vec![0, 32_767, 32_768, 33_768]));
    let Pixels::F32(blanked) = pixels(&cards(&["BZERO   = 32768", "BLANK   = -1"])) else { panic!("no floats") };
    assert!(blanked[1].is_nan());
    assert_eq!((blanked[0], blanked[2], blanked[3]), (0.0, 32_768.0, 33_768.0));
}

#[test]
fn the_first_image_with_pixels_is_taken_and_gets_keywords_of_the_primary_header() {
    let mut bytes = by_hand(
        &["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 0", "OBJECT  = 'M 31'", "FILTER  = 'R'", "BZERO   = 9"],
        &[],
    );
    let table = ["XTENSION= 'BINTABLE'", "BITPIX  = 8", "NAXIS   = 2", "NAXIS1  = 3", "NAXIS2  = 2", "PCOUNT  = 5"];
    bytes.extend(by_hand(&[&table[..], &["GCOUNT  = 1", "TFIELDS = 1", "TFORM1  = '3B'"]].concat(), &[7; 11]));
    let image = ["XTENSION= 'IMAGE'", "BITPIX  = 8", "NAXIS   = 3", "NAXIS1  = 3", "NAXIS2  = 1", "NAXIS3  = 1"];
    bytes.extend(by_hand(&[&image[..], &["PCOUNT  = 0", "GCOUNT  = 1", "FILTER  = 'B'"]].concat(), &[1, 2, 3]));
    let image = fits::parse(Path::new("parts.fits"), bytes).unwrap();
    assert_eq!((image.hdu, image.width_px, image.height_px), (3, 3, 1));
    assert_eq!(image.pixels, Pixels::U16(vec![1, 2, 3]));
    assert_eq!((image.header.text("OBJECT"), image.header.text("FILTER")), (Ok("M 31"), Ok("B")));
    assert_eq!(image.header.value("BZERO"), None, "the first part's own scaling");
}

#[test]
fn a_last_block_that_is_not_filled_up_is_enough() {
    let folder = TempDir::new().unwrap();
    for (name, how) in [("short.fits", ""), ("short.fits.fz", "[compress R]")] {
        let file = write(&folder.path().join(name), how, ImageType::UnsignedShort, &counts());
        let mut bytes = std::fs::read(&file).unwrap();
        // Neither the last pixel nor the last byte of the last tile is zero.
        let end = bytes.iter().rposition(|byte| *byte != 0).unwrap() + 1;
        assert!(end % 2880 != 0, "{name}: no block to shorten");
        bytes.truncate(end);
        std::fs::write(&file, &bytes).unwrap();
        check(&file, &Pixels::U16(counts()));
    }
}
