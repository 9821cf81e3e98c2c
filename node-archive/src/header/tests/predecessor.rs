//! The predecessor's own night (tests/data/headers) completed again.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::*;
use crate::interpolate::Rule;

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
            let before = earlier.iter().rev().take(2).cloned().collect();
            let after = later.iter().take(2).cloned().collect();
            Some(Around { before, after, received_since: true, ..Around::default() })
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
            let ends = samples.before.first().zip(samples.after.first());
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
                Rule::Held => {
                    // One of the two states that were polled, with the predecessor's number between them.
                    let polled = [&samples.before, &samples.after].map(|s| s.first().and_then(|s| s.value.number()));
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
    // The predecessor wrote states between two states; `Held` corrects that.
    assert!(fractions > 0);
}
