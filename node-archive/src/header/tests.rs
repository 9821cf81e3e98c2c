//! Tests of headers: those of new files here, those that are completed in [`later`], and the predecessor's own night in
//! [`predecessor`].

use std::collections::{BTreeMap, BTreeSet};

use contract::device::camera::Purpose;
use contract::device::telescope::EquatorialSystem;

use super::*;
use crate::interpolate::{Around, Sample};
use crate::sensor::unknown_of_sensor;

mod later;
mod predecessor;

fn place() -> config::Place {
    config::Place {
        site: "paranal".parse().unwrap(),
        telescope: "callisto".parse().unwrap(),
        latitude_deg: 48.0,
        longitude_deg: 8.0,
        elevation_m: 1000.0,
        dut1_s: 0.0,
        polar_x_arcsec: 0.0,
        polar_y_arcsec: 0.0,
    }
}

/// The site in the Earth's frame.
const OBSGEO_M: [f64; 3] = [4_234_769.43, 595_158.03, 4_717_619.47];

fn frame() -> Frame {
    Frame {
        purpose: Purpose {
            action: "object".to_owned(),
            object: Some("FieldA".to_owned()),
            image_type: "Light Frame".to_owned(),
            ra_deg: Some(90.0),
            dec_deg: Some(50.0),
            ..Purpose::default()
        },
        bin: 2,
        started_utc: "2026-11-21T01:38:03.821036Z".parse().unwrap(),
        ..test_support::frame("frame-1")
    }
}

fn table(rows: &str) -> HeaderTable {
    format!("header,dtype,fixed,device_type,device_command,comment\n{rows}").parse().unwrap()
}

fn base_of(
    table: &HeaderTable,
    frame: &Frame,
    newest: &dyn Fn(Kind, &str) -> Option<Scalar>,
) -> BTreeMap<String, CardValue> {
    let written = frame.started_utc.plus_seconds(10.0);
    let cards = base(table, &HeaderFacts { frame, place: &place(), written, sensor: Sensor::default(), newest });
    let count = cards.len();
    let cards: BTreeMap<_, _> = cards.into_iter().map(|card| (card.keyword, card.value)).collect();
    assert_eq!(cards.len(), count, "a keyword stands twice");
    cards
}

fn complete(
    table: &HeaderTable,
    frame: &Frame,
    mount: EquatorialSystem,
    around: &dyn Fn(Kind, &str) -> Option<Around>,
) -> (BTreeMap<String, CardValue>, Vec<String>) {
    let present = BTreeSet::new();
    let (place, holds_s, unknown_before) = (&place(), 60.0, None);
    let later = Later { frame, place, mount, holds_s, present: &present, unknown_before, around };
    let plan = completion(table, &later).unwrap();
    (plan.cards.into_iter().map(|card| (card.keyword, card.value)).collect(), plan.history)
}

fn float(value: &CardValue) -> f64 {
    match value {
        CardValue::Float(number) => *number,
        CardValue::Int(number) => *number as f64,
        CardValue::Logical(value) => f64::from(u8::from(*value)),
        CardValue::Text(text) => text.parse().unwrap(),
    }
}

/// A poll 1 s before and one 3 s after the start of the exposure.
fn polls(before: Scalar, after: Scalar) -> Option<Around> {
    let start = frame().started_utc;
    let sample = |seconds: f64, value| vec![Sample { at: start.plus_seconds(seconds), value }];
    let (before, after) = (sample(-1.0, before), sample(3.0, after));
    Some(Around { before, after, received_since: true, ..Around::default() })
}

#[test]
fn a_new_header_has_what_is_known_and_nothing_else() {
    let newest = |kind: Kind, property: &str| match (kind, property) {
        (Kind::Camera, "PixelSizeX") => Some(Scalar::Float(13.5)),
        (Kind::Camera, "BinX") => Some(Scalar::Int(2)),
        (Kind::Telescope, "FocalLength") => Some(Scalar::Int(8)),
        (Kind::Telescope, "SiteLatitude") => Some(Scalar::Float(-89.0)),
        _ => None,
    };
    let cards = base_of(&HeaderTable::default(), &frame(), &newest);
    for (keyword, value) in [
        ("DATE-OBS", CardValue::from("2026-11-21T01:38:03.821036")),
        ("DATE", "2026-11-21T01:38:13.821036".into()),
        ("EXPTIME", CardValue::Float(5.0)),
        ("OBJECT", "FieldA".into()),
        ("FRAMEID", "frame-1".into()),
        ("RA", CardValue::Float(90.0)),
        ("DEC", CardValue::Float(50.0)),
        ("RADESYS", "ICRS".into()),
        ("XPIXSZ", CardValue::Float(27.0)),
        ("XBINNING", CardValue::Int(2)),
        ("FOCALLEN", CardValue::Float(8000.0)),
        ("TELESCOP", "paranal-callisto".into()),
        ("INSTRUME", "paranal-callisto-andor".into()),
        ("SITELAT", CardValue::Float(48.0)),
        ("SITELONG", CardValue::Float(8.0)),
        ("SITEELEV", CardValue::Float(1000.0)),
        // By astropy 5.2, EarthLocation.from_geodetic(8, 48, 1000).
        ("OBSGEO-X", CardValue::Float(OBSGEO_M[0])),
        ("OBSGEO-Y", CardValue::Float(OBSGEO_M[1])),
        ("OBSGEO-Z", CardValue::Float(OBSGEO_M[2])),
        ("OBSGEO-H", CardValue::Float(997.0)),
        ("SWCREATE", PROGRAM.into()),
        ("ROWORDER", "TOP-DOWN".into()),
        ("BUNIT", "adu".into()),
        // The site that everything is computed for, not the site that the mount has.
        ("LAT-OBS", CardValue::Float(48.0)),
        ("ASTRA", PROGRAM.into()),
    ] {
        assert_eq!(cards.get(keyword), Some(&value), "{keyword}");
    }
    for keyword in ["BZERO", "SIMPLE", "BLANK", "YPIXSZ", "FILTER", "ALTITUDE", "ID", "AIRMASS", "PI-COI", "GAIN"] {
        assert_eq!(cards.get(keyword), None, "{keyword}");
    }
}

#[test]
fn a_table_that_calls_the_target_fk5_is_put_right() {
    let table = table("RADESYS,str,true,static,FK5,\nEQUINOX,float,true,static,2000,\nBLANK,int,true,static,-32768,\n");
    let cards = base_of(&table, &frame(), &|_, _| None);
    assert_eq!(cards["RADESYS"], "ICRS".into());
    assert_eq!(cards["EQUINOX"], CardValue::Float(2000.0));
    assert_eq!(cards.get("BLANK"), None);
}

#[test]
fn the_schedules_own_values_are_typed_or_left_out() {
    let table = table(
        "ID,int,true,action_metadata,ID,\nPROG,str,true,action_metadata,PROG,\nNIGHT,float,true,action_metadata,N,\n",
    );
    let mut frame = frame();
    frame.purpose.metadata =
        [("ID", "17"), ("PROG", "SPC"), ("N", "first")].map(|(k, v)| (k.to_owned(), v.to_owned())).into();
    let cards = base_of(&table, &frame, &|_, _| None);
    assert_eq!((&cards["ID"], &cards["PROG"], cards.get("NIGHT")), (&CardValue::Int(17), &"SPC".into(), None));
}

#[test]
fn rows_that_leave_no_trace_are_reported_at_the_start() {
    assert_eq!(check(&HeaderTable::default()), Vec::<String>::new());
    let notes = check(&table("MOONAGE,float,false,astra,,\nEPOCH,float,true,static,soon,\nGOOD,bool,true,static,1,\n"));
    assert_eq!(notes, ["MOONAGE: no keyword that Starmesh computes", "EPOCH: \"soon\" is no number"]);
}

#[test]
fn what_archives_ask_for_is_in_every_header_and_a_table_may_give_another_value() {
    let mut frame = frame();
    frame.purpose.night = "20261120".to_owned();
    frame.purpose.row = Some(7);
    frame.purpose.programme = Some("112.25XK.001".to_owned());
    let cards = base_of(&table(""), &frame, &|_, _| None);
    assert_eq!((&cards["OBSERVAT"], &cards["NIGHT"]), (&"paranal".into(), &"20261120".into()));
    assert_eq!((&cards["SCHEDROW"], &cards["PROGID"]), (&CardValue::Int(7), &"112.25XK.001".into()));
    let own = table("OBSERVAT,str,true,static,Cerro Paranal,\nPROGID,str,true,static,60.A-9009(A),\n");
    let cards = base_of(&own, &frame, &|_, _| None);
    assert_eq!((&cards["OBSERVAT"], &cards["PROGID"]), (&"Cerro Paranal".into(), &"112.25XK.001".into()));
    // A row without a programme has that of the table.
    frame.purpose.programme = None;
    assert_eq!(base_of(&own, &frame, &|_, _| None)["PROGID"], "60.A-9009(A)".into());
    assert_eq!(base_of(&table(""), &frame, &|_, _| None).get("PROGID"), None);
}

/// What photometry asks for: by the driver, before it by the configuration, and named where neither knows.
#[test]
fn gain_noise_and_saturation_are_the_drivers_or_the_configurations() {
    let driver = |kind: Kind, property: &str| match (kind, property) {
        (Kind::Camera, "ElectronsPerADU") => Some(Scalar::Float(1.3)),
        (Kind::Camera, "MaxADU") => Some(Scalar::Int(1_048_575)),
        _ => None,
    };
    let with = |sensor: Sensor, newest: &dyn Fn(Kind, &str) -> Option<Scalar>, table: &HeaderTable| {
        let (frame, place) = (frame(), place());
        let known = HeaderFacts { frame: &frame, place: &place, written: frame.started_utc, sensor, newest };
        base(table, &known).into_iter().map(|card| (card.keyword, card.value)).collect::<BTreeMap<_, _>>()
    };
    let present = |cards: &BTreeMap<String, CardValue>| cards.keys().cloned().collect::<BTreeSet<String>>();
    for table in [HeaderTable::default(), table("")] {
        let cards = with(Sensor::default(), &driver, &table);
        assert_eq!((&cards["GAIN"], &cards["EGAIN"]), (&CardValue::Float(1.3), &CardValue::Float(1.3)));
        // 16 bits hold no more than 65,535, and what is clipped has one percent less or more.
        assert_eq!(cards["SATURATE"], CardValue::Float(64_879.0));
        assert_eq!(unknown_of_sensor(&present(&cards)), ["RDNOISE not known: give read_noise_e of the camera's block"]);
        let given = Sensor {
            electrons_per_adu: Some(0.8),
            read_noise_e: Some(2.5),
            saturation_adu: Some(50_000.0),
            max_adu: None,
        };
        let cards = with(given, &driver, &table);
        assert_eq!((&cards["GAIN"], &cards["RDNOISE"]), (&CardValue::Float(0.8), &CardValue::Float(2.5)));
        assert_eq!((&cards["SATURATE"], unknown_of_sensor(&present(&cards))), (&CardValue::Float(50_000.0), vec![]));
    }
    let beyond = Sensor { saturation_adu: Some(100_000.0), ..Sensor::default() };
    let cards = with(beyond, &driver, &HeaderTable::default());
    assert_eq!(cards["SATURATE"], CardValue::Float(65_535.0), "the file holds no more");
    // Drivers report 0 for what they do not know.
    let zeros = |_: Kind, _: &str| Some(Scalar::Int(0));
    let cards = with(Sensor::default(), &zeros, &HeaderTable::default());
    assert!(["GAIN", "EGAIN", "SATURATE", "FOCALLEN", "APTDIA"].iter().all(|keyword| !cards.contains_key(*keyword)));
    assert_eq!(unknown_of_sensor(&present(&cards)).len(), 3);
    // A site whose GAIN is the setting of its camera keeps it.
    let own = table("GAIN,int,false,Camera,Gain,setting\n");
    assert_eq!(with(Sensor::default(), &driver, &own).get("GAIN"), None);
    assert!(unknown_of_sensor(&BTreeSet::new()).iter().all(|line| line.len() <= 72));
}

#[test]
fn lengths_are_in_the_unit_that_the_table_names() {
    let newest = |_: Kind, property: &str| {
        Some(Scalar::Float(match property {
            "FocalLength" => 0.9,
            "ApertureDiameter" => 0.3,
            _ => 0.07,
        }))
    };
    let of = |unit: &str| {
        let row = |keyword: &str, unit: String| format!("{keyword},float,true,astra,,{unit} of the telescope\n");
        let rows =
            [row("FOCALLEN", unit.to_owned()), row("APTDIA", unit.to_owned()), row("APTAREA", unit.replace(']', "2]"))];
        let cards = base_of(&table(&rows.concat()), &frame(), &newest);
        ["FOCALLEN", "APTDIA", "APTAREA"].map(|keyword| float(&cards[keyword]))
    };
    assert_eq!(of("[mm]"), [900.0, 300.0, 70_000.0]);
    assert_eq!(of("[m]"), [0.9, 0.3, 0.07]);
    // As the predecessor's tables have it.
    assert_eq!(of("length"), [0.9, 0.3, 0.07]);
}

/// Ten years of motion are half an arcsecond of many a star.
#[test]
fn the_place_of_a_target_has_a_frame_and_an_epoch() {
    let (frame, place, sensor) = (frame(), place(), Sensor::default());
    let known = HeaderFacts { frame: &frame, place: &place, written: frame.started_utc, sensor, newest: &|_, _| None };
    let records: Vec<String> = base(&HeaderTable::default(), &known).iter().filter_map(Card::record).collect();
    for expected in [
        "RA      =                 90.0 / [deg] RA of the target at DATE-OBS, ICRS",
        "DEC     =                 50.0 / [deg] DEC of the target at DATE-OBS, ICRS",
        "RADESYS = 'ICRS    '           / frame of RA and DEC",
        "EQUINOX =               2000.0 / equinox of RA and DEC; their epoch is DATE-OBS",
    ] {
        assert!(records.iter().any(|record| record.trim_end() == expected), "{expected}: {records:?}");
    }
}

#[test]
fn what_a_frame_does_not_have_is_no_keyword_and_what_it_has_fits_its_card() {
    let mut frame = frame();
    frame.purpose.row = Some(0);
    let cards = base_of(&table(""), &frame, &|_, _| None);
    assert_eq!(cards["SCHEDROW"], CardValue::Int(0));
    assert!(!cards.contains_key("NIGHT") && !cards.contains_key("PROGID") && !cards.contains_key("FILTER"));
    for programme in ["X".repeat(40), "'".repeat(34), "112.25XK.001".to_owned()] {
        frame.purpose.programme = Some(programme.clone());
        let (written, sensor) = (frame.started_utc, Sensor::default());
        let known = HeaderFacts { frame: &frame, place: &place(), written, sensor, newest: &|_, _| None };
        let cards = base(&table(""), &known);
        let card = cards.iter().find(|card| card.keyword == "PROGID").unwrap();
        let record = card.record().unwrap();
        assert!(record.starts_with(&format!("PROGID  = '{:<8}'", programme.replace('\'', "''"))), "{record}");
    }
}

#[test]
fn the_colours_of_a_one_shot_camera_are_those_of_the_part_of_the_sensor_that_was_read() {
    let sensor = |kind: i64, [x, y]: [i64; 2]| {
        move |of: Kind, property: &str| match (of, property) {
            (Kind::Camera, "SensorType") => Some(Scalar::Int(kind)),
            (Kind::Camera, "BayerOffsetX") => Some(Scalar::Int(x)),
            (Kind::Camera, "BayerOffsetY") => Some(Scalar::Int(y)),
            _ => None,
        }
    };
    let keywords = ["BAYERPAT", "XBAYROFF", "YBAYROFF"];
    let whole = Frame { bin: 1, ..frame() };
    let part = Frame { origin_px: [101, 200], ..whole.clone() };
    // Whether a site's table lists them or not.
    for table in [HeaderTable::default(), table("")] {
        for (frame, offset, expected) in
            [(&whole, [0, 0], [0, 0]), (&whole, [1, 0], [1, 0]), (&part, [0, 1], [1, 1]), (&part, [1, 1], [0, 1])]
        {
            let cards = base_of(&table, frame, &sensor(2, offset));
            let values = keywords.map(|keyword| cards[keyword].clone());
            assert_eq!(values, ["RGGB".into(), CardValue::Int(expected[0]), CardValue::Int(expected[1])]);
        }
        let binned = Frame { bin: 2, ..whole.clone() };
        let planes = Frame { planes: 3, ..whole.clone() };
        for (frame, kind) in [(&binned, 2), (&planes, 2), (&whole, 0), (&whole, 1), (&whole, 3)] {
            let cards = base_of(&table, frame, &sensor(kind, [0, 0]));
            assert!(keywords.iter().all(|keyword| !cards.contains_key(*keyword)), "{kind}: {cards:?}");
        }
    }
}

#[test]
fn a_row_that_stands_twice_or_is_no_keyword_is_named_and_left_out() {
    let table = table(
        "SITE,str,true,static,first,\nsite,str,true,static,second,\nTEMP,float,false,Dome,Azimuth,\nTEMP,float,true,static,1.5,\nHISTORY,str,true,static,x,\n\
         COMMENT,str,true,static,x,\nCONTINUE,str,true,static,x,\nHIERARCH,float,false,Telescope,Altitude,\n",
    );
    let notes = check(&table);
    assert_eq!(notes.len(), 6, "{notes:?}");
    for keyword in ["SITE", "TEMP", "HISTORY", "COMMENT", "CONTINUE", "HIERARCH"] {
        assert!(notes.iter().any(|note| note.starts_with(&format!("{keyword}: "))), "{keyword}: {notes:?}");
    }
    let cards = base_of(&table, &frame(), &|_, _| None);
    assert_eq!(cards["SITE"], "first".into());
    assert!(["TEMP", "HISTORY", "COMMENT", "CONTINUE"].iter().all(|keyword| !cards.contains_key(*keyword)));
    let around = |_: Kind, _: &str| polls(Scalar::Float(7.0), Scalar::Float(7.0));
    let (cards, _) = complete(&table, &frame(), EquatorialSystem::J2000, &around);
    assert_eq!((float(&cards["TEMP"]), cards.contains_key("HIERARCH")), (7.0, false));
}
