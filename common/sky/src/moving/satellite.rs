//! Satellites of the Earth: two-line elements and the SGP4 model that belongs to them.

use sgp4::{Constants, MinutesSinceEpoch};
use sofars::erst;
use units::Utc;

use crate::{Observer, SkyError};

const AU_KM: f64 = 149_597_870.7;
/// Elements older than this do not give a satellite's place, days.
const MOST_DAYS: f64 = 366.0;

/// A satellite of the Earth by its two-line elements.
#[derive(Debug, Clone)]
pub struct Satellite {
    lines: String,
    epoch: Utc,
    constants: Constants,
}

impl PartialEq for Satellite {
    fn eq(&self, other: &Self) -> bool {
        self.lines == other.lines
    }
}

impl Satellite {
    /// From the text of two-line elements: two lines, or three with the name first.
    ///
    /// # Errors
    /// When they are no such lines, a checksum is wrong, or they describe no orbit.
    pub fn from_lines(text: &str) -> Result<Self, SkyError> {
        let refuse = |why: String| SkyError::TwoLines(why);
        let lines: Vec<&str> = text.lines().map(str::trim_end).filter(|line| !line.trim().is_empty()).collect();
        let (first, second) = match lines.as_slice() {
            [first, second] | [_, first, second] => (first, second),
            _ => return Err(refuse(format!("expected two lines (or three with a name first), found {}", lines.len()))),
        };
        if !(first.is_ascii() && second.is_ascii()) {
            return Err(refuse("expected plain ASCII".to_owned()));
        }
        let elements = sgp4::Elements::from_tle(None, first.trim_start().as_bytes(), second.trim_start().as_bytes())
            .map_err(|error| refuse(error.to_string()))?;
        // The constants of WGS72, with which such elements are made (Vallado et al. 2006, AIAA 2006-6753).
        let constants =
            Constants::from_elements_afspc_compatibility_mode(&elements).map_err(|error| refuse(error.to_string()))?;
        let epoch = Utc::from_micros(elements.datetime.and_utc().timestamp_micros());
        Ok(Self { lines: format!("{first}\n{second}"), epoch, constants })
    }

    /// When the elements were true.
    pub const fn epoch(&self) -> Utc {
        self.epoch
    }

    /// From the centre of the Earth, ICRS axes, au; `from_teme` turns the frame of the elements to those.
    pub(super) fn at(&self, at: Utc, from_teme: &[[f64; 3]; 3]) -> Result<[f64; 3], SkyError> {
        let minutes = at.seconds_since(self.epoch) / 60.0;
        if minutes.abs() > MOST_DAYS * 1440.0 {
            let days = minutes / 1440.0;
            return Err(SkyError::TwoLines(format!("the elements of {} are {days:.0} days away", self.epoch)));
        }
        let place = self
            .constants
            .propagate(MinutesSinceEpoch(minutes))
            .map_err(|error| SkyError::TwoLines(format!("no place at {at}: {error}")))?
            .position;
        let turned = from_teme.map(|row| (row[0] * place[0] + row[1] * place[1] + row[2] * place[2]) / AU_KM);
        match turned.iter().all(|part| part.is_finite()) {
            true => Ok(turned),
            false => Err(SkyError::TwoLines(format!("no place at {at}"))),
        }
    }
}

impl Observer {
    /// Turns the frame of two-line elements (true equator, mean equinox: TEME) to ICRS axes.
    ///
    /// About the pole of date by mean sidereal time of 1982, which defines that equinox, less the Earth's rotation
    /// angle; then by precession and nutation (Vallado et al. 2006, AIAA 2006-6753, appendix C).
    pub(super) fn teme_axes(&self) -> [[f64; 3]; 3] {
        let (ut1_day, ut1_part) = self.scales.ut1;
        let turn = erst::gmst82(ut1_day, ut1_part) - erst::era00(ut1_day, ut1_part);
        let (sin, cos) = turn.sin_cos();
        let to_intermediate = [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]];
        let bpn = &self.astrometry.bpn;
        std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| bpn[k][i] * to_intermediate[k][j]).sum()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The space station in July 2020.
    const FIRST: &str = "1 25544U 98067A   20194.88612269 -.00002218  00000-0 -31515-4 0  9992";
    const SECOND: &str = "2 25544  51.6461 221.2784 0001413  89.1723 280.4612 15.49507896236008";

    #[test]
    fn the_epoch_and_a_name_are_read() {
        let satellite = Satellite::from_lines(&format!("ISS (ZARYA)\n{FIRST}\n{SECOND}\n")).unwrap();
        // Day 194.88612269 of 2020.
        assert_eq!(satellite.epoch().to_string().get(..19), Some("2020-07-12T21:16:01"));
        assert_eq!(satellite, Satellite::from_lines(&format!("{FIRST}\r\n{SECOND}")).unwrap());
    }

    #[test]
    fn lines_that_are_none_are_refused_and_never_panic() {
        let wrong_sum = SECOND.replace("236008", "236009");
        for text in ["", FIRST, "a\nb", "ä\nö", &*format!("{SECOND}\n{FIRST}"), &*format!("{FIRST}\n{wrong_sum}")] {
            assert!(Satellite::from_lines(text).is_err(), "{text}");
        }
        for cut in 0..FIRST.len() {
            assert!(Satellite::from_lines(&format!("{}\n{SECOND}", &FIRST[..cut])).is_err(), "{cut}");
        }
    }

    #[test]
    fn old_elements_are_refused() {
        let satellite = Satellite::from_lines(&format!("{FIRST}\n{SECOND}")).unwrap();
        let unit = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let place = satellite.at(satellite.epoch(), &unit).unwrap();
        let km = sofars::vm::pm(place) * AU_KM;
        assert!((6700.0..6850.0).contains(&km), "{km}");
        assert!(satellite.at("2026-11-21T03:00:00Z".parse().unwrap(), &unit).is_err());
    }
}
