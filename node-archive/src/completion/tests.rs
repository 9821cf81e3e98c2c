//! A header is the old one or the new one, whenever the kill comes.

use contract::device::camera::Pixel;

use super::*;
use crate::card::{Card, CardValue};
use crate::fits::{FitsFile, Shape};

mod tiled;

fn completer(path: &Path) -> Completer {
    Completer::new(path.parent().unwrap())
}

fn recover(path: &Path) {
    completer(path).recover(path).unwrap();
}

fn complete_file(path: &Path, plan: &Plan) -> Result<(), CompletionError> {
    completer(path).recover(path)?;
    completer(path).complete(path, read_header(path)?, plan)
}

const SHAPE: Shape = Shape { pixel: Pixel::U16, width_px: 50, height_px: 40, planes: 1 };

fn pixels() -> Vec<u8> {
    (0..2000u16).flat_map(|i| (i.wrapping_mul(2741)).to_le_bytes()).collect()
}

fn new_file(folder: &Path, room: usize) -> PathBuf {
    let path = folder.join("a [1] frame.fits"); // Brackets are cfitsio's filter syntax, and must mean nothing.
    let mut fits = FitsFile::create(&path, &SHAPE).unwrap();
    assert!(fits.set(&Card::new("OBJECT", "Rigel".into(), "object")).unwrap());
    assert!(!fits.set(&Card::new("BAD", CardValue::Float(f64::NAN), "")).unwrap());
    fits.reserve(room).unwrap();
    fits.write_pixels(&SHAPE, &pixels()).unwrap();
    fits.write_checksums().unwrap();
    fits.close().unwrap();
    path
}

fn plan() -> Plan {
    let mut cards: Vec<Card> =
        (0..60).map(|i| Card::new(&format!("KEY{i}"), CardValue::Float(f64::from(i) / 7.0), "a number")).collect();
    cards.push(Card::new("OBJECT", "O'Brien".into(), "renamed"));
    let history = vec!["not known at DATE-OBS: HUMIDITY".to_owned()];
    Plan { cards, history, ..Plan::default() }
}

/// Ones' complement sum over the file's 32-bit words, which CHECKSUM makes all ones.
fn is_checksum_right(bytes: &[u8]) -> bool {
    let mut sum: u64 = bytes.chunks(4).map(|word| u64::from(u32::from_be_bytes(word.try_into().unwrap()))).sum();
    while sum >> 32 != 0 {
        sum = (sum & 0xffff_ffff) + (sum >> 32);
    }
    sum == 0xffff_ffff
}

fn data_of(path: &Path) -> Vec<u8> {
    let start = read_header(path).unwrap().length();
    std::fs::read(path).unwrap()[start..].to_vec()
}

fn assert_complete(path: &Path, data: &[u8]) {
    let header = read_header(path).unwrap();
    assert_eq!(header.value("KEY59").unwrap().parse::<f64>().unwrap(), 59.0 / 7.0);
    assert_eq!(header.value("OBJECT").unwrap(), "O'Brien");
    assert_eq!(header.cards().filter(|card| card.starts_with("HISTORY not known")).count(), 1);
    assert_eq!(header.cards().filter(|card| card.starts_with("OBJECT")).count(), 1);
    assert_eq!(data_of(path), data);
    assert!(is_checksum_right(&std::fs::read(path).unwrap()));
    assert!(!journal_of(path).exists());
}

#[test]
fn a_new_file_reads_back_as_it_was_given() {
    let folder = tempfile::tempdir().unwrap();
    let path = new_file(folder.path(), 100);
    let header = read_header(&path).unwrap();
    assert_eq!(header.value("OBJECT").unwrap(), "Rigel");
    assert_eq!(
        (header.value("BITPIX").unwrap(), header.value("BZERO").unwrap()),
        ("16".to_owned(), "32768".to_owned())
    );
    assert!(header.keywords().contains("DATASUM") && !header.keywords().contains("BAD"));
    assert!(is_checksum_right(&std::fs::read(&path).unwrap()));
    // An independent reader; brackets in the name are for cfitsio's own syntax, so it gets a plain one.
    let plain = folder.path().join("plain.fits");
    std::fs::copy(&path, &plain).unwrap();
    let mut file = fitsio::FitsFile::open(&plain).unwrap();
    let image: Vec<u16> = file.primary_hdu().unwrap().read_image(&mut file).unwrap();
    assert_eq!(image.iter().flat_map(|pixel| pixel.to_le_bytes()).collect::<Vec<u8>>(), pixels());
}

#[test]
fn all_pixel_types_and_planes_are_written() {
    let folder = tempfile::tempdir().unwrap();
    for (name, pixel, planes, bitpix) in
        [("i", Pixel::I32, 1, "32"), ("f", Pixel::F64, 1, "-64"), ("c", Pixel::U16, 3, "16")]
    {
        let shape = Shape { pixel, width_px: 3, height_px: 2, planes };
        let path = folder.path().join(name);
        let mut fits = FitsFile::create(&path, &shape).unwrap();
        assert!(fits.write_pixels(&shape, &[0; 5]).is_err(), "too few pixels");
        let bytes: Vec<u8> = (0..shape.bytes().unwrap()).map(|i| (i % 63) as u8).collect();
        fits.write_pixels(&shape, &bytes).unwrap();
        fits.close().unwrap();
        let header = read_header(&path).unwrap();
        assert_eq!(header.value("BITPIX").unwrap(), bitpix);
        assert_eq!(header.value("NAXIS").unwrap(), if planes == 1 { "2" } else { "3" });
        assert_eq!(header.value("NAXIS3"), (planes > 1).then(|| planes.to_string()));
        // Big endian on disk.
        if pixel == Pixel::I32 {
            assert_eq!(data_of(&path)[..4], [bytes[3], bytes[2], bytes[1], bytes[0]]);
        }
    }
    assert!(FitsFile::create(&folder.path().join("i"), &SHAPE).is_err(), "an existing file is not replaced");
    assert!(FitsFile::create(&folder.path().join("z"), &Shape { width_px: 0, ..SHAPE }).is_err());
    assert!(FitsFile::create(&folder.path().join("no/such/folder"), &SHAPE).is_err());
}

#[test]
fn completing_in_place_moves_no_pixel_and_twice_is_as_good_as_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = new_file(folder.path(), 100);
    let (data, length) = (data_of(&path), std::fs::metadata(&path).unwrap().len());
    complete_file(&path, &plan()).unwrap();
    assert_complete(&path, &data);
    assert_eq!(std::fs::metadata(&path).unwrap().len(), length);
    let once = std::fs::read(&path).unwrap();
    complete_file(&path, &plan()).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), once);
}

#[test]
fn a_frame_that_is_solved_again_without_distortion_keeps_no_term_of_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    let path = new_file(folder.path(), 100);
    let data = data_of(&path);
    let text = |keyword: &str, value: &str| Card::new(keyword, value.into(), "");
    let number = |keyword: &str| Card::new(keyword, CardValue::Float(2e-9), "");
    let bent = vec![text("CTYPE1", "RA---TAN-SIP"), number("A_3_0"), number("BP_1_0"), number("A_GAIN")];
    complete_file(&path, &Plan { cards: bent, own_keywords: vec!["CTYPE1"], ..plan() }).unwrap();
    assert!(read_header(&path).unwrap().keywords().contains("A_3_0"));
    // A plan that knows nothing of solutions takes nothing away.
    complete_file(&path, &plan()).unwrap();
    assert!(read_header(&path).unwrap().keywords().contains("BP_1_0"));
    let plain = vec![text("CTYPE1", "RA---TAN")];
    complete_file(&path, &Plan { cards: plain, own_keywords: vec!["CTYPE1"], ..plan() }).unwrap();
    let header = read_header(&path).unwrap();
    assert_eq!(header.value("CTYPE1").unwrap(), "RA---TAN");
    let present = ["A_3_0", "BP_1_0", "A_GAIN", "KEY59"].map(|keyword| header.keywords().contains(keyword));
    assert_eq!(present, [false, false, true, true]);
    assert_eq!(data_of(&path), data);
    assert!(is_checksum_right(&std::fs::read(&path).unwrap()));
}

#[test]
fn a_header_without_room_is_completed_in_a_new_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = new_file(folder.path(), 0);
    #[cfg(unix)]
    std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o640)).unwrap();
    let (data, before) = (data_of(&path), std::fs::metadata(&path).unwrap());
    complete_file(&path, &plan()).unwrap();
    assert_complete(&path, &data);
    let after = std::fs::metadata(&path).unwrap();
    assert!(after.len() > before.len());
    assert_eq!(after.permissions(), before.permissions(), "it is as open to others as before");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left next to it");
}

#[test]
fn a_kill_at_any_step_leaves_the_old_header_or_the_new_one() {
    let folder = tempfile::tempdir().unwrap();
    killed_at_any_step(folder.path(), new_file(folder.path(), 100));
    killed_at_any_step(folder.path(), tiled::new_tiled_file(folder.path(), 100));
}

fn killed_at_any_step(folder: &Path, path: PathBuf) {
    let (data, old) = (data_of(&path), std::fs::read(&path).unwrap());
    complete_file(&path, &plan()).unwrap();
    let new = std::fs::read(&path).unwrap();
    let header = &new[..read_header(&path).unwrap().length()];
    let journal = entry(&path, header);

    // Killed while the journal was written, after any number of bytes, over one of another file or over nothing.
    let before = entry(&folder.join("b.fits"), &old[..header.len()]);
    std::fs::write(&path, &old).unwrap();
    for length in (0..journal.len()).step_by(97) {
        for rest in [&before[length.min(before.len())..], &[]] {
            std::fs::write(journal_of(&path), [&journal[..length], rest].concat()).unwrap();
            recover(&path);
            assert_eq!(std::fs::read(&path).unwrap(), old, "{length} bytes of journal");
        }
    }

    // Killed while the new header was written over the old one, after any number of bytes.
    for length in (0..=header.len()).step_by(131) {
        std::fs::write(journal_of(&path), &journal).unwrap();
        let mut torn = old.clone();
        torn[..length].copy_from_slice(&header[..length]);
        std::fs::write(&path, &torn).unwrap();
        recover(&path);
        assert_complete(&path, &data);
    }

    // Killed before the journal was given back, and completed again.
    std::fs::write(journal_of(&path), &journal).unwrap();
    complete_file(&path, &plan()).unwrap();
    assert_complete(&path, &data);
}

#[test]
fn one_journal_serves_file_after_file() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join(PART_FOLDER)).unwrap();
    let first = new_file(folder.path(), 100);
    let second = folder.path().join("b.fits");
    std::fs::copy(&first, &second).unwrap();
    let data = data_of(&first);
    for path in [&first, &second] {
        complete_file(path, &plan()).unwrap();
        assert_complete(path, &data);
    }
    let spare = folder.path().join(PART_FOLDER).join("spare.header");
    // It moved to the next file, and the kill came before it was written anew.
    let bytes = std::fs::read(&second).unwrap();
    std::fs::rename(&spare, journal_of(&first)).unwrap();
    recover(&first);
    assert_eq!(std::fs::read(&second).unwrap(), bytes);
    assert_complete(&first, &data);
    assert!(spare.exists(), "given back");
}

#[test]
fn what_is_no_fits_file_is_refused_and_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.fits");
    assert!(complete_file(&path, &plan()).is_err(), "no file");
    for bytes in [&b""[..], b"hello", &[b' '; 5760]] {
        std::fs::write(&path, bytes).unwrap();
        assert!(matches!(complete_file(&path, &plan()), Err(CompletionError::NoHeader(_))));
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
    }
}
