//! Stories of names, good and hostile.

use std::path::Component;

use contract::CommandId;
use contract::device::camera::{Pixel, Purpose};

use super::*;

fn frame() -> Frame {
    Frame {
        id: CommandId("f1".to_owned()),
        camera: "andor".to_owned(),
        purpose: Purpose {
            action: "object".to_owned(),
            object: Some("TRAPPIST-1".to_owned()),
            image_type: "Light Frame".to_owned(),
            filter: Some("I+z".to_owned()),
            night: "20261120".to_owned(),
            sequence: 3,
            ..Purpose::default()
        },
        width_px: 2,
        height_px: 2,
        planes: 1,
        pixel: Pixel::U16,
        bin: 1,
        origin_px: [0, 0],
        started_utc: written(),
        exposure_s: 30.0,
        url: String::new(),
        bytes: 8,
        sha256: String::new(),
        readings: BTreeMap::new(),
    }
}

fn written() -> Utc {
    "2026-11-21T03:00:01.2345Z".parse().unwrap()
}

fn own(action: &str, template: &str) -> Result<Namer, NameError> {
    Namer::new(&BTreeMap::from([(action.to_owned(), template.to_owned())]), -70.4)
}

fn name_of(namer: &Namer, frame: &Frame) -> String {
    namer.path(frame, written()).to_string_lossy().replace('\\', "/")
}

#[test]
fn default_names_are_those_of_the_predecessor() {
    let namer = Namer::new(&BTreeMap::new(), -70.4).unwrap();
    let mut frame = frame();
    assert_eq!(name_of(&namer, &frame), "20261120/andor_I+z_TRAPPIST-1_30.000_20261121_030001.234.fits");
    frame.purpose.action = "calibration".to_owned();
    frame.purpose.image_type = "Dark Frame".to_owned();
    assert_eq!(name_of(&namer, &frame), "20261120/andor_dark_30.000_20261121_030001.234.fits");
    frame.purpose.action = "autofocus".to_owned();
    frame.purpose.filter = None;
    assert_eq!(name_of(&namer, &frame), "autofocus/20261120/andor_NA_dark_30.000_20261121_030001.234.fits");
    frame.purpose.action = "something new".to_owned();
    frame.purpose.image_type = "Unknown Frame".to_owned();
    assert_eq!(name_of(&namer, &frame), "20261120/andor_NA_default_30.000_20261121_030001.234.fits");
}

#[test]
fn a_frame_without_a_night_is_filed_under_the_one_it_was_taken_in() {
    let namer = own("object", "{action_date}.fits").unwrap();
    let mut frame = frame();
    frame.purpose.night = String::new();
    assert_eq!(name_of(&namer, &frame), "20261120.fits");
    frame.started_utc = "2026-11-21T16:41:36Z".parse().unwrap();
    assert_eq!(name_of(&namer, &frame), "20261121.fits");
}

#[test]
fn a_site_may_write_plain_templates() {
    let namer = own("object", "{action_datetime:%Y/%m}/{sequence_counter:04d}_{{_{datetime_timestamp:%H%M%S}.fit");
    // a brace has no place in a name and becomes an underscore
    assert_eq!(name_of(&namer.unwrap(), &frame()), "2026/11/0003___030001.fit");
}

#[test]
fn a_site_may_write_jinja_templates() {
    let namer = own(
        "object",
        "{{ action_datetime.strftime('%Y-%m') }}/{{ object_name | lower }}_{{ '%.2f' | format(exptime) }}{% if sequence_counter > 2 %}_late{% endif %}_{{ '{:03d}'.format(sequence_counter) }}_{{ action_datetime.plus(days=1).day }}.fits",
    );
    assert_eq!(name_of(&namer.unwrap(), &frame()), "2026-11/trappist-1_30.00_late_003_21.fits");
}

#[test]
fn a_template_that_cannot_work_is_refused_at_the_start_and_named() {
    for template in [
        "{nonsense}.fits",
        "{exptime:d}.fits",
        "{exptime",
        "exptime}",
        "../{device}.fits",
        "/data/{device}.fits",
        "a\\b.fits",
        "c:/x.fits",
        "{device}/",
        "",
        "{{ nonsense }}.fits",
        "{{ device.nothing() }}.fits",
        "{{ device | nothing }}.fits",
        "{{ datetime_timestamp.strftime('%Q') }}.fits",
        "{% if %}{{ }}.fits",
    ] {
        let error = own("flats", template).map(|_| ()).unwrap_err().to_string();
        assert!(error.starts_with("archive.filename.flats: "), "{error}");
    }
}

#[test]
fn no_name_from_a_schedule_leaves_the_folder() {
    let namer = Namer::new(
        &BTreeMap::from([("object".to_owned(), "{object_name}/{filter_name}/{device}_{action_type}.fits".to_owned())]),
        0.0,
    )
    .unwrap();
    let huge = "x".repeat(4096);
    let hostile = [
        "..",
        "../../etc/passwd",
        "/etc/passwd",
        "a\0b",
        "..\\..\\x",
        "C:\\x",
        "",
        " ",
        ".",
        "\u{1F52D}",
        "CON",
        "NUL.fits",
        "a/../..",
        &huge,
        "~",
        "....",
        "'",
    ];
    for text in hostile {
        for folder in [None, Some(text)] {
            let mut frame = frame();
            frame.purpose.object = Some(text.to_owned());
            frame.purpose.filter = Some(text.to_owned());
            frame.purpose.folder = folder.map(str::to_owned);
            let path = namer.path(&frame, written());
            assert!(path.components().count() >= 3, "{path:?}");
            for component in path.components() {
                let Component::Normal(name) = component else { panic!("{text:?} made {path:?}") };
                let name = name.to_str().unwrap();
                assert!(
                    name.len() <= LONGEST_PART + 1 && !name.starts_with('.') && !name.ends_with(['.', ' ']),
                    "{name:?}"
                );
                assert!(!name.contains(['/', '\\', '\0', ':', '\n']), "{name:?}");
            }
            assert!(path.to_str().unwrap().ends_with("_object.fits"), "{path:?}");
        }
    }
}

#[test]
fn an_action_may_have_a_folder_inside_that_of_images() {
    let namer = own("object", "{device}.fits").unwrap();
    let mut frame = frame();
    for (folder, expected) in [
        ("trappist-1/raw", "trappist-1/raw/andor.fits"),
        ("./a//b/", "a/b/andor.fits"),
        ("/data/x", "andor.fits"),
        ("a/../../b", "andor.fits"),
        ("D:\\x", "andor.fits"),
    ] {
        frame.purpose.folder = Some(folder.to_owned());
        assert_eq!(name_of(&namer, &frame), expected, "{folder}");
    }
}

#[test]
fn a_taken_name_gets_the_time_of_writing() {
    let folder = tempfile::tempdir().unwrap();
    let taken = folder.path().join("a_1.000.fits");
    let other = other_than(&taken, written());
    assert_eq!(other.file_name().unwrap(), "a_1.000-v20261121_030001-234500.fits");
    std::fs::write(&other, "").unwrap();
    assert_eq!(other_than(&taken, written()).file_name().unwrap(), "a_1.000-v20261121_030001-234500-2.fits");
}
