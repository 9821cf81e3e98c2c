//! Tests of headers, and the predecessor's own night (tests/data/headers) completed again.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use contract::datum::ReadingOutcome;
use contract::device::camera::{Pixel, Purpose};
use contract::{CommandId, NoData, Reading};
use serde_json::Value;

use super::*;
use crate::sensor::unknown_of_sensor;

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
        id: CommandId("frame-1".to_owned()),
        camera: "andor".to_owned(),
        purpose: Purpose {
            action: "object".to_owned(),
            object: Some("FieldA".to_owned()),
            image_type: "Light Frame".to_owned(),
            ra_deg: Some(90.0),
            dec_deg: Some(50.0),
            ..Purpose::default()
        },
        width_px: 4,
        height_px: 2,
        planes: 1,
        pixel: Pixel::U16,
        bin: 2,
        origin_px: [0, 0],
        started_utc: "2026-11-21T01:38:03.821036Z".parse().unwrap(),
        exposure_s: 5.0,
        url: String::new(),
        bytes: 16,
        sha256: String::new(),
        readings: BTreeMap::new(),
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
    let sample = |seconds: f64, value| Some(Sample { at: start.plus_seconds(seconds), value });
    Some(Around { before: sample(-1.0, before), after: sample(3.0, after), received_since: true })
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

// The predecessor's night.

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/headers").join(name)
}

fn unzipped(path: &Path) -> String {
    let mut text = String::new();
    flate2::read::GzDecoder::new(std::fs::File::open(path).unwrap()).read_to_string(&mut text).unwrap();
    text
}

/// All polls of a property, by kind and property (each kind has one device).
fn telemetry() -> BTreeMap<(String, String), Vec<Sample>> {
    let mut polls: BTreeMap<(String, String), Vec<Sample>> = BTreeMap::new();
    for line in unzipped(&data("polling.csv.gz")).lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let value = match cells[3] {
            "True" => Scalar::Bool(true),
            "False" => Scalar::Bool(false),
            text => match (text.parse(), text.parse()) {
                (Ok(number), _) => Scalar::Int(number),
                (_, Ok(number)) => Scalar::Float(number),
                _ => Scalar::Text(text.to_owned()),
            },
        };
        let sample = Sample { at: cells[4].parse().unwrap(), value };
        polls.entry((cells[0].to_owned(), cells[2].to_owned())).or_default().push(sample);
    }
    polls.values_mut().for_each(|samples| samples.sort_by_key(|sample| sample.at));
    polls
}

#[test]
fn the_predecessors_night_completes_to_the_same_numbers_and_better_states() {
    let table: HeaderTable = std::fs::read_to_string(data("fits_header_config.csv")).unwrap().parse().unwrap();
    let telemetry = telemetry();
    let (mut linear, mut states, mut fractions, mut skies) = (0, 0, 0, 0);
    let mut files: Vec<PathBuf> = std::fs::read_dir(data("")).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.to_string_lossy().ends_with(".json.gz"));
    assert!(files.len() > 40, "{}", files.len());
    for path in files {
        let image: Value = serde_json::from_str(&unzipped(&path)).unwrap();
        let cards = |key: &str| -> BTreeMap<String, Value> {
            let cards = image[key].as_array().unwrap().iter();
            cards.map(|card| (card["k"].as_str().unwrap().to_owned(), card["v"].clone())).collect()
        };
        let (before, after) = (cards("before"), cards("after"));
        let mut frame = frame();
        frame.started_utc = before["DATE-OBS"].as_str().unwrap().parse().unwrap();
        frame.exposure_s = before["EXPTIME"].as_f64().unwrap();
        frame.purpose.ra_deg = before.get("RA").and_then(Value::as_f64);
        frame.purpose.dec_deg = before.get("DEC").and_then(Value::as_f64);
        let around = |kind: Kind, property: &str| {
            let samples = telemetry.get(&(kind.ascom().to_owned(), property.to_owned()))?;
            let split = samples.partition_point(|sample| sample.at < frame.started_utc);
            let (earlier, later) = samples.split_at(split);
            Some(Around { before: earlier.last().cloned(), after: later.first().cloned(), received_since: true })
        };
        let (ours, history) = complete(&table, &frame, EquatorialSystem::J2000, &around);
        assert_eq!(history, Vec::<String>::new(), "{}", path.display());

        for row in table.rows.iter().filter(|row| !row.fixed && after.contains_key(&row.keyword)) {
            let Source::Property(kind, property) = &row.source else { continue };
            let Some(expected) = after[&row.keyword].as_f64() else { continue };
            let Some(value) = ours.get(&row.keyword) else {
                // The target's own place, which completion leaves alone.
                assert!(
                    matches!(row.keyword.as_str(), "RA" | "DEC") && frame.purpose.ra_deg.is_some(),
                    "{}",
                    row.keyword
                );
                continue;
            };
            let samples = around(*kind, property).unwrap();
            let ends = samples.before.as_ref().zip(samples.after.as_ref());
            // The predecessor interpolates in Julian days, which are good to 50 us.
            let step = ends.and_then(|(a, b)| Some((b.value.number()? - a.value.number()?, b.at.seconds_since(a.at))));
            let tolerance = 1e-6 + step.map_or(0.0, |(step, span_s)| step.abs() / span_s * 1e-4);
            match Rule::of(*kind, property, row.dtype) {
                Rule::Linear => {
                    assert!((float(value) - expected).abs() < tolerance, "{} {value:?} {expected}", row.keyword);
                    linear += 1;
                }
                Rule::Circular { turn } => {
                    assert!((0.0..if row.keyword == "RA" { 360.0 } else { turn }).contains(&float(value)));
                    // Over north the predecessor goes the long way round.
                    if step.is_none_or(|(step, _)| step.abs() < turn / 2.0) {
                        assert!(
                            (float(value) - expected).abs() < tolerance * 15.0,
                            "{} {value:?} {expected}",
                            row.keyword
                        );
                        linear += 1;
                    }
                }
                Rule::Nearest => {
                    // One of the two states that were polled, with the predecessor's number between them.
                    let polled = [&samples.before, &samples.after].map(|s| s.as_ref().and_then(|s| s.value.number()));
                    let [first, second] = polled.map(|number| number.unwrap_or(float(value)));
                    assert!([first, second].contains(&float(value)), "{} {value:?}", row.keyword);
                    assert!((first.min(second)..=first.max(second)).contains(&expected), "{} {expected}", row.keyword);
                    states += 1;
                    fractions += usize::from(expected.fract() != 0.0);
                }
            }
        }
        for (keyword, tolerance) in [
            ("JD-OBS", 1e-9),
            ("JD-END", 1e-9),
            ("MJD-OBS", 1e-9),
            ("MJD-END", 1e-9),
            ("LST", 1.0),      // Its own UT1-UTC.
            ("HJD-OBS", 6e-7), // 50 ms
            ("BJD-OBS", 6e-7),
            ("AIRMASS", 1e-3),
        ] {
            // A bias has no target here; the predecessor takes the parked mount's direction, so do we.
            let Some(expected) = after.get(keyword).and_then(Value::as_f64) else { continue };
            assert!((float(&ours[keyword]) - expected).abs() < tolerance, "{keyword} {:?} {expected}", ours[keyword]);
            skies += 1;
        }
        assert_eq!(ours["DATE-END"], after["DATE-END"].as_str().unwrap().into());
    }
    assert!(linear > 400 && states > 200 && skies > 300, "{linear} {states} {skies}");
    // The predecessor wrote states between two states; `Nearest` corrects that.
    assert!(fractions > 0);
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
