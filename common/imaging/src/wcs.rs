//! The world coordinate system of a frame: which direction of the sky falls on which pixel.
//!
//! TAN projection with CD matrix and, for lenses and large fields, a SIP distortion ([`Sip`]). Inside, pixel `(0, 0)`
//! is the centre of the first pixel; in the FITS cards CRPIX is greater by one. Calabretta & Greisen 2002, A&A 395, 1077.

mod sip;

use units::Angle;

use crate::tangent::TangentPlane;
pub use sip::{MAX_ORDER, Sip, Term};

/// Pixels to sky and back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wcs {
    /// ICRS right ascension of the reference pixel (CRVAL1).
    pub ra: Angle,
    /// ICRS declination of the reference pixel (CRVAL2).
    pub dec: Angle,
    /// Column of the reference pixel, px (CRPIX1 - 1).
    pub x_px: f64,
    /// Row of the reference pixel, px (CRPIX2 - 1).
    pub y_px: f64,
    /// Degrees of xi (first row) and eta (second row) per px of x (first column) and y.
    pub cd_deg_px: [[f64; 2]; 2],
    /// Distortion; None where the optics show none.
    pub sip: Option<Sip>,
}

/// A card of a FITS header.
#[derive(Debug, Clone, PartialEq)]
pub struct Card {
    /// Keyword, such as `CRVAL1`.
    pub name: String,
    /// Its value.
    pub value: Value,
    /// What it means, with its unit.
    pub comment: &'static str,
}

/// The value of a FITS card.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// A string.
    Text(String),
    /// A whole number.
    Integer(i64),
    /// A number.
    Number(f64),
}

impl Wcs {
    /// The ICRS direction (right ascension in [0, 360) deg, declination) of a place in the frame, px.
    pub fn pixel_to_sky(&self, x_px: f64, y_px: f64) -> (Angle, Angle) {
        let (u, v) = (x_px - self.x_px, y_px - self.y_px);
        let (u, v) = self.sip.map_or((u, v), |sip| sip.apply(u, v));
        let [[a, b], [c, d]] = self.cd_deg_px;
        let plane = TangentPlane::new(self.ra, self.dec);
        plane.direction((a * u + b * v).to_radians(), (c * u + d * v).to_radians())
    }

    /// Where an ICRS direction falls, px; it may lie outside of the frame. None for the far hemisphere, or where the
    /// distortion, used far outside of the frame it was made for, has no inverse.
    pub fn sky_to_pixel(&self, ra: Angle, dec: Angle) -> Option<(f64, f64)> {
        self.plane_to_pixel(TangentPlane::new(self.ra, self.dec).project(ra, dec)?)
    }

    /// Where several directions fall; the plane is made once.
    pub(crate) fn all_to_pixels<'a>(
        &'a self,
        directions: impl Iterator<Item = (Angle, Angle)> + 'a,
    ) -> impl Iterator<Item = Option<(f64, f64)>> + 'a {
        let plane = TangentPlane::new(self.ra, self.dec);
        directions.map(move |(ra, dec)| self.plane_to_pixel(plane.project(ra, dec)?))
    }

    fn plane_to_pixel(&self, (xi, eta): (f64, f64)) -> Option<(f64, f64)> {
        let (xi, eta) = (xi.to_degrees(), eta.to_degrees());
        let [[a, b], [c, d]] = self.cd_deg_px;
        let determinant = a * d - b * c;
        let (u, v) = ((d * xi - b * eta) / determinant, (a * eta - c * xi) / determinant);
        let (u, v) = self.sip.map_or(Some((u, v)), |sip| sip.invert(u, v))?;
        (u.is_finite() && v.is_finite()).then_some((self.x_px + u, self.y_px + v))
    }

    /// Size of a pixel at the reference pixel: the root of its area, arcsec.
    pub fn scale_arcsec_px(&self) -> f64 {
        self.determinant().abs().sqrt() * 3600.0
    }

    /// Position angle of the +y direction, from north through east, degrees in [-180, 180); the mean over both axes.
    /// 0 means that +y points to the north; astrometry.net says "up is ... degrees E of N".
    pub fn rotation_deg(&self) -> f64 {
        let [[a, b], [c, d]] = self.cd_deg_px;
        let sense = if self.mirrored() { -1.0 } else { 1.0 };
        Angle::from_radians((b - sense * c).atan2(d + sense * a)).wrapped_signed().degrees()
    }

    /// Whether the frame, drawn with its first row at the top as camera programs do, is a mirror image of the sky:
    /// a negative determinant of CD, which astrometry.net calls parity "neg". (FITS viewers draw the first row at the
    /// bottom and so turn this about.)
    pub fn mirrored(&self) -> bool {
        self.determinant() < 0.0
    }

    /// The cards of a FITS header for a frame of this many columns and rows (the inverse distortion is fitted for it).
    pub fn cards(&self, width: usize, height: usize) -> Vec<Card> {
        let card = |name: &str, value: Value, comment| Card { name: name.to_owned(), value, comment };
        let number = |name: &str, value: f64, comment| card(name, Value::Number(value), comment);
        let text = |name: &str, value: &str, comment| card(name, Value::Text(value.to_owned()), comment);
        let kind = |axis: &str| if self.sip.is_some() { format!("{axis}-SIP") } else { axis.to_owned() };
        let [[a, b], [c, d]] = self.cd_deg_px;
        let mut cards = vec![
            card("WCSAXES", Value::Integer(2), "number of axes of the coordinate system"),
            text("CTYPE1", &kind("RA---TAN"), "right ascension, tangent plane"),
            text("CTYPE2", &kind("DEC--TAN"), "declination, tangent plane"),
            text("CUNIT1", "deg", "unit of CRVAL1 and CD1"),
            text("CUNIT2", "deg", "unit of CRVAL2 and CD2"),
            text("RADESYS", "ICRS", "frame of the coordinates"),
            number("CRVAL1", self.ra.degrees(), "[deg] right ascension of the reference pixel"),
            number("CRVAL2", self.dec.degrees(), "[deg] declination of the reference pixel"),
            number("CRPIX1", self.x_px + 1.0, "[pix] column of the reference pixel, from 1"),
            number("CRPIX2", self.y_px + 1.0, "[pix] row of the reference pixel, from 1"),
            number("CD1_1", a, "[deg/pix] to the east per column"),
            number("CD1_2", b, "[deg/pix] to the east per row"),
            number("CD2_1", c, "[deg/pix] to the north per column"),
            number("CD2_2", d, "[deg/pix] to the north per row"),
        ];
        if let Some(sip) = self.sip {
            let half = |length: usize, at: f64| at.max(length as f64 - 1.0 - at).max(1.0);
            cards.extend(polynomial(["A", "B"], sip.terms(), MAX_ORDER));
            // without an inverse a reader inverts A and B itself
            let inverse = sip.inverse_terms(half(width, self.x_px), half(height, self.y_px));
            cards.extend(inverse.into_iter().flat_map(|terms| polynomial(["AP", "BP"], terms, sip::INVERSE_ORDER)));
        }
        cards
    }

    fn determinant(&self) -> f64 {
        let [[a, b], [c, d]] = self.cd_deg_px;
        a * d - b * c
    }
}

fn polynomial(names: [&str; 2], terms: [Vec<Term>; 2], order: usize) -> Vec<Card> {
    let axis = |(name, terms): (&str, Vec<Term>)| {
        let comment = "order of the distortion polynomial";
        let head = Card { name: format!("{name}_ORDER"), value: Value::Integer(order as i64), comment };
        let card = |t: Term| Card {
            name: format!("{name}_{}_{}", t.p, t.q),
            value: Value::Number(t.coefficient),
            comment: "distortion coefficient",
        };
        std::iter::once(head).chain(terms.into_iter().map(card)).collect::<Vec<_>>()
    };
    names.into_iter().zip(terms).flat_map(axis).collect()
}

#[cfg(test)]
mod tests;
