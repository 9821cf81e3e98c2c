//! Tests of names, good and hostile.

use std::path::Component;

use contract::device::camera::Purpose;

use super::*;

fn frame() -> Frame {
    Frame {
        purpose: Purpose {
            action: "object".to_owned(),
            object: Some("TRAPPIST-1".to_owned()),
            image_type: "Light Frame".to_owned(),
            filter: Some("I+z".to_owned()),
            night: "20261120".to_owned(),
            sequence: 3,
            ..Purpose::default()
        },
        started_utc: written(),
        exposure_s: 30.0,
        ..test_support::frame("f1")
    }
}

fn written() -> Utc {
    "2026-11-21T03:00:01.2345Z".parse().unwrap()
}

fn own(action: &str, template: &str) -> Result<Namer, NameError> {
    Namer::new(&BTreeMap::from([(action.to_owned(), template.to_owned())]), FileProfile::Plain, -70.4)
}

fn name_of(namer: &Namer, frame: &Frame) -> String {
    namer.path(frame, written()).to_string_lossy().replace('\\', "/")
}

#[test]
fn names_of_an_imported_site_are_those_of_the_predecessor() {
    let namer = Namer::new(&BTreeMap::new(), FileProfile::Astra, -70.4).unwrap();
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
fn an_exposure_as_the_camera_counted_it_is_a_short_word() {
    for (exposure_s, expected) in [
        (119.99987, "120s"),
        (120.0, "120s"),
        (1.5, "1500ms"),
        (1.0049, "1s"),
        (0.99999, "1s"),
        (0.25, "250ms"),
        (0.2500004, "250ms"),
        (0.0123, "12300us"),
        (0.000_999_7, "1ms"),
        (0.000_25, "250us"),
        (0.0, "0s"),
        (-1.0, "NA"),
        (f64::NAN, "NA"),
        (f64::INFINITY, "NA"),
    ] {
        assert_eq!(exposure_word(exposure_s), expected, "{exposure_s}");
    }
}

/// Each part of a name is a word that no shell and no archive reads otherwise, and names sort by the start of the exposure.
#[test]
fn names_are_plain_words_in_the_order_of_exposure() {
    let namer = Namer::new(&BTreeMap::new(), FileProfile::Plain, -70.4).unwrap();
    let mut frame = frame();
    // Read out and written a minute after its exposure began.
    frame.started_utc = "2026-11-21T02:59:01.2345Z".parse().unwrap();
    assert_eq!(name_of(&namer, &frame), "20261120/20261121T025901-234_andor_light_TRAPPIST-1_I+z_30s.fits");
    for (object, filter, exposure_s, expected) in [
        (Some("NGC 253"), Some("Johnson V"), 0.5, "light_NGC-253_Johnson-V_500ms"),
        (Some("2M 0746+20.0 (b)"), Some("r'"), 0.00025, "light_2M-0746+20-0-b_r_250us"),
        (Some("C/2023 A3 _x_"), None, 1.5, "light_C-2023-A3-x_NA_1500ms"),
        (None, Some("..."), 0.0, "light_NA_NA_0s"),
        (Some("\u{1F52D}"), Some("V"), f64::NAN, "light_NA_V_NA"),
    ] {
        frame.purpose.object = object.map(str::to_owned);
        frame.purpose.filter = filter.map(str::to_owned);
        frame.exposure_s = exposure_s;
        assert_eq!(name_of(&namer, &frame), format!("20261120/20261121T025901-234_andor_{expected}.fits"));
    }
    frame = self::frame();
    (frame.purpose.action, frame.purpose.image_type) = ("pointing".to_owned(), "Acquisition Frame".to_owned());
    assert_eq!(name_of(&namer, &frame), "20261120/20261121T030001-234_andor_acquisition_TRAPPIST-1_I+z_30s.fits");
    for (action, image_type, expected) in [
        ("calibration", "Bias Frame", "20261120/20261121T030001-234_andor_bias_0s.fits"),
        ("flats", "Flat Frame", "20261120/20261121T030001-234_andor_flat_I+z_0s.fits"),
        ("autofocus", "Light Frame", "autofocus/20261120/20261121T030001-234_andor_light_I+z_0s.fits"),
        ("something new", "Strange", "20261120/20261121T030001-234_andor_default_TRAPPIST-1_I+z_0s.fits"),
    ] {
        (frame.purpose.action, frame.purpose.image_type) = (action.to_owned(), image_type.to_owned());
        frame.exposure_s = 0.0;
        assert_eq!(name_of(&namer, &frame), expected);
        let name = compressed(PathBuf::from(expected)).file_name().unwrap().to_str().unwrap().to_owned();
        assert!(name.chars().all(|c| c.is_ascii_alphanumeric() || "_+-.".contains(c)), "{name}");
        assert_eq!(name.split_once('.').unwrap().1, "fits.fz", "what is behind the first dot is the type of the file");
    }
    let names: Vec<String> = ["2026-11-21T02:59:59.999Z", "2026-11-21T03:00:00.001Z", "2026-11-21T10:00:00Z"]
        .map(|start| {
            frame.started_utc = start.parse().unwrap();
            name_of(&namer, &frame)
        })
        .into();
    assert!(names.is_sorted(), "{names:?}");
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
    // A brace has no place in a name and becomes an underscore.
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

/// Each rule of the predecessor's names, with the name that CPython 3.11 and Jinja2 3.1 print for it.
#[test]
fn templates_of_the_predecessor_give_the_names_that_they_gave_there() {
    let (day, at) = ("20261120", "20261121_030001.234");
    for (template, expected) in [
        // Plain: every variable, with its type.
        ("{action_type}/{device}.fits", "object/andor.fits".to_owned()),
        ("{filter_name}_{object_name}_{imagetype}.fits", "I+z_TRAPPIST-1_light.fits".to_owned()),
        ("{exptime}_{exptime:.3f}_{exptime:g}_{exptime:06.1f}.fits", "30.0_30.000_30_0030.0.fits".to_owned()),
        ("{action_date}/{timestamp}.fits", format!("{day}/{at}.fits")),
        ("{datetime_timestamp:%Y-%m-%d}_{action_datetime:%H%M}.fits", "2026-11-21_0000.fits".to_owned()),
        ("{sequence_counter}_{sequence_counter:05d}_{device:>8}.fits", "3_00003_   andor.fits".to_owned()),
        ("{action_date}/raw/{action_date}/{device}.fits", format!("{day}/raw/{day}/andor.fits")),
        // Jinja: the same, then its own.
        ("{{ action_type }}/{{ device }}_{{ exptime }}.fits", "object/andor_30.0.fits".to_owned()),
        ("{{ action_date }}/{{ timestamp }}_{{ sequence_counter }}.fits", format!("{day}/{at}_3.fits")),
        ("{{ datetime_timestamp.strftime('%Y%m%d_%H%M%S.%f')[:-5] }}.fits", "20261121_030001.2.fits".to_owned()),
        ("{{ filter_name.replace('+', 'p') | upper }}_{{ object_name[:4] }}.fits", "IPZ_TRAP.fits".to_owned()),
        (
            "{{ 'Dusk' if (datetime_timestamp + datetime.timedelta(hours=5)).hour > 12 else 'Dawn' }}_{{ device }}.fits",
            "Dawn_andor.fits".to_owned(),
        ),
        (
            "{{ 'Dusk' if (datetime_timestamp + datetime.timedelta(hours=10)).hour > 12 else 'Dawn' }}_{{ device }}.fits",
            "Dusk_andor.fits".to_owned(),
        ),
        (
            "{{ (action_datetime - datetime.timedelta(1, hours=12)).strftime('%m%d_%H') }}{{ device }}.fits",
            "1118_12andor.fits".to_owned(),
        ),
        (
            "{{ (action_datetime+datetime.timedelta(weeks=1, minutes=30)).strftime('%m%d_%H%M') }}.fits",
            "1127_0030.fits".to_owned(),
        ),
    ] {
        assert_eq!(name_of(&own("object", template).unwrap(), &frame()), expected, "{template}");
    }
    // Kinds of frames by a part of their name, whatever its case.
    for (image_type, expected) in [
        ("Light Frame", "light"),
        ("BIAS", "bias"),
        ("dark frame", "dark"),
        ("Flat Frame", "flat"),
        ("Unknown Frame", "default"),
    ] {
        let mut frame = frame();
        frame.purpose.image_type = image_type.to_owned();
        assert_eq!(name_of(&own("object", "{imagetype}.fits").unwrap(), &frame), format!("{expected}.fits"));
    }
    // Without a filter or an object, and with apostrophes.
    let mut bare = frame();
    (bare.purpose.filter, bare.purpose.object) = (Some("r'".to_owned()), None);
    assert_eq!(name_of(&own("object", "{filter_name}_{object_name}.fits").unwrap(), &bare), "r_NA.fits");
    // One Jinja template makes all of them Jinja, and an unknown action is passed over.
    let mixed = BTreeMap::from([
        ("object".to_owned(), "{device}.fits".to_owned()),
        ("flats".to_owned(), "{{ device }}.fits".to_owned()),
        ("focus".to_owned(), "{nonsense".to_owned()),
    ]);
    let namer = Namer::new(&mixed, FileProfile::Plain, 0.0).unwrap();
    let mut flat = frame();
    flat.purpose.action = "flats".to_owned();
    assert_eq!(name_of(&namer, &flat), "andor.fits");
    assert_ne!(name_of(&namer, &frame()), "andor.fits", "read as Jinja, a plain field is only text");
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
        FileProfile::Plain,
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
