//! Nights of real FITS files, delivered as the copies that a profile makes of them.

use ::fits::card::Value;
use ::fits::checksum::{add, encode, sum};
use ::fits::profile::{CardEntry, CardList, Profile, ProfileName, check};

use super::*;

const LCO: &str = "[[delivery]]\nname = \"share\"\ndirectory = \"there\"\nprofile = \"lco\"\n\
    set = { SITEID = \"lsc\", TELID = \"1m0a\" }\n";

fn fits_file(path: &Path, number: u32, programme: Option<&str>, extra: &[(&str, &str)]) {
    let mut cards = CardList::default();
    let mut set = |keyword: &str, value: Value| cards.set(CardEntry::new(keyword, value, "").unwrap());
    let text = |text: &str| Value::Text(text.to_owned());
    set("SIMPLE", Value::Logical(true));
    for (keyword, whole) in [("BITPIX", 16), ("NAXIS", 2), ("NAXIS1", 40), ("NAXIS2", 30), ("SCHEDROW", 3)] {
        set(keyword, Value::Whole(whole));
    }
    set("DATE-OBS", text(&format!("2026-11-22T03:00:{number:02}.000000")));
    set("EXPTIME", Value::Number(1.0));
    for (keyword, value) in [
        ("IMAGETYP", "Light Frame"),
        ("OBJECT", "TRAPPIST-1"),
        ("INSTRUME", "main"),
        ("OBSERVAT", "paranal"),
        ("TELESCOP", "callisto"),
        ("NIGHT", "20261121"),
    ] {
        set(keyword, text(value));
    }
    let programme = programme.map(|programme| ("PROGID", programme));
    programme.iter().chain(extra).for_each(|(keyword, value)| set(keyword, text(value)));
    let data = vec![number as u8; 2880];
    set("DATASUM", text(&sum(&data).to_string()));
    set("CHECKSUM", text(&"0".repeat(16)));
    let total = add(sum(&cards.to_bytes()), sum(&data));
    cards.set(CardEntry::new("CHECKSUM", text(&encode(!total)), "").unwrap());
    fs::write(path, [&cards.to_bytes()[..], &data].concat()).unwrap();
}

impl Site {
    fn with_block(block: &str) -> Self {
        let site = Self::new(block);
        fs::create_dir_all(site.path("there")).unwrap();
        site
    }

    /// Stores frames of programmes, with files as the archive writes them.
    async fn store_fits(&self, frames: &[(u32, Option<&str>)]) {
        let kinds: Vec<(u32, &str)> = frames.iter().map(|(number, _)| (*number, "light")).collect();
        self.store_with(&kinds, true, |frame| {
            let number = frame.started_utc.seconds_since(at(0)) as u32;
            let programme = frames.iter().find(|(of, _)| *of == number).and_then(|(_, programme)| *programme);
            frame.purpose.programme = programme.map(str::to_owned);
        })
        .await;
        for (number, programme) in frames {
            fits_file(&self.image(&format!("20261121/f{number}.fits")), *number, *programme, &[]);
        }
    }

    fn copies(&self) -> Vec<PathBuf> {
        let mut found = files(&self.path("there"));
        found.retain(|path| path.extension().is_some_and(|ending| ending == "fits"));
        found.sort();
        found
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn copies_are_delivered_under_their_names_and_found_again_as_ours() {
    let site = Site::with_block(LCO);
    site.store_fits(&[(1, Some("2026A-001")), (2, Some("2026A-001"))]).await;
    let done = site.deliver().await;
    assert_eq!((done.frames, done.sent, done.faults.len()), (2, 2, 0), "{done:?}");
    let copies = site.copies();
    assert_eq!(copies.len(), 2);
    let manifest = site.manifest("20261121.manifest.json");
    assert_eq!(manifest.profile.as_deref(), Some("lco"));
    for (file, number) in manifest.files.iter().zip(1..) {
        let path = site.path("there").join(&file.name);
        assert_eq!(hash_file(&path).unwrap().sha256, file.sha256);
        assert!(file.name.starts_with("paranal/callisto/20261121/lsc1m0a-main-20261121-0300"), "{}", file.name);
        let own = format!("20261121/f{number}.fits");
        assert_eq!((&file.archive_file, file.frame_id.0.as_str()), (&own, format!("frame-{number}").as_str()));
        assert_eq!(file.archive_sha256, Some(hash_file(&site.image(&own)).unwrap().sha256));
        assert!(check(&path, &Profile::load(ProfileName::Lco).unwrap()).unwrap().is_empty());
    }
    let before = files(&site.path("there"));
    // Again; without the record of before; and without record and manifest: the same bytes are ours.
    for round in 0..3 {
        let again = site.deliver().await;
        assert_eq!((again.sent, again.there, again.manifest.is_some()), (0, 2, true), "{again:?}");
        fs::remove_dir_all(site.config.folders.data.join("delivery-callisto")).unwrap();
        if round == 1 {
            fs::remove_file(site.there("20261121.manifest.json")).unwrap();
        }
    }
    assert_eq!(files(&site.path("there")), before);
    let verified = site.verify().await;
    assert!(verified.is_whole() && verified.same_here == 2, "{verified:?}");
    // No copy stays here, also none that a kill left.
    let left = site.config.folders.data.join("delivery-callisto/share/send-left");
    fs::create_dir_all(&left).unwrap();
    fs::write(left.join("copy.fits"), "half").unwrap();
    site.deliver().await;
    assert!(files(&site.config.folders.data).iter().all(|path| path.extension().is_none_or(|ending| ending != "fits")));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_its_profile_refuses_is_named_with_the_rule_and_holds_back_the_manifest_alone() {
    let site = Site::with_block(LCO);
    site.store_fits(&[(1, Some("2026A-001")), (2, None), (3, Some("2026A-001"))]).await;
    let done = site.deliver().await;
    assert_eq!((done.sent, done.manifest.as_ref(), done.faults.len()), (2, None, 1), "{done:?}");
    let fault = &done.faults[0];
    assert!(fault.contains("20261121/f2.fits") && fault.contains("PROPID is missing"), "{fault}");
    assert!(fault.contains("required by ocs-archive"), "{fault}");
    assert_eq!(site.copies().len(), 2);
    assert!(!site.there("20261121.manifest.json").exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_programme_that_is_given_is_for_frames_without_one() {
    let given = LCO.replace("TELID = \"1m0a\"", "TELID = \"1m0a\", PROPID = \"calibrate-7\"");
    let site = Site::with_block(&given);
    site.store_fits(&[(1, Some("2026A-001")), (2, None)]).await;
    let done = site.deliver().await;
    assert!(done.manifest.is_some(), "{done:?}");
    let programme = |path: &PathBuf| {
        let cards = CardList::read(fs::File::open(path).unwrap()).unwrap().unwrap().0;
        cards.text("PROPID").unwrap().to_owned()
    };
    assert_eq!(site.copies().iter().map(programme).collect::<Vec<_>>(), ["2026A-001", "calibrate-7"]);
    // Everybody sees the second one at once.
    let warnings = done.warning_lines();
    assert!(
        warnings.len() == 1 && warnings[0].contains("f2.fits") && warnings[0].contains("public at once"),
        "{warnings:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_waits_for_its_header_with_a_profile_too() {
    let site = Site::with_block(LCO);
    site.store_fits(&[(1, Some("2026A-001"))]).await;
    // Without its header's end a profile would refuse it.
    site.store(&[(2, "light")], false).await;
    let done = site.deliver().await;
    assert_eq!((done.sent, done.incomplete, done.faults.len(), done.manifest), (1, 1, 0, None));
}

#[tokio::test(flavor = "multi_thread")]
async fn two_frames_never_get_one_name() {
    let site = Site::with_block(LCO);
    site.store_fits(&[(1, Some("2026A-001")), (2, Some("2026A-001"))]).await;
    fits_file(&site.image("20261121/f2.fits"), 1, Some("2026A-001"), &[]);
    let done = site.deliver().await;
    assert_eq!((done.sent, done.faults.len(), done.manifest), (1, 1, None));
    assert!(
        done.faults[0].contains("f2.fits") && done.faults[0].contains("name of 20261121/f1.fits"),
        "{:?}",
        done.faults
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_header_that_changed_since_is_reported_of_a_copy_too() {
    let site = Site::with_block(LCO);
    site.store_fits(&[(1, Some("2026A-001")), (2, Some("2026A-001"))]).await;
    site.deliver().await;
    fits_file(&site.image("20261121/f1.fits"), 1, Some("2026A-001"), &[("NOTE", "late")]);
    let done = site.deliver().await;
    assert_eq!((done.sent, done.there, done.faults.len()), (0, 2, 0), "{done:?}");
    let verified = site.verify().await;
    assert_eq!((verified.newer_here.len(), verified.same_here, verified.is_whole()), (1, 1, true));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_file_of_the_archive_is_not_delivered() {
    let site = Site::with_block(LCO);
    site.store_fits(&[(1, Some("2026A-001")), (2, Some("2026A-001"))]).await;
    let mut bytes = fs::read(site.image("20261121/f1.fits")).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(site.image("20261121/f1.fits"), bytes).unwrap();
    let done = site.deliver().await;
    assert_eq!((done.sent, done.manifest), (1, None));
    assert!(done.faults[0].contains("not as it was written"), "{:?}", done.faults);
}

#[tokio::test(flavor = "multi_thread")]
async fn another_profile_makes_another_manifest_and_is_not_taken_for_the_first_one() {
    let mut site = Site::with_block(LCO);
    site.store_fits(&[(1, Some("2026A-001"))]).await;
    site.deliver().await;
    site.config.delivery[0].profile = ProfileName::Astra;
    site.config.delivery[0].set.clear();
    assert!(site.verify().await.faults[0].contains("of profile lco, not astra"));
    let done = site.deliver().await;
    assert_eq!((done.sent, done.manifest.as_deref()), (1, Some("paranal/callisto/20261121.manifest-2.json")));
    assert!(site.there("20261121/f1.fits").exists() && site.verify().await.is_whole());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_destination_gets_the_programmes_that_it_asks_for() {
    for (asked, expected) in [("\"2026A-001\"", &[1][..]), ("\"\"", &[3]), ("\"2026A-002\", \"\"", &[2, 3])] {
        let block = format!("[[delivery]]\nname = \"share\"\ndirectory = \"there\"\nprogrammes = [{asked}]\n");
        let site = Site::with_block(&block);
        site.store_fits(&[(1, Some("2026A-001")), (2, Some("2026A-002")), (3, None)]).await;
        assert_eq!(site.deliver().await.frames, expected.len(), "{asked}");
        let names: Vec<PathBuf> =
            expected.iter().map(|number| site.there(&format!("20261121/f{number}.fits"))).collect();
        assert_eq!(site.copies(), names);
    }
    // The site's table gives a programme to frames whose row names none.
    let mut site =
        Site::with_block("[[delivery]]\nname = \"share\"\ndirectory = \"there\"\nprogrammes = [\"60.A-9009\"]\n");
    fs::write(
        site.path("header.csv"),
        "header,dtype,fixed,device_type,device_command,comment\nPROGID,str,true,static,60.A-9009,\n",
    )
    .unwrap();
    site.config.archive.fits_header = Some(site.path("header.csv"));
    site.store_fits(&[(1, Some("2026A-001")), (2, None)]).await;
    site.deliver().await;
    assert_eq!(site.copies(), [site.there("20261121/f2.fits")]);
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn files_leave_the_archive_for_copies_that_were_made_of_them() {
    let elsewhere = on_another_disk();
    let site = Site::new(&LCO.replace("\"there\"", &format!("\"{}\"", elsewhere.path().display())));
    site.store_fits(&[(1, Some("2026A-001")), (2, Some("2026A-001"))]).await;
    assert!(site.deliver().await.manifest.is_some());
    fits_file(&site.image("20261121/f2.fits"), 2, Some("2026A-001"), &[("NOTE", "late")]);
    let removed = site.remove().await.unwrap();
    assert_eq!((removed.files, removed.staying), (1, 1));
    assert!(!site.image("20261121/f1.fits").exists() && site.image("20261121/f2.fits").exists());
    let done = site.deliver().await;
    assert_eq!((done.sent, done.there, done.faults.len()), (0, 2, 0), "{done:?}");
    assert_eq!(site.verify().await.gone_here, 1);
}
