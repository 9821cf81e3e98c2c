//! A camera that sees the stars of the shipped catalogue where a WCS puts them.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use axum::extract::Path;
use axum::http::StatusCode;
use bus::{Catch, Publisher, Subscriber};
use contract::device::camera::{self, Frame, Pixel, Purpose};
use contract::observatory::FrameFacts;
use contract::{CommandId, Key, Kind, Topic};
use imaging::Wcs;
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, Normal};
use sha2::{Digest as _, Sha256};
use test_support::serve;
use units::Angle;

use crate::site::{Device, Site};

/// Size of a pixel, arcsec.
pub const SCALE_ARCSEC_PX: f64 = 6.18;
/// Magnitude of a star that gives 1 ADU per second.
pub const ZERO_POINT_MAG: f64 = 19.0;
const SIDE_PX: u32 = 480;
const EXPOSURE_S: f64 = 5.0;
const FWHM_PX: f64 = 3.0;
const STARTED: &str = "2026-11-21T03:00:00Z";

/// The middle of the whole sensor, px.
pub fn middle() -> (f64, f64) {
    (0.5 * f64::from(SIDE_PX - 1), 0.5 * f64::from(SIDE_PX - 1))
}

/// The sensor's WCS with its middle at a place (ICRS degrees), +y at this position angle, degrees.
pub fn wcs((ra_deg, dec_deg): (f64, f64), rotation_deg: f64, mirrored: bool) -> Wcs {
    let (sin, cos) = rotation_deg.to_radians().sin_cos();
    let (s, sense) = (SCALE_ARCSEC_PX / 3600.0, if mirrored { -1.0 } else { 1.0 });
    Wcs {
        ra: Angle::from_degrees(ra_deg),
        dec: Angle::from_degrees(dec_deg),
        x_px: middle().0,
        y_px: middle().1,
        cd_deg_px: [[sense * s * cos, s * sin], [-sense * s * sin, s * cos]],
        sip: None,
    }
}

/// One frame to be taken.
#[derive(Debug, Clone)]
pub struct Shot {
    /// Where the sensor's pixels are on the sky.
    pub truth: Wcs,
    /// Counts the frames.
    pub n: u32,
    /// What the frame is of, ICRS degrees.
    pub target: Option<(f64, f64)>,
    /// Share of the starlight that comes through.
    pub light: f64,
    /// First column and row, columns and rows.
    pub part: [u32; 4],
    /// IMAGETYP.
    pub image_type: &'static str,
}

impl Shot {
    /// The whole sensor under a clear sky, of no target.
    pub fn of(truth: Wcs, n: u32) -> Self {
        let (part, image_type) = ([0, 0, SIDE_PX, SIDE_PX], "Light Frame");
        Self { truth, n, target: None, light: 1.0, part, image_type }
    }

    /// Gaussian stars on a sky of 500 ADU with a noise of 5 ADU, as the spool has them.
    fn pixels(&self) -> Vec<u8> {
        let [x0, y0, width, height] = self.part.map(|px| px as usize);
        let mut chance = rand::rngs::StdRng::seed_from_u64(u64::from(self.n));
        let noise = Normal::new(500.0, 5.0).unwrap();
        let mut image: Vec<f64> = (0..width * height).map(|_| noise.sample(&mut chance)).collect();
        let (ra, dec) = self.truth.pixel_to_sky(middle().0, middle().1);
        let cone = Angle::from_arcseconds(0.75 * f64::from(SIDE_PX) * SCALE_ARCSEC_PX);
        let width2_px = FWHM_PX * FWHM_PX / (4.0 * std::f64::consts::LN_2);
        for star in catalogue::shipped().cone(ra, dec, cone, 99.0, 2026.889) {
            let Some((x, y)) = self.truth.sky_to_pixel(star.ra, star.dec) else { continue };
            let (x, y) = (x - x0 as f64, y - y0 as f64);
            let flux = self.light * EXPOSURE_S * 10_f64.powf(0.4 * (ZERO_POINT_MAG - star.mag));
            let peak = flux / (std::f64::consts::PI * width2_px);
            let near = |at: f64, length: usize| {
                ((at - 12.0).max(0.0) as usize)..((at + 13.0).clamp(0.0, length as f64) as usize)
            };
            for row in near(y, height) {
                for column in near(x, width) {
                    let r2 = (column as f64 - x).powi(2) + (row as f64 - y).powi(2);
                    image[row * width + column] += peak * (-r2 / width2_px).exp();
                }
            }
        }
        image.iter().flat_map(|value| (value.round().clamp(0.0, 65_535.0) as u16).to_le_bytes()).collect()
    }
}

/// The camera, its spool, and the published facts of its frames.
pub struct Camera {
    _device: Arc<Device<camera::Camera>>,
    url: String,
    spool: Arc<Mutex<HashMap<String, Vec<u8>>>>,
    frames: Publisher<Frame>,
    facts: Subscriber<FrameFacts>,
}

impl Camera {
    pub async fn start(site: &Site) -> Self {
        let spool: Arc<Mutex<HashMap<String, Vec<u8>>>> = Arc::default();
        let served = spool.clone();
        let answer = move |Path(frame): Path<String>| {
            let answer = served.lock().unwrap().get(&frame).cloned().ok_or(StatusCode::NOT_FOUND);
            async move { answer }
        };
        let url = format!("http://{}", serve(axum::Router::new().route("/{frame}", axum::routing::get(answer))).await);
        let device: Arc<Device<camera::Camera>> = Device::new(&site.address, "guider", camera::Fields::default());
        let can = camera::Capabilities { width_px: SIDE_PX, height_px: SIDE_PX, ..Default::default() };
        device.appear(&site.bus, can).await;
        let camera = site.address.device(Kind::Camera, &"guider".parse().unwrap());
        let frames = site.bus.publisher(&Key::Frame(camera)).await.unwrap();
        let all = Topic::Facts.at(&site.address);
        Self { _device: device, url, spool, frames, facts: site.bus.subscribe(all, Catch::All, 100).await.unwrap() }
    }

    /// Takes a frame and waits for its last facts: for a frame whose place takes long, facts are first published
    /// without it.
    pub async fn take(&self, shot: &Shot) -> FrameFacts {
        let (id, pixels) = (format!("frame-{}", shot.n), shot.pixels());
        let sha256 = Sha256::digest(&pixels).iter().map(|byte| format!("{byte:02x}")).collect();
        let [x_px, y_px, width_px, height_px] = shot.part;
        let purpose = Purpose {
            action: "object".to_owned(),
            image_type: shot.image_type.to_owned(),
            filter: Some("V".to_owned()),
            ra_deg: shot.target.map(|(ra, _)| ra),
            dec_deg: shot.target.map(|(_, dec)| dec),
            row: Some(0),
            ..Purpose::default()
        };
        let started: units::Utc = STARTED.parse().unwrap();
        let frame = Frame {
            id: CommandId(id.clone()),
            camera: "guider".to_owned(),
            purpose,
            width_px,
            height_px,
            planes: 1,
            pixel: Pixel::U16,
            bin: 1,
            origin_px: [x_px, y_px],
            started_utc: started.plus_seconds(10.0 * f64::from(shot.n)),
            exposure_s: EXPOSURE_S,
            url: format!("{}/{id}", self.url),
            bytes: pixels.len() as u64,
            sha256,
            readings: Default::default(),
        };
        self.spool.lock().unwrap().insert(id.clone(), pixels);
        self.frames.put(frame).await.unwrap();
        let waiting = async {
            loop {
                let facts = self.facts.recv().await.sample.body;
                if facts.frame.0 == id && (facts.solving_s.is_some() || shot.image_type != "Light Frame") {
                    return facts;
                }
            }
        };
        let most = crate::MOST;
        tokio::time::timeout(most, waiting).await.unwrap_or_else(|_| panic!("no facts of {id} within {most:?}"))
    }
}
