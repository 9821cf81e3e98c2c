//! Files, values and folders that want a wrong copy.

use super::moments::{changed, words};
use super::*;

fn cards_of(path: &Path) -> CardList {
    CardList::read(fs::File::open(path).unwrap()).unwrap().unwrap().0
}

fn given(values: &[(&str, &str)]) -> Vec<(String, String)> {
    values.iter().map(|(keyword, value)| ((*keyword).to_owned(), (*value).to_owned())).collect()
}

#[test]
fn what_stands_in_the_place_of_a_value_and_is_none_is_found() {
    for (field, is_right) in [
        ("2.5", true),
        ("2.5D0 / [pix]", true),
        ("T", true),
        ("'NaN'", true),
        ("", true),
        ("/ not known", true),
        ("(1.0, 2.0)", true),
        ("NaN", false),
        ("nan / [pix]", false),
        ("-inf", false),
        ("2,5", false),
        ("soon", false),
        ("5 px", false),
    ] {
        let card = format!("FWHM    = {field}");
        for name in PROFILES {
            let found = words(&changed(&card, "FWHM"), name);
            let refused = found.iter().any(|text| text.starts_with("FWHM is ") && text.contains("a text in quotes"));
            assert_eq!(refused, !is_right, "{name} {card}: {found:?}");
        }
    }
    let (folder, target) = folders();
    let source = file(folder.path(), "a.fits", &changed("FWHM    = NaN", "FWHM"));
    let refused = deliver_copy(&source, &target, &profile(ProfileName::Lco), &[]).unwrap_err().to_string();
    assert!(refused.contains("FWHM is NaN; expected a number"), "{refused}");
    assert!(names(&target).is_empty());
}

#[test]
fn a_given_value_that_looks_like_a_number_stays_a_text_where_one_is_wanted() {
    let text = |text: &str| Value::Text(text.to_owned());
    for (name, keyword, value, made, expected) in [
        (ProfileName::Lco, "PROPID", "2026001", "PROPID", text("2026001")),
        (ProfileName::Lco, "PROGID", "0815", "PROPID", text("0815")),
        (ProfileName::Lco, "TELID", "007", "TELID", text("007")),
        (ProfileName::Lco, "DAY-OBS", "20261119", "DAY-OBS", text("20261119")),
        (ProfileName::Lco, "FRAMEID", "1.10", "FRAMEID", text("1.10")),
        (ProfileName::Lco, "BLKUID", "12", "BLKUID", Value::Whole(12)),
        (ProfileName::Lco, "EXPTIME", "12.5", "EXPTIME", Value::Number(12.5)),
        (ProfileName::Lco, "RA", "15.0", "RA", text("01:00:00.0000")),
        (ProfileName::Lco, "SEEING", "1.25", "SEEING", Value::Number(1.25)),
        (ProfileName::Lco, "SEEING", "good", "SEEING", text("good")),
        (ProfileName::Eso, "INSTRUME", "4", "ESO INS NAME", text("4")),
        (ProfileName::Eso, "PROGID", "112.25", "ESO OBS PROG ID", text("112.25")),
        (ProfileName::Astra, "OBJECT", "47", "OBJECT", text("47")),
    ] {
        let (folder, target) = folders();
        let source = file(folder.path(), "a.fits", &LIGHT);
        let made_copy = deliver_copy(&source, &target, &profile(name), &given(&[(keyword, value)]));
        let path = made_copy.unwrap_or_else(|error| panic!("{name} {keyword}={value}: {error}")).path;
        assert_eq!(cards_of(&path).value(made), Some(&expected), "{name} {keyword}={value}");
        assert_eq!(check(&path, &profile(name)).unwrap(), [], "{name} {keyword}={value}");
    }
}

#[test]
fn no_name_of_a_site_leads_out_of_the_folder_of_copies() {
    let (folder, target) = folders();
    let source = file(folder.path(), "a.fits", &LIGHT);
    for hostile in ["../../x", "/etc/x", "..", "a/b", "a\\b", "a b", "x;rm"] {
        for (name, keyword) in
            [(ProfileName::Lco, "INSTRUME"), (ProfileName::Lco, "SITEID"), (ProfileName::Eso, "INSTRUME")]
        {
            let refused = deliver_copy(&source, &target, &profile(name), &given(&[(keyword, hostile)])).unwrap_err();
            assert!(matches!(refused, DeliveryError::Violations { .. }), "{keyword} {hostile:?}: {refused}");
        }
    }
    assert!(names(&target).is_empty());
    assert_eq!(names(folder.path()), ["a.fits", "copies"]);
    // Signs that a name may have part the name of a copy, and are left out of it.
    let named = given(&[("INSTRUME", "cam-1+2_3")]);
    let made = deliver_copy(&source, &target, &profile(ProfileName::Lco), &named).unwrap();
    assert_eq!(names(&target), ["paranalcallisto-cam12_3-20261120-031241006-e00.fits"]);
    assert_eq!(cards_of(&made.path).text("INSTRUME"), Some("cam-1+2_3"));
}

#[test]
fn pixels_of_several_pieces_are_the_same_bit_for_bit_with_every_profile() {
    let data: Vec<u8> = (0..700_001_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let mut records = LIGHT.to_vec();
    for record in &mut records {
        match record.split('=').next() {
            Some("BITPIX  ") => *record = "BITPIX  =                    8 / bits",
            Some("NAXIS1  ") => *record = "NAXIS1  =               700001 / columns",
            Some("NAXIS2  ") => *record = "NAXIS2  =                    1 / rows",
            Some("BZERO   ") => *record = "BZERO   =                    0 / offset",
            _ => {}
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let source = file_of(folder.path(), "a.fits", &records, data.clone());
    for name in PROFILES {
        let target = folder.path().join(name.word());
        fs::create_dir(&target).unwrap();
        let made = deliver_copy(&source, &target, &profile(name), &[]).unwrap();
        let copy = fs::read(&made.path).unwrap();
        let filled = data.len().next_multiple_of(2880);
        let pixels = &copy[copy.len() - filled..];
        assert!(pixels[..data.len()] == data && pixels[data.len()..].iter().all(|byte| *byte == 0), "{name}");
        assert_eq!((made.bytes, checksum::sum(&copy)), (copy.len() as u64, checksum::WHOLE), "{name}");
        if !profile(name).advice {
            assert_eq!(check(&made.path, &profile(name)).unwrap(), [], "{name}");
        }
    }
}

#[test]
fn parts_behind_the_first_are_delivered_to_the_byte_and_a_cut_one_is_not() {
    let (folder, target) = folders();
    let source = file(folder.path(), "a.fits", &LIGHT);
    let first = fs::read(&source).unwrap();
    let mut table = format!("{:80}{:80}", "XTENSION= 'IMAGE   '", "BITPIX  =                    8").into_bytes();
    table.extend(format!("{:80}{:80}END", "NAXIS   =                    1", "NAXIS1  =                    5").bytes());
    table.resize(2880, b' ');
    table.extend([1, 2, 3, 4, 5]);
    table.resize(5760, 0);
    let whole = [&first[..], &table[..]].concat();
    fs::write(&source, &whole).unwrap();
    for (name, behind) in [(ProfileName::Lco, 5760), (ProfileName::Astra, whole.len())] {
        let made = deliver_copy(&source, &target, &profile(name), &[]).unwrap();
        let copy = fs::read(&made.path).unwrap();
        assert!(copy[copy.len() - behind..] == whole[whole.len() - behind..], "{name}");
        assert_eq!(made.bytes, copy.len() as u64, "{name}");
        fs::remove_file(made.path).unwrap();
    }
    for cut in [1, 100, 2879, 2881, 5759] {
        fs::write(&source, &whole[..whole.len() - cut]).unwrap();
        for name in PROFILES {
            let refused = deliver_copy(&source, &target, &profile(name), &[]).unwrap_err().to_string();
            assert!(refused.contains("is cut short"), "{name} without {cut} bytes: {refused}");
            assert!(check(&source, &profile(name)).is_err(), "{name} without {cut} bytes");
        }
    }
    assert!(names(&target).is_empty());
}

#[test]
fn a_copy_of_a_copy_is_the_same_to_the_byte() {
    let (folder, target) = folders();
    let source = file(folder.path(), "a.fits", &[&LIGHT[..], &SOLUTION[..]].concat());
    let again = folder.path().join("again");
    fs::create_dir(&again).unwrap();
    let lco = profile(ProfileName::Lco);
    let first = deliver_copy(&source, &target, &lco, &given(&[("SITEID", "lsc"), ("TELID", "1m0a")])).unwrap();
    let second = deliver_copy(&first.path, &again, &lco, &[]).unwrap();
    assert_eq!((first.path.file_name(), first.bytes), (second.path.file_name(), second.bytes));
    assert!(fs::read(&first.path).unwrap() == fs::read(&second.path).unwrap());
}

#[test]
fn of_many_who_make_one_copy_at_once_one_makes_it_and_all_have_it() {
    let (folder, target) = folders();
    let (source, lco) = (file(folder.path(), "a.fits", &LIGHT), profile(ProfileName::Lco));
    let made: Vec<Delivered> = std::thread::scope(|scope| {
        let threads: Vec<_> =
            (0..8).map(|_| scope.spawn(|| deliver_copy(&source, &target, &lco, &[]).unwrap())).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(made.iter().filter(|copy| !copy.was_there).count(), 1);
    assert_eq!(names(&target), ["paranalcallisto-andor1-20261120-031241006-e00.fits"]);
    assert_eq!(check(&made[0].path, &lco).unwrap(), []);
}

#[test]
fn what_has_the_name_of_a_copy_stays_whatever_it_is() {
    let (folder, target) = folders();
    let (source, astra) = (file(folder.path(), "a.fits", &LIGHT), profile(ProfileName::Astra));
    let before = fs::read(&source).unwrap();
    // Into its own folder: the file is its own copy.
    let same = deliver_copy(&source, folder.path(), &astra, &[]).unwrap();
    assert!(same.was_there && fs::read(&source).unwrap() == before);
    // With a value of its own it would be another file of the same name.
    let refused = deliver_copy(&source, folder.path(), &astra, &given(&[("OBSERVER", "me")])).unwrap_err();
    assert!(matches!(refused, DeliveryError::Exists(_)), "{refused}");
    assert!(fs::read(&source).unwrap() == before);
    fs::create_dir(target.join("a.fits")).unwrap();
    let refused = deliver_copy(&source, &target, &astra, &[]).unwrap_err();
    assert!(matches!(refused, DeliveryError::Exists(_)), "{refused}");
    assert_eq!(names(&target), ["a.fits"]);
    assert_eq!(names(folder.path()), ["a.fits", "copies"]);
}

#[cfg(unix)]
#[test]
fn a_link_that_has_the_name_of_a_copy_is_neither_followed_nor_replaced() {
    let (folder, target) = folders();
    let (source, astra) = (file(folder.path(), "a.fits", &LIGHT), profile(ProfileName::Astra));
    for leads_to in [folder.path().join("nowhere.fits"), source.clone()] {
        std::os::unix::fs::symlink(&leads_to, target.join("a.fits")).unwrap();
        let refused = deliver_copy(&source, &target, &astra, &[]).unwrap_err();
        assert!(matches!(refused, DeliveryError::Exists(_)), "{refused}");
        assert_eq!(fs::read_link(target.join("a.fits")).unwrap(), leads_to);
        assert!(!folder.path().join("nowhere.fits").exists());
        fs::remove_file(target.join("a.fits")).unwrap();
    }
    assert!(names(&target).is_empty(), "no part is left");
}

#[test]
fn the_rules_of_a_frame_follow_from_its_type_and_its_action() {
    for (image_type, action, kind, category) in [
        ("Light Frame", "object", "EXPOSE", "SCIENCE"),
        ("LIGHT", "object", "EXPOSE", "SCIENCE"),
        ("Light Frame", "autofocus", "EXPERIMENTAL", "TECHNICAL"),
        ("Light Frame", "pointing_model", "EXPERIMENTAL", "TECHNICAL"),
        ("Acquisition Frame", "pointing", "GUIDE", "ACQUISITION"),
        ("Light Frame", "pointing", "GUIDE", "ACQUISITION"),
        ("Light Frame", "calibrate_guiding", "EXPERIMENTAL", "TECHNICAL"),
        ("Flat Frame", "flats", "SKYFLAT", "CALIB"),
        ("Test Frame", "flats_level", "EXPERIMENTAL", "TEST"),
        ("dark frame", "calibration", "DARK", "CALIB"),
        ("Bias Frame", "autofocus", "BIAS", "CALIB"),
    ] {
        let (image_type, action) = (format!("IMAGETYP= '{image_type}'"), format!("ASTRATYP= '{action}'"));
        let mut records = changed(&image_type, "IMAGETYP");
        records.push(&action);
        let cards = list(&records);
        let lco = convert(&cards, "a.fits", &profile(ProfileName::Lco));
        assert_eq!(lco.text("OBSTYPE"), Some(kind), "{image_type} {action}");
        let eso = convert(&cards, "a.fits", &profile(ProfileName::Eso));
        assert_eq!(eso.text("ESO DPR CATG"), Some(category), "{image_type} {action}");
    }
    for (none, shown) in [("", "missing"), ("IMAGETYP= '        '", "missing"), ("IMAGETYP= 3", "3")] {
        let found = words(&changed(none, "IMAGETYP"), ProfileName::Lco);
        let expected = format!("IMAGETYP is {shown}; expected Light Frame");
        assert!(found.iter().any(|text| text.starts_with(&expected)), "{found:?}");
    }
}

/// A table of two rows as the second part of a file, with right sums.
fn table(first_row: u8) -> Vec<u8> {
    let records = [
        "XTENSION= 'BINTABLE'           / a table",
        "BITPIX  =                    8",
        "NAXIS   =                    2",
        "NAXIS1  =                    4",
        "NAXIS2  =                    2",
        "PCOUNT  =                    0",
        "GCOUNT  =                    1",
        "TFIELDS =                    1",
        "TFORM1  = '4A      '",
    ];
    let mut data = [vec![first_row; 4], vec![b'z'; 4]].concat();
    data.resize(2880, 0);
    hdu_of(&records, data)
}

#[test]
fn damage_in_a_later_part_is_found_and_not_delivered() {
    let (folder, target) = folders();
    let source = file(folder.path(), "a.fits", &LIGHT);
    let whole = [fs::read(&source).unwrap(), table(b'a')].concat();
    fs::write(&source, &whole).unwrap();
    let astra = profile(ProfileName::Astra);
    assert_eq!(check(&source, &astra).unwrap(), []);
    let made = deliver_copy(&source, &target, &astra, &[]).unwrap();
    assert!(fs::read(&made.path).unwrap() == whole && made.bytes == whole.len() as u64);
    fs::remove_file(&made.path).unwrap();
    let last = whole.len() - 2880;
    for (what, at) in [("data", last), ("header", last - 2880 + 40)] {
        let mut bad = whole.clone();
        bad[at] ^= 1;
        fs::write(&source, &bad).unwrap();
        let found = check(&source, &astra).unwrap();
        assert!(found.iter().any(|violation| violation.keyword.ends_with("SUM of HDU 2")), "{what}: {found:?}");
        let refused = deliver_copy(&source, &target, &astra, &[]).unwrap_err().to_string();
        assert!(refused.contains("SUM of HDU 2 is"), "{what}: {refused}");
    }
    // Blocks of something else.
    let mut other = whole;
    other[last - 2880..].fill(b'x');
    fs::write(&source, &other).unwrap();
    let refused = deliver_copy(&source, &target, &astra, &[]).unwrap_err().to_string();
    assert!(refused.contains("HDU 2"), "{refused}");
    assert!(names(&target).is_empty());
}

#[test]
fn a_name_that_fits_has_no_form_for_is_shown_with_what_to_do() {
    let (folder, target) = folders();
    let source = file(folder.path(), "barré.fits", &LIGHT);
    let refused = deliver_copy(&source, &target, &profile(ProfileName::Eso), &[]).unwrap_err().to_string();
    assert!(refused.contains("ORIGFILE is 'barré.fits'; expected printable ASCII"), "{refused}");
    assert!(names(&target).is_empty());
}

/// What photometry and the programs of others need is asked for by name, and no copy is held back for it.
#[test]
fn the_profile_plain_names_what_programs_of_others_miss_and_copies_all_the_same() {
    let (folder, target) = folders();
    let plain = profile(ProfileName::Plain);
    let bare = file(folder.path(), "bare.fits", &LIGHT);
    let missing = |found: &[Violation]| -> Vec<String> {
        found.iter().filter(|violation| violation.found.is_none()).map(|violation| violation.keyword.clone()).collect()
    };
    let found = check(&bare, &plain).unwrap();
    for keyword in ["GAIN", "RDNOISE", "SATURATE", "MJD-AVG", "BJD_TDB", "SITELAT", "OBSGEO-X", "ROWORDER"] {
        assert!(missing(&found).iter().any(|name| name == keyword), "{keyword} in {found:?}");
    }
    let copy = deliver_copy(&bare, &target, &plain, &[]).unwrap();
    assert_eq!(fs::read(&copy.path).unwrap(), fs::read(&bare).unwrap());
    // Lengths in metres and states as numbers are the predecessor's.
    let old: Vec<&str> =
        LIGHT.iter().copied().chain(["FOCALLEN=                  0.9", "PIERSIDE=                    1"]).collect();
    let found = check(&file(folder.path(), "old.fits", &old), &plain).unwrap();
    let lines: Vec<String> = found.iter().map(Violation::to_string).collect();
    assert!(
        lines.iter().any(|line| line.starts_with("FOCALLEN is 0.9; expected a number from 10 to 1000000. Rule: mm")),
        "{lines:?}"
    );
    assert!(lines.iter().any(|line| line.starts_with("PIERSIDE is 1; expected East or West or unknown")), "{lines:?}");
    // A bias has no place on the sky.
    let found = check(&file(folder.path(), "bias.fits", &bias()), &plain).unwrap();
    assert!(
        !missing(&found).iter().any(|name| ["BJD_TDB", "AIRMMID", "FOCALLEN", "OBJECT"].contains(&name.as_str())),
        "{found:?}"
    );
}

#[test]
fn a_type_of_frame_that_nobody_knows_is_no_science() {
    let (folder, target) = folders();
    let source = file(folder.path(), "a.fits", &changed("IMAGETYP= 'Tricolour'", "IMAGETYP"));
    for name in [ProfileName::Lco, ProfileName::Eso] {
        let refused = deliver_copy(&source, &target, &profile(name), &[]).unwrap_err().to_string();
        assert!(refused.contains("IMAGETYP is 'Tricolour'; expected Light Frame"), "{name}: {refused}");
    }
    for image_type in ["Light Frame", "LIGHT", "object"] {
        let card = format!("IMAGETYP= '{image_type}'");
        let source = file(folder.path(), "b.fits", &changed(&card, "IMAGETYP"));
        let _ = fs::remove_dir_all(&target);
        fs::create_dir(&target).unwrap();
        assert!(deliver_copy(&source, &target, &profile(ProfileName::Lco), &[]).is_ok(), "{image_type}");
    }
}
