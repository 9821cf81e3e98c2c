//! The values of place, scale and time in a header, before its frame is solved.

use anyhow::{bail, ensure};
use fits::Header;
use fits::card::Value;
use imaging::Wcs;
use imaging::solve::{FIRST_LIGHT, KNOWN_OPTICS};
use sky::{Icrs, separation};
use units::Angle;

/// A place on the sky: ICRS right ascension and declination.
pub type Place = (Angle, Angle);

/// Arcseconds of a radian.
const ARCSEC: f64 = 206_264.806;
/// Focal lengths up to here are metres, as the standard telescopes write them; beyond they are mm. No focal length lies
/// between: 20 mm would be a fish-eye, and 20 m is longer than any tube.
const LONGEST_M: f64 = 20.0;
/// Julian date of J2000.0.
const J2000_JD: f64 = 2_451_545.0;

/// Longest side of a frame that a hint may give it, degrees, as the solver has it.
const WIDEST_FIELD_DEG: f64 = 60.0;
/// No pixel shows less of the sky, arcsec.
const LEAST_SCALE: f64 = 0.001;
/// Places nearer to one that is tried before are not tried again.
const SAME_PLACE: Angle = Angle::from_degrees(0.2);
/// The same of scales, as a share.
const SAME_SCALE: f64 = 0.02;
/// Hints that are tried, at most: each that fits nothing takes some seconds.
const MOST_TRIES: usize = 6;
/// Right ascensions are written within this, degrees.
const RA_DEG: std::ops::RangeInclusive<f64> = -360.0..=720.0;

/// The keywords of a place, in the order in which they are tried.
const PLACES: [(&str, &str); 7] = [
    ("RA", "DEC"),
    ("RA_DEG", "DEC_DEG"),
    ("OBJCTRA", "OBJCTDEC"),
    ("RA-MNT", "DEC-MNT"),
    ("TELRA", "TELDEC"),
    ("OBJRA", "OBJDEC"),
    ("CRVAL1", "CRVAL2"),
];
/// The keywords of a scale.
const SCALES: [&str; 5] = ["SECPIX", "SECPIX1", "PIXSCALE", "PIXSCAL1", "SCALE"];

/// Size of a pixel, arcsec, and how wrong it may be, as a share.
pub type Scale = (f64, f64);

/// The hints in a header that can be, best first, and why others cannot be.
#[derive(Debug, Default)]
pub struct HeaderHints {
    /// Expected centres of the frame.
    pub places: Vec<Place>,
    /// Scales.
    pub scales: Vec<Scale>,
    /// What was passed over, and why.
    pub passed_over: Vec<String>,
}

impl HeaderHints {
    /// Those of the header of a frame of this size.
    pub fn of(header: &Header, size_px: (usize, usize)) -> Self {
        let mut hints = Self::default();
        let side_px = size_px.0.max(size_px.1) as f64;
        // Zeros may be a place, and are what programs write that know none.
        let mut zeros = Vec::new();
        match old_solution(header) {
            Some(Ok(wcs)) => {
                let scale = wcs_scale(&wcs);
                match possible_scale(scale, side_px) {
                    Ok(()) => {
                        hints.add_scale((scale, KNOWN_OPTICS));
                        let centre = wcs.pixel_to_sky(0.5 * (size_px.0 as f64 - 1.0), 0.5 * (size_px.1 as f64 - 1.0));
                        match () {
                            () if is_zero((wcs.ra, wcs.dec)) => zeros.push(("the WCS".to_owned(), centre)),
                            () if centre.0.is_finite() && centre.1.is_finite() => hints.add_place(centre),
                            () => hints.passed_over.push("the WCS (its centre is no direction)".to_owned()),
                        }
                    }
                    Err(why) => hints.passed_over.push(format!("the WCS ({why})")),
                }
            }
            Some(Err(why)) => hints.passed_over.push(format!("the WCS ({why})")),
            None => {}
        }
        for (ra, dec) in PLACES {
            let Some((ra_value, dec_value)) = header.value(ra).zip(header.value(dec)) else { continue };
            let found = angle(ra_value, 15.0).zip(angle(dec_value, 1.0));
            let place = found.filter(|(ra, dec)| RA_DEG.contains(&ra.degrees()) && dec.degrees().abs() <= 90.0);
            match place {
                Some(place) if is_zero(place) => zeros.push((format!("{ra}/{dec}"), place)),
                Some(place) => hints.add_place(place),
                None => {
                    let shown = format!("{}, {}", shown(ra_value), shown(dec_value));
                    hints.passed_over.push(format!("{ra}/{dec} ({shown} is no direction)"));
                }
            }
        }
        for (name, place) in zeros {
            if !hints.places.iter().any(|known| !is_zero(*known)) {
                hints.add_place(place);
            } else {
                hints.passed_over.push(format!("{name} (0, 0 is written where the place is not known)"));
            }
        }
        hints.read_scales(header, side_px);
        hints
    }

    fn read_scales(&mut self, header: &Header, side_px: f64) {
        for keyword in SCALES {
            let Ok(scale) = header.number(keyword) else { continue };
            match possible_scale(scale, side_px) {
                Ok(()) => self.add_scale((scale, FIRST_LIGHT)),
                Err(why) => self.passed_over.push(format!("{keyword} ({why})")),
            }
        }
        let mut first_positive = |keywords: &[&str]| {
            keywords.iter().find_map(|keyword| {
                let value = header.number(keyword).ok()?;
                let is_one = value.is_finite() && value > 0.0;
                if !is_one {
                    self.passed_over.push(format!("{keyword} ({value} is no length)"));
                }
                is_one.then_some(value)
            })
        };
        let (focal, pixel_um) = (first_positive(&["FOCALLEN"]), first_positive(&["XPIXSZ", "PIXSIZE1"]));
        if let Some((focal, pixel_um)) = focal.zip(pixel_um) {
            let focal_mm = if focal <= LONGEST_M { focal * 1e3 } else { focal };
            let scale = pixel_um * 1e-3 / focal_mm * ARCSEC;
            match possible_scale(scale, side_px) {
                Ok(()) => self.add_scale((scale, FIRST_LIGHT)),
                Err(why) => self.passed_over.push(format!("FOCALLEN and XPIXSZ ({why})")),
            }
        }
    }

    fn add_place(&mut self, place: Place) {
        let at = |(ra, dec): Place| Icrs { ra, dec };
        if !self.places.iter().any(|known| separation(&at(*known), &at(place)) < SAME_PLACE) {
            self.places.push(place);
        }
    }

    fn add_scale(&mut self, scale: Scale) {
        if !self.scales.iter().any(|known| (known.0 / scale.0 - 1.0).abs() < SAME_SCALE) {
            self.scales.push(scale);
        }
    }

    /// The places and scales to try, in this order; those of the options stand in place of the header's.
    pub fn pairs(&self, place: Option<Place>, scale: Option<Scale>) -> anyhow::Result<Vec<(Place, Scale)>> {
        let places = place.map_or_else(|| self.places.clone(), |place| vec![place]);
        let scales = scale.map_or_else(|| self.scales.clone(), |scale| vec![scale]);
        if places.is_empty() {
            let keywords: Vec<String> = PLACES.iter().map(|(ra, dec)| format!("{ra}/{dec}")).collect();
            bail!("the header has no place ({}); give --ra-deg and --dec-deg", keywords.join(", "));
        }
        if scales.is_empty() {
            bail!("the header has no scale (FOCALLEN and XPIXSZ, {}); give --scale-arcsec-px", SCALES.join(", "));
        }
        let mut ranked: Vec<(usize, Place, Scale)> = Vec::new();
        for (m, place) in places.iter().enumerate() {
            ranked.extend(scales.iter().enumerate().map(|(n, scale)| (m + n, *place, *scale)));
        }
        ranked.sort_by_key(|(rank, ..)| *rank);
        Ok(ranked.into_iter().take(MOST_TRIES).map(|(_, place, scale)| (place, scale)).collect())
    }

    /// What was passed over, as the end of a sentence; empty where nothing was.
    pub fn passed_over_words(&self) -> String {
        if self.passed_over.is_empty() {
            return String::new();
        }
        format!("; passed over in the header: {}", self.passed_over.join(", "))
    }
}

fn is_zero((ra, dec): Place) -> bool {
    ra.wrapped_signed().degrees().abs() < 1e-9 && dec.degrees().abs() < 1e-9
}

/// A scale that a frame can have whose longer side is so many pixels; an error with the reason.
fn possible_scale(scale_arcsec_px: f64, side_px: f64) -> Result<(), String> {
    let field_deg = scale_arcsec_px * side_px / 3600.0;
    match () {
        // True for NaN too.
        () if !(LEAST_SCALE..f64::MAX).contains(&scale_arcsec_px) => {
            Err(format!("{scale_arcsec_px} arcsec/px is no scale"))
        }
        () if field_deg > WIDEST_FIELD_DEG => {
            Err(format!("{scale_arcsec_px:.4} arcsec/px makes a field of {field_deg:.0} deg; expected at most 60"))
        }
        () => Ok(()),
    }
}

fn wcs_scale(wcs: &Wcs) -> f64 {
    let [[a, b], [c, d]] = wcs.cd_deg_px;
    (a * d - b * c).abs().sqrt() * 3600.0
}

/// The value of a card, for people.
fn shown(value: &Value) -> String {
    match value {
        Value::Whole(whole) => whole.to_string(),
        Value::Number(number) => number.to_string(),
        Value::Text(text) => format!("'{}'", text.trim()),
        other => format!("{other:?}"),
    }
}

/// When the frame was taken, Julian year; None where no keyword contains it.
pub fn epoch_year(header: &Header) -> Option<f64> {
    let date = |keyword: &str| header.text(keyword).ok().and_then(julian_date);
    let number = |keyword: &str, zero: f64| header.number(keyword).ok().map(|day| day + zero);
    let jd = date("DATE-OBS").or_else(|| number("MJD-OBS", 2_400_000.5)).or_else(|| number("JD", 0.0));
    jd.map(|jd| 2000.0 + (jd - J2000_JD) / 365.25).filter(|year| (1800.0..2200.0).contains(year))
}

/// An older solution: TAN and its kin, by CD matrix or by CDELT and CROTA.
pub fn solution(header: &Header) -> Option<Wcs> {
    old_solution(header)?.ok()
}

/// As [`solution`]; where there is one that cannot be, the reason.
fn old_solution(header: &Header) -> Option<Result<Wcs, String>> {
    let axis = |keyword: &str, word: &str| header.text(keyword).is_ok_and(|kind| kind.starts_with(word));
    if !(axis("CTYPE1", "RA--") && axis("CTYPE2", "DEC-")) {
        return None;
    }
    Some(read_solution(header))
}

fn read_solution(header: &Header) -> Result<Wcs, String> {
    let number = |keyword: &str| header.number(keyword).ok();
    let needed = |keyword: &str| {
        let value = number(keyword).ok_or_else(|| format!("{keyword} is missing"))?;
        if value.is_finite() { Ok(value) } else { Err(format!("{keyword} = {value}")) }
    };
    let cd = |keyword: &str| number(keyword).unwrap_or(0.0);
    let matrix = if number("CD1_1").is_some() || number("CD1_2").is_some() {
        [[cd("CD1_1"), cd("CD1_2")], [cd("CD2_1"), cd("CD2_2")]]
    } else {
        let (x, y, turn) = (needed("CDELT1")?, needed("CDELT2")?, cd("CROTA2").to_radians());
        if x.abs() == 1.0 && y.abs() == 1.0 {
            return Err("CDELT1 and CDELT2 have their default, 1 deg/px".to_owned());
        }
        let pc = |keyword: &str, or: f64| number(keyword).unwrap_or(or);
        if number("CROTA2").is_some() {
            [[x * turn.cos(), -y * turn.sin()], [x * turn.sin(), y * turn.cos()]]
        } else {
            [[x * pc("PC1_1", 1.0), x * pc("PC1_2", 0.0)], [y * pc("PC2_1", 0.0), y * pc("PC2_2", 1.0)]]
        }
    };
    let (ra_deg, dec_deg) = (needed("CRVAL1")?, needed("CRVAL2")?);
    if !RA_DEG.contains(&ra_deg) || dec_deg.abs() > 90.0 {
        return Err(format!("CRVAL1, CRVAL2 = {ra_deg}, {dec_deg} is no direction"));
    }
    let [[a, b], [c, d]] = matrix;
    let determinant = a * d - b * c;
    let (across, along) = (a.hypot(c), b.hypot(d));
    if !determinant.is_finite() || determinant == 0.0 || !(1.0 / UNLIKE..=UNLIKE).contains(&(across / along)) {
        return Err("its matrix is none of a frame".to_owned());
    }
    Ok(Wcs {
        ra: Angle::from_degrees(ra_deg),
        dec: Angle::from_degrees(dec_deg),
        x_px: needed("CRPIX1")? - 1.0,
        y_px: needed("CRPIX2")? - 1.0,
        cd_deg_px: matrix,
        sip: None,
    })
}

/// The sides of a pixel differ by no more than this factor.
const UNLIKE: f64 = 8.0;

/// A number is degrees; text with three numbers is hours (or degrees, with `units_deg` 1), minutes and seconds.
fn angle(value: &Value, unit_deg: f64) -> Option<Angle> {
    let text = match value {
        Value::Whole(whole) => return Some(Angle::from_degrees(*whole as f64)),
        Value::Number(number) => return Some(Angle::from_degrees(*number)).filter(|angle| angle.is_finite()),
        Value::Text(text) => text.trim(),
        _ => return None,
    };
    let parts: Vec<f64> = text
        .split(|c: char| c == ':' || c.is_whitespace() || "hdms'\"°".contains(c))
        .filter(|part| !part.is_empty())
        .map(|part| part.parse().ok().filter(|number: &f64| number.is_finite()))
        .collect::<Option<_>>()?;
    let degrees = match parts.as_slice() {
        [degrees] => *degrees,
        [whole, rest @ ..] if rest.len() <= 2 => {
            let small = rest.iter().rev().fold(0.0, |sum, part| (sum + part) / 60.0);
            let size = (whole.abs() + small) * unit_deg;
            if text.starts_with('-') { -size } else { size }
        }
        _ => return None,
    };
    Some(Angle::from_degrees(degrees)).filter(|angle| angle.is_finite())
}

/// The Julian date of `2026-11-21` or `2026-11-21T03:00:00.5`.
fn julian_date(text: &str) -> Option<f64> {
    let (day, time) = text.trim().split_once('T').unwrap_or((text.trim(), ""));
    let parts: Vec<i64> = day.split('-').map(|part| part.parse().ok()).collect::<Option<_>>()?;
    let [year, month, day] = parts.as_slice() else { return None };
    if !((1..=12).contains(month) && (1..=31).contains(day) && (1000..3000).contains(year)) {
        return None;
    }
    let clock = time.trim_end_matches('Z').split(':').map(|part| part.parse().unwrap_or(0.0));
    let seconds: f64 = clock.zip([3600.0, 60.0, 1.0]).map(|(part, unit): (f64, f64)| part * unit).sum();
    // Days of the Gregorian calendar: Fliegel & van Flandern 1968, CACM 11, 657.
    let a = (month - 14) / 12;
    let days = (1461 * (year + 4800 + a)) / 4 + (367 * (month - 2 - 12 * a)) / 12 - (3 * ((year + 4900 + a) / 100)) / 4
        + day
        - 32_075;
    Some(days as f64 - 0.5 + seconds / 86_400.0)
}

/// The place that options give; both or none of them.
pub fn asked_place(ra_deg: Option<f64>, dec_deg: Option<f64>) -> anyhow::Result<Option<Place>> {
    let (ra, dec) = match (ra_deg, dec_deg) {
        (Some(ra), Some(dec)) => (ra, dec),
        (None, None) => return Ok(None),
        _ => bail!("give both --ra-deg and --dec-deg, or none of them"),
    };
    ensure!((-360.0..=360.0).contains(&ra), "--ra-deg is {ra}, expected 0 to 360");
    ensure!((-90.0..=90.0).contains(&dec), "--dec-deg is {dec}, expected -90 to 90");
    Ok(Some((Angle::from_degrees(ra).wrapped_positive(), Angle::from_degrees(dec))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(cards: &[&str]) -> Header {
        let mut text: String =
            ["SIMPLE  =                    T", "BITPIX  =                   16", "NAXIS   =                    0"]
                .iter()
                .chain(cards)
                .chain(&["END"])
                .map(|card| format!("{card:80}"))
                .collect();
        while !text.len().is_multiple_of(2880) {
            text.push(' ');
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        fits::table::primary_header(file.path()).unwrap()
    }

    fn hints(cards: &[&str]) -> (Vec<(f64, f64)>, Vec<f64>, String) {
        let found = HeaderHints::of(&header(cards), (512, 512));
        let tenths = |number: f64| (number * 10.0).round() / 10.0;
        let places = found.places.iter().map(|(ra, dec)| (tenths(ra.degrees()), tenths(dec.degrees())));
        let scales = found.scales.iter().map(|(scale, _)| tenths(*scale));
        (places.collect(), scales.collect(), found.passed_over_words())
    }

    const TAN: [&str; 4] = ["CTYPE1  = 'RA---TAN'", "CTYPE2  = 'DEC--TAN'", "CRPIX1  = 256.5", "CRPIX2  = 256.5"];
    const GOOD: [&str; 4] = ["RA      = 60.0", "DEC     = -30.0", "FOCALLEN= 1055.0", "XPIXSZ  = 54.0"];

    #[test]
    fn a_solution_that_cannot_be_is_passed_over_with_the_reason() {
        let with = |more: &[&str]| hints(&[&TAN[..], more, &GOOD[..]].concat());
        let rows: [(&[&str], &str); 7] = [
            (&["CRVAL1  = 0.0", "CRVAL2  = 0.0", "CDELT1  = 1.0", "CDELT2  = 1.0"], "have their default, 1 deg/px"),
            (
                &["CRVAL1  = 10.0", "CRVAL2  = 5.0", "CD1_1   = 1.0", "CD2_2   = 1.0"],
                "a field of 512 deg; expected at most 60",
            ),
            (&["CRVAL1  = 10.0", "CRVAL2  = 95.0", "CDELT1  = 0.003", "CDELT2  = 0.003"], "10, 95 is no direction"),
            (&["CRVAL1  = -9999.0", "CRVAL2  = 5.0", "CDELT1  = 0.003", "CDELT2  = 0.003"], "-9999, 5 is no direction"),
            (&["CRVAL1  = 10.0", "CRVAL2  = 5.0", "CDELT1  = 0.0", "CDELT2  = 0.0"], "its matrix is none of a frame"),
            (&["CRVAL1  = 10.0", "CRVAL2  = 5.0"], "CDELT1 is missing"),
            (&["CRVAL2  = 5.0", "CDELT1  = 0.003", "CDELT2  = 0.003"], "CRVAL1 is missing"),
        ];
        for (cards, why) in rows {
            let (places, scales, passed_over) = with(cards);
            assert_eq!((places[0], &scales[..]), ((60.0, -30.0), &[10.6][..]), "{cards:?}");
            assert!(passed_over.contains("the WCS (") && passed_over.contains(why), "{cards:?}: {passed_over}");
        }
        // One that can be is the first hint, and the other keywords are tried after it.
        let good = ["CRVAL1  = 10.0", "CRVAL2  = 5.0", "CDELT1  = -0.001", "CDELT2  = 0.001"];
        let found = with(&good);
        assert_eq!(found, (vec![(10.0, 5.0), (60.0, -30.0)], vec![3.6, 10.6], String::new()));
        // Only its place is zero.
        let (places, scales, passed_over) =
            with(&["CRVAL1  = 0.0", "CRVAL2  = 0.0", "CDELT1  = -0.001", "CDELT2  = 0.001"]);
        assert_eq!((places, scales), (vec![(60.0, -30.0)], vec![3.6, 10.6]));
        assert!(passed_over.contains("the WCS (0, 0 is written where the place is not known)"), "{passed_over}");
    }

    #[test]
    fn keywords_that_hold_no_value_are_passed_over_and_the_next_are_used() {
        let object = ["OBJCTRA = '04 00 05.27'", "OBJCTDEC= '-30 00 47.1'"];
        let rows: [(&[&str], &str); 5] = [
            (&["RA      = 0.0", "DEC     = 0.0"], "RA/DEC (0, 0 is written where the place is not known)"),
            (&["RA      = 'north'", "DEC     = 10.0"], "RA/DEC ('north', 10 is no direction)"),
            (&["RA      = 10.0", "DEC     = 99.0"], "RA/DEC (10, 99 is no direction)"),
            (&["RA      = -9999", "DEC     = 0"], "RA/DEC (-9999, 0 is no direction)"),
            (&["RA      = 'NaN'", "DEC     = 'NaN'"], "RA/DEC ('NaN', 'NaN' is no direction)"),
        ];
        for (cards, why) in rows {
            let (places, _, passed_over) = hints(&[cards, &object[..]].concat());
            assert_eq!(places, [(60.0, -30.0)], "{cards:?}");
            assert!(passed_over.contains(why), "{cards:?}: {passed_over}");
        }
        let (places, _, passed_over) = hints(&["RA      = 0.0", "DEC     = 0.0"]);
        assert_eq!(
            (places, passed_over.as_str()),
            (vec![(0.0, 0.0)], ""),
            "it may be the place, where no other is given"
        );
        let (_, scales, passed_over) =
            hints(&["SCALE   = 0.0", "PIXSCALE= 9999.0", "FOCALLEN= 1055.0", "XPIXSZ  = 0.0", "PIXSIZE1= 54.0"]);
        assert_eq!(scales, [10.6]);
        for why in [
            "SCALE (0 arcsec/px is no scale)",
            "PIXSCALE (9999.0000 arcsec/px makes a field of 1422 deg",
            "XPIXSZ (0 is no length)",
        ] {
            assert!(passed_over.contains(why), "{passed_over}");
        }
    }

    #[test]
    fn all_pairs_of_hints_are_tried_the_best_of_both_first() {
        let place = |deg: f64| (Angle::from_degrees(deg), Angle::from_degrees(deg));
        let all = HeaderHints {
            places: [1.0, 2.0, 3.0].map(place).to_vec(),
            scales: vec![(1.0, 0.1), (2.0, 0.1)],
            passed_over: Vec::new(),
        };
        let numbers = |pairs: Vec<(Place, Scale)>| -> Vec<(f64, f64)> {
            pairs.iter().map(|((ra, _), (scale, _))| (ra.degrees().round(), *scale)).collect()
        };
        let pairs = numbers(all.pairs(None, None).unwrap());
        assert_eq!(pairs, [(1.0, 1.0), (1.0, 2.0), (2.0, 1.0), (2.0, 2.0), (3.0, 1.0), (3.0, 2.0)]);
        assert_eq!(numbers(all.pairs(Some(place(9.0)), Some((4.0, 0.1))).unwrap()), [(9.0, 4.0)]);
        let none = HeaderHints::default();
        assert!(none.pairs(None, Some((1.0, 0.1))).unwrap_err().to_string().contains("give --ra-deg and --dec-deg"));
        assert!(none.pairs(Some(place(1.0)), None).unwrap_err().to_string().contains("give --scale-arcsec-px"));
    }

    #[test]
    fn places_are_read_as_degrees_or_in_sixtieths() {
        let text = |text: &str, unit| angle(&Value::Text(text.to_owned()), unit).map(|angle| angle.degrees());
        let near = |found: Option<f64>, expected: f64| assert!((found.unwrap() - expected).abs() < 1e-9, "{found:?}");
        near(text("05 35 17.3", 15.0), (5.0 + 35.0 / 60.0 + 17.3 / 3600.0) * 15.0);
        near(text("-00:23:28", 1.0), -(23.0 / 60.0 + 28.0 / 3600.0));
        near(text("83.5", 15.0), 83.5);
        near(text("+45d30m", 1.0), 45.5);
        assert_eq!(text("north", 1.0), None);
        assert_eq!(text("1 2 3 4", 1.0), None);
    }

    #[test]
    fn dates_become_julian_dates() {
        assert_eq!(julian_date("2000-01-01T12:00:00"), Some(2_451_545.0));
        assert_eq!(julian_date("2026-11-21T03:00:00.000"), Some(2_461_365.625));
        assert_eq!(julian_date("2000-09-27"), Some(2_451_814.5));
        assert_eq!(julian_date("27/09/00"), None);
        assert_eq!(julian_date("2000-13-01"), None);
    }
}
