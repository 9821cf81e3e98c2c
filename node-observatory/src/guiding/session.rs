//! One field that is held: where its stars were, what pulses do there, and the guider that decides.

use std::sync::Arc;
use std::time::Duration;

use config::{GuideControl, Guiding};
use contract::CommandId;
use contract::observatory::{GuideCalibration, GuideField, GuideMethod};
use imaging::guide::pid::Gains;
use imaging::guide::{CalibrationError, Control, Exposure, GuideSettings, Guider, Measurement, Reference, State};
use imaging::{Clean, NoShift, Star};

use super::calibrated::binned;
use crate::frames::looked::{Fetched, Looks};

/// With fewer stars than this, a field may be recognized by its sums over rows and columns.
const FEW_STARS: usize = 5;
/// The list of a frame's stars is there within this time, machine time.
pub const LISTED_WITHIN: Duration = Duration::from_secs(30);

/// A field that is held.
pub struct Session {
    /// Which field.
    pub field: GuideField,
    /// The frame that it is held to.
    pub reference_frame: CommandId,
    /// ICRS direction of that frame's middle, degrees, where it was solved.
    pub centre_deg: Option<[f64; 2]>,
    /// What pulses do there.
    pub calibration: GuideCalibration,
    /// Declination that the guider counts with, degrees.
    pub dec_deg: f64,
    /// What decides.
    pub guider: Guider,
    reference: Reference,
    /// Frames in a row that repeated the one before, pixel by pixel.
    pub repeats: u32,
    /// The last frame, and what it showed.
    last: Option<(Arc<Fetched>, Result<Measurement, NoShift>)>,
    /// From where the field was found to where it is held, px of these frames.
    hold_px: [f64; 2],
}

/// What a frame showed of the field.
pub struct FieldMeasurement {
    /// How far it moved, or why this cannot be measured.
    pub measured: Result<Measurement, NoShift>,
    /// By what it was measured.
    pub method: GuideMethod,
    /// Why it could not be measured, in words.
    pub reason: Option<String>,
}

/// Why a field cannot be held.
#[derive(Debug, thiserror::Error)]
pub enum NoSession {
    /// The first frame gives no reference.
    #[error("no reference: {0}")]
    Reference(#[from] NoShift),
    /// The calibration does not hold there.
    #[error("{0}")]
    Calibration(#[from] CalibrationError),
}

impl Session {
    /// Begins to hold a field where `stars` are.
    ///
    /// # Errors
    /// [`NoSession`] when there is no good star, or the calibration does not hold at this declination.
    pub fn new(
        config: &Guiding,
        field: GuideField,
        (reference_frame, centre_deg): (CommandId, Option<[f64; 2]>),
        stars: Vec<Star>,
        calibration: GuideCalibration,
        dec_deg: f64,
    ) -> Result<Self, NoSession> {
        let [width, height] = field.size_px.map(|n| n as usize);
        let reference = Reference::from_lists(&[stars], width, height)?;
        let guider = Guider::new(settings(config), &binned(&calibration, field.bin), dec_deg)?;
        let hold_px = config.hold_offset_px;
        Ok(Self {
            field,
            reference_frame,
            centre_deg,
            calibration,
            dec_deg,
            guider,
            reference,
            repeats: 0,
            last: None,
            hold_px,
        })
    }

    /// The stars that are compared.
    pub fn stars(&self) -> &[Star] {
        self.reference.stars()
    }

    /// With the sums over rows and columns of the reference frame, for fields of few stars.
    #[must_use]
    pub fn with_profiles(mut self, fetched: &Fetched) -> Self {
        if self.reference.stars().len() < FEW_STARS
            && let Ok(frame) = fetched.plane.frame(&fetched.frame)
            && let Ok(clean) = Clean::new(&frame, &fetched.camera, None)
        {
            self.reference = self.reference.with_profiles(&clean);
        }
        self
    }

    /// When a frame was exposed, s since 1970.
    pub fn exposure(fetched: &Fetched) -> Exposure {
        let length_s = fetched.frame.exposure_s;
        Exposure { mid_s: fetched.frame.started_utc.seconds() + 0.5 * length_s, length_s }
    }

    /// Measures how far the field is from where it is held. A camera that repeats its last frame, pixel by pixel, shows
    /// what it showed then, which the guider knows for no news.
    pub async fn look(&mut self, looks: &Looks, fetched: &Arc<Fetched>) -> FieldMeasurement {
        if let Some((last, measured)) = &self.last
            && last.frame.id != fetched.frame.id
            && last.plane == fetched.plane
        {
            let reason = format!("the frame repeats {}, pixel by pixel: no pulse is given after it", last.frame.id);
            self.repeats += 1;
            return FieldMeasurement {
                reason: Some(reason),
                ..FieldMeasurement::of(measured.clone(), GuideMethod::Boxes)
            };
        }
        let mut seen = self.look_for_shift(looks, fetched).await;
        if let Ok(measured) = &mut seen.measured {
            measured.shift.dx_px -= self.hold_px[0];
            measured.shift.dy_px -= self.hold_px[1];
        }
        self.repeats = 0;
        self.last = Some((fetched.clone(), seen.measured.clone()));
        seen
    }

    /// Measures how far the field moved: in boxes where its stars should be; where it may be anywhere, or the boxes
    /// are empty, by the list of all stars; and only in fields of few stars by sums over rows and columns, which find a
    /// shift between any two fields.
    async fn look_for_shift(&mut self, looks: &Looks, fetched: &Arc<Fetched>) -> FieldMeasurement {
        let is_reference = fetched.frame.id == self.reference_frame;
        let is_anywhere = matches!(self.guider.state(), State::Acquire | State::Lost) && !is_reference;
        if !is_anywhere {
            match self.look_in_boxes(fetched).await {
                Ok(measured) => return FieldMeasurement::of(Ok(measured), GuideMethod::Boxes),
                Err(NoShift::TooFewStars { .. } | NoShift::NoMatch { .. } | NoShift::Uncertain { .. }) => {}
                Err(why) => return FieldMeasurement::nothing(why, GuideMethod::Boxes),
            }
        }
        let listed = self.look_at_all(looks, fetched).await;
        match listed {
            Err(_) if self.reference.stars().len() < FEW_STARS => match self.look_at_sums(fetched).await {
                Ok(measured) => FieldMeasurement::of(Ok(measured), GuideMethod::Projections),
                Err(why) => FieldMeasurement::nothing(why, GuideMethod::Projections),
            },
            Ok(measured) => FieldMeasurement::of(Ok(measured), GuideMethod::StarList),
            Err(why) => FieldMeasurement::nothing(why, GuideMethod::StarList),
        }
    }

    async fn look_in_boxes(&mut self, fetched: &Arc<Fetched>) -> Result<Measurement, NoShift> {
        let expected_px = self.guider.expected_px(Self::exposure(fetched));
        let expected_px = [expected_px[0] + self.hold_px[0], expected_px[1] + self.hold_px[1]];
        // A copy of some ten kilobytes, so that nothing is lost when the loop is dropped meanwhile.
        let (mut reference, fetched) = (self.reference.clone(), fetched.clone());
        let look = move || {
            let seen = match fetched.plane.frame(&fetched.frame) {
                Ok(frame) => reference.measure(&frame, &fetched.camera, expected_px),
                Err(_) => Err(NoShift::TooFewStars { reference: reference.stars().len(), check: 0 }),
            };
            (reference, seen)
        };
        match tokio::task::spawn_blocking(look).await {
            Ok((reference, seen)) => {
                self.reference = reference;
                seen
            }
            Err(_) => Err(self.no_stars()),
        }
    }

    async fn look_at_all(&self, looks: &Looks, fetched: &Fetched) -> Result<Measurement, NoShift> {
        let looked = tokio::time::timeout(LISTED_WITHIN, looks.of(&fetched.frame.id)).await;
        let measured = looked.ok().and_then(|looked| looked.measured.as_ref().map(|measured| measured.stars.clone()));
        self.reference.register(&measured.ok_or_else(|| self.no_stars())?)
    }

    async fn look_at_sums(&self, fetched: &Arc<Fetched>) -> Result<Measurement, NoShift> {
        let (reference, fetched, none) = (self.reference.clone(), fetched.clone(), self.no_stars());
        let look = move || {
            let frame = fetched.plane.frame(&fetched.frame).ok()?;
            let clean = Clean::new(&frame, &fetched.camera, None).ok()?;
            Some(reference.project(&clean))
        };
        tokio::task::spawn_blocking(look).await.ok().flatten().unwrap_or(Err(none))
    }

    fn no_stars(&self) -> NoShift {
        NoShift::TooFewStars { reference: self.reference.stars().len(), check: 0 }
    }
}

impl FieldMeasurement {
    fn of(measured: Result<Measurement, NoShift>, method: GuideMethod) -> Self {
        Self { measured, method, reason: None }
    }

    fn nothing(why: NoShift, method: GuideMethod) -> Self {
        Self { reason: Some(why.to_string()), ..Self::of(Err(why), method) }
    }
}

/// The settings as `imaging` has them.
fn settings(config: &Guiding) -> GuideSettings {
    let control = |control: GuideControl, gains: config::Gains| match control {
        GuideControl::Predict => Control::Predict,
        GuideControl::Pid => Control::Pid(Gains { proportional: gains.p, integral: gains.i, differential: gains.d }),
    };
    GuideSettings {
        control: [control(config.control_ra, config.pid_ra), control(config.control_dec, config.pid_dec)],
        dead_band_px: config.dead_band_px,
        longest_pulse_ms: config.longest_pulse_ms,
        cap_px: config.cap_px,
        stabilise_cap_px: config.stabilise_cap_px,
        resist_dec_reversal: config.resist_dec_reversal,
        worm_period_s: config.worm_period_s,
        hold_drift_s: config.hold_drift_s,
        alert_after_s: config.alert_after_s,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_configurations_defaults_are_those_of_the_guider() {
        assert_eq!(settings(&Guiding::default()), GuideSettings::default());
        let pid = Guiding { control_ra: GuideControl::Pid, control_dec: GuideControl::Pid, ..Guiding::default() };
        assert_eq!(settings(&pid), GuideSettings::pid());
    }
}
