//! The fluxes of a target and of comparison stars on each frame, for light curves: measured once, soon after a frame is
//! stored and solved, so that a report needs no pixels.
//!
//! Frames of one object, filter, camera, binning and exposure of a night are a series. The comparison stars of a series
//! are the brightest good ones of its first solved frame; on the following frames they are measured where the plate
//! solution puts them. A light curve compares stars within each frame, so the circle may follow the seeing.

mod aperture;

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::time::Duration;

use anyhow::Context as _;
use bus::MachineTime;
use config::{Observatory, Sensor};
use contract::CommandId;
use contract::device::camera::{Frame, Purpose};
use contract::observatory::FrameFacts;
use imaging::{Camera, Pixels, StarSearch};
use node::Node;
use serde_json::json;
use units::{Angle, Utc};

use crate::database::{Database, StarFlux, StoredFluxes, Write};
use crate::folder::without_links;
use crate::night::NightFrame;
use crate::reader::Reader;
use crate::solution::wcs;

/// Comparison stars of a series, at most.
const COMPARISON_STARS: usize = 12;
/// A comparison star is at least so many radii from the target and from another one.
const APART_RADII: f64 = 3.0;
/// A comparison star has this flux over its error.
const LEAST_SNR: f64 = 30.0;
/// How often it is looked for frames, machine time.
const EVERY: Duration = Duration::from_secs(2);
/// Frames of so long ago are looked for, sky s: a restart in the night loses none.
const BACK_S: f64 = 86_400.0;
/// Frames of one look.
const AT_ONCE: u32 = 50;

/// A frame that failed, such as one on a disk that is away, is tried again after these times, machine time; then no more.
const AGAIN_AFTER_S: [u64; 4] = [10, 60, 600, 3600];

/// The frames that are not measured again and again.
#[derive(Debug, Default)]
struct Tried {
    /// Frames that have no fluxes, and those that failed too often.
    done: HashSet<CommandId>,
    /// Frames that failed: how often, and when they are tried again.
    failed: HashMap<CommandId, (usize, MachineTime)>,
}

impl Tried {
    /// Is it the time of a frame?
    fn is_due(&self, frame: &CommandId, now: MachineTime) -> bool {
        !self.done.contains(frame) && self.failed.get(frame).is_none_or(|(_, not_before)| now >= *not_before)
    }

    /// A frame has nothing to measure, or was measured.
    fn finish(&mut self, frame: &CommandId) {
        self.failed.remove(frame);
        self.done.insert(frame.clone());
    }

    /// A frame could not be measured; returns whether it is tried again.
    fn fail(&mut self, frame: &CommandId, now: MachineTime) -> bool {
        let times = self.failed.get(frame).map_or(0, |(times, _)| *times);
        let Some(after_s) = AGAIN_AFTER_S.get(times) else {
            self.finish(frame);
            return false;
        };
        self.failed.insert(frame.clone(), (times + 1, now.plus(Duration::from_secs(*after_s))));
        true
    }

    /// How many frames may be returned by a look although it is not their time.
    fn len(&self) -> u32 {
        u32::try_from(self.done.len() + self.failed.len()).unwrap_or(u32::MAX)
    }
}

/// Measures the frames of targets until the node is stopped.
pub async fn keep(node: Node, database: Database) -> anyhow::Result<()> {
    let mut tried = Tried::default();
    loop {
        let (file, config) = (database.path().to_owned(), node.config.clone());
        let clock = node.bus.clock();
        let (since, now) = (clock.utc().plus_seconds(-BACK_S), clock.machine());
        let look = move || {
            let measured = measure_next(&config, &file, since, &mut tried, now);
            (tried, measured)
        };
        let measured;
        (tried, measured) = tokio::task::spawn_blocking(look).await?;
        match measured {
            Ok(Some(fluxes)) => {
                database.commit(vec![Write::Fluxes(Box::new(fluxes))]).await?;
                continue;
            }
            Ok(None) => {}
            // A database that cannot be read is the writer's to report.
            Err(error) => tracing::debug!(error = format!("{error:#}"), "no frame is looked at"),
        }
        tokio::time::sleep(EVERY).await;
    }
}

/// Measures the oldest frame that is due.
///
/// # Errors
/// The database cannot be read.
fn measure_next(
    config: &Observatory,
    file: &Path,
    since: Utc,
    tried: &mut Tried,
    now: MachineTime,
) -> anyhow::Result<Option<StoredFluxes>> {
    let telescope = config.place.telescope.as_str();
    let reader = Reader::open(file, telescope)?;
    for frame in reader.unmeasured_targets(since, AT_ONCE.saturating_add(tried.len()))? {
        let id = &frame.image.frame.id;
        if !tried.is_due(id, now) {
            continue;
        }
        match measure_frame(&reader, config, &frame) {
            Ok(fluxes) => {
                tried.finish(id);
                if fluxes.is_some() {
                    return Ok(fluxes);
                }
            }
            Err(error) => {
                let is_tried_again = tried.fail(id, now);
                tracing::warn!(
                    frame = %id, is_tried_again, error = format!("{error:#}"),
                    "the stars of a frame are not measured; it is no point of a light curve"
                );
            }
        }
    }
    Ok(None)
}

/// Frames whose fluxes can be compared, as a list in JSON: names of objects and filters may have blanks and commas.
fn series(telescope: &str, frame: &Frame) -> String {
    let Purpose { night, object, filter, .. } = &frame.purpose;
    json!([telescope, night, object, filter, frame.camera, frame.bin, frame.exposure_s.round()]).to_string()
}

/// The fluxes of a frame; absent where it has no target, no solution or no comparison stars.
fn measure_frame(reader: &Reader, config: &Observatory, frame: &NightFrame) -> anyhow::Result<Option<StoredFluxes>> {
    let Some(facts) = &frame.facts else { return Ok(None) };
    let images = &config.folders.images;
    let series = series(config.place.telescope.as_str(), &frame.image.frame);
    let path = frame.image.path(images);
    without_links(images, &path).context("the file is not where it was written")?;
    let known = reader.series_stars(&series)?;
    let image = fits::read(&path)?;
    let pixels = match &image.pixels {
        fits::Pixels::U16(counts) => Pixels::U16(counts),
        fits::Pixels::F32(floats) => Pixels::F32(floats),
    };
    let pixels = imaging::Frame::new(image.width_px, image.height_px, pixels)?;
    let sensor = Sensor::of(config, &frame.image.frame);
    Ok(measure(&pixels, &frame.image.frame, sensor, facts, known, series))
}

/// The fluxes of the stars of a series on a frame; the stars of a series that has none are chosen.
fn measure(
    pixels: &imaging::Frame,
    frame: &Frame,
    sensor: Sensor,
    facts: &FrameFacts,
    known: Vec<[f64; 2]>,
    series: String,
) -> Option<StoredFluxes> {
    let (solution, fwhm_px) = (wcs(facts.wcs.as_ref()?), facts.fwhm_px.filter(|fwhm| *fwhm > 0.0)?);
    let gain = sensor.electrons_per_adu.unwrap_or(1.0);
    let camera = Camera {
        max_adu: sensor.max_adu.map(|adu| adu as f32),
        saturation_adu: sensor.saturation_adu.map(|adu| adu as f32),
        gain_e_per_adu: gain as f32,
        ..Camera::default()
    };
    let limit_adu = f64::from(camera.saturation_adu(pixels));
    let is_new = known.is_empty();
    let mut stars = if is_new {
        let target = [frame.purpose.ra_deg?, frame.purpose.dec_deg?];
        let at = solution.sky_to_pixel(Angle::from_degrees(target[0]), Angle::from_degrees(target[1]))?;
        let others = comparison_stars(pixels, &camera, at, fwhm_px);
        let sky = |(x, y): (f64, f64)| {
            let (ra, dec) = solution.pixel_to_sky(x, y);
            [ra.degrees(), dec.degrees()]
        };
        [target].into_iter().chain(others.into_iter().map(sky)).collect()
    } else {
        known
    };
    // A moving target has another place on each frame.
    if let (Some(ra_deg), Some(dec_deg), Some(target)) =
        (frame.purpose.ra_deg, frame.purpose.dec_deg, stars.first_mut())
    {
        *target = [ra_deg, dec_deg];
    }
    let flux = |(star, [ra_deg, dec_deg]): (usize, &[f64; 2])| {
        let place = solution.sky_to_pixel(Angle::from_degrees(*ra_deg), Angle::from_degrees(*dec_deg))?;
        let measured = aperture::measure(pixels, place, fwhm_px, gain, limit_adu)?;
        Some(StarFlux {
            star: u32::try_from(star).ok()?,
            x_px: measured.x_px,
            y_px: measured.y_px,
            flux_adu: measured.flux_adu,
            error_adu: measured.error_adu,
            is_saturated: measured.is_saturated,
        })
    };
    let fluxes: Vec<StarFlux> = stars.iter().enumerate().filter_map(flux).collect();
    // A first frame that does not show the target, or nothing else, is no model for those that follow.
    let has_both = fluxes.iter().any(|flux| flux.star == 0) && fluxes.iter().any(|flux| flux.star > 0);
    let new_stars = if is_new { stars } else { Vec::new() };
    has_both.then(|| StoredFluxes { frame: frame.id.clone(), series, new_stars, fluxes })
}

/// The places of the brightest stars that are good to compare with, px.
fn comparison_stars(pixels: &imaging::Frame, camera: &Camera, target: (f64, f64), fwhm_px: f64) -> Vec<(f64, f64)> {
    let search = StarSearch { fwhm_px: Some(fwhm_px as f32), ..StarSearch::default() };
    let Ok(measured) = imaging::measure(pixels, camera, &search) else { return Vec::new() };
    let (apart, margin) = (APART_RADII * aperture::circle_px(fwhm_px), 2.0 * aperture::margin_px(fwhm_px));
    let mut chosen: Vec<(f64, f64)> = Vec::new();
    for star in measured.stars.iter().filter(|star| star.flags.none() && star.snr >= LEAST_SNR) {
        let at = (star.x_px, star.y_px);
        let is_apart = |other: &(f64, f64)| (other.0 - at.0).hypot(other.1 - at.1) >= apart;
        // The field drifts and is turned: a star near the edge would leave the frame.
        let is_inside = at.0 >= margin
            && at.1 >= margin
            && at.0 + margin <= pixels.width() as f64
            && at.1 + margin <= pixels.height() as f64;
        if is_inside && is_apart(&target) && chosen.iter().all(is_apart) {
            chosen.push(at);
        }
        if chosen.len() == COMPARISON_STARS {
            break;
        }
    }
    chosen
}

#[cfg(test)]
mod tests;
