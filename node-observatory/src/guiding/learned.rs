//! The learned state of guiding, which survives a restart: what pulses do to the stars of a camera, and where the stars
//! of a field were. One file, `guiding-TELESCOPE.json` in the data folder.

use contract::Part;
use contract::observatory::{
    AlertKind, CalibrationSource, CameraCalibration, GUIDE_REFERENCES, GuideCalibration, GuideField, GuideReference,
    GuidingState, ReferenceStar,
};
use imaging::star::{Flags, Star};
use serde::{Deserialize, Serialize};

use crate::persisted::replaced;
use crate::replicated::Replicate;

/// All of it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct LearnedGuiding {
    /// What pulses do, newest last.
    #[serde(default)]
    pub calibrations: Vec<CameraCalibration>,
    /// The references of fields, newest last.
    #[serde(default)]
    pub references: Vec<GuideReference>,
}

/// A star of a reference frame as it is kept.
pub fn stored(star: &Star) -> ReferenceStar {
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
pub fn star(stored: &ReferenceStar) -> Star {
    Star {
        x_px: stored.x_px,
        y_px: stored.y_px,
        x_error_px: stored.x_error_px,
        y_error_px: stored.y_error_px,
        flux_adu: stored.flux_adu,
        flux_error_adu: stored.flux_error_adu,
        snr: stored.flux_adu / stored.flux_error_adu,
        significance: stored.significance,
        peak_adu: stored.peak_adu,
        fwhm_px: stored.fwhm_px,
        ellipticity: stored.ellipticity,
        angle_deg: stored.angle_deg,
        flags: Flags::default(),
    }
}

impl Replicate for LearnedGuiding {
    type Payload = GuidingState;
    const PART: Part = Part::Guiding;
    const FILE: &'static str = "guiding";
    const WHAT: &'static str = "what guiding knows of the mount";
    const NOT_SAVED: AlertKind = AlertKind::GuidingNotSaved;

    fn put_in(&self, payload: &mut GuidingState) -> bool {
        replaced(&mut payload.calibrations, &self.calibrations)
    }

    /// The references come as events of their own. A node of an older version publishes no calibrations.
    fn adopt(&mut self, payload: GuidingState) -> bool {
        !payload.calibrations.is_empty() && replaced(&mut self.calibrations, &payload.calibrations)
    }
}

impl LearnedGuiding {
    /// Keeps a calibration in the place of the one of the same camera, side of the pier and source.
    pub fn keep_calibration(&mut self, camera: &str, calibration: GuideCalibration) {
        let (side, source) = (calibration.pier_side, calibration.source);
        self.calibrations.retain(|stored| {
            stored.camera != camera || stored.calibration.pier_side != side || stored.calibration.source != source
        });
        self.calibrations.push(CameraCalibration { camera: camera.to_owned(), calibration });
    }

    /// Calibrations of a camera from one source, newest last.
    pub fn calibrations_of(&self, camera: &str, source: CalibrationSource) -> Vec<GuideCalibration> {
        let of = |stored: &&CameraCalibration| stored.camera == camera && stored.calibration.source == source;
        self.calibrations.iter().filter(of).map(|stored| stored.calibration.clone()).collect()
    }

    /// Keeps a reference in the place of the one of the same field.
    pub fn keep_reference(&mut self, reference: GuideReference) {
        self.forget_reference(&reference.field);
        self.references.push(reference);
        let surplus = self.references.len().saturating_sub(GUIDE_REFERENCES);
        self.references.drain(..surplus);
    }

    /// Adopts a reference that another node has; returns whether it is new. An older one of the same field is not.
    pub fn observe_reference(&mut self, received: &GuideReference) -> bool {
        if self.reference(&received.field).is_some_and(|known| known.made_utc >= received.made_utc) {
            return false;
        }
        self.keep_reference(received.clone());
        true
    }

    /// The reference of a field.
    pub fn reference(&self, field: &GuideField) -> Option<&GuideReference> {
        self.references.iter().rev().find(|stored| stored.field == *field)
    }

    /// Forgets the reference of a field; returns whether there was one.
    pub fn forget_reference(&mut self, field: &GuideField) -> bool {
        let before = self.references.len();
        self.references.retain(|stored| stored.field != *field);
        self.references.len() < before
    }
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
            stars: vec![stored(&star)],
        }
    }

    #[test]
    fn what_was_learned_reads_back_as_it_was_written() {
        let mut learned = LearnedGuiding::default();
        learned.keep_calibration("cam", calibration(CalibrationSource::Pulses, Some(PierSide::West), 7.5));
        learned.keep_reference(reference("a"));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("guiding.json");
        assert_eq!(LearnedGuiding::read(&path), LearnedGuiding::default());
        std::fs::write(&path, serde_json::to_vec(&learned).unwrap()).unwrap();
        assert_eq!(LearnedGuiding::read(&path), learned);
        let star = super::star(&learned.references[0].stars[0]);
        assert_eq!((star.x_px, star.snr), (1.5, 200.0));
        std::fs::write(&path, "{").unwrap();
        assert_eq!(LearnedGuiding::read(&path), LearnedGuiding::default());
    }

    #[test]
    fn a_new_calibration_replaces_only_its_own_kind() {
        let mut learned = LearnedGuiding::default();
        let (pulses, solution) = (CalibrationSource::Pulses, CalibrationSource::PlateSolution);
        learned.keep_calibration("cam", calibration(pulses, Some(PierSide::West), 1.0));
        learned.keep_calibration("cam", calibration(pulses, Some(PierSide::East), 2.0));
        learned.keep_calibration("cam", calibration(solution, Some(PierSide::West), 3.0));
        learned.keep_calibration("other", calibration(pulses, Some(PierSide::West), 4.0));
        learned.keep_calibration("cam", calibration(pulses, Some(PierSide::West), 5.0));
        let speeds = |source| -> Vec<f64> {
            learned.calibrations_of("cam", source).iter().map(|stored| stored.east_px_per_s[0]).collect()
        };
        assert_eq!((speeds(pulses), speeds(solution)), (vec![2.0, 5.0], vec![3.0]));
    }

    #[test]
    fn of_two_references_of_a_field_that_are_received_the_later_one_counts() {
        let mut learned = LearnedGuiding::default();
        let at = |seconds: f64, frame: &str| GuideReference {
            made_utc: Utc::from_seconds(seconds),
            frame: CommandId(frame.to_owned()),
            ..reference("a")
        };
        assert!(learned.observe_reference(&at(2.0, "second")) && !learned.observe_reference(&at(1.0, "first")));
        assert!(!learned.observe_reference(&at(2.0, "second")), "published again");
        assert!(learned.observe_reference(&at(3.0, "third")));
        assert_eq!((learned.references.len(), learned.references[0].frame.0.as_str()), (1, "third"));
    }

    #[test]
    fn a_field_has_one_reference_and_the_oldest_fields_give_way() {
        let mut learned = LearnedGuiding::default();
        for n in 0..GUIDE_REFERENCES + 2 {
            learned.keep_reference(reference(&format!("f{n}")));
        }
        learned.keep_reference(reference("f2"));
        assert_eq!(learned.references.len(), GUIDE_REFERENCES);
        assert_eq!(learned.reference(&reference("f0").field), None);
        assert_eq!(learned.references.last().unwrap().field.object, "f2");
        let mut elsewhere = reference("f2").field;
        elsewhere.pier_side = Some(PierSide::West);
        assert_eq!(learned.reference(&elsewhere), None, "on the other side of the pier it stands elsewhere");
        assert!(learned.forget_reference(&reference("f2").field) && !learned.forget_reference(&elsewhere));
    }
}
