//! The steps of a frame: set, start, read what is fixed, wait, download; storing it runs in parallel with the next one.

use std::time::Duration;

use alpaca::{Alpaca, AlpacaError, Image, RawImage, value};
use contract::device::camera::{Exposure, Purpose, Subframe};
use contract::{CommandId, Kind, NoData};
use tokio::time::{Instant, sleep, sleep_until};
use units::Utc;

use super::camera::Camera;
use super::camera_setting::Setting;
use crate::deadline::machine_limit;
use crate::readings::{Readings, member};
use crate::spool::About;

/// Image readiness is asked so often near the end of an exposure.
const READY_PERIOD: Duration = Duration::from_millis(10);
/// The image must be ready so long after the end of the exposure, sky s.
const READOUT_LIMIT_S: f64 = 60.0;
/// So many failed questions in a row and the exposure has failed.
const MOST_FAILURES: u32 = 3;

/// A start that was answered, or whose answer was lost, within this time is known to half of it.
const START_KNOWN: Duration = Duration::from_millis(500);
/// A camera that refuses to begin while it is still at the frame before is given so long.
const BECOMES_FREE: Duration = Duration::from_secs(20);
/// An image may be so much smaller or larger than asked for, px of each axis: cameras read whole blocks of pixels.
const BLOCK_PX: u32 = 64;
/// ASCOM CameraState: waiting for its start, exposing, reading, download.
const EXPOSES: [i64; 4] = [1, 2, 3, 4];

/// Shows the exposure in the camera's state for as long as it lives, also when the command is interrupted.
struct ExposureInState<'a>(&'a Camera);

impl Drop for ExposureInState<'_> {
    fn drop(&mut self) {
        self.0.memory(|memory| memory.exposure = None);
    }
}

impl Camera {
    /// Takes a frame; returns when the camera is free for the next one.
    pub(super) async fn expose(
        &self,
        alpaca: &Alpaca,
        id: &CommandId,
        exposure_s: f64,
        light: bool,
        setting: Setting,
        purpose: &Purpose,
    ) -> Result<(), AlpacaError> {
        let taken = self.take(alpaca, id, exposure_s, light, setting, purpose).await;
        if let Err(error) = &taken {
            tracing::warn!(camera = %self.name, frame = %id, %error, "exposure failed");
            self.memory(|memory| memory.setting = None);
            // The camera may still be exposing; whether it is shows in its state.
            let _ = alpaca.at_once().put("abortexposure", &[]).await;
        }
        // The outcome of an exposure is known here; the camera's later state does not show it.
        taken.map_err(|error| AlpacaError::Value(error.no_data()))
    }

    async fn take(
        &self,
        alpaca: &Alpaca,
        id: &CommandId,
        exposure_s: f64,
        light: bool,
        setting: Setting,
        purpose: &Purpose,
    ) -> Result<(), AlpacaError> {
        let place = self.spool.place().await;
        let part = self.set(alpaca, setting).await?;
        let duration = exposure_s.to_string();
        let parameters = [("Duration", duration.as_str()), ("Light", if light { "True" } else { "False" })];
        let between = self.begin(alpaca, &parameters).await?;
        let began = Instant::now();
        let (asked, answered) = between;
        let started_utc = asked.plus_seconds(answered.seconds_since(asked) / 2.0);
        let in_state = ExposureInState(self);
        self.memory(|memory| memory.exposure = Some(Exposure { id: id.clone(), started_utc, exposure_s }));

        let readings = self.read_fixed(alpaca).await;
        self.wait_until_ready(alpaca, began, exposure_s).await?;
        let elapsed_s = self.clock.utc().seconds_since(asked);
        let (reported_utc, exposure_s) = self.as_the_camera_reports(alpaca, between, exposure_s, elapsed_s).await;
        let started_utc = reported_utc.unwrap_or(started_utc);
        let raw = alpaca.image(setting.pixels()).await?;
        if let Some((width, height)) = raw.size_px()
            && let Some(why) = differs((width, height), part)
        {
            return Err(AlpacaError::Protocol(why));
        }
        drop(in_state);
        self.store(
            place,
            raw,
            part,
            About {
                id: id.clone(),
                camera: self.name.clone(),
                purpose: purpose.clone(),
                bin: setting.bin,
                origin_px: [part.x_px, part.y_px],
                started_utc,
                exposure_s,
                readings: readings.published(Kind::Camera, self.clock.machine()),
            },
        );
        Ok(())
    }

    /// Opens the shutter, once; returns when the request that did so was sent and when it was answered. A lost answer is no
    /// failure where the camera reports that it exposes, and when the loss was noticed so soon that the time of the start
    /// is still known.
    async fn begin(&self, alpaca: &Alpaca, parameters: &[(&str, &str)]) -> Result<(Utc, Utc), AlpacaError> {
        let (mut asked, mut asked_utc) = (Instant::now(), self.clock.utc());
        let mut answer = alpaca.put("startexposure", parameters).await;
        if answer.as_ref().is_err_and(AlpacaError::is_ascom) && self.becomes_free(alpaca).await {
            // It was refused while the camera was still at the frame before; nothing was begun.
            (asked, asked_utc) = (Instant::now(), self.clock.utc());
            answer = alpaca.put("startexposure", parameters).await;
        }
        let between = (asked_utc, self.clock.utc());
        let Err(lost) = answer else { return Ok(between) };
        if !lost.is_unknown_outcome() || asked.elapsed() > START_KNOWN {
            return Err(lost);
        }
        let state = alpaca.get("camerastate").await.ok().and_then(|state| value::whole(&state).ok());
        if !state.is_some_and(|state| EXPOSES.contains(&state)) {
            return Err(lost);
        }
        tracing::warn!(camera = %self.name, %lost, "the answer to the start of an exposure was lost; the camera exposes");
        Ok(between)
    }

    /// Waits until a camera that is still busy with the frame before is free; false where it is not busy, or stays so.
    async fn becomes_free(&self, alpaca: &Alpaca) -> bool {
        let began = Instant::now();
        let mut was_busy = false;
        while began.elapsed() < BECOMES_FREE {
            let state = alpaca.get("camerastate").await.ok().and_then(|state| value::whole(&state).ok());
            match state {
                Some(state) if EXPOSES.contains(&state) => was_busy = true,
                Some(_) => return was_busy,
                None => return false,
            }
            sleep(READY_PERIOD * 10).await;
        }
        false
    }

    /// Sends only what is not set already: each call costs dead time. Returns the part of the sensor that the camera
    /// reports to read: many cameras read whole blocks of pixels only.
    async fn set(&self, alpaca: &Alpaca, setting: Setting) -> Result<Subframe, AlpacaError> {
        if let Some((_, part)) = self.memory(|memory| memory.setting).filter(|(before, _)| *before == setting) {
            return Ok(part);
        }
        self.memory(|memory| memory.setting = None);
        let Setting { bin, part } = setting;
        let numbers = [
            ("BinX", bin),
            ("BinY", bin),
            ("StartX", part.x_px),
            ("StartY", part.y_px),
            ("NumX", part.width_px),
            ("NumY", part.height_px),
        ];
        for (property, number) in numbers {
            if number > 0 || property.starts_with("Start") {
                alpaca.put(&property.to_ascii_lowercase(), &[(property, &number.to_string())]).await?;
            }
        }
        let part = self.read_back(alpaca, setting).await?;
        self.memory(|memory| memory.setting = Some((setting, part)));
        Ok(part)
    }

    /// The part of the sensor that the camera reports to read; that of the setting where it does not report it.
    async fn read_back(&self, alpaca: &Alpaca, setting: Setting) -> Result<Subframe, AlpacaError> {
        let read = async |property: &str| match alpaca.get(&property.to_ascii_lowercase()).await {
            Ok(answer) => Ok(value::whole(&answer).ok().and_then(|number| u32::try_from(number).ok())),
            Err(error) if error.is_transport() => Err(error),
            Err(_) => Ok(None),
        };
        for axis in ["BinX", "BinY"] {
            if let Some(bin) = read(axis).await?.filter(|bin| *bin != setting.bin) {
                let detail = format!("{axis} is {bin} after it was set to {}", setting.bin);
                return Err(AlpacaError::Value(NoData::new("binning", detail)));
            }
        }
        let asked = setting.part;
        let part = Subframe {
            x_px: read("StartX").await?.unwrap_or(asked.x_px),
            y_px: read("StartY").await?.unwrap_or(asked.y_px),
            width_px: read("NumX").await?.filter(|width| *width > 0).unwrap_or(asked.width_px),
            height_px: read("NumY").await?.filter(|height| *height > 0).unwrap_or(asked.height_px),
        };
        if part != asked {
            tracing::info!(camera = %self.name, ?asked, reads = ?part, "the camera reads another part of its sensor");
        }
        Ok(part)
    }

    /// Reads the fixed rows of the FITS-header table, while the camera exposes.
    async fn read_fixed(&self, alpaca: &Alpaca) -> Readings {
        let mut readings = Readings::default();
        let mut gone = None;
        for property in &self.fixed {
            let answer = match &gone {
                None => alpaca.get(&member(property).0).await,
                Some(reason) => Err(AlpacaError::Value(NoData::clone(reason))),
            };
            if let Err(error) = &answer
                && error.is_transport()
            {
                // A header value is not worth one deadline after the other.
                gone = Some(error.no_data());
            }
            readings.keep(property, answer.map_err(|error| error.no_data()), self.clock.utc());
        }
        readings
    }

    async fn wait_until_ready(&self, alpaca: &Alpaca, began: Instant, exposure_s: f64) -> Result<(), AlpacaError> {
        let light = self.clock.machine_duration(Duration::from_secs_f64(exposure_s));
        let limit = light + machine_limit(&self.clock, Duration::from_secs_f64(READOUT_LIMIT_S));
        sleep_until(began + light.saturating_sub(READY_PERIOD / 2)).await;
        let mut failures = 0;
        while began.elapsed() < limit {
            match alpaca.get("imageready").await.map(|ready| value::flag(&ready)) {
                Ok(Ok(true)) => return Ok(()),
                Ok(Ok(false)) => failures = 0,
                Ok(Err(reason)) => return Err(AlpacaError::Value(reason)),
                Err(error) => {
                    failures += 1;
                    if failures >= MOST_FAILURES {
                        return Err(error);
                    }
                }
            }
            // A long readout is not shortened by asking often.
            let late = began.elapsed().saturating_sub(light) > Duration::from_secs(2);
            sleep(if late { READY_PERIOD * 5 } else { READY_PERIOD }).await;
        }
        let waited = limit.as_secs_f64();
        Err(AlpacaError::Value(NoData::new("timeout", format!("no image {waited:.0} s after the exposure began"))))
    }

    /// The camera knows best when its shutter opened, if it reports this to a fraction of a second and believably, which is
    /// while the start was asked for, and how long it collected light, if that was possible in the time since.
    async fn as_the_camera_reports(
        &self,
        alpaca: &Alpaca,
        (asked, answered): (Utc, Utc),
        exposure_s: f64,
        elapsed_s: f64,
    ) -> (Option<Utc>, f64) {
        if !self.memory(|memory| memory.reports_start) {
            return (None, exposure_s);
        }
        let start = alpaca.get("lastexposurestarttime").await;
        let light = alpaca.get("lastexposureduration").await;
        if start.is_err() && light.is_err() {
            self.memory(|memory| memory.reports_start = false);
        }
        let reported = start.ok().and_then(|start| value::text(&start).ok()).filter(|text| text.contains('.'));
        let reported = reported.and_then(|text| text.parse::<Utc>().ok());
        // A camera computer's own clock may be off.
        let most_off_s = 0.5 * self.clock.speed();
        let started = reported.filter(|reported| {
            asked.seconds_since(*reported) <= most_off_s && reported.seconds_since(answered) <= most_off_s
        });
        let light = light.ok().and_then(|light| value::number(&light).ok());
        let light = light.filter(|light| is_possible(*light, exposure_s, elapsed_s));
        if let Some(reported_s) = light.filter(|light| (light - exposure_s).abs() > 0.1 * exposure_s + 0.1) {
            tracing::warn!(camera = %self.name, asked_s = exposure_s, reported_s, "the camera exposed for another time");
        }
        (started, light.unwrap_or(exposure_s))
    }

    /// Decodes, writes, hashes and announces in parallel with the next exposure.
    fn store(&self, place: crate::spool::Place, raw: RawImage, part: Subframe, about: About) {
        let max_adu = self.memory(|memory| memory.can.max_adu.known().copied());
        let spool = self.spool.clone();
        tokio::spawn(async move { spool.keep(place, move || decoded(raw, max_adu, part), about).await });
    }
}

/// Is this how long a camera may have collected light, s, when it was asked for `asked_s` and gave the image after
/// `elapsed_s`? A report that cannot be, or of nothing, is none.
fn is_possible(light_s: f64, asked_s: f64, elapsed_s: f64) -> bool {
    let agrees = (light_s - asked_s).abs() <= 0.1 * asked_s + 0.1;
    agrees || (light_s > 0.0 && light_s <= elapsed_s)
}

/// The image that was asked for. Of one that came as JSON the size is not known earlier.
fn decoded(raw: RawImage, max_adu: Option<f64>, part: Subframe) -> Result<Image, AlpacaError> {
    let image = raw.into_image(max_adu)?;
    match differs((image.width_px, image.height_px), part) {
        Some(why) => Err(AlpacaError::Protocol(why)),
        None => Ok(image),
    }
}

/// Why an image is not the one that was asked for: it is larger or smaller by more than a block of pixels.
fn differs((width, height): (u32, u32), part: Subframe) -> Option<String> {
    if part.width_px == 0 || part.height_px == 0 {
        return None;
    }
    let fits = |got: u32, asked: u32| got > 0 && got.abs_diff(asked) <= BLOCK_PX.min(asked / 8);
    let differs = !(fits(width, part.width_px) && fits(height, part.height_px));
    let asked = format!("asked for {} x {} px", part.width_px, part.height_px);
    differs.then(|| format!("the image has {width} x {height} px, {asked}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_of_light_that_a_camera_reports_is_believed_where_it_can_be() {
        // It exposed for less than asked, for more, reports nothing, another unit, and an instant in the future.
        let rows = [
            (30.0, 60.0, 62.0, true),
            (1.0, 0.4, 1.5, true),
            (0.0, 60.0, 62.0, false),
            (60_000.0, 60.0, 62.0, false),
            (60.0, 60.0, 59.9, true),
            (0.0, 0.0, 0.2, true),
            (f64::NAN, 60.0, 62.0, false),
            (-1.0, 60.0, 62.0, false),
        ];
        for (light_s, asked_s, elapsed_s, is_believed) in rows {
            assert_eq!(is_possible(light_s, asked_s, elapsed_s), is_believed, "{light_s} s of {asked_s} s");
        }
    }

    #[test]
    fn an_image_may_differ_by_a_block_of_pixels_and_not_by_a_binning() {
        let part = Subframe { x_px: 0, y_px: 0, width_px: 2000, height_px: 1000 };
        for good in [(2000, 1000), (1992, 1000), (2048, 1008)] {
            assert_eq!(differs(good, part), None, "{good:?}");
        }
        for bad in [(1000, 500), (2000, 0), (1000, 2000), (4000, 2000)] {
            assert!(differs(bad, part).unwrap().contains("asked for 2000 x 1000 px"), "{bad:?}");
        }
        assert!(differs((3, 2), Subframe { width_px: 2, height_px: 2, ..part }).is_some());
    }
}
