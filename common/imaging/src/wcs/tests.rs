//! The way to the sky and back, and what the numbers of a WCS mean.

use super::*;

fn wcs(ra_deg: f64, dec_deg: f64, rotation_deg: f64, mirrored: bool) -> Wcs {
    let (sin, cos) = rotation_deg.to_radians().sin_cos();
    let side = if mirrored { -1.0 } else { 1.0 };
    let s = 0.5 / 3600.0;
    Wcs {
        ra: Angle::from_degrees(ra_deg),
        dec: Angle::from_degrees(dec_deg),
        x_px: 1023.5,
        y_px: 511.5,
        cd_deg_px: [[s * side * cos, s * sin], [-s * side * sin, s * cos]],
        sip: None,
    }
}

fn lens() -> Sip {
    let mut sip = Sip { a: [0.0; 7], b: [0.0; 7] };
    // a pincushion of 10 px in the corner, and a little tilt
    (sip.a[3], sip.a[5], sip.b[4], sip.b[6]) = (7e-9, 7e-9, 7e-9, 7e-9);
    (sip.a[0], sip.b[1]) = (3e-7, -2e-7);
    sip
}

#[test]
fn a_pixel_survives_the_way_to_the_sky_and_back() {
    for (ra, dec) in [(0.0, 0.0), (359.99, 12.0), (10.0, 89.9), (200.0, -90.0), (90.0, -45.0)] {
        for sip in [None, Some(lens())] {
            let wcs = Wcs { sip, ..wcs(ra, dec, 33.0, true) };
            for (x, y) in [(0.0, 0.0), (2047.0, 1023.0), (1023.5, 511.5), (-30.0, 700.25)] {
                let (ra, dec) = wcs.pixel_to_sky(x, y);
                let (back_x, back_y) = wcs.sky_to_pixel(ra, dec).unwrap();
                assert!((back_x - x).hypot(back_y - y) < 1e-7, "{x} {y} came back as {back_x} {back_y}");
            }
        }
    }
}

#[test]
fn rotation_is_the_position_angle_of_up() {
    for mirrored in [false, true] {
        for rotation in [0.0, 37.0, 89.59, -135.0, -179.5] {
            let wcs = wcs(83.0, 20.0, rotation, mirrored);
            assert_eq!(wcs.mirrored(), mirrored);
            assert!((wcs.rotation_deg() - rotation).abs() < 1e-9, "{} for {rotation}", wcs.rotation_deg());
            assert!((wcs.scale_arcsec_px() - 0.5).abs() < 1e-12);
            // a step up moves by the rotation east of north
            let plane = TangentPlane::new(wcs.ra, wcs.dec);
            let (ra, dec) = wcs.pixel_to_sky(wcs.x_px, wcs.y_px + 1.0);
            let (xi, eta) = plane.project(ra, dec).unwrap();
            assert!((xi.atan2(eta).to_degrees() - rotation).abs() < 1e-5);
        }
    }
}

#[test]
fn a_corner_agrees_with_another_program() {
    // golden/frames/f06_rot37: the centre pixel (512, 512) as cabaret and astropy 7.2.3 give it
    let wcs = Wcs {
        ra: Angle::from_degrees(210.006_481_845_539_33),
        dec: Angle::from_degrees(49.997_499_819_453_62),
        x_px: 511.0,
        y_px: 511.0,
        cd_deg_px: [
            [-5.719_805_511_872_720_6e-5, 4.310_182_609_271_974e-5],
            [-4.310_182_609_271_974e-5, -5.719_805_511_872_720_6e-5],
        ],
        sip: None,
    };
    let (ra, dec) = wcs.pixel_to_sky(512.0, 512.0);
    assert!((ra.degrees() - 210.006_459_916_886_06).abs() < 1e-11);
    assert!((dec.degrees() - 49.997_399_519_570_36).abs() < 1e-11);
}

#[test]
fn cards_count_from_one_and_carry_the_distortion_both_ways() {
    let plain = wcs(10.0, 20.0, 0.0, false).cards(2048, 1024);
    let value = |cards: &[Card], name: &str| cards.iter().find(|card| card.name == name).map(|card| card.value.clone());
    assert_eq!(value(&plain, "CRPIX1"), Some(Value::Number(1024.5)));
    assert_eq!(value(&plain, "CTYPE2"), Some(Value::Text("DEC--TAN".to_owned())));
    assert_eq!(value(&plain, "A_ORDER"), None);

    let wcs = Wcs { sip: Some(lens()), ..wcs(10.0, 20.0, 0.0, false) };
    let cards = wcs.cards(2048, 1024);
    assert_eq!(value(&cards, "CTYPE1"), Some(Value::Text("RA---TAN-SIP".to_owned())));
    assert_eq!(value(&cards, "A_ORDER"), Some(Value::Integer(3)));
    assert_eq!(value(&cards, "BP_ORDER"), Some(Value::Integer(5)));
    assert_eq!(value(&cards, "A_3_0"), Some(Value::Number(7e-9)));
    // the inverse takes a corrected corner back
    let (u, v) = (-1000.0, 500.0);
    let (seen_u, seen_v) = lens().apply(u, v);
    let [ap, bp] = lens().inverse_terms(1023.5, 511.5).unwrap();
    let sum = |terms: &[Term]| terms.iter().map(|t| t.coefficient * seen_u.powi(t.p) * seen_v.powi(t.q)).sum::<f64>();
    assert!((seen_u + sum(&ap) - u).abs() < 0.005 && (seen_v + sum(&bp) - v).abs() < 0.005);
}

#[test]
fn a_distortion_that_folds_over_gives_no_place() {
    let mut sip = lens();
    sip.a[0] = 0.1;
    let wcs = Wcs { sip: Some(sip), ..wcs(10.0, 20.0, 0.0, false) };
    assert_eq!(wcs.sky_to_pixel(Angle::from_degrees(10.2), Angle::from_degrees(20.2)), None);
}
