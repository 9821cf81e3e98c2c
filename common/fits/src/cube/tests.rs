use std::fs;

use super::*;
use crate::checksum;

const SIZE: (usize, usize) = (5, 3);

/// A frame of 16 bits without sign, with these further cards; its pixels count from `first`.
fn frame(folder: &Path, name: &str, first: u16, cards: &[&str]) -> PathBuf {
    let (width, height) = SIZE;
    let pixels: Vec<u8> =
        (0..(width * height) as u16).flat_map(|n| (first.wrapping_add(n) ^ 0x8000).to_be_bytes()).collect();
    let sum = checksum::sum(&[&pixels[..], &[0; 2]].concat());
    let mut all = vec![
        "SIMPLE  =                    T".to_owned(),
        "BITPIX  =                   16".to_owned(),
        "NAXIS   =                    2".to_owned(),
        format!("NAXIS1  = {width:>20}"),
        format!("NAXIS2  = {height:>20}"),
        "BSCALE  =                  1.0".to_owned(),
        "BZERO   =              32768.0".to_owned(),
        format!("DATASUM = '{sum}'"),
    ];
    all.extend(cards.iter().map(|card| (*card).to_owned()));
    all.push("END".to_owned());
    let mut bytes: Vec<u8> = all.iter().flat_map(|card| format!("{card:<80}").into_bytes()).collect();
    bytes.resize(bytes.len().next_multiple_of(2880), b' ');
    bytes.extend(&pixels);
    bytes.resize(bytes.len().next_multiple_of(2880), 0);
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    path
}

fn three(folder: &Path) -> Vec<PathBuf> {
    vec![
        frame(
            folder,
            "a.fits",
            0,
            &[
                "OBJECT  = 'WASP-12 '           / target",
                "DATE-OBS= '2026-11-21T22:00:00'",
                "FWHM    =                  2.5 / [arcsec] width",
                "NSTARS  =                  100",
                "CTYPE1  = 'RA---TAN'",
                "SAFE    =                    T",
                "MIXED   =                    T",
            ],
        ),
        frame(
            folder,
            "b.fits",
            1000,
            &[
                "OBJECT  = 'WASP-12 '           / target",
                "DATE-OBS= '2026-11-21T22:00:01.5'",
                "FWHM    =                    3 / [arcsec] width",
                "CTYPE1  = 'RA---TAN'",
                "SAFE    =                    F",
                "MIXED   =                    7",
            ],
        ),
        frame(
            folder,
            "c.fits",
            65530,
            &[
                "OBJECT  = 'WASP-12 '           / target",
                "DATE-OBS= '2026-11-21T22:00:03'",
                "NSTARS  =                  102",
                "CTYPE1  = 'RA---TAN'",
                "SAFE    =                    F",
                "MIXED   = 'word'",
            ],
        ),
    ]
}

/// The HDUs of a file, each with all its words added up.
fn sums(bytes: &[u8], ends: &[usize]) -> Vec<u32> {
    let begins = std::iter::once(0).chain(ends.iter().copied());
    begins.zip(ends).map(|(begin, end)| checksum::sum(&bytes[begin..*end])).collect()
}

#[test]
fn pixels_are_the_same_bits_and_a_row_has_what_varies() {
    let folder = tempfile::tempdir().unwrap();
    let (frames, target) = (three(folder.path()), folder.path().join("cube.fits"));
    let summary = write_cube(&frames, &target).unwrap();
    let bytes = fs::read(&target).unwrap();
    assert_eq!((summary.frames, summary.columns, summary.bytes), (3, 6, bytes.len() as u64));
    let header = crate::table::primary_header(&target).unwrap();
    assert_eq!(header.whole("NAXIS3").unwrap(), 3);
    assert_eq!(header.text("OBJECT").unwrap(), "WASP-12");
    assert!(header.value("CTYPE1").is_none(), "half a WCS is none");
    let one = 2 * SIZE.0 * SIZE.1;
    for (n, frame) in frames.iter().enumerate() {
        let own = &fs::read(frame).unwrap()[2880..2880 + one];
        assert_eq!(&bytes[2880 + n * one..2880 + (n + 1) * one], own, "{n}");
    }
    // Both HDUs add up to all ones: header of one block, data of one block, header of the table, its data.
    let table_begins = 2 * 2880;
    let table_header =
        bytes[table_begins..].chunks(2880).position(|block| block.windows(80).any(|c| c.starts_with(b"END   ")));
    assert!(table_header.is_some());
    assert_eq!(sums(&bytes, &[table_begins, bytes.len()]), [checksum::WHOLE; 2]);

    let mut table = crate::Table::open(&target).unwrap();
    let numbers: Vec<&str> = table.columns().iter().map(|column| column.name.as_str()).collect();
    assert_eq!(numbers, ["FWHM", "NSTARS", "SAFE"], "three more are text");
    let fwhm = table.column("FWHM").unwrap().clone();
    let rows: Vec<Vec<u8>> = std::iter::from_fn(|| table.next_row().unwrap().map(<[u8]>::to_vec)).collect();
    assert_eq!(rows.len(), 3);
    assert_eq!(rows.iter().map(|row| fwhm.value(row)).collect::<Vec<_>>()[..2], [Some(2.5), Some(3.0)]);
    assert!(fwhm.value(&rows[2]).is_none_or(f64::is_nan), "a frame without stars has no width");
    assert!(rows[0].starts_with(b"2026-11-21T22:00:00  "), "{:?}", String::from_utf8_lossy(&rows[0]));
    assert!(rows[2].ends_with(b"Fword") && rows[1].ends_with(b"F7   ") && rows[0].ends_with(b"TT   "));
}

#[test]
fn what_is_there_is_never_replaced_and_a_failure_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (mut frames, target) = (three(folder.path()), folder.path().join("cube.fits"));
    fs::write(&target, "mine").unwrap();
    assert!(matches!(write_cube(&frames, &target), Err(CubeError::Exists(_))));
    assert_eq!(fs::read(&target).unwrap(), b"mine");
    fs::remove_file(&target).unwrap();

    let mut damaged = fs::read(&frames[1]).unwrap();
    damaged[2880 + 4] ^= 1;
    fs::write(&frames[1], damaged).unwrap();
    let error = write_cube(&frames, &target).unwrap_err().to_string();
    assert!(error.contains("b.fits") && error.contains("DATASUM") && error.contains("leave it out"), "{error}");

    let whole = fs::read(&frames[0]).unwrap();
    fs::write(&frames[0], &whole[..2880 + 7]).unwrap();
    let error = write_cube(&frames[..1], &target).unwrap_err().to_string();
    assert!(error.contains("its pixels end early"), "{error}");
    fs::write(&frames[0], "no FITS").unwrap();
    assert!(write_cube(&frames[..1], &target).unwrap_err().to_string().contains("a.fits"));
    assert!(matches!(write_cube(&[], &target), Err(CubeError::NoFrames)));
    frames.push(folder.path().join("gone.fits"));
    assert!(write_cube(&frames[3..], &target).is_err());
    let left: Vec<String> =
        fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    assert!(left.iter().all(|name| !name.contains("cube")), "{left:?}");
}

#[test]
fn a_frame_of_another_shape_is_refused_with_both_shapes() {
    let folder = tempfile::tempdir().unwrap();
    let mut frames = three(folder.path());
    let other = folder.path().join("other.fits");
    let text = fs::read(&frames[0]).unwrap();
    let text = String::from_utf8_lossy(&text[..2880])
        .replace("NAXIS1  =                    5", "NAXIS1  =                    7");
    fs::write(&other, [text.as_bytes(), &[0; 2880]].concat()).unwrap();
    frames.push(other);
    let error = write_cube(&frames, &folder.path().join("cube.fits")).unwrap_err().to_string();
    assert!(error.contains("7 x 3 px") && error.contains("5 x 3 px"), "{error}");
}

/// The numbers of a column of the table, one per frame.
fn numbers(cube: &Path, name: &str) -> Vec<Option<f64>> {
    let mut table = crate::Table::open(cube).unwrap();
    let rows: Vec<Vec<u8>> = std::iter::from_fn(|| table.next_row().unwrap().map(<[u8]>::to_vec)).collect();
    let column = table.column(name).unwrap_or_else(|| panic!("no column {name}: {:?}", table.columns()));
    rows.iter().map(|row| column.value(row)).collect()
}

/// The pixels of a frame as they are in its file.
fn pixels(frame: &Path) -> Vec<u8> {
    fs::read(frame).unwrap()[2880..2880 + 2 * SIZE.0 * SIZE.1].to_vec()
}

#[test]
fn planes_and_rows_have_the_order_of_the_call() {
    let folder = tempfile::tempdir().unwrap();
    let (frames, target) = (three(folder.path()), folder.path().join("cube.fits"));
    let files: Vec<PathBuf> = [2, 0, 1].into_iter().map(|n: usize| frames[n].clone()).collect();
    write_cube(&files, &target).unwrap();
    let bytes = fs::read(&target).unwrap();
    let all: Vec<u8> = files.iter().flat_map(|file| pixels(file)).collect();
    assert_eq!(bytes[2880..2880 + all.len()], all);
    assert_eq!(numbers(&target, "NSTARS"), [Some(102.0), Some(100.0), None]);
    assert_eq!(numbers(&target, "FWHM"), [None, Some(2.5), Some(3.0)]);
    // The same frame again is a plane and a row of its own.
    let twice = folder.path().join("twice.fits");
    assert_eq!(write_cube(&[files[1].clone(), files[0].clone(), files[1].clone()], &twice).unwrap().frames, 3);
    assert_eq!(numbers(&twice, "NSTARS"), [Some(100.0), Some(102.0), Some(100.0)]);
}

#[test]
fn sums_are_right_wherever_the_last_plane_ends_in_its_block() {
    let folder = tempfile::tempdir().unwrap();
    // 30 bytes each, so that planes begin within words; 96 of them fill a block.
    for count in [1, 2, 3, 95, 96, 97] {
        let files: Vec<PathBuf> = (0..count)
            .map(|n: u16| frame(folder.path(), &format!("{n}.fits"), n * 600, &[&format!("SEQ     = {n}")]))
            .collect();
        let target = folder.path().join(format!("cube{count}.fits"));
        let summary = write_cube(&files, &target).unwrap();
        let bytes = fs::read(&target).unwrap();
        let all: Vec<u8> = files.iter().flat_map(|file| pixels(file)).collect();
        let table_begins = 2880 + all.len().next_multiple_of(2880);
        assert!(bytes[2880..2880 + all.len()] == all, "{count}");
        assert!(bytes[2880 + all.len()..table_begins].iter().all(|byte| *byte == 0), "{count}");
        assert_eq!(sums(&bytes, &[table_begins, bytes.len()]), [checksum::WHOLE; 2], "{count}");
        assert_eq!((summary.frames, summary.bytes), (files.len(), bytes.len() as u64));
        if count > 1 {
            let expected: Vec<Option<f64>> = (0..count).map(|n| Some(f64::from(n))).collect();
            assert_eq!(numbers(&target, "SEQ"), expected);
        }
    }
}

#[test]
fn a_keyword_that_stands_twice_in_a_frame_counts_once() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, cards: &[&str]| frame(folder.path(), name, 0, cards);
    let (one, again) = ("GAIN    =                    1", "GAIN    =                    2");
    let none = file("none.fits", &[]);
    let once = file("once.fits", &[one]);
    let twice = file("twice.fits", &[one, again]);
    let same_twice = file("same.fits", &[one, one]);
    for (number, (files, expected)) in [
        (vec![&none, &twice], vec![None, Some(1.0)]),
        (vec![&none, &same_twice], vec![None, Some(1.0)]),
        (vec![&none, &once, &same_twice], vec![None, Some(1.0), Some(1.0)]),
        (vec![&same_twice, &none, &same_twice], vec![Some(1.0), None, Some(1.0)]),
    ]
    .into_iter()
    .enumerate()
    {
        let target = folder.path().join(format!("cube{number}.fits"));
        write_cube(&files.into_iter().cloned().collect::<Vec<_>>(), &target).unwrap();
        assert_eq!(numbers(&target, "GAIN"), expected, "{number}");
        assert!(crate::table::primary_header(&target).unwrap().value("GAIN").is_none(), "{number}");
    }
    // Where all frames have it, the cube has it once.
    let target = folder.path().join("constant.fits");
    write_cube(&[twice.clone(), once, twice], &target).unwrap();
    let header = crate::table::primary_header(&target).unwrap();
    assert_eq!(header.cards().filter(|(keyword, _)| *keyword == "GAIN").count(), 1);
    assert_eq!(header.whole("GAIN").unwrap(), 1);
}

#[test]
fn long_texts_and_hierarchical_keywords_of_all_frames_are_whole_in_the_cube() {
    let folder = tempfile::tempdir().unwrap();
    let file = |n: u16| {
        let azimuth = format!("HIERARCH ESO TEL AZ = {n}.5 / [deg] azimuth");
        let cards = [
            "HIERARCH ESO TEL ALT = 45.25 / [deg] altitude",
            "NOTE    = 'clouds from &'",
            "CONTINUE  'the west&'",
            "CONTINUE  ', then rain' / all",
            "HISTORY a word of this frame",
            &azimuth,
        ];
        frame(folder.path(), &format!("{n}.fits"), n, &cards)
    };
    let target = folder.path().join("cube.fits");
    write_cube(&[file(7), file(8)], &target).unwrap();
    let header = crate::table::primary_header(&target).unwrap();
    assert_eq!(header.number("ESO TEL ALT").unwrap(), 45.25);
    assert_eq!(header.text("NOTE").unwrap(), "clouds from the west, then rain");
    assert_eq!(numbers(&target, "ESO TEL AZ"), [Some(7.5), Some(8.5)]);
    let bytes = fs::read(&target).unwrap();
    assert!(bytes[..2880].chunks(80).all(|card| !card.starts_with(b"HISTORY")), "of one frame only");
    assert_eq!(sums(&bytes, &[2 * 2880, bytes.len()]), [checksum::WHOLE; 2]);
}

#[test]
fn the_number_that_stands_for_no_value_is_that_of_all_frames() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, cards: &[&str]| frame(folder.path(), name, 0, cards);
    let a = file("a.fits", &["BLANK   =               -32768"]);
    let b = file("b.fits", &["BLANK   =               -32768", "FWHM    = 2.5"]);
    let target = folder.path().join("cube.fits");
    write_cube(&[a.clone(), b], &target).unwrap();
    assert_eq!(crate::table::primary_header(&target).unwrap().whole("BLANK").unwrap(), -32768);
    fs::remove_file(&target).unwrap();
    for (other, words) in [
        (file("zero.fits", &["BLANK   =                    0"]), "BZERO 32768, BLANK 0, and the first"),
        (file("none.fits", &[]), "BZERO 32768, and the first"),
    ] {
        let error = write_cube(&[a.clone(), other], &target).unwrap_err().to_string();
        assert!(error.contains(words) && error.ends_with("BZERO 32768, BLANK -32768"), "{error}");
        assert!(!target.exists());
    }
}

#[test]
fn a_frame_without_a_sum_is_taken_and_a_frame_that_is_no_plain_image_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let good = frame(folder.path(), "good.fits", 0, &[]);
    let changed = |name: &str, old: &str, new: &str| {
        let path = frame(folder.path(), name, 5, &[]);
        let bytes = fs::read(&path).unwrap();
        let header = String::from_utf8(bytes[..2880].to_vec()).unwrap().replacen(old, new, 1);
        assert_eq!(header.len(), 2880, "{old:?} becomes {new:?}");
        fs::write(&path, [header.as_bytes(), &bytes[2880..]].concat()).unwrap();
        path
    };
    let target = folder.path().join("cube.fits");
    let unsummed = changed("unsummed.fits", "DATASUM ", "NOSUM   ");
    assert_eq!(write_cube(&[good.clone(), unsummed], &target).unwrap().frames, 2);
    fs::remove_file(&target).unwrap();
    for (name, old, new, words) in [
        ("cube.fits.in", "NAXIS   =                    2", "NAXIS   =                    3", "it has 3 axes"),
        ("tall.fits", "NAXIS2  =                    3", "NAXIS2  =                    4", "5 x 4 px"),
        ("none.fits", "NAXIS2  =                    3", "NAXIS2  =                    0", "is no image"),
        ("less.fits", "NAXIS2  =                    3", "NAXIS2  =                   -3", "is no image"),
        ("odd.fits", "BITPIX  =                   16", "BITPIX  =                   17", "is no image"),
        ("float.fits", "BITPIX  =                   16", "BITPIX  =                  -32", "BITPIX -32"),
        ("zero.fits", "BZERO   =              32768.0", "BZERO   =                  0.0", "BZERO 0"),
        ("text.fits", "NAXIS1  =                    5", "NAXIS1  = '5                 '", "NAXIS1"),
        ("end.fits", "END", "ENN", "its header ends early"),
        ("begin.fits", "SIMPLE  =", "SIMPLE  :", "it is no plain FITS file"),
    ] {
        let bad = changed(name, old, new);
        let error = write_cube(&[good.clone(), bad], &target).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(words), "{name}: {error}");
        assert!(!target.exists(), "{name}");
    }
    let left = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(left.filter(|name| name.ends_with(".part")).count(), 0);
}

#[test]
fn a_cube_is_written_neither_through_a_link_nor_into_a_folder_that_is_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let frames = three(folder.path());
    let nowhere = folder.path().join("none").join("cube.fits");
    assert!(matches!(write_cube(&frames, &nowhere), Err(CubeError::Write { .. })));
    assert!(matches!(write_cube(&frames, folder.path()), Err(CubeError::Exists(_))));
    assert!(matches!(write_cube(&frames, &frames[0]), Err(CubeError::Exists(_))), "a frame is no target");
    #[cfg(unix)]
    {
        let link = folder.path().join("link.fits");
        std::os::unix::fs::symlink(folder.path().join("nowhere.fits"), &link).unwrap();
        assert!(matches!(write_cube(&frames, &link), Err(CubeError::Exists(_))));
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink() && !folder.path().join("nowhere.fits").exists());
    }
    let names = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(names.filter(|name| name.starts_with('.')).count(), 0, "no part is left");
}

#[test]
fn keywords_that_would_be_one_column_are_two() {
    let folder = tempfile::tempdir().unwrap();
    let one = |name: &str, at: &str, other: &str| {
        frame(folder.path(), name, 0, &[&format!("DATE-OBS= '{at}'"), &format!("DATE_OBS= '{other}'")])
    };
    let frames = [one("a.fits", "2026-11-21T22:00:00", "old"), one("b.fits", "2026-11-21T22:00:01", "odd")];
    let target = folder.path().join("cube.fits");
    write_cube(&frames, &target).unwrap();
    let table = crate::Table::open(&target).unwrap();
    let name = |n: usize| table.header.text(&format!("TTYPE{n}")).unwrap().to_owned();
    assert_eq!([name(1), name(2)], ["DATE_OBS_2", "DATE_OBS"]);
}

#[test]
fn more_keywords_than_columns_are_refused_and_none_is_dropped() {
    let folder = tempfile::tempdir().unwrap();
    let cards = |value: usize| -> Vec<String> { (0..1000).map(|n| format!("KEY{n:<5}= {value:>20}")).collect() };
    let of = |name: &str, value: usize| {
        let cards = cards(value);
        frame(folder.path(), name, 0, &cards.iter().map(String::as_str).collect::<Vec<_>>())
    };
    let (frames, target) = ([of("a.fits", 1), of("b.fits", 2)], folder.path().join("cube.fits"));
    let refused = write_cube(&frames, &target).unwrap_err().to_string();
    assert!(refused.starts_with("1000 keywords") && refused.contains("at most 999 columns"), "{refused}");
    assert!(!target.exists());
}

#[test]
fn the_part_of_a_killed_cube_is_in_nobody_s_way() {
    let folder = tempfile::tempdir().unwrap();
    let (frames, target) = (three(folder.path()), folder.path().join("cube.fits"));
    let young = folder.path().join(format!(".cube.fits.{}.part", std::process::id()));
    let old = folder.path().join(".cube.fits.1.part");
    fs::write(&young, "half").unwrap();
    fs::write(&old, "half").unwrap();
    let before = std::time::SystemTime::now() - std::time::Duration::from_secs(7200);
    fs::File::options().write(true).open(&old).unwrap().set_modified(before).unwrap();
    write_cube(&frames, &target).unwrap();
    assert!(young.exists() && !old.exists(), "one may be of a program that is still at work");
}
