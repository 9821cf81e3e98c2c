//! The learned state of guiding, which survives a restart: what pulses do to the stars of a camera, and where the stars
//! of a field were. One file, `guiding-TELESCOPE.json` in the data folder.

use std::path::{Path, PathBuf};

use contract::observatory::{
    CalibrationSource, CameraCalibration, GuideCalibration, GuideField, GuideReference, ReferenceStar,
};
use imaging::star::{Flags, Star};
use serde::{Deserialize, Serialize};

/// References that are retained; a new one replaces the oldest.
pub const REFERENCES: usize = 60;

/// All of it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Learnt {
    /// What pulses do, newest last.
    #[serde(default)]
    pub calibrations: Vec<CameraCalibration>,
    /// The references of fields, newest last.
    #[serde(default)]
    pub references: Vec<GuideReference>,
}

/// A star of a reference frame as it is kept.
pub fn kept(star: &Star) -> ReferenceStar {
    ReferenceStar {
        x_px: star.x_px,
        y_px: star.y_px,
        x_error_px: star.x_error_px,
        y_error_px: star.y_error_px,
        flux_adu: star.flux_adu,
        flux_error_adu: star.flux_error_adu,
        significance: star.significance,
        peak_adu: star.peak_adu,
        fwhm_px: star.fwhm_px,
        ellipticity: star.ellipticity,
        angle_deg: star.angle_deg,
    }
}

/// A kept star as it was measured; what is flagged does not become part of a reference.
pub fn star(kept: &ReferenceStar) -> Star {
    Star {
        x_px: kept.x_px,
        y_px: kept.y_px,
        x_error_px: kept.x_error_px,
        y_error_px: kept.y_error_px,
        flux_adu: kept.flux_adu,
        flux_error_adu: kept.flux_error_adu,
        snr: kept.flux_adu / kept.flux_error_adu,
        significance: kept.significance,
        peak_adu: kept.peak_adu,
        fwhm_px: kept.fwhm_px,
        ellipticity: kept.ellipticity,
        angle_deg: kept.angle_deg,
        flags: Flags::default(),
    }
}

impl Learnt {
    /// Reads the file. If it cannot be read, this is reported and the state begins anew: nothing unsafe depends on it.
    pub fn read(path: &Path) -> Self {
        crate::kept::read_or_anew(path, "what guiding knows of the mount")
    }

    /// Keeps a calibration in the place of the one of the same camera, side of the pier and source.
    pub fn keep_calibration(&mut self, camera: &str, calibration: GuideCalibration) {
        let (side, source) = (calibration.pier_side, calibration.source);
        self.calibrations.retain(|kept| {
            kept.camera != camera || kept.calibration.pier_side != side || kept.calibration.source != source
        });
        self.calibrations.push(CameraCalibration { camera: camera.to_owned(), calibration });
    }

    /// Calibrations of a camera from one source, newest last.
    pub fn calibrations_of(&self, camera: &str, source: CalibrationSource) -> Vec<GuideCalibration> {
        let of = |kept: &&CameraCalibration| kept.camera == camera && kept.calibration.source == source;
        self.calibrations.iter().filter(of).map(|kept| kept.calibration.clone()).collect()
    }

    /// Keeps a reference in the place of the one of the same field.
    pub fn keep_reference(&mut self, reference: GuideReference) {
        self.forget_reference(&reference.field);
        self.references.push(reference);
        let surplus = self.references.len().saturating_sub(REFERENCES);
        self.references.drain(..surplus);
    }

    /// Adopts a reference that another node has; returns whether it is new. An older one of the same field is not.
    pub fn hear_reference(&mut self, heard: &GuideReference) -> bool {
        if self.reference(&heard.field).is_some_and(|known| known.made_utc >= heard.made_utc) {
            return false;
        }
        self.keep_reference(heard.clone());
        true
    }

    /// The reference of a field.
    pub fn reference(&self, field: &GuideField) -> Option<&GuideReference> {
        self.references.iter().rev().find(|kept| kept.field == *field)
    }

    /// Forgets the reference of a field; returns whether there was one.
    pub fn forget_reference(&mut self, field: &GuideField) -> bool {
        let before = self.references.len();
        self.references.retain(|kept| kept.field != *field);
        self.references.len() < before
    }
}

/// Where it is kept.
pub fn path(config: &config::Observatory) -> PathBuf {
    config.folders.data.join(format!("guiding-{}.json", config.place.telescope))
}

#[cfg(test)]
mod tests {
    use contract::CommandId;
    use contract::device::telescope::PierSide;
    use units::Utc;

    use super::*;

    fn calibration(source: CalibrationSource, side: Option<PierSide>, speed: f64) -> GuideCalibration {
        GuideCalibration {
            source,
            made_utc: Utc::from_seconds(1.8e9),
            pier_side: side,
            dec_deg: 0.0,
            east_px_per_s: [speed, 0.0],
            north_px_per_s: [0.0, speed],
            backlash_s: None,
        }
    }

    fn reference(object: &str) -> GuideReference {
        let field = GuideField {
            object: object.to_owned(),
            filter: Some("V".to_owned()),
            exposure_s: 10.0,
            camera: "cam".to_owned(),
            pier_side: Some(PierSide::East),
            bin: 1,
            size_px: [100, 100],
            origin_px: [0, 0],
        };
        let star = Star {
            x_px: 1.5,
            y_px: 2.5,
            x_error_px: 0.01,
            y_error_px: 0.02,
            flux_adu: 1e5,
            flux_error_adu: 500.0,
            snr: 200.0,
            significance: 90.0,
            peak_adu: 9e3,
            fwhm_px: 3.0,
            ellipticity: 0.1,
            angle_deg: 3.0,
            flags: Flags::default(),
        };
        GuideReference {
            field,
            frame: CommandId(object.to_owned()),
            made_utc: Utc::from_seconds(1.8e9),
            row: "r".to_owned(),
            centre_deg: Some([10.0, -5.0]),
            stars: vec![kept(&star)],
        }
    }

    #[test]
    fn what_was_learnt_reads_back_as_it_was_written() {
        let mut learnt = Learnt::default();
        learnt.keep_calibration("cam", calibration(CalibrationSource::Pulses, Some(PierSide::West), 7.5));
        learnt.keep_reference(reference("a"));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("guiding.json");
        assert_eq!(Learnt::read(&path), Learnt::default());
        std::fs::write(&path, serde_json::to_vec(&learnt).unwrap()).unwrap();
        assert_eq!(Learnt::read(&path), learnt);
        let star = super::star(&learnt.references[0].stars[0]);
        assert_eq!((star.x_px, star.snr), (1.5, 200.0));
        std::fs::write(&path, "{").unwrap();
        assert_eq!(Learnt::read(&path), Learnt::default());
    }

    #[test]
    fn a_new_calibration_replaces_only_its_own_kind() {
        let mut learnt = Learnt::default();
        let (pulses, solution) = (CalibrationSource::Pulses, CalibrationSource::PlateSolution);
        learnt.keep_calibration("cam", calibration(pulses, Some(PierSide::West), 1.0));
        learnt.keep_calibration("cam", calibration(pulses, Some(PierSide::East), 2.0));
        learnt.keep_calibration("cam", calibration(solution, Some(PierSide::West), 3.0));
        learnt.keep_calibration("other", calibration(pulses, Some(PierSide::West), 4.0));
        learnt.keep_calibration("cam", calibration(pulses, Some(PierSide::West), 5.0));
        let speeds = |source| -> Vec<f64> {
            learnt.calibrations_of("cam", source).iter().map(|kept| kept.east_px_per_s[0]).collect()
        };
        assert_eq!((speeds(pulses), speeds(solution)), (vec![2.0, 5.0], vec![3.0]));
    }

    #[test]
    fn of_two_references_of_a_field_that_are_heard_the_later_one_counts() {
        let mut learnt = Learnt::default();
        let at = |seconds: f64, frame: &str| GuideReference {
            made_utc: Utc::from_seconds(seconds),
            frame: CommandId(frame.to_owned()),
            ..reference("a")
        };
        assert!(learnt.hear_reference(&at(2.0, "second")) && !learnt.hear_reference(&at(1.0, "first")));
        assert!(!learnt.hear_reference(&at(2.0, "second")), "said again");
        assert!(learnt.hear_reference(&at(3.0, "third")));
        assert_eq!((learnt.references.len(), learnt.references[0].frame.0.as_str()), (1, "third"));
    }

    #[test]
    fn a_field_has_one_reference_and_the_oldest_fields_give_way() {
        let mut learnt = Learnt::default();
        for n in 0..REFERENCES + 2 {
            learnt.keep_reference(reference(&format!("f{n}")));
        }
        learnt.keep_reference(reference("f2"));
        assert_eq!(learnt.references.len(), REFERENCES);
        assert_eq!(learnt.reference(&reference("f0").field), None);
        assert_eq!(learnt.references.last().unwrap().field.object, "f2");
        let mut elsewhere = reference("f2").field;
        elsewhere.pier_side = Some(PierSide::West);
        assert_eq!(learnt.reference(&elsewhere), None, "on the other side of the pier it stands elsewhere");
        assert!(learnt.forget_reference(&reference("f2").field) && !learnt.forget_reference(&elsewhere));
    }
}
