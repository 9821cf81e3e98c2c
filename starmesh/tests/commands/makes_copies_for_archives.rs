//! `starmesh fits`, as docs/fits.md has it, on a file that cfitsio wrote with the keywords of a frame of ours.

use std::fs;
use std::path::{Path, PathBuf};

use fits::card::Value;
use fits::checksum::{add, encode, sum};
use fits::profile::{CardEntry, CardList};
use fitsio::FitsFile;
use fitsio::images::{ImageDescription, ImageType};

use crate::command::{Output, starmesh};

/// A frame of 5 x 3 pixels; its sums are left out.
fn frame(folder: &Path, name: &str, programme: &str) -> PathBuf {
    let path = folder.join(name);
    let description = ImageDescription { data_type: ImageType::UnsignedShort, dimensions: &[3, 5] };
    let mut file = FitsFile::create(&path).with_custom_primary(&description).open().unwrap();
    let hdu = file.primary_hdu().unwrap();
    for (keyword, value) in [
        ("IMAGETYP", "Light Frame"),
        ("DATE-OBS", "2026-11-21T03:12:41.006789"),
        ("OBJECT", "TRAPPIST-1"),
        ("INSTRUME", "andor"),
        ("OBSERVAT", "paranal"),
        ("TELESCOP", "callisto"),
        ("NIGHT", "20261120"),
        ("PROGID", programme),
    ] {
        if !value.is_empty() {
            hdu.write_key(&mut file, keyword, value).unwrap();
        }
    }
    hdu.write_key(&mut file, "EXPTIME", 30.0).unwrap();
    hdu.write_key(&mut file, "SCHEDROW", 2i64).unwrap();
    let pixels: Vec<u16> = (0..15).map(|n| n * 4000).collect();
    hdu.write_image(&mut file, &pixels).unwrap();
    drop(file);
    path
}

/// Gives a file its sums, as the archive node does.
fn with_sums(file: &Path) {
    let bytes = fs::read(file).unwrap();
    let (mut cards, length) = CardList::read(bytes.as_slice()).unwrap().unwrap();
    let data = &bytes[length..];
    let set = |cards: &mut CardList, keyword: &str, text: String| {
        cards.set(CardEntry::new(keyword, Value::Text(text), "").unwrap());
    };
    set(&mut cards, "DATASUM", sum(data).to_string());
    set(&mut cards, "CHECKSUM", "0".repeat(16));
    let total = add(sum(&cards.to_bytes()), sum(data));
    set(&mut cards, "CHECKSUM", encode(!total));
    fs::write(file, [&cards.to_bytes()[..], data].concat()).unwrap();
}

fn fits(arguments: &[&str], files: &[&Path]) -> Output {
    let files = files.iter().map(|file| file.to_str().unwrap());
    starmesh(["fits"].into_iter().chain(arguments.iter().copied()).chain(files))
}

#[test]
fn each_violation_is_printed_with_its_rule_and_the_copy_has_none() {
    let folder = tempfile::tempdir().unwrap();
    let file = frame(folder.path(), "a.fits", "LCO2026B-001");
    let checked = fits(&["check", "--profile", "lco"], &[&file]);
    assert!(!checked.success);
    let line = checked.out.lines().find(|line| line.contains("BLKUID")).unwrap();
    assert!(line.starts_with(&format!("{}: BLKUID is missing; expected a whole number", file.display())), "{line}");
    assert!(line.ends_with("Rule: required by ocs-archive 0.5.0, a whole number (INTEGER_TYPES)"), "{line}");
    assert!(checked.err.contains("violations of profile lco in 1 of 1 files"), "{}", checked.err);
    // A file without sums is not handed over: nobody knows whether its pixels are those that were written.
    let out = folder.path().join("copies");
    let out_text = out.to_str().unwrap();
    let refused = fits(&["convert", "--profile", "lco", "--out", out_text], &[&file]);
    assert!(
        !refused.success && refused.err.contains("is not as it was written: DATASUM is missing"),
        "{}",
        refused.err
    );
    assert_eq!(fs::read_dir(&out).unwrap().count(), 0);
}

#[test]
fn a_check_lists_first_what_no_copy_mends_and_ends_with_the_command_that_mends_the_rest() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (frame(folder.path(), "a.fits", "P-1"), frame(folder.path(), "my b.fits", ""));
    with_sums(&first);
    let checked = fits(&["check", "--profile", "lco"], &[&first]);
    let command = format!("starmesh fits convert --profile lco --out copies {}", first.display());
    let end = format!("; a copy has none of them: {command}");
    assert!(!checked.success && checked.err.trim_end().ends_with(&end), "{}", checked.err);
    with_sums(&second);
    let checked = fits(&["check", "--profile", "lco"], &[&first, &second]);
    let lines: Vec<&str> = checked.out.lines().collect();
    assert!(lines[0].contains("my b.fits: PROPID is missing"), "{}", checked.out);
    let is_of_first = |line: &&str| line.starts_with(&first.display().to_string());
    assert!(lines.iter().filter(|line| is_of_first(line)).count() > 5, "{}", checked.out);
    let (words, mended) = ("; 1 of them, which are listed first, would be in a copy too", lines.len() - 1);
    let rest = format!("; the other {mended} are mended in a copy: starmesh fits convert --profile lco --out copies ");
    let typed = format!("{} '{}'", first.display(), second.display());
    assert!(checked.err.contains(words) && checked.err.contains(&rest), "{}", checked.err);
    assert!(checked.err.trim_end().ends_with(&typed), "{}", checked.err);
    // What is only looked at has no copy that is better.
    let checked = fits(&["check"], &[&frame(folder.path(), "c.fits", "")]);
    assert!(!checked.err.contains("convert"), "{}", checked.err);
}

#[test]
fn files_that_cannot_be_read_are_named_and_the_others_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    let file = frame(folder.path(), "a.fits", "");
    let (none, text) = (folder.path().join("none.fits"), folder.path().join("text.fits"));
    fs::write(&text, "no FITS").unwrap();
    let checked = fits(&["check"], &[&none, &text, &file]);
    assert!(!checked.success);
    for words in ["none.fits cannot be read", "text.fits is not FITS", "2 of 3 files cannot be checked; 2 violations"] {
        assert!(checked.err.contains(words), "{words} in {}", checked.err);
    }
    assert!(checked.out.contains("a.fits: DATASUM is missing") && checked.out.contains("a.fits: CHECKSUM is missing"));
}

#[test]
fn wrong_options_are_refused_with_what_was_expected() {
    let wrong = starmesh(["fits", "check", "--profile", "esa", "a.fits"]);
    assert!(!wrong.success && wrong.err.contains("expected astra, plain, eso or lco"), "{}", wrong.err);
    let wrong = starmesh(["fits", "convert", "--profile", "eso", "--out", "x", "--set", "INSTRUME", "a.fits"]);
    assert!(!wrong.success && wrong.err.contains("expected KEYWORD=VALUE"), "{}", wrong.err);
    let wrong = starmesh(["fits", "convert", "--profile", "eso", "a.fits"]);
    assert!(!wrong.success && wrong.err.contains("--out"), "{}", wrong.err);
}

#[test]
fn copies_are_made_once_and_a_file_that_fails_does_not_stop_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (frame(folder.path(), "a.fits", "P-1"), frame(folder.path(), "b.fits", "P-1"));
    with_sums(&first);
    let out = folder.path().join("not").join("yet");
    let convert = ["convert", "--profile", "lco", "--out", out.to_str().unwrap()];
    // The second one has no sums.
    let made = fits(&convert, &[&second, &first]);
    let copy = "paranalcallisto-andor-20261120-031241006-e00.fits";
    assert!(!made.success && made.err.contains("1 of 2 files were not converted; 1 copies are in"), "{}", made.err);
    assert_eq!(made.out, format!("{} -> {copy}\n", first.display()));
    let before = fs::read(out.join(copy)).unwrap();
    let again = fits(&convert, &[&first]);
    assert!(again.success, "{}", again.err);
    assert_eq!(again.out, format!("{} -> {copy} (was there already)\n", first.display()));
    let checked = fits(&["check", "--profile", "lco"], &[&out.join(copy)]);
    assert_eq!((checked.success, checked.out.as_str()), (true, "1 files, no violation of profile lco\n"));
    // Another frame of the same moment has the same name: the first copy stays.
    with_sums(&second);
    let values = ["convert", "--profile", "lco", "--out", out.to_str().unwrap(), "--set", "PROPID=2026001"];
    let refused = fits(&values, &[&second]);
    assert!(!refused.success && refused.err.contains("is there already and is another file"), "{}", refused.err);
    assert!(fs::read(out.join(copy)).unwrap() == before);
    // An id of digits alone is a text.
    let other = folder.path().join("other");
    let values = ["convert", "--profile", "lco", "--out", other.to_str().unwrap(), "--set", "PROPID=2026001"];
    let given = fits(&values, &[&second]);
    assert!(given.success, "{}", given.err);
    let (cards, _) = CardList::read(fs::File::open(other.join(copy)).unwrap()).unwrap().unwrap();
    assert_eq!(cards.text("PROPID"), Some("2026001"));
    // What the check of the copy warns of is said when it is made.
    let public = folder.path().join("public");
    let values = ["convert", "--profile", "lco", "--out", public.to_str().unwrap(), "--set", "PROPID=calibrate"];
    let shown = fits(&values, &[&second]);
    let warning = "b.fits: warning: a frame of the sky becomes public at once: PROPID is 'calibrate'";
    assert!(shown.success && shown.err.contains(warning), "{}", shown.err);
    let checked = fits(&["check", "--profile", "lco"], &[&public.join(copy)]);
    assert!(checked.success && checked.out.contains(&warning["b.fits".len()..]), "{}", checked.out);
}
