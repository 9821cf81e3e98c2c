//! Answers questions about the sky: one JSON object per line in, one per line out, for programs that compare this crate
//! with others (`tests/python/test_sky.py`).
//!
//! ```text
//! {"utc": "2026-11-21T03:00:00Z", "latitude_deg": -24.6, "longitude_east_deg": -70.4, "elevation_m": 2518.0,
//!  "dut1_s": 0.05, "polar_x_arcsec": 0.18, "polar_y_arcsec": 0.36,
//!  "star": {"ra_deg": 78.6, "dec_deg": -8.2}, "body": {"name": "mars"}, "sun_crossing": {"altitude_deg": -18, "rising": false}}
//! ```
//! A body is `{"name": ...}`, `{"tle": ...}` or `{"elements": {"q_au", "e", "i_deg", "node_deg", "peri_deg",
//! "tp_jd"}}`.
#![allow(clippy::print_stdout, reason = "this is what it is for")]

use std::io::BufRead as _;

use serde::Deserialize;
use serde_json::{Value, json};
use sky::moving::{Orbit, Satellite, Shape, When};
use sky::{Body, EarthOrientation, Horizontal, Icrs, Observer, Place};
use units::{Angle, Utc};

#[derive(Deserialize)]
struct Question {
    utc: Utc,
    latitude_deg: f64,
    longitude_east_deg: f64,
    elevation_m: f64,
    #[serde(default)]
    dut1_s: f64,
    #[serde(default)]
    polar_x_arcsec: f64,
    #[serde(default)]
    polar_y_arcsec: f64,
    star: Option<Star>,
    body: Option<Named>,
    sun_crossing: Option<Crossing>,
}

#[derive(Deserialize)]
struct Star {
    ra_deg: f64,
    dec_deg: f64,
}

#[derive(Deserialize)]
struct Crossing {
    altitude_deg: f64,
    rising: bool,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Named {
    Name(String),
    Tle(String),
    Elements(Elements),
}

#[derive(Deserialize)]
struct Elements {
    q_au: f64,
    e: f64,
    i_deg: f64,
    node_deg: f64,
    peri_deg: f64,
    tp_jd: f64,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for line in std::io::stdin().lock().lines() {
        println!("{}", answer(&serde_json::from_str(&line?)?)?);
    }
    Ok(())
}

fn answer(question: &Question) -> Result<Value, Box<dyn std::error::Error>> {
    let Question { dut1_s, polar_x_arcsec, polar_y_arcsec, .. } = *question;
    let (latitude, longitude) = (question.latitude_deg, question.longitude_east_deg);
    let place = Place::new(Angle::from_degrees(latitude), Angle::from_degrees(longitude), question.elevation_m)?;
    let earth = EarthOrientation { dut1_s, polar_x_arcsec, polar_y_arcsec };
    let observer = Observer::new(&place, &earth, question.utc)?;
    let mut report = json!({
        "apparent_sidereal_h": observer.sidereal_time().hours(),
        "mean_sidereal_h": observer.mean_sidereal_time().hours(),
        "sun": direction(observer.sun()),
        "moon": direction(observer.moon()),
    });
    if let Some(Star { ra_deg, dec_deg }) = question.star {
        let star = Icrs::from_degrees(ra_deg, dec_deg);
        let (horizontal, of_date) = (observer.to_horizontal(&star), observer.to_of_date(&star));
        report["star"] = direction(horizontal);
        report["star"]["airmass"] = json!(sky::airmass(horizontal.altitude));
        report["star"]["of_date_ra_deg"] = json!(of_date.ra.degrees());
        report["star"]["of_date_dec_deg"] = json!(of_date.dec.degrees());
    }
    if let Some(named) = &question.body {
        let seen = body(named)?.seen(&observer)?;
        report["body"] = direction(observer.to_horizontal(&seen.icrs));
        report["body"]["ra_deg"] = json!(seen.icrs.ra.degrees());
        report["body"]["dec_deg"] = json!(seen.icrs.dec.degrees());
        report["body"]["distance_au"] = json!(seen.distance_au);
    }
    if let Some(Crossing { altitude_deg, rising }) = question.sun_crossing {
        let altitude = Angle::from_degrees(altitude_deg);
        report["sun_crossing"] = json!(sky::next_sun_crossing(&place, &earth, question.utc, altitude, rising)?);
    }
    Ok(report)
}

fn body(named: &Named) -> Result<Body, Box<dyn std::error::Error>> {
    Ok(match named {
        Named::Name(name) => Body::named(name)?.ok_or(format!("{name}: not known without elements"))?,
        Named::Tle(lines) => Body::Satellite(Box::new(Satellite::from_lines(lines)?)),
        Named::Elements(elements) => {
            let angles = [elements.i_deg, elements.node_deg, elements.peri_deg].map(Angle::from_degrees);
            let angles = (angles[0], angles[1], angles[2]);
            let when = When::PerihelionAt(elements.tp_jd);
            Body::Orbit(Orbit::new(Shape::Perihelion(elements.q_au), elements.e, angles, when)?)
        }
    })
}

fn direction(horizontal: Horizontal) -> Value {
    json!({"altitude_deg": horizontal.altitude.degrees(), "azimuth_deg": horizontal.azimuth.degrees()})
}
