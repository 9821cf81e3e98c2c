//! The mirror cover, flat panel, or both.

use alpaca::{Abilities, Alpaca, AlpacaError, value};
use contract::device::cover_calibrator::{self, Calibrator, Capabilities, Command, Cover, Fields};
use contract::{CommandId, NoData, Reason};
use interlock::Need;

use super::{Driver, Executed, Progress};
use crate::readings::Readings;

const COVER: [(i64, Cover); 6] = [
    (0, Cover::NotPresent),
    (1, Cover::Closed),
    (2, Cover::Moving),
    (3, Cover::Open),
    (4, Cover::Unknown),
    (5, Cover::Error),
];

const CALIBRATOR: [(i64, Calibrator); 6] = [
    (0, Calibrator::NotPresent),
    (1, Calibrator::Off),
    (2, Calibrator::NotReady),
    (3, Calibrator::Ready),
    (4, Calibrator::Unknown),
    (5, Calibrator::Error),
];

/// Drives a cover and a panel.
pub struct CoverCalibrator;

impl Driver for CoverCalibrator {
    type Kind = cover_calibrator::CoverCalibrator;

    fn polled(&self) -> Vec<String> {
        ["CoverState", "CalibratorState", "Brightness"].map(str::to_owned).to_vec()
    }

    fn moving(&self) -> &'static [&'static str] {
        &["CoverState", "CalibratorState", "Brightness"]
    }

    async fn capabilities(&self, abilities: &mut Abilities) -> Result<Capabilities, AlpacaError> {
        // It lacks a part only where it says so.
        let present = |state: Result<i64, NoData>| match state {
            Ok(state) => state != 0,
            Err(reason) => reason != NoData::not_implemented(),
        };
        let cover = present(abilities.read("CoverState", value::whole).await?);
        let calibrator = present(abilities.read("CalibratorState", value::whole).await?);
        // One that reports 0 states none: a panel can be lit.
        let brightness = value::whole_in(0..=i64::from(i32::MAX));
        let max_brightness = abilities.read("MaxBrightness", brightness).await?.unwrap_or(0);
        Ok(Capabilities { cover, calibrator, max_brightness })
    }

    fn fields(&self, readings: &Readings) -> Fields {
        Fields {
            cover: readings.choice("CoverState", &COVER),
            calibrator: readings.choice("CalibratorState", &CALIBRATOR),
            brightness: readings.whole("Brightness"),
        }
    }

    fn is_busy(&self, fields: &Fields) -> bool {
        cover_moves(fields) || panel_changes(fields)
    }

    fn works_at(&self, command: &Command, fields: &Fields) -> bool {
        match command {
            Command::OpenCover | Command::CloseCover | Command::HaltCover => cover_moves(fields),
            Command::CalibratorOn { .. } | Command::CalibratorOff => panel_changes(fields),
        }
    }

    fn contradiction(&self, command: Option<&Command>, fields: &Fields) -> Option<String> {
        let moves = command.is_none() && fields.cover.known() == Some(&Cover::Moving);
        moves.then(|| "CoverState is 2 (moving), and no movement was commanded".to_owned())
    }

    fn need(&self, command: &Command) -> Need {
        match command {
            Command::OpenCover | Command::CalibratorOn { .. } => Need::Token,
            Command::CloseCover | Command::HaltCover | Command::CalibratorOff => Need::Nothing,
        }
    }

    fn interrupts(&self, command: &Command) -> bool {
        matches!(command, Command::CloseCover | Command::HaltCover)
    }

    fn refuse(&self, _: &CommandId, command: &Command, can: &Capabilities, _: &Fields) -> Option<(Reason, String)> {
        let lacks = |what: &str| Some((Reason::NotImplemented, format!("there is no {what}")));
        match command {
            Command::OpenCover | Command::CloseCover | Command::HaltCover if !can.cover => lacks("cover"),
            Command::CalibratorOn { .. } | Command::CalibratorOff if !can.calibrator => lacks("panel"),
            Command::CalibratorOn { brightness }
                if *brightness < 0 || (can.max_brightness > 0 && *brightness > can.max_brightness) =>
            {
                Some((Reason::Malformed, format!("brightness {brightness}: expected 0 to {}", can.max_brightness)))
            }
            Command::OpenCover
            | Command::CloseCover
            | Command::HaltCover
            | Command::CalibratorOn { .. }
            | Command::CalibratorOff => None,
        }
    }

    async fn execute(
        &self,
        alpaca: &Alpaca,
        _: &CommandId,
        command: &Command,
        _: &Fields,
    ) -> Result<Executed, AlpacaError> {
        match command {
            Command::OpenCover => alpaca.put("opencover", &[]).await?,
            Command::CloseCover => alpaca.put("closecover", &[]).await?,
            Command::HaltCover => alpaca.put("haltcover", &[]).await?,
            Command::CalibratorOn { brightness } => {
                alpaca.put("calibratoron", &[("Brightness", &brightness.to_string())]).await?;
            }
            Command::CalibratorOff => alpaca.put("calibratoroff", &[]).await?,
        }
        Ok(Executed::Watch)
    }

    fn progress(&self, command: &Command, fields: &Fields) -> Progress {
        let (cover, panel) = (fields.cover.known(), fields.calibrator.known());
        let cover_moved = matches!(command, Command::OpenCover | Command::CloseCover);
        match command {
            _ if cover_moved && cover == Some(&Cover::Error) => Progress::Failed("the cover is in error".to_owned()),
            Command::OpenCover => Progress::done_if(cover == Some(&Cover::Open)),
            Command::CloseCover => Progress::done_if(cover == Some(&Cover::Closed)),
            Command::HaltCover => Progress::done_if(cover.is_some_and(|cover| *cover != Cover::Moving)),
            Command::CalibratorOn { .. } if panel == Some(&Calibrator::Error) => {
                Progress::Failed("the panel is in error".to_owned())
            }
            Command::CalibratorOn { .. } => Progress::done_if(panel == Some(&Calibrator::Ready)),
            Command::CalibratorOff => Progress::done_if(panel == Some(&Calibrator::Off)),
        }
    }
}

/// Does the cover move, or is that unknown?
fn cover_moves(fields: &Fields) -> bool {
    fields.cover.known().is_none_or(|cover| *cover == Cover::Moving)
}

/// Does the panel warm up or fade, or is that unknown?
fn panel_changes(fields: &Fields) -> bool {
    fields.calibrator.known().is_none_or(|panel| *panel == Calibrator::NotReady)
}
