//! Headers that are completed.

use contract::datum::ReadingOutcome;
use contract::{NoData, Reading};

use super::*;

#[test]
fn the_targets_place_is_never_converted_again() {
    let around = |_: Kind, property: &str| match property {
        "RightAscension" => polls(Scalar::Float(12.0), Scalar::Float(12.0)),
        _ => polls(Scalar::Float(10.0), Scalar::Float(14.0)),
    };
    let (cards, history) = complete(&HeaderTable::default(), &frame(), EquatorialSystem::Topocentric, &around);
    assert!(!cards.contains_key("RA") && !cards.contains_key("DEC"));
    assert_eq!(cards["ALTITUDE"], CardValue::Float(11.0));
    assert_eq!(cards["PIERSIDE"], "unknown".into());
    assert!(cards.contains_key("OBJALT") && history.is_empty(), "{history:?}");
}

#[test]
fn a_mount_of_date_is_turned_to_icrs_and_one_of_j2000_is_taken_as_it_is() {
    let mut frame = frame();
    (frame.purpose.ra_deg, frame.purpose.dec_deg) = (None, None);
    let around = |_: Kind, property: &str| match property {
        "RightAscension" => polls(Scalar::Float(6.0), Scalar::Float(6.0)),
        "Declination" => polls(Scalar::Float(50.0), Scalar::Float(50.0)),
        "Altitude" => polls(Scalar::Float(44.0), Scalar::Float(48.0)),
        _ => None,
    };
    let table = HeaderTable::default();
    let (as_it_is, _) = complete(&table, &frame, EquatorialSystem::J2000, &around);
    assert_eq!((float(&as_it_is["RA"]), float(&as_it_is["DEC"])), (90.0, 50.0));
    let (turned, _) = complete(&table, &frame, EquatorialSystem::Topocentric, &around);
    // 26.9 years of precession at RA 6 h: 26.9 x (46.1 + 20.0 tan 50 deg) arcsec in RA, next to nothing in Dec.
    assert!((90.0 - float(&turned["RA"]) - 0.523).abs() < 0.02, "{:?}", turned["RA"]);
    assert!((float(&turned["DEC"]) - 50.0).abs() < 0.01, "{:?}", turned["DEC"]);
    // No target: the airmass is that of the direction that the mount reports, 45 deg.
    assert!((float(&turned["AIRMASS"]) - 1.4121).abs() < 1e-4);
    assert!(!turned.contains_key("OBJALT"));
    let (unknown, history) = complete(&table, &frame, EquatorialSystem::B1950, &around);
    assert!(!unknown.contains_key("RA") && history.iter().any(|line| line.contains("RA")), "{history:?}");
}

#[test]
fn what_was_not_polled_is_left_out_and_named() {
    let around = |kind: Kind, property: &str| match (kind, property) {
        (Kind::Camera, _) => Some(Around::default()),
        (Kind::Focuser, "Temperature") => polls(Scalar::Float(10.0), Scalar::Float(f64::INFINITY)),
        _ => None,
    };
    let (cards, history) = complete(&HeaderTable::default(), &frame(), EquatorialSystem::Other, &around);
    assert!(!cards.contains_key("CCD-TEMP") && !cards.contains_key("ALTITUDE") && !cards.contains_key("FOCUSTEM"));
    assert!(history.concat().contains("CCD-TEMP") && history.concat().contains("FOCUSTEM"), "{history:?}");
    assert!(!history.concat().contains("ALTITUDE"), "no mount is paired, so none is missed");
    assert!(history.iter().all(|line| line.len() <= 72));
}

#[test]
fn a_frame_without_target_and_mount_has_no_sky() {
    let mut frame = frame();
    (frame.purpose.ra_deg, frame.purpose.dec_deg) = (None, None);
    let (cards, _) = complete(&HeaderTable::default(), &frame, EquatorialSystem::Other, &|_, _| None);
    assert!(["JD-OBS", "LST", "DATE-END"].iter().all(|keyword| cards.contains_key(*keyword)));
    assert!(["AIRMASS", "BJD-OBS", "HA", "OBJAZ", "RA"].iter().all(|keyword| !cards.contains_key(*keyword)));
}

#[test]
fn the_middle_of_the_exposure_has_its_airmass_sun_and_moon() {
    let rows: String =
        ["AIRMASS", "MJD-OBS", "MJD-END", "MJD-AVG", "AIRMMID", "SUNALT", "MOONALT", "MOONDIST", "MOONFRAC"]
            .map(|keyword| format!("{keyword},float,false,astra,,\n"))
            .concat();
    let mut frame = frame();
    frame.exposure_s = 1200.0;
    let (cards, history) = complete(&table(&rows), &frame, EquatorialSystem::J2000, &|_, _| None);
    assert!(history.is_empty(), "{history:?}");
    let value = |keyword: &str| float(&cards[keyword]);
    assert!((value("MJD-AVG") - (value("MJD-OBS") + value("MJD-END")) / 2.0).abs() < 1e-9);
    // The same as the airmass at the start of an exposure that begins then.
    let mut later = frame.clone();
    later.started_utc = frame.started_utc.plus_seconds(600.0);
    let (at_start, _) = complete(&table(&rows), &later, EquatorialSystem::J2000, &|_, _| None);
    assert!((value("AIRMMID") - float(&at_start["AIRMASS"])).abs() < 1e-9);
    assert!((value("AIRMMID") - value("AIRMASS")).abs() > 1e-4, "it moves in ten minutes");
    // By astropy 7.2, for 01:48:03.821 UTC.
    for (keyword, expected, within) in [
        ("SUNALT", -48.1303, 0.005),
        ("MOONALT", 7.2794, 0.01),
        ("MOONDIST", 79.7031, 0.02),
        ("MOONFRAC", 0.83167, 1e-4),
    ] {
        assert!((value(keyword) - expected).abs() < within, "{keyword} is {}", value(keyword));
    }
    // Without a direction there is no airmass and no distance.
    frame.purpose.ra_deg = None;
    let (cards, history) = complete(&table(&rows), &frame, EquatorialSystem::J2000, &|_, _| None);
    assert!(!cards.contains_key("MOONDIST") && !cards.contains_key("BJD_TDB") && cards.contains_key("SUNALT"));
    assert_eq!(history, ["not known at DATE-OBS: AIRMASS, AIRMMID, MOONDIST"]);
}

/// A light curve of exposures of 120 s is 60 s early by the start; the middle is there whatever the table lists.
#[test]
fn the_middle_of_the_exposure_is_in_every_header() {
    let mut frame = frame();
    frame.exposure_s = 120.0;
    let (cards, _) = complete(&table("BJD-OBS,float,false,astra,,\n"), &frame, EquatorialSystem::J2000, &|_, _| None);
    assert!((float(&cards["BJD_TDB"]) - float(&cards["BJD-OBS"]) - 60.0 / 86_400.0).abs() < 2e-7, "{cards:?}");
    assert!(["DATE-AVG", "MJD-AVG", "AIRMMID"].iter().all(|keyword| cards.contains_key(*keyword)));
    // The same number as that of an exposure that begins then.
    let mut later = frame.clone();
    later.started_utc = frame.started_utc.plus_seconds(60.0);
    let (at_start, _) =
        complete(&table("BJD-OBS,float,false,astra,,\n"), &later, EquatorialSystem::J2000, &|_, _| None);
    assert!((float(&cards["BJD_TDB"]) - float(&at_start["BJD-OBS"])).abs() < 1e-9);
}

#[test]
fn a_frame_with_a_closed_shutter_has_a_time_and_no_direction() {
    for image_type in ["Bias Frame", "Dark Frame"] {
        let mut frame = frame();
        frame.purpose.image_type = image_type.to_owned();
        let around = |_: Kind, _: &str| polls(Scalar::Float(10.0), Scalar::Float(10.0));
        let (cards, history) = complete(&HeaderTable::default(), &frame, EquatorialSystem::J2000, &around);
        assert!(
            ["JD-OBS", "MJD-AVG", "DATE-END", "SUNALT", "CCD-TEMP"].iter().all(|keyword| cards.contains_key(*keyword))
        );
        let of_sky = ["AIRMASS", "AIRMMID", "BJD-OBS", "BJD_TDB", "HJD-OBS", "HA", "MOONDIST", "OBJALT", "OBJAZ"];
        assert!(of_sky.iter().all(|keyword| !cards.contains_key(*keyword)), "{image_type}: {cards:?}");
        assert!(history.is_empty(), "what there cannot be is not missed: {history:?}");
    }
}

#[test]
fn states_are_words_where_the_table_asks_for_a_text() {
    let state = |number: i64| move |_: Kind, _: &str| polls(Scalar::Int(number), Scalar::Int(number));
    let of = |dtype: &str, number: i64| {
        let table = table(&format!(
            "PIERSIDE,{dtype},false,Telescope,SideOfPier,\nDOMESTAT,{dtype},false,Dome,ShutterStatus,\nFW-POS,{dtype},false,FilterWheel,Position,\n"
        ));
        let (cards, _) = complete(&table, &frame(), EquatorialSystem::J2000, &state(number));
        ["PIERSIDE", "DOMESTAT", "FW-POS"].map(|keyword| cards[keyword].clone())
    };
    assert_eq!(of("str", 1), ["West".into(), "closed".into(), "1".into()]);
    assert_eq!(of("str", 0), ["East".into(), "open".into(), "0".into()]);
    assert_eq!(of("str", -1), ["unknown".into(), "unknown".into(), "-1".into()]);
    assert_eq!(of("int", 1), [1, 1, 1].map(CardValue::Int));
}

/// A row that is lost from the default table is missed by nobody else.
#[test]
fn what_devices_measure_is_written_by_the_default_table_and_states_as_words() {
    let measured = [
        ("ROTATANG", Kind::Rotator, "Position"),
        ("PRESSURE", Kind::ObservingConditions, "Pressure"),
        ("WINDSPD", Kind::ObservingConditions, "WindSpeed"),
        ("WINDGUST", Kind::ObservingConditions, "WindGust"),
        ("WINDDIR", Kind::ObservingConditions, "WindDirection"),
        ("RAINRATE", Kind::ObservingConditions, "RainRate"),
        ("CLOUDCVR", Kind::ObservingConditions, "CloudCover"),
        ("MPSAS", Kind::ObservingConditions, "SkyQuality"),
        ("SKYBRGHT", Kind::ObservingConditions, "SkyBrightness"),
    ];
    let around = |kind: Kind, property: &str| {
        let at = measured.iter().position(|row| (row.1, row.2) == (kind, property));
        let value = at.map_or(Scalar::Int(0), |at| Scalar::Float(at as f64 + 0.5));
        polls(value.clone(), value)
    };
    let (cards, _) = complete(&HeaderTable::default(), &frame(), EquatorialSystem::J2000, &around);
    for (at, (keyword, ..)) in measured.iter().enumerate() {
        assert!((float(&cards[*keyword]) - at as f64 - 0.5).abs() < 1e-9, "{keyword} is {:?}", cards[*keyword]);
    }
    let states = ["PIERSIDE", "DOMESTAT", "CAM-STAT", "CAM-STYP"].map(|keyword| cards[keyword].clone());
    assert_eq!(states, ["East", "open", "idle", "monochrome"].map(CardValue::from));
}

#[test]
fn a_setting_that_was_not_read_during_the_exposure_is_not_that_of_another_poll() {
    let table = table(
        "CAM-GAIN,int,true,Camera,Gain,\nCAM-OFFS,int,true,Camera,Offset,\nREADMODE,int,true,Camera,ReadoutMode,\nCAM-DNAM,str,true,Camera,Name,\n",
    );
    let mut frame = frame();
    let mut lose = |property: &str, no_data| {
        let outcome = ReadingOutcome::Missing { no_data };
        let reading = Reading { outcome, at_utc: frame.started_utc, age_s: None };
        frame.readings.insert(property.to_owned(), reading);
    };
    lose("Gain", NoData::new("timeout", "no answer within 2 s"));
    lose("Offset", NoData::not_implemented());
    let around = |_: Kind, property: &str| match property {
        "Name" => polls(Scalar::Text("andor".to_owned()), Scalar::Text("andor".to_owned())),
        _ => polls(Scalar::Int(120), Scalar::Int(120)),
    };
    let (cards, history) = complete(&table, &frame, EquatorialSystem::J2000, &around);
    assert_eq!(cards["CAM-DNAM"], CardValue::from("andor"));
    assert!(["CAM-GAIN", "CAM-OFFS", "READMODE"].iter().all(|keyword| !cards.contains_key(*keyword)), "{cards:?}");
    assert_eq!(history, ["not known at DATE-OBS: CAM-GAIN"]);
}

/// A station without a rain sensor is not one that was not asked.
#[test]
fn a_sensor_that_a_device_does_not_have_is_not_missed() {
    let around = |kind: Kind, property: &str| match (kind, property) {
        (Kind::ObservingConditions, "RainRate") => Some(Around { received_since: true, ..Around::default() }),
        (Kind::ObservingConditions, "Pressure") => Some(Around::default()),
        _ => None,
    };
    let (cards, history) = complete(&HeaderTable::default(), &frame(), EquatorialSystem::J2000, &around);
    assert!(!cards.contains_key("RAINRATE") && !cards.contains_key("PRESSURE"));
    assert_eq!(history, ["not known at DATE-OBS: PRESSURE"]);
}

#[test]
fn the_middle_and_the_end_of_an_exposure_may_be_on_another_day() {
    let rows = table("DATE-AVG,str,false,astra,,\nDATE-END,str,false,astra,,\nMJD-AVG,float,false,astra,,\n");
    for (start, exposure_s, middle, end) in [
        ("2026-12-31T23:59:50Z", 30.0, "2027-01-01T00:00:05.000000", "2027-01-01T00:00:20.000000"),
        ("2024-02-28T23:59:59.5Z", 2.0, "2024-02-29T00:00:00.500000", "2024-02-29T00:00:01.500000"),
        ("2026-11-21T03:00:00Z", 0.0, "2026-11-21T03:00:00.000000", "2026-11-21T03:00:00.000000"),
        ("2026-11-21T03:00:00.000001Z", 0.001, "2026-11-21T03:00:00.000501", "2026-11-21T03:00:00.001001"),
        ("2026-11-21T03:00:00Z", 7200.0, "2026-11-21T04:00:00.000000", "2026-11-21T05:00:00.000000"),
    ] {
        let mut frame = frame();
        (frame.started_utc, frame.exposure_s) = (start.parse().unwrap(), exposure_s);
        let (cards, history) = complete(&rows, &frame, EquatorialSystem::J2000, &|_, _| None);
        assert_eq!((&cards["DATE-AVG"], &cards["DATE-END"]), (&middle.into(), &end.into()), "{start}");
        let at: Utc = middle.parse().unwrap();
        assert_eq!(cards["MJD-AVG"], CardValue::Float(at.mjd()), "{start}");
        assert_eq!(history, Vec::<String>::new(), "{start}");
        let base = base_of(&table(""), &frame, &|_, _| None);
        assert_eq!(base["DATE-OBS"], fits_date(frame.started_utc).as_str().into(), "{start}");
    }
}

#[test]
fn a_target_below_the_horizon_has_a_direction_and_no_airmass() {
    let rows: String = ["AIRMASS", "AIRMMID", "MOONDIST", "HA", "BJD-OBS"]
        .map(|keyword| format!("{keyword},{},false,astra,,\n", if keyword == "HA" { "str" } else { "float" }))
        .concat();
    let mut frame = frame();
    // From 48 deg north it never rises.
    frame.purpose.dec_deg = Some(-80.0);
    let (cards, history) = complete(&table(&rows), &frame, EquatorialSystem::J2000, &|_, _| None);
    assert_eq!(history, ["not known at DATE-OBS: AIRMASS, AIRMMID"]);
    assert!(float(&cards["OBJALT"]) < -30.0, "{:?}", cards["OBJALT"]);
    assert!(["MOONDIST", "HA", "BJD-OBS"].iter().all(|keyword| cards.contains_key(*keyword)));
    // A place that is none is no target, and half of one neither.
    for (ra_deg, dec_deg) in [(Some(90.0), Some(91.0)), (Some(f64::NAN), Some(50.0)), (None, Some(50.0))] {
        (frame.purpose.ra_deg, frame.purpose.dec_deg) = (ra_deg, dec_deg);
        let (cards, _) = complete(&table(&rows), &frame, EquatorialSystem::J2000, &|_, _| None);
        let words: Vec<&str> = cards.keys().map(String::as_str).collect();
        assert_eq!(words, ["DATE-AVG", "MJD-AVG"], "{ra_deg:?} {dec_deg:?}: {cards:?}");
        let base = base_of(&table(""), &frame, &|_, _| None);
        assert!(!base.contains_key("RA") && !base.contains_key("DEC"), "{ra_deg:?} {dec_deg:?}");
    }
}

#[test]
fn a_focuser_stands_at_a_whole_step_and_a_wheel_at_a_filter() {
    let around = |kind: Kind, property: &str| match (kind, property) {
        (Kind::Focuser, "Position") => polls(Scalar::Int(25_009), Scalar::Int(25_010)),
        (Kind::FilterWheel, "Position") => polls(Scalar::Float(2.0), Scalar::Float(3.0)),
        _ => None,
    };
    let rows = table("FOCUSPOS,float,false,Focuser,Position,\nFW-POS,float,false,FilterWheel,Position,\n");
    let (cards, _) = complete(&rows, &frame(), EquatorialSystem::J2000, &around);
    // As they were polled while there was light.
    assert_eq!((float(&cards["FOCUSPOS"]), float(&cards["FW-POS"])), (25_010.0, 3.0));
}
