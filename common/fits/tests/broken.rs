//! Files that are no image: each is refused with a message that names the file, the fault and what to do.
#![allow(clippy::unwrap_used, clippy::panic)] // Helpers of tests are tests too.

use std::io::Write as _;
use std::path::Path;

use fits::{Fault, FitsError};
use fitsio::FitsFile;
use fitsio::images::{ImageDescription, ImageType};
use fitsio::tables::{ColumnDataType, ColumnDescription};
use tempfile::TempDir;

fn refused(bytes: &[u8]) -> FitsError {
    match fits::parse(Path::new("night/frame.fits"), bytes.to_vec()) {
        Ok(image) => panic!("taken: {} x {} px", image.width_px, image.height_px),
        Err(error) => {
            assert!(error.to_string().starts_with("night/frame.fits "), "{error}");
            error
        }
    }
}

/// A whole file of cfitsio's; `how` names a compression.
fn image(how: &str, dimensions: &[usize]) -> Vec<u8> {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("image.fits");
    let description = ImageDescription { data_type: ImageType::UnsignedShort, dimensions };
    let name = format!("{}{how}", file.display());
    let mut fits = FitsFile::create(name).with_custom_primary(&description).open().unwrap();
    let hdu = if how.is_empty() { fits.primary_hdu().unwrap() } else { fits.hdu(1).unwrap() };
    let values: Vec<u16> = (0..dimensions.iter().product()).map(|n| (n * 7919 % 65_536) as u16).collect();
    hdu.write_image(&mut fits, &values).unwrap();
    drop(fits);
    std::fs::read(file).unwrap()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(bytes).unwrap();
    packed.finish().unwrap()
}

#[test]
fn the_error_of_a_file_that_is_cut_short_names_the_missing_bytes() {
    let whole = image("", &[60, 80]);
    assert_eq!(whole.len(), 2880 + 4 * 2880);
    let message = refused(&whole[..2880 + 9599]).to_string();
    let expected = "night/frame.fits is cut short: HDU 1 should end at byte 12480, the file has 12479; copy or fetch it \
                    again";
    assert_eq!(message, expected);
    assert!(fits::parse(Path::new("enough.fits"), whole[..2880 + 9600].to_vec()).is_ok());
    for length in [9, 80, 1000, 2879] {
        assert!(matches!(refused(&whole[..length]).fault, Fault::CutShort { .. }), "{length} bytes");
    }
    let packed = image("[compress R]", &[60, 80]);
    for length in [2880 + 100, packed.len() - 2880] {
        assert!(matches!(refused(&packed[..length]).fault, Fault::CutShort { .. }), "{length} bytes of tiles");
    }
    let gzipped = gzip(&whole);
    for length in [5, 100, gzipped.len() - 1] {
        let message = refused(&gzipped[..length]).to_string();
        assert!(message.contains("damaged or cut short (gzip says"), "{message}");
    }
}

#[test]
fn what_is_not_fits_is_recognised_by_its_first_bytes() {
    let reports = |bytes: &[u8], words: &str| {
        let message = refused(bytes).to_string();
        assert!(message.contains(words), "{message}");
    };
    reports(b"", "is empty (0 bytes): copy or fetch it again");
    reports(&gzip(b""), "is empty");
    reports(
        b"\n<!DOCTYPE html><html>404</html>",
        "is a web page (HTML): the download was refused; fetch the file again",
    );
    reports(b"PK\x03\x04", "unzip");
    reports(b"\xff\xd8\xff\xe0 and more", "JPEG");
    reports(b"observatory:\n  name: x", "begins with \"observatory:\\n  n\", expected \"SIMPLE  =\"");
    reports(&gzip(&gzip(b"SIMPLE")), "gzip twice");
    reports(b"BZh91AY&SY not really", "bzip2 says");
    reports(b"SIMPLE : T", "broken card SIMPLE");
    let folder = TempDir::new().unwrap();
    let missing = folder.path().join("none.fits");
    let message = fits::read(&missing).unwrap_err().to_string();
    assert!(message.starts_with(&format!("{} cannot be read: No such file", missing.display())), "{message}");
    let message = fits::read(folder.path()).unwrap_err().to_string();
    assert!(message.contains("cannot be read: Is a directory"), "{message}");
}

#[test]
fn tables_cubes_and_spectra_are_named() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("table.fits");
    let mut fits = FitsFile::create(&file).open().unwrap();
    let column = ColumnDescription::new("RA").with_type(ColumnDataType::Double).create().unwrap();
    fits.create_table("CATALOGUE".to_owned(), &[column]).unwrap();
    drop(fits);
    let message = refused(&std::fs::read(&file).unwrap()).to_string();
    let expected = "night/frame.fits holds no image, only a header without pixels, a table CATALOGUE; give a file with \
                    an image of two axes";
    assert_eq!(message, expected);
    for how in ["", "[compress R]"] {
        let message = refused(&image(how, &[4, 20, 30])).to_string();
        let hdu = if how.is_empty() { 1 } else { 2 };
        assert!(message.contains(&format!("HDU {hdu} has the axes 30 x 20 x 4, expected two, or three")), "{message}");
    }
    let message = refused(&image("", &[100])).to_string();
    assert!(message.contains("HDU 1 has the axes 100, expected two"), "{message}");
}

#[test]
fn damaged_tiles_are_refused_before_they_are_decoded() {
    let mut bytes = image("[compress R]", &[60, 80]);
    let at = |bytes: &[u8], card: &str| bytes.chunks_exact(80).position(|found| found.starts_with(card.as_bytes()));
    // A sum as fpack writes it; cfitsio leaves it out unless asked.
    let end = 2880 + 80 * at(&bytes[2880..], "END").unwrap();
    let data = 2880 * end.div_ceil(2880);
    let sum = |data: &[u8]| {
        let words = data.as_chunks().0.iter().map(|word| u64::from(u32::from_be_bytes(*word)));
        let sum: u64 = words.sum();
        (sum & 0xffff_ffff) + (sum >> 32)
    };
    let card = format!("{:80}{:80}", format!("DATASUM = '{}'", sum(&bytes[data..])), "END");
    assert!(end + 160 <= data, "no room for a card");
    bytes[end..end + 160].copy_from_slice(card.as_bytes());
    assert!(fits::parse(Path::new("whole.fits.fz"), bytes.clone()).is_ok());
    bytes[data + 600] ^= 0x10;
    assert!(matches!(refused(&bytes).fault, Fault::Checksum { hdu: 2, .. }));
}

#[test]
fn headers_that_cannot_be_are_refused() {
    let file = |cards: &[&str]| {
        let mut text: String = cards.iter().map(|card| format!("{card:80}")).collect();
        text = format!("{text:2880}");
        text.into_bytes()
    };
    let reports = |cards: &[&str], words: &str| {
        let message = refused(&file(cards)).to_string();
        assert!(message.contains(words), "{message}");
    };
    reports(&["SIMPLE  = T", "BITPIX  = 16"], "expected a card END");
    reports(&["SIMPLE  = T", "BITPIX  = 12", "NAXIS   = 0", "END"], "BITPIX is 12, expected 8, 16");
    reports(&["SIMPLE  = T", "BITPIX  = 16", "END"], "NAXIS is missing, expected a whole number");
    reports(&["SIMPLE  = T", "BITPIX  = 16", "NAXIS   = 'two'", "END"], "NAXIS is 'two', expected a whole number");
    reports(&["SIMPLE  = T", "BITPIX  = 16", "NAXIS   = -1", "END"], "NAXIS is -1, expected 0 to 999");
    let axes = |n: i64| format!("NAXIS1  = {n}");
    let two = ["SIMPLE  = T", "BITPIX  = 16", "NAXIS   = 2", "NAXIS2  = 9223372036854775807"];
    reports(&[&two[..], &[&axes(i64::MAX), "END"]].concat(), "longer than any file");
    reports(&[&two[..], &[&axes(-5), "END"]].concat(), "NAXIS1 is -5, expected a length");
    let tiles = ["ZIMAGE  = T", "ZBITPIX = 16", "ZNAXIS  = 2", "ZNAXIS1 = 9223372036854775807"];
    let primary = file(&["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 0", "END"]);
    let table = ["XTENSION= 'BINTABLE'", "BITPIX  = 8", "NAXIS   = 2", "NAXIS1  = 8", "NAXIS2  = 1"];
    let bomb = file(&[&table[..], &tiles, &["ZNAXIS2 = 2147483647", "END"]].concat());
    let message = refused(&[primary, bomb, vec![0; 2880]].concat()).to_string();
    assert!(message.contains("too large"), "{message}");
}

/// No byte of a plain image may bring a reader down.
#[test]
fn any_byte_may_be_wrong() {
    let whole = image("", &[3, 4]);
    let mut taken = 0;
    for at in 0..800 {
        for wrong in [0, b' ', b'=', b'9', b'\'', 0xff] {
            let mut bytes = whole.clone();
            bytes[at] = wrong;
            taken += usize::from(fits::parse(Path::new("any.fits"), bytes).is_ok());
        }
    }
    assert!((1..4800).contains(&taken), "{taken} of 4800 were taken");
}

/// cfitsio divides by the lengths of tiles: a zero there must not reach it.
#[test]
fn tiles_that_cannot_be_are_refused_before_they_are_decoded() {
    let whole = image("[compress R 40,30]", &[60, 80]);
    let reports = |keyword: &str, value: &str, words: &str| {
        let mut bytes = whole.clone();
        let card = format!("{keyword:8}=");
        let at = 80 * bytes.chunks_exact(80).rposition(|found| found.starts_with(card.as_bytes())).unwrap();
        bytes[at..at + 80].copy_from_slice(format!("{:80}", format!("{card} {value}")).as_bytes());
        let message = refused(&bytes).to_string();
        assert!(message.contains(words), "{message}");
    };
    reports("ZTILE1", "0", "ZTILE1 is no length up to 80");
    reports("ZTILE2", "61", "ZTILE2 is no length up to 60");
    reports("ZTILE2", "-1", "ZTILE2 is no length up to 60");
    reports("ZTILE1", "20", "NAXIS2 is 4, expected 8 tiles");
    reports("ZNAXIS2", "600", "NAXIS2 is 4, expected 40 tiles");
    reports("ZVAL1", "0", "ZVAL1 is 0, expected one of [16, 32]");
    reports("ZCMPTYPE", "'ZIP_1'", "ZCMPTYPE is 'ZIP_1', expected one of RICE_1");
}
