//! Profiles on headers as the archive node writes them, and copies in folders in which things go wrong.

use std::fs;
use std::path::{Path, PathBuf};

use super::*;
use crate::checksum;

mod hostile;
mod moments;

const LIGHT: [&str; 24] = [
    "SIMPLE  =                    T / FITS",
    "BITPIX  =                   16 / bits",
    "NAXIS   =                    2 / axes",
    "NAXIS1  =                    4 / columns",
    "NAXIS2  =                    3 / rows",
    "BZERO   =                32768 / offset",
    "BSCALE  =                    1 / scale",
    "BUNIT   = 'ADU     '           / unit of the pixels",
    "TELESCOP= 'callisto'           / telescope",
    "INSTRUME= 'andor-1 '           / instrument",
    "OBSERVAT= 'paranal '           / site",
    "RADESYS = 'ICRS    '           / frame",
    "OBJECT  = 'O''Neil 1'          / object",
    "EXPTIME =                 30.0 / [s] exposure time",
    "IMAGETYP= 'Light Frame'        / type",
    "DATE-OBS= '2026-11-21T03:12:41.006789' / UTC at start",
    "LST     =              12345.5 / [s] sidereal time",
    "PROGID  = '112.25XK.001'       / programme",
    "SCHEDROW=                    7 / row of the schedule",
    "FRAMEID = '019aa520'           / id",
    "RA      =            346.62201 / [deg]",
    "DEC     =             -5.04133 / [deg]",
    "LONG-OBS=             -70.3976 / [deg] east positive",
    "HISTORY not known at DATE-OBS: DOMEAZ",
];
const SOLUTION: [&str; 15] = [
    "POSANGLE=                 12.5 / [deg]",
    "CTYPE1  = 'RA---TAN'",
    "CTYPE2  = 'DEC--TAN'",
    "WCSAXES =                    2",
    "EQUINOX =               2000.0",
    "CRVAL1  =                346.6",
    "CRVAL2  =                 -5.0",
    "CRPIX1  =                  2.0",
    "CRPIX2  =                  1.5",
    "CD1_1   =              -9.7E-5",
    "CD1_2   =               1.0E-6",
    "CD2_1   =               1.0E-6",
    "CD2_2   =               9.7E-5",
    "CUNIT1  = 'deg     '",
    "CUNIT2  = 'deg     '",
];

fn list(records: &[&str]) -> CardList {
    let text: String = records.iter().chain([&"END"]).map(|record| format!("{record:80}")).collect();
    let bytes = format!("{text:width$}", width = text.len().div_ceil(2880) * 2880).into_bytes();
    CardList::read(bytes.as_slice()).unwrap().unwrap().0
}

fn bias() -> Vec<&'static str> {
    let mut records = LIGHT.to_vec();
    records.retain(|record| !["RA ", "DEC ", "OBJECT"].iter().any(|begins| record.starts_with(begins)));
    records
        .iter_mut()
        .filter(|record| record.starts_with("IMAGETYP"))
        .for_each(|record| *record = "IMAGETYP= 'Bias Frame'");
    records
}

/// A file with these cards, twelve pixels, and the right sums.
fn file(folder: &Path, name: &str, records: &[&str]) -> PathBuf {
    file_of(folder, name, records, (0..24).map(|n| n * 11).collect())
}

/// A file with these cards and the right sums; zeros fill the last block of its data.
fn file_of(folder: &Path, name: &str, records: &[&str], mut data: Vec<u8>) -> PathBuf {
    data.resize(data.len().next_multiple_of(2880), 0);
    let path = folder.join(name);
    fs::write(&path, hdu_of(records, data)).unwrap();
    path
}

/// A header with the right sums, and its data, which is whole blocks.
fn hdu_of(records: &[&str], data: Vec<u8>) -> Vec<u8> {
    let mut cards = list(records);
    let set = |cards: &mut CardList, keyword: &str, text: String| {
        cards.set(CardEntry::new(keyword, Value::Text(text), "").unwrap());
    };
    set(&mut cards, "DATASUM", checksum::sum(&data).to_string());
    set(&mut cards, "CHECKSUM", "0".repeat(16));
    let sum = checksum::add(checksum::sum(&cards.to_bytes()), checksum::sum(&data));
    set(&mut cards, "CHECKSUM", checksum::encode(!sum));
    [cards.to_bytes(), data].concat()
}

fn profile(name: ProfileName) -> Profile {
    Profile::load(name).unwrap()
}

/// Folders of a file and of its copies.
fn folders() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("copies");
    fs::create_dir(&target).unwrap();
    (folder, target)
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn every_embedded_profile_can_be_used_and_asks_for_nothing_that_is_not_computed() {
    for name in PROFILES {
        let profile = profile(name);
        assert_eq!(name.word().parse(), Ok(name));
        for rule in &profile.keyword {
            assert!(rule.range.is_none_or(|[low, high]| low <= high), "{name} {}", rule.name);
            for source in rule.from.iter().filter(|source| source.starts_with('@')) {
                assert!(computed::COMPUTED.iter().any(|(known, ..)| known == source), "{name}: {source}");
            }
            if let Some(value) = &rule.value {
                let card = CardEntry::new(&rule.name, value.value(), &rule.comment).unwrap();
                let mut cards = list(&LIGHT);
                cards.set(card);
                let found = check::violations(&cards, &profile);
                let wrong = found.iter().find(|violation| violation.keyword == rule.name && violation.found.is_some());
                assert!(wrong.is_none() || rule.when != When::Always, "{name}: {wrong:?}");
            }
        }
    }
    assert_eq!(
        "esa".parse::<ProfileName>().unwrap_err().to_string(),
        "\"esa\" is no profile; expected astra, plain, eso or lco"
    );
    assert!(page().unwrap().contains("| `BLKUID` | all | `BLKUID`, else `@block` |"));
}

#[test]
fn lco_gets_its_names_and_its_forms_of_values() {
    let (folder, target) = folders();
    let source = file(folder.path(), "andor_O-Neil.fits", &[&LIGHT[..], &SOLUTION[..]].concat());
    let made = deliver_copy(&source, &target, &profile(ProfileName::Lco), &[]).unwrap();
    assert!(!made.was_there);
    assert_eq!(names(&target), ["paranalcallisto-andor1-20261120-031241006-e00.fits"]);
    let cards = CardList::read(fs::File::open(&made.path).unwrap()).unwrap().unwrap().0;
    assert_eq!(cards.text("PROPID"), Some("112.25XK.001"));
    assert_eq!(cards.text("RA"), Some("23:06:29.2824"));
    assert_eq!(cards.text("DEC"), Some("-05:02:28.788"));
    assert_eq!(cards.text("OBSTYPE"), Some("EXPOSE"));
    assert_eq!(cards.text("UTSTOP"), Some("03:13:11.006"));
    assert_eq!(cards.number("RLEVEL"), Some(0.0));
    // 2026-11-20 is MJD 61364.
    assert_eq!(cards.number("BLKUID"), Some(613_640_007.0));
    assert!(cards.entries.iter().any(|entry| entry.bytes().starts_with(b"HISTORY not known")));
    assert_eq!(check(&made.path, &profile(ProfileName::Lco)).unwrap(), []);
    assert_eq!(fs::read(&source).unwrap()[2880 * 2..], fs::read(&made.path).unwrap()[made.bytes as usize - 2880..]);
}

#[test]
fn eso_gets_hierarchical_keywords_and_nothing_that_its_validator_refuses() {
    let (folder, target) = folders();
    let old = ["EPOCH   =               2000.0", "VENDOR  = 'left over'"];
    let source = file(folder.path(), "a.fits", &[&LIGHT[..], &old, &SOLUTION[..]].concat());
    let instrument = [("INSTRUME".to_owned(), "SPECULOOS1".to_owned())];
    let made = deliver_copy(&source, &target, &profile(ProfileName::Eso), &instrument).unwrap();
    assert_eq!(names(&target), ["SPECULOOS1.2026-11-21T03_12_41.006.fits"]);
    let cards = CardList::read(fs::File::open(&made.path).unwrap()).unwrap().unwrap().0;
    assert_eq!(cards.text("ESO OBS PROG ID"), Some("112.25XK.001"));
    assert_eq!(cards.text("ESO DPR CATG"), Some("SCIENCE"));
    assert_eq!(cards.text("ESO INS NAME"), Some("SPECULOOS1"));
    assert_eq!(cards.text("BUNIT"), Some("adu"));
    assert_eq!(cards.number("PA"), Some(12.5));
    assert_eq!(cards.number("UTC"), Some(11561.006789));
    assert_eq!(cards.number("LST"), Some(12345.5));
    assert_eq!(cards.text("DATE-END"), Some("2026-11-21T03:13:11.006789"));
    assert_eq!(cards.text("ORIGFILE"), Some("a.fits"));
    for gone in ["EPOCH", "VENDOR", "HISTORY", "PROGID", "POSANGLE"] {
        assert!(cards.entries.iter().all(|entry| entry.keyword != gone), "{gone}");
    }
    let place = |keyword: &str| cards.entries.iter().position(|entry| entry.keyword == keyword).unwrap();
    assert!(
        cards
            .entries
            .iter()
            .filter(|entry| is_world(&entry.keyword))
            .all(|entry| place(&entry.keyword) >= place("WCSAXES"))
    );
    assert!(place("BZERO") < place("DATE-OBS"));
    assert_eq!(check(&made.path, &profile(ProfileName::Eso)).unwrap(), []);
}

#[test]
fn calibration_frames_get_pixel_coordinates_for_eso_and_the_public_proposal_for_lco() {
    let (folder, target) = folders();
    let mut records = bias();
    let source = file(folder.path(), "b.fits", &records);
    let made = deliver_copy(&source, &target, &profile(ProfileName::Eso), &[]).unwrap();
    let cards = CardList::read(fs::File::open(&made.path).unwrap()).unwrap().unwrap().0;
    assert_eq!(
        (cards.text("CTYPE1"), cards.number("PC2_2"), cards.number("PC1_2")),
        (Some("PIXEL"), Some(1.0), Some(0.0))
    );
    assert_eq!((cards.text("ESO DPR TYPE"), cards.text("ESO DPR CATG")), (Some("BIAS"), Some("CALIB")));
    records.retain(|record| !record.starts_with("PROGID"));
    let source = file(folder.path(), "c.fits", &records);
    let made = deliver_copy(&source, &target, &profile(ProfileName::Lco), &[]).unwrap();
    assert!(made.path.to_string_lossy().ends_with("-031241006-b00.fits"), "{made:?}");
    let cards = CardList::read(fs::File::open(&made.path).unwrap()).unwrap().unwrap().0;
    assert_eq!((cards.text("PROPID"), cards.text("OBSTYPE")), (Some("calibrate"), Some("BIAS")));
}

#[test]
fn the_profile_astra_delivers_a_file_to_the_byte_under_its_own_name() {
    let (folder, target) = folders();
    let source = file(folder.path(), "my frame é.fits", &LIGHT);
    let made = deliver_copy(&source, &target, &profile(ProfileName::Astra), &[]).unwrap();
    assert_eq!(made.path, target.join("my frame é.fits"));
    assert!(fs::read(&source).unwrap() == fs::read(&made.path).unwrap());
    assert_eq!(check(&made.path, &profile(ProfileName::Astra)).unwrap(), []);
}

#[test]
fn a_copy_that_its_archive_would_refuse_is_not_written() {
    let (folder, target) = folders();
    let mut records = LIGHT.to_vec();
    records.retain(|record| !record.starts_with("PROGID") && !record.starts_with("LST"));
    let source = file(folder.path(), "a.fits", &records);
    let error = deliver_copy(&source, &target, &profile(ProfileName::Eso), &[]).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("LST is missing; expected a number from 0 to 86400"), "{text}");
    assert!(text.contains("ESO OBS PROG ID is missing") && text.contains("give the row of the schedule"), "{text}");
    assert!(names(&target).is_empty());
}

#[test]
fn what_a_copy_mends_is_told_apart_from_what_its_archive_would_refuse() {
    let (folder, lco) = (tempfile::tempdir().unwrap(), profile(ProfileName::Lco));
    let whole = file(folder.path(), "a.fits", &LIGHT);
    let found = check_copy(&whole, &lco).unwrap();
    assert!(found.left.is_empty() && !found.mended.is_empty(), "{found:?}");
    assert_eq!(found.mended, check(&whole, &lco).unwrap());
    let mut records = LIGHT.to_vec();
    records.retain(|record| !record.starts_with("PROGID"));
    let keywords = |found: &[Violation]| found.iter().map(|one| one.keyword.clone()).collect::<Vec<_>>();
    let without = check_copy(&file(folder.path(), "b.fits", &records), &lco).unwrap();
    assert_eq!(keywords(&without.left), ["PROPID"], "nobody's proposal is made up");
    assert!(!without.mended.is_empty() && !keywords(&without.mended).contains(&"PROPID".to_owned()));
    // The copy of the profile astra is the file: it mends nothing.
    let twice = [&LIGHT[..], &["FRAMEID = 'again'"]].concat();
    let astra = check_copy(&file(folder.path(), "c.fits", &twice), &profile(ProfileName::Astra)).unwrap();
    assert!(!astra.left.is_empty() && astra.mended.is_empty(), "{astra:?}");
    // A damaged file gets no copy.
    let mut bytes = fs::read(&whole).unwrap();
    let first_pixel = bytes.len() - 2880;
    bytes[first_pixel] ^= 1;
    fs::write(&whole, bytes).unwrap();
    assert_eq!(keywords(&check_copy(&whole, &lco).unwrap().left), ["DATASUM", "CHECKSUM"]);
}

#[test]
fn nothing_is_overwritten_and_the_same_copy_is_found_again() {
    let (folder, target) = folders();
    let source = file(folder.path(), "a.fits", &LIGHT);
    let lco = profile(ProfileName::Lco);
    let first = deliver_copy(&source, &target, &lco, &[]).unwrap();
    let before = fs::read(&first.path).unwrap();
    let again = deliver_copy(&source, &target, &lco, &[]).unwrap();
    assert_eq!((again.was_there, &again.path, again.bytes), (true, &first.path, before.len() as u64));
    let mut other = before.clone();
    *other.last_mut().unwrap() = 1;
    fs::write(&first.path, &other).unwrap();
    let refused = deliver_copy(&source, &target, &lco, &[]).unwrap_err();
    assert!(matches!(refused, DeliveryError::Exists(_)), "{refused}");
    assert!(fs::read(&first.path).unwrap() == other);
    assert_eq!(names(&target).len(), 1, "no part is left");
}

#[test]
fn a_damaged_or_half_written_file_is_not_delivered() {
    let (folder, target) = folders();
    let (source, lco) = (file(folder.path(), "a.fits", &LIGHT), profile(ProfileName::Lco));
    let whole = fs::read(&source).unwrap();
    let mut changed = whole.clone();
    let first_pixel = whole.len() - 2880;
    changed[first_pixel] ^= 1;
    fs::write(&source, &changed).unwrap();
    let text = deliver_copy(&source, &target, &lco, &[]).unwrap_err().to_string();
    assert!(text.contains("is not as it was written: DATASUM is"), "{text}");
    assert_eq!(check(&source, &lco).unwrap().iter().filter(|found| SUMS.contains(&found.keyword.as_str())).count(), 2);
    for (bytes, words) in [
        (&whole[..whole.len() - 2000], "is cut short"),
        (&whole[..1000], "expected a card END"),
        (&b""[..], "is empty"),
        (&b"\x1f\x8b\x08 packed"[..], "is packed by gzip"),
        (&b"no FITS at all"[..], "does not begin with SIMPLE"),
    ] {
        fs::write(&source, bytes).unwrap();
        let text = deliver_copy(&source, &target, &lco, &[]).unwrap_err().to_string();
        assert!(text.contains(words), "{text}");
        assert!(check(&source, &lco).is_err());
    }
    assert!(names(&target).is_empty());
}

#[test]
fn an_old_part_of_a_killed_program_goes_and_a_young_one_stays() {
    let (folder, target) = folders();
    let source = file(folder.path(), "a.fits", &LIGHT);
    let (old, young) = (target.join(".a.fits.1-0.part"), target.join(".a.fits.2-0.part"));
    fs::write(&young, "half").unwrap();
    fs::write(&old, "half").unwrap();
    let long_ago = std::time::SystemTime::now() - std::time::Duration::from_secs(7200);
    fs::File::options().write(true).open(&old).unwrap().set_modified(long_ago).unwrap();
    deliver_copy(&source, &target, &profile(ProfileName::Astra), &[]).unwrap();
    assert_eq!(names(&target), [".a.fits.2-0.part", "a.fits"]);
}

#[test]
fn a_target_that_cannot_be_written_is_named() {
    let (folder, _) = folders();
    let source = file(folder.path(), "a.fits", &LIGHT);
    let error = deliver_copy(&source, &folder.path().join("none"), &profile(ProfileName::Lco), &[]).unwrap_err();
    assert!(error.to_string().starts_with("cannot create") && error.to_string().contains("none"), "{error}");
    for (keyword, value) in
        [("site id", "x"), ("SITEID", "Cerro Ara\u{f1}a"), ("NAXIS1", "5"), ("CHECKSUM", "0"), ("", "x")]
    {
        let bad = [(keyword.to_owned(), value.to_owned())];
        let error = deliver_copy(&source, folder.path(), &profile(ProfileName::Lco), &bad).unwrap_err();
        assert!(error.to_string().contains("expected a FITS keyword"), "{error}");
    }
    assert_eq!(names(folder.path()).len(), 2, "no copy and no part of one");
}

#[test]
fn coordinates_in_two_forms_and_keywords_twice_are_found() {
    let both = [
        &LIGHT[..],
        &["CDELT2  =                  1.0"],
        &SOLUTION[..],
        &["CDELT1  =                  1.0", "PC1_1   =                  1.0", "FRAMEID = 'again'"],
    ]
    .concat();
    let found = check::violations(&list(&both), &profile(ProfileName::Astra));
    let words: Vec<String> = found.iter().map(Violation::to_string).collect();
    assert!(
        words.iter().any(|text| text.starts_with("PC1_1 is there next to CD1_1; expected PCi_j or CDi_j")),
        "{words:?}"
    );
    assert!(words.iter().any(|text| text.starts_with("FRAMEID is there twice")), "{words:?}");
    assert!(words.iter().any(|text| text.starts_with("WCSAXES is behind CDELT2")), "{words:?}");
}

#[test]
fn an_evening_is_that_of_local_noon_to_noon() {
    let at = |time: &str, longitude: &str| {
        let (date, place) = (format!("DATE-OBS= '{time}'"), format!("LONG-OBS= {longitude}"));
        computed::computed("@day_obs", &list(&[&date, &place]), "")
    };
    let day = |text: &str| Some(Value::Text(text.to_owned()));
    // Noon at 70.4 degrees west is 16:41 UTC.
    assert_eq!(at("2026-11-21T16:40:00", "-70.4"), day("20261120"));
    assert_eq!(at("2026-11-21T16:43:00", "-70.4"), day("20261121"));
    assert_eq!(at("2026-11-21T23:59:59.999", "0.0"), day("20261121"));
    assert_eq!(at("2026-11-21T03:00:00", "150.0"), day("20261121"));
    assert_eq!(at("2026-11-21T01:00:00", "150.0"), day("20261120"));
    // NIGHT is what the schedule's night was; another text under that keyword is a site's own.
    let with_night = |night: &str| {
        let night = format!("NIGHT   = '{night}'");
        computed::computed("@day_obs", &list(&["DATE-OBS= '2026-11-21T03:00:00'", "LONG-OBS= 150.0", &night]), "")
    };
    assert_eq!((with_night("20261120"), with_night("first")), (day("20261120"), day("20261121")));
    assert_eq!(computed::computed("@day_obs", &list(&["DATE-OBS= 'yesterday'", "LONG-OBS= 0.0"]), ""), None);
}

#[test]
fn eso_gets_adu_only_of_frames_that_are_in_adu_or_name_no_unit() {
    let (folder, target) = folders();
    let eso = profile(ProfileName::Eso);
    let with_unit = |unit: Option<&'static str>| {
        let mut records = LIGHT.to_vec();
        records.retain(|record| !record.starts_with("BUNIT"));
        records.extend(unit);
        list(&records)
    };
    for unit in [None, Some("BUNIT   = 'adu     '"), Some("BUNIT   = 'ADU     '")] {
        assert_eq!(convert(&with_unit(unit), "a.fits", &eso).text("BUNIT"), Some("adu"), "{unit:?}");
    }
    let mut records = LIGHT.to_vec();
    records.retain(|record| !record.starts_with("BUNIT"));
    records.push("BUNIT   = 'electron'");
    let source = file(folder.path(), "a.fits", &records);
    let text = deliver_copy(&source, &target, &eso, &[]).unwrap_err().to_string();
    assert!(text.contains("BUNIT is 'electron'; expected adu"), "{text}");
}

#[test]
fn a_frame_that_lco_would_show_to_everybody_at_once_is_named() {
    let (folder, lco) = (tempfile::tempdir().unwrap(), profile(ProfileName::Lco));
    let found = |records: &[&str], values: &[(&str, &str)]| {
        let source = file(folder.path(), "a.fits", records);
        let values: Vec<_> = values.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect();
        plan_copy(&source, &lco, &values).unwrap().warnings
    };
    assert_eq!(found(&LIGHT, &[]), [""; 0]);
    let calib = found(&LIGHT, &[("PROPID", "calibrate")]);
    assert!(calib.len() == 1 && calib[0].contains("PROPID is 'calibrate'"), "{calib:?}");
    assert!(found(&LIGHT, &[("L1PUBDAT", "2026-11-21T04:00:00")])[0].contains("L1PUBDAT"));
    assert_eq!(found(&LIGHT, &[("L1PUBDAT", "2027-11-21T04:00:00")]), [""; 0]);
    let mut focus = LIGHT.to_vec();
    focus.push("ASTRATYP= 'autofocus'");
    assert!(found(&focus, &[])[0].contains("OBSTYPE is 'EXPERIMENTAL'"));
    // That calibration frames are public is what their archive is for.
    assert_eq!(found(&bias(), &[]), [""; 0]);
}

/// ocs-archive refuses a bias without one, too, and stores texts such as N/A as no text.
#[test]
fn a_calibration_frame_needs_a_proposal_at_lco_and_one_with_calib_is_right() {
    let (folder, target) = folders();
    let lco = profile(ProfileName::Lco);
    for (card, is_right, delivered) in [
        ("", false, "calibrate"),
        ("PROPID  = '        '", false, "calibrate"),
        ("PROPID  = 'N/A'", false, "calibrate"),
        ("PROPID  = 'UNKNOWN'", false, "calibrate"),
        ("PROPID  = 'calib'", true, "calib"),
        ("PROPID  = 'LCO2026B-001'", true, "LCO2026B-001"),
    ] {
        let mut records = bias();
        records.retain(|record| !record.starts_with("PROGID"));
        records.extend(Some(card).filter(|card| !card.is_empty()));
        let source = file(folder.path(), "a.fits", &records);
        let found = check(&source, &lco).unwrap();
        assert_eq!(found.iter().all(|violation| violation.keyword != "PROPID"), is_right, "{card}: {found:?}");
        assert_eq!(warnings(&source, &lco).unwrap(), [""; 0], "{card}");
        let made = deliver_copy(&source, &target, &lco, &[]).unwrap();
        let copied = CardList::read(fs::File::open(&made.path).unwrap()).unwrap().unwrap().0;
        assert_eq!(copied.text("PROPID"), Some(delivered), "{card}");
        assert_eq!(check(&made.path, &lco).unwrap(), [], "{card}");
        fs::remove_file(made.path).unwrap();
    }
    // Nobody else's proposal is made up for a frame of the sky; the programme of its row is the next to ask.
    let with = |card: &'static str| [moments::changed(card, "PROGID"), vec!["PROPID  = 'UNSPECIFIED'"]].concat();
    let refused = deliver_copy(&file(folder.path(), "b.fits", &with("")), &target, &lco, &[]).unwrap_err().to_string();
    assert!(refused.contains("PROPID is missing; expected a text, not N/A or UNSPECIFIED"), "{refused}");
    let made = deliver_copy(&file(folder.path(), "b.fits", &with("PROGID  = 'P-1'")), &target, &lco, &[]).unwrap();
    let copied = CardList::read(fs::File::open(&made.path).unwrap()).unwrap().unwrap().0;
    assert_eq!(copied.text("PROPID"), Some("P-1"));
    for keyword in ["INSTRUME", "SITEID", "TELID"] {
        let card = format!("{keyword:<8}= 'UNKNOWN'");
        let found = moments::words(&moments::changed(&card, keyword), ProfileName::Lco);
        assert!(found.iter().any(|text| text.starts_with(&format!("{keyword} is 'UNKNOWN'; expected"))), "{found:?}");
    }
}

#[test]
fn the_plan_of_a_copy_is_what_the_copy_becomes() {
    let (folder, target) = folders();
    let source = file(folder.path(), "a.fits", &LIGHT);
    for name in PROFILES {
        let plan = plan_copy(&source, &profile(name), &[]).unwrap();
        let copy = deliver_copy(&source, &target, &profile(name), &[]).unwrap();
        assert_eq!(copy.path, target.join(plan.name));
    }
    let eso = profile(ProfileName::Eso);
    assert!(check_given(&eso, "INSTRUME", "SPECULOOS1").is_ok());
    for (keyword, value) in
        [("NAXIS", "2"), ("instrume", "A"), ("ORIGIN", "\u{e9}"), ("CHECKSUM", "0"), ("TOOLONGKEY", "1")]
    {
        assert!(check_given(&eso, keyword, value).is_err(), "{keyword}");
    }
}
