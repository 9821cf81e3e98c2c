//! The learned pointing models: how cameras miss where their mounts are sent, by camera and pier side.
//!
//! A few dozen points, spread over the sky: a new one takes the place of those near it. The model made of them corrects
//! first slews only once it has proven to help, and never by more than is believed: each point is predicted from the
//! others, and each new one from all before.

use contract::Part;
use contract::device::telescope::PierSide;
use contract::observatory::{AlertKind, PointingCheck, PointingModel, PointingPoint, PointingState};
use imaging::pointing::{Miss, MountErrorModel, MountErrorPoint};
use imaging::tangent::separation;
use serde::{Deserialize, Serialize};
use units::Angle;

use crate::persisted::replaced;
use crate::replicated::Replicate;

/// Points of one camera and pier side.
const POINTS: usize = 60;
/// A point is of the same place as another one so near, deg.
const SAME_PLACE_DEG: f64 = 3.0;
/// Fewest points with which a model is used.
const FEWEST: usize = 4;
/// It is used when what remains is less than this share of what it takes away.
const HELPS: f64 = 0.7;
/// Foretellings that are remembered.
const CHECKS: usize = 10;
/// After so many in a row that harm, the earlier points are no longer valid: the mount was synchronised or moved.
const HARMFUL: usize = 4;
/// A model that is wrong by less than this is no sign of anything, arcmin.
const HARMLESS_ARCMIN: f64 = 0.5;

/// All of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PointingModels {
    /// One model per camera and pier side.
    pub models: Vec<PointingModel>,
}

impl Replicate for PointingModels {
    type Payload = PointingState;
    const PART: Part = Part::Pointing;
    const FILE: &'static str = "pointing";
    const WHAT: &'static str = "what is known of the pointing";
    const NOT_SAVED: AlertKind = AlertKind::PointingNotSaved;

    fn put_in(&self, payload: &mut PointingState) -> bool {
        replaced(&mut payload.models, &self.models)
    }

    fn adopt(&mut self, payload: PointingState) -> bool {
        !payload.models.is_empty() && replaced(&mut self.models, &payload.models)
    }
}

impl PointingModels {
    /// The expected miss of a camera at a place; on the side of the pier where the nearest point was seen. None
    /// while nothing trustworthy is known, and where it is more than `most`.
    pub fn expected(&self, camera: &str, hour_angle: Angle, dec: Angle, most: Angle) -> Option<Miss> {
        let away = |model: &PointingModel| {
            let points = model.points.iter().map(|point| separation(place(point), (hour_angle, dec)).degrees());
            points.fold(f64::INFINITY, f64::min)
        };
        let sides = self.models.iter().filter(|model| model.camera == camera);
        let side = sides.min_by(|a, b| away(a).total_cmp(&away(b))).filter(|side| side.used)?;
        let miss = fit(&side.points)?.miss(hour_angle, dec);
        (miss.size() <= most).then_some(miss)
    }

    /// Learns a point.
    pub fn learn(&mut self, camera: &str, pier_side: Option<PierSide>, point: PointingPoint) {
        let known = self.models.iter().position(|model| model.camera == camera && model.pier_side == pier_side);
        let at = known.unwrap_or_else(|| {
            self.models.push(PointingModel { camera: camera.to_owned(), pier_side, ..PointingModel::default() });
            self.models.len() - 1
        });
        let Some(model) = self.models.get_mut(at) else { return };
        if let Some(before) = fit(&model.points) {
            model.checks.push(check(&before, &point));
            let too_many = model.checks.len().saturating_sub(CHECKS);
            model.checks.drain(..too_many);
        }
        model.points.retain(|known| separation(place(known), place(&point)).degrees() > SAME_PLACE_DEG);
        model.points.push(point);
        forget(model);
        let too_many = model.points.len().saturating_sub(POINTS);
        model.points.drain(..too_many);
        model.rms_arcmin = fit(&model.points).map(|fit| fit.rms_arcmin());
        model.used = helps(model);
    }

    /// Forgets all of some cameras: their mount was synchronised, so that their earlier misses are no longer valid.
    /// Returns whether anything was known of them.
    pub fn forget(&mut self, is_of: impl Fn(&str) -> bool) -> bool {
        let before = self.models.len();
        self.models.retain(|model| !is_of(&model.camera));
        self.models.len() < before
    }
}

/// Points from before a mount was synchronised or moved mislead: only the newest points are retained.
fn forget(model: &mut PointingModel) {
    let Some(last) = model.checks.len().checked_sub(HARMFUL) else { return };
    let harms = |check: &PointingCheck| check.with_arcmin > check.without_arcmin && check.with_arcmin > HARMLESS_ARCMIN;
    if model.checks[last..].iter().all(harms) {
        let old = model.points.len().saturating_sub(HARMFUL);
        model.points.drain(..old);
        model.checks.clear();
    }
}

/// Whether the model is better than none, by its predictions of points that it has not learned.
fn helps(model: &PointingModel) -> bool {
    if model.points.len() < FEWEST {
        return false;
    }
    let others = (0..model.points.len()).filter_map(|left_out| {
        let mut others = model.points.clone();
        let point = others.remove(left_out);
        Some(check(&fit(&others)?, &point))
    });
    let others: Vec<PointingCheck> = others.collect();
    // The newest foretellings count only once there are a few.
    better(&others) && (model.checks.len() < FEWEST || better(&model.checks))
}

/// Medians, so that one frame that was solved in the wrong place decides nothing.
fn better(checks: &[PointingCheck]) -> bool {
    let median = |of: fn(&PointingCheck) -> f64| {
        let mut values: Vec<f64> = checks.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(f64::INFINITY)
    };
    median(|check| check.with_arcmin) < HELPS * median(|check| check.without_arcmin)
}

fn check(model: &MountErrorModel, point: &PointingPoint) -> PointingCheck {
    let (hour_angle, dec) = place(point);
    let expected = model.miss(hour_angle, dec);
    let (east, north) = (expected.east.degrees() * 60.0, expected.north.degrees() * 60.0);
    PointingCheck {
        with_arcmin: (point.east_arcmin - east).hypot(point.north_arcmin - north),
        without_arcmin: point.east_arcmin.hypot(point.north_arcmin),
    }
}

fn fit(points: &[PointingPoint]) -> Option<MountErrorModel> {
    let arcmin = |arcmin: f64| Angle::from_degrees(arcmin / 60.0);
    let points = points.iter().map(|point| {
        let (hour_angle, dec) = place(point);
        MountErrorPoint {
            hour_angle,
            dec,
            miss: Miss { east: arcmin(point.east_arcmin), north: arcmin(point.north_arcmin) },
        }
    });
    MountErrorModel::fit(&points.collect::<Vec<_>>())
}

fn place(point: &PointingPoint) -> (Angle, Angle) {
    (Angle::from_degrees(point.hour_angle_deg), Angle::from_degrees(point.dec_deg))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(hour_angle_deg: f64, dec_deg: f64, east_arcmin: f64, north_arcmin: f64) -> PointingPoint {
        let at_utc = units::Utc::from_seconds(1.8e9);
        PointingPoint { at_utc, hour_angle_deg, dec_deg, east_arcmin, north_arcmin }
    }

    fn deg(degrees: f64) -> Angle {
        Angle::from_degrees(degrees)
    }

    /// Places on one side of the meridian, far apart.
    fn places() -> impl Iterator<Item = (f64, f64)> {
        (0..12).map(|n| (-50.0 + 12.0 * f64::from(n % 4), -60.0 + 25.0 * f64::from(n / 4)))
    }

    fn models(east_arcmin: f64, north_arcmin: f64) -> PointingModels {
        let mut models = PointingModels::default();
        for (hour_angle, dec) in places() {
            models.learn("cam", Some(PierSide::West), at(hour_angle, dec, east_arcmin, north_arcmin));
        }
        models
    }

    #[test]
    fn a_mount_that_always_misses_alike_is_corrected_on_the_side_where_it_was_seen() {
        let mut models = models(4.0, -3.0);
        let expected = |models: &PointingModels, h, d, most| models.expected("cam", deg(h), deg(d), deg(most));
        let miss = expected(&models, -30.0, -30.0, 1.0).unwrap();
        assert!((miss.east.degrees() * 60.0 - 4.0).abs() < 0.1 && (miss.north.degrees() * 60.0 + 3.0).abs() < 0.1);
        assert_eq!(expected(&models, -30.0, -30.0, 0.05), None, "more than is believed");
        assert_eq!(models.expected("other", deg(-30.0), deg(-30.0), deg(1.0)), None);
        assert!(models.models[0].used && models.models[0].rms_arcmin.unwrap() < 0.1);
        // One point on the other side is no model, and its side is not this one's.
        models.learn("cam", Some(PierSide::East), at(30.0, -30.0, -4.0, 3.0));
        assert_eq!(expected(&models, 30.0, -20.0, 1.0), None);
        assert!(expected(&models, -30.0, -30.0, 1.0).is_some());
    }

    #[test]
    fn a_model_that_foretells_nothing_is_not_used() {
        let mut models = PointingModels::default();
        for (n, (hour_angle, dec)) in places().enumerate() {
            let sign = if n % 2 == 0 { 1.0 } else { -1.0 };
            models.learn("cam", None, at(hour_angle, dec, 3.0 * sign, 2.0 * -sign));
        }
        assert!(!models.models[0].used, "{:?}", models.models[0]);
        let mut few = PointingModels::default();
        places().take(3).for_each(|(h, d)| few.learn("cam", None, at(h, d, 4.0, 4.0)));
        assert!(!few.models[0].used, "three points prove nothing");
    }

    #[test]
    fn one_place_is_one_point_and_there_are_not_endlessly_many() {
        let mut models = PointingModels::default();
        for n in 0..500 {
            models.learn("cam", None, at(-20.0 + 0.001 * f64::from(n), -30.0, 4.0, 4.0));
        }
        assert_eq!(models.models[0].points.len(), 1);
        for n in 0..300 {
            models.learn("cam", None, at(-80.0 + 8.0 * f64::from(n % 20), -75.0 + 8.0 * f64::from(n / 20), 4.0, 4.0));
        }
        assert_eq!(models.models[0].points.len(), POINTS);
        assert!(models.models[0].checks.len() <= CHECKS && models.models[0].used);
        assert!(serde_json::to_vec(&models).unwrap().len() < 12_000, "a state of a few kilobytes");
    }

    #[test]
    fn after_somebody_has_synchronised_the_mount_the_old_points_mislead_no_longer_than_four_slews() {
        let mut models = models(4.0, -3.0);
        for (n, (hour_angle, dec)) in places().take(HARMFUL + 4).enumerate() {
            let here = models.expected("cam", deg(hour_angle + 4.0), deg(dec + 4.0), deg(1.0));
            if n >= HARMFUL {
                assert!(here.is_none_or(|miss| miss.size().degrees() * 60.0 < 1.0), "{n}: {here:?}");
            }
            // It misses nothing any more.
            models.learn("cam", Some(PierSide::West), at(hour_angle + 4.0, dec + 4.0, 0.05, -0.05));
        }
    }

    #[test]
    fn what_was_learned_outlives_a_restart_and_a_broken_file_is_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pointing.json");
        assert_eq!(PointingModels::read(&path), PointingModels::default());
        let models = models(4.0, -3.0);
        crate::persisted::write_whole(&path, &folder.path().join("part"), &models).unwrap();
        let read = PointingModels::read(&path);
        assert_eq!(read.models[0].points.len(), models.models[0].points.len());
        assert!(read.expected("cam", deg(-30.0), deg(-30.0), deg(1.0)).is_some());
        std::fs::write(&path, "{").unwrap();
        assert_eq!(PointingModels::read(&path), PointingModels::default());
    }
}
