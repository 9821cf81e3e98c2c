//! The values of place, scale and time in a header, before its frame is solved.

use anyhow::{Context as _, bail, ensure};
use fits::Header;
use fits::card::Value;
use imaging::Wcs;
use imaging::solve::{FIRST_LIGHT, KNOWN_OPTICS};
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

/// The expected centre of the frame: from an older solution in the header, else from the direction of the telescope.
pub fn place(header: &Header, size_px: (usize, usize)) -> anyhow::Result<Place> {
    if let Some(wcs) = solution(header) {
        return Ok(wcs.pixel_to_sky(0.5 * (size_px.0 as f64 - 1.0), 0.5 * (size_px.1 as f64 - 1.0)));
    }
    const PAIRS: [(&str, &str); 7] = [
        ("RA", "DEC"),
        ("RA_DEG", "DEC_DEG"),
        ("OBJCTRA", "OBJCTDEC"),
        ("RA-MNT", "DEC-MNT"),
        ("TELRA", "TELDEC"),
        ("OBJRA", "OBJDEC"),
        ("CRVAL1", "CRVAL2"),
    ];
    for (ra, dec) in PAIRS {
        if let Some((ra, dec)) = header.value(ra).zip(header.value(dec)) {
            let place = angle(ra, 15.0).zip(angle(dec, 1.0)).filter(|(_, dec)| dec.degrees().abs() <= 90.0);
            return place.context(
                "the header's place is no direction (right ascension and declination); give --ra-deg and --dec-deg",
            );
        }
    }
    let pairs: Vec<String> = PAIRS.iter().map(|(ra, dec)| format!("{ra}/{dec}")).collect();
    bail!("the header has no place ({}); give --ra-deg and --dec-deg", pairs.join(", "))
}

/// Size of a pixel, arcsec, and how wrong it may be, as a share.
pub fn scale(header: &Header) -> anyhow::Result<(f64, f64)> {
    if let Some(wcs) = solution(header) {
        let [[a, b], [c, d]] = wcs.cd_deg_px;
        return Ok(((a * d - b * c).abs().sqrt() * 3600.0, KNOWN_OPTICS));
    }
    let positive = |keyword: &str| header.number(keyword).ok().filter(|value| *value > 0.0);
    const DIRECT: [&str; 5] = ["SECPIX", "SECPIX1", "PIXSCALE", "PIXSCAL1", "SCALE"];
    if let Some(scale) = DIRECT.iter().find_map(|keyword| positive(keyword)) {
        return Ok((scale, FIRST_LIGHT));
    }
    let pixel_um = ["XPIXSZ", "PIXSIZE1"].iter().find_map(|keyword| positive(keyword));
    let Some((focal, pixel_um)) = positive("FOCALLEN").zip(pixel_um) else {
        bail!("the header has no scale (FOCALLEN and XPIXSZ, {}); give --scale-arcsec-px", DIRECT.join(", "))
    };
    let focal_mm = if focal <= LONGEST_M { focal * 1e3 } else { focal };
    Ok((pixel_um * 1e-3 / focal_mm * ARCSEC, FIRST_LIGHT))
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
    let axis = |keyword: &str, word: &str| header.text(keyword).is_ok_and(|kind| kind.starts_with(word));
    if !(axis("CTYPE1", "RA--") && axis("CTYPE2", "DEC-")) {
        return None;
    }
    let number = |keyword: &str| header.number(keyword).ok();
    let cd = |keyword: &str| number(keyword).unwrap_or(0.0);
    let matrix = if number("CD1_1").is_some() || number("CD1_2").is_some() {
        [[cd("CD1_1"), cd("CD1_2")], [cd("CD2_1"), cd("CD2_2")]]
    } else {
        let (x, y, turn) = (number("CDELT1")?, number("CDELT2")?, cd("CROTA2").to_radians());
        let pc = |keyword: &str, or: f64| number(keyword).unwrap_or(or);
        if number("CROTA2").is_some() {
            [[x * turn.cos(), -y * turn.sin()], [x * turn.sin(), y * turn.cos()]]
        } else {
            [[x * pc("PC1_1", 1.0), x * pc("PC1_2", 0.0)], [y * pc("PC2_1", 0.0), y * pc("PC2_2", 1.0)]]
        }
    };
    let determinant = matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0];
    let wcs = Wcs {
        ra: Angle::from_degrees(number("CRVAL1")?),
        dec: Angle::from_degrees(number("CRVAL2").filter(|dec| dec.abs() <= 90.0)?),
        x_px: number("CRPIX1")? - 1.0,
        y_px: number("CRPIX2")? - 1.0,
        cd_deg_px: matrix,
        sip: None,
    };
    (determinant.is_finite() && determinant != 0.0).then_some(wcs)
}

/// A number is degrees; text with three numbers is hours (or degrees, with `units_deg` 1), minutes and seconds.
fn angle(value: &Value, unit_deg: f64) -> Option<Angle> {
    let text = match value {
        Value::Whole(whole) => return Some(Angle::from_degrees(*whole as f64)),
        Value::Number(number) => return Some(Angle::from_degrees(*number)),
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
    Some(Angle::from_degrees(degrees))
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
