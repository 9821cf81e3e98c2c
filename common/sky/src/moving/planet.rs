//! The planets, by the analytic theory VSOP87.

use vsop87::vsop87a;

/// From the ecliptic and equinox of J2000 of the theory to the axes of FK5, which are those of the ICRS within 0.03
/// arcsec: the matrix that comes with VSOP87 (Bretagnon and Francou 1988, A&A 202, 309).
const TO_EQUATOR: [[f64; 3]; 3] = [
    [1.0, 0.000_000_440_360, -0.000_000_190_919],
    [-0.000_000_479_966, 0.917_482_137_087, -0.397_776_982_902],
    [0.0, 0.397_776_982_902, 0.917_482_137_087],
];

/// A planet, other than the Earth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Planet {
    /// The innermost.
    Mercury,
    /// The brightest.
    Venus,
    /// The red one.
    Mars,
    /// The largest.
    Jupiter,
    /// The one with rings.
    Saturn,
    /// The seventh.
    Uranus,
    /// The outermost.
    Neptune,
}

impl Planet {
    /// The planet of this name, in lower case.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "mercury" => Self::Mercury,
            "venus" => Self::Venus,
            "mars" => Self::Mars,
            "jupiter" => Self::Jupiter,
            "saturn" => Self::Saturn,
            "uranus" => Self::Uranus,
            "neptune" => Self::Neptune,
            _ => return None,
        })
    }

    /// From the Sun, ICRS axes, au, at a terrestrial time (Julian date in two parts).
    pub(super) fn at(self, tt: (f64, f64)) -> [f64; 3] {
        // One number: it holds 40 us, in which the fastest planet goes 2 m.
        let jd = tt.0 + tt.1;
        let place = match self {
            Self::Mercury => vsop87a::mercury(jd),
            Self::Venus => vsop87a::venus(jd),
            Self::Mars => vsop87a::mars(jd),
            Self::Jupiter => vsop87a::jupiter(jd),
            Self::Saturn => vsop87a::saturn(jd),
            Self::Uranus => vsop87a::uranus(jd),
            Self::Neptune => vsop87a::neptune(jd),
        };
        let ecliptic = [place.x, place.y, place.z];
        TO_EQUATOR.map(|row| row[0] * ecliptic[0] + row[1] * ecliptic[1] + row[2] * ecliptic[2])
    }
}
