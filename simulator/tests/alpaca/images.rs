//! The image shows the stars of the sky.

use std::time::Instant;

use serde_json::Value;
use sky::{Icrs, Tangent};
use units::Angle;

use crate::client::{Site, options};

pub struct Image {
    pub width: usize,
    pub height: usize,
    /// `[x][y]`.
    pixels: Vec<u16>,
}

impl Image {
    fn at(&self, x: usize, y: usize) -> u16 {
        self.pixels[x * self.height + y]
    }

    fn median(&self) -> u16 {
        let mut sorted = self.pixels.clone();
        sorted.sort_unstable();
        sorted[sorted.len() / 2]
    }

    /// Flux-weighted middle of the light around a place, and its peak.
    pub fn centroid(&self, x: f64, y: f64) -> (f64, f64, f64) {
        let sky = f64::from(self.median());
        let (mut sum, mut sx, mut sy, mut peak) = (0.0, 0.0, 0.0, 0.0_f64);
        for column in (x as usize).saturating_sub(6)..(x as usize + 7).min(self.width) {
            for row in (y as usize).saturating_sub(6)..(y as usize + 7).min(self.height) {
                let light = f64::from(self.at(column, row)) - sky;
                if light > 60.0 {
                    (sum, sx, sy) = (sum + light, sx + light * column as f64, sy + light * row as f64);
                    peak = peak.max(light);
                }
            }
        }
        (sx / sum, sy / sum, peak)
    }
}

async fn bytes(site: &Site, camera: &str) -> Vec<u8> {
    let request = site.http.get(site.url(camera, "imagearray?ClientTransactionID=9"));
    let response = request.header("Accept", "application/imagebytes").send().await.unwrap();
    assert_eq!(response.headers()["content-type"], "application/imagebytes");
    response.bytes().await.unwrap().to_vec()
}

async fn image(site: &Site, camera: &str) -> Image {
    let bytes = bytes(site, camera).await;
    let word = |n: usize| i32::from_le_bytes(std::array::from_fn(|i| bytes[4 * n + i]));
    assert_eq!([word(0), word(1), word(2), word(4), word(5), word(6), word(7)], [1, 0, 9, 44, 2, 8, 2]);
    let (width, height) = (word(8) as usize, word(9) as usize);
    let pixels: Vec<u16> = bytes[44..].chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
    assert_eq!(pixels.len(), width * height);
    Image { width, height, pixels }
}

async fn expose(site: &Site, duration_s: f64, light: bool) -> Image {
    expose_with(site, "camera", duration_s, light).await
}

pub async fn expose_with(site: &Site, camera: &str, duration_s: f64, light: bool) -> Image {
    site.put(camera, "startexposure", &format!("Duration={duration_s}&Light={light}")).await;
    site.until(camera, "imageready", true).await;
    image(site, camera).await
}

/// An open dome, a telescope that tracks, a cooled camera.
pub async fn observing(options: simulator::Options, ra_h: f64, dec_deg: f64) -> Site {
    let site =
        Site::connected(options, &["telescope", "camera", "dome", "filterwheel", "focuser", "covercalibrator"]).await;
    site.put("dome", "slaved", "Slaved=true").await;
    site.put("dome", "openshutter", "").await;
    site.put("filterwheel", "position", "Position=4").await;
    site.put("camera", "setccdtemperature", "SetCCDTemperature=-20").await;
    site.put("camera", "cooleron", "CoolerOn=true").await;
    site.put("telescope", "unpark", "").await;
    site.put("telescope", "tracking", "Tracking=true").await;
    site.put("telescope", "slewtocoordinates", &format!("RightAscension={ra_h}&Declination={dec_deg}")).await;
    site.until("dome", "shutterstatus", 0).await;
    site.until("dome", "slewing", false).await;
    site.until("filterwheel", "position", 4).await;
    site
}

/// Stars of the shipped catalogue on a sensor turned by so many degrees, brightest first: pixel and magnitude.
pub fn expected(center: Icrs, camera: &simulator::CameraOptions, angle_deg: f64) -> Vec<(f64, f64, f64)> {
    let scale = camera.pixel_scale().radians();
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let radius = Angle::from_radians(scale * w.hypot(h) / 2.0);
    let tangent = Tangent::new(center);
    // East is left unless a mirror turns it over.
    let left = if camera.mirrored { -1.0 } else { 1.0 };
    let stars = simulator::catalogue::default().cone(center.ra, center.dec, radius, 20.0, 2026.889);
    let mut found: Vec<(f64, f64, f64)> = stars
        .iter()
        .filter_map(|star| {
            let (xi, eta) = tangent.project(&Icrs { ra: star.ra, dec: star.dec })?;
            let (xi, eta) = (xi.radians() / scale, eta.radians() / scale);
            let (x, y) = (left * (eta * sin - xi * cos), eta * cos + xi * sin);
            Some(((w - 1.0) / 2.0 + x, (h - 1.0) / 2.0 + y, star.mag))
        })
        .filter(|(x, y, _)| (8.0..w - 8.0).contains(x) && (8.0..h - 8.0).contains(y))
        .collect();
    found.sort_by(|a, b| a.2.total_cmp(&b.2));
    found
}

/// Stars that no other of at most three magnitudes less brightness disturbs.
pub fn alone(stars: &[(f64, f64, f64)]) -> Vec<(f64, f64, f64)> {
    let lonely = |a: &&(f64, f64, f64)| {
        stars.iter().filter(|b| b.2 < a.2 + 3.0 && (a.0 - b.0).hypot(a.1 - b.1) < 20.0).count() == 1
    };
    stars.iter().filter(lonely).copied().collect()
}

#[tokio::test]
async fn stars_stand_where_the_catalogue_projects_them() {
    let mut options = options(30.0);
    (options.camera.width, options.camera.height) = (1200, 1000);
    let site = observing(options.clone(), 5.5, -2.0).await;
    let image = expose(&site, 20.0, true).await;
    let center = site.simulator.world().looks_at();
    let angle_deg = if site.get("telescope", "sideofpier").await == 1 { 180.0 } else { 0.0 };
    let stars = alone(&expected(center, &options.camera, angle_deg));
    let seen: Vec<_> = stars.iter().filter(|star| star.2 > 8.5 && star.2 < 11.0).take(8).collect();
    assert_eq!(seen.len(), 8, "{stars:?}");
    for (x, y, mag) in seen {
        let (cx, cy, peak) = image.centroid(x.round(), y.round());
        assert!(peak > 300.0, "no star of {mag} at {x} {y}: {peak}");
        assert!((cx - x).hypot(cy - y) < 0.25, "{mag} mag expected at {x:.2} {y:.2}, seen at {cx:.2} {cy:.2}");
    }
}

#[tokio::test]
async fn the_same_pointing_shows_the_same_stars_twice() {
    let site = observing(options(30.0), 5.0, -20.0).await;
    let first = expose(&site, 10.0, true).await;
    site.put("telescope", "slewtocoordinates", "RightAscension=4&Declination=10").await;
    let elsewhere = expose(&site, 10.0, true).await;
    site.put("telescope", "slewtocoordinates", "RightAscension=5&Declination=-20").await;
    let again = expose(&site, 10.0, true).await;
    assert!(likeness(&first, &again) > 0.9, "{}", likeness(&first, &again));
    assert!(likeness(&first, &elsewhere) < 0.3, "{}", likeness(&first, &elsewhere));
}

/// Correlation of two images, clipped so that no single star decides.
fn likeness(a: &Image, b: &Image) -> f64 {
    let (ma, mb) = (f64::from(a.median()), f64::from(b.median()));
    let clip = |v: u16, m: f64| (f64::from(v) - m).clamp(0.0, 2000.0);
    let pairs = a.pixels.iter().zip(&b.pixels).map(|(a, b)| (clip(*a, ma), clip(*b, mb)));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in pairs {
        (ab, aa, bb) = (ab + a * b, aa + a * a, bb + b * b);
    }
    ab / (aa * bb).sqrt()
}

#[tokio::test]
async fn json_and_image_bytes_agree() {
    let site = observing(options(50.0), 3.0, -30.0).await;
    site.put("camera", "numx", "NumX=40").await;
    site.put("camera", "numy", "NumY=30").await;
    site.put("camera", "startx", "StartX=100").await;
    let image = expose(&site, 1.0, true).await;
    assert_eq!((image.width, image.height), (40, 30));
    let json: Value = site.answer("camera", "imagearray").await;
    assert_eq!((&json["Type"], &json["Rank"], &json["ErrorNumber"]), (&2.into(), &2.into(), &0.into()));
    let columns = json["Value"].as_array().unwrap();
    assert_eq!(columns.len(), 40);
    for (x, column) in columns.iter().enumerate() {
        let rows: Vec<u64> = column.as_array().unwrap().iter().map(|v| v.as_u64().unwrap()).collect();
        assert_eq!(rows, (0..30).map(|y| u64::from(image.at(x, y))).collect::<Vec<_>>());
    }
}

#[tokio::test]
async fn an_image_that_is_not_there_is_an_error_in_both_forms() {
    let site = Site::connected(options(1.0), &["camera"]).await;
    assert_eq!(site.answer("camera", "imagearray").await["ErrorNumber"], 0x40B);
    let bytes = bytes(&site, "camera").await;
    assert_eq!(i32::from_le_bytes(std::array::from_fn(|i| bytes[4 + i])), 0x40B);
    assert!(String::from_utf8_lossy(&bytes[44..]).contains("no image"));
}

#[tokio::test]
async fn exposures_bins_and_subframes_mind_their_limits() {
    let site = Site::connected(options(20.0), &["camera"]).await;
    assert_eq!(site.try_put("camera", "startexposure", "Duration=-1&Light=true").await, (200, 0x401));
    site.put("camera", "binx", "BinX=2").await;
    assert_eq!(site.try_put("camera", "startexposure", "Duration=1&Light=false").await, (200, 0x401));
    site.put("camera", "numx", "NumX=256").await;
    site.put("camera", "numy", "NumY=200").await;
    let started = site.world().now();
    site.put("camera", "startexposure", "Duration=10&Light=false").await;
    assert_eq!(site.get("camera", "camerastate").await, 2);
    assert_eq!(site.try_put("camera", "startexposure", "Duration=1&Light=false").await, (200, 0x40B));
    site.until("camera", "imageready", true).await;
    // Ten seconds of exposure and one of readout.
    let sky_s = site.world().now().seconds_since(started);
    assert!((10.9..15.0).contains(&sky_s), "{sky_s}");
    assert_eq!(site.get("camera", "lastexposureduration").await, 10.0);
    let stamp = site.get("camera", "lastexposurestarttime").await;
    assert!(stamp.as_str().unwrap().starts_with("2026-11-21T03:0"), "{stamp}");
    let binned = image(&site, "camera").await;
    assert_eq!((binned.width, binned.height), (256, 200));
    site.put("camera", "startexposure", "Duration=1000&Light=true").await;
    site.put("camera", "abortexposure", "").await;
    assert_eq!(site.get("camera", "camerastate").await, 0);
    assert_eq!(site.get("camera", "imageready").await, false);
    site.put("camera", "startexposure", "Duration=1000&Light=true").await;
    site.pass(4.0).await;
    site.put("camera", "stopexposure", "").await;
    site.until("camera", "imageready", true).await;
    assert!(site.get("camera", "lastexposureduration").await.as_f64().unwrap() < 900.0);
}

#[tokio::test]
async fn darks_have_no_stars_and_grow_with_time_and_warmth() {
    let site = Site::connected(options(400.0), &["camera", "dome", "covercalibrator"]).await;
    let bias = expose(&site, 0.0, false).await;
    let warm = expose(&site, 200.0, false).await;
    assert!((490..=510).contains(&bias.median()), "{}", bias.median());
    assert!(warm.median() > bias.median() + 300, "{}", warm.median());
    let limit = 2 * warm.median();
    let hot = warm.pixels.iter().filter(|count| **count > limit).count();
    assert!((5..100).contains(&hot), "{hot} hot pixels");
    // Behind a closed dome a light exposure is as dark as any.
    let closed = expose(&site, 200.0, true).await;
    assert!(closed.median().abs_diff(warm.median()) < 60);
    // The flat panel shines into a closed cover.
    site.put("covercalibrator", "closecover", "").await;
    site.put("covercalibrator", "calibratoron", "Brightness=60").await;
    site.until("covercalibrator", "coverstate", 1).await;
    let flat = expose(&site, 5.0, true).await;
    assert!(flat.median() > 5000 && flat.median() < 60_000, "{}", flat.median());
    let (middle, corner) = (u32::from(flat.at(256, 200)), u32::from(flat.at(2, 2)));
    assert!(corner < middle * 95 / 100, "{corner} {middle}");
}

#[tokio::test]
async fn a_slit_that_stands_elsewhere_hides_the_stars_and_the_world_shows_it() {
    // 35 deg from the zenith, so that the slit must stand in the south.
    let site = observing(options(100.0), 3.0, -60.0).await;
    let dome = |site: &Site| site.simulator.world().state()["dome"].clone();
    let bright = |image: &Image| {
        let limit = image.median() + 1000;
        image.pixels.iter().filter(|count| **count > limit).count()
    };
    let before = expose(&site, 20.0, true).await;
    assert_eq!((dome(&site)["slit_free"].as_f64(), dome(&site)["vignetted_s"].as_f64()), (Some(1.0), Some(0.0)));
    assert!(dome(&site)["exposed_s"].as_f64().unwrap() > 15.0, "{}", dome(&site));
    site.put("dome", "slaved", "Slaved=false").await;
    site.put("dome", "slewtoazimuth", "Azimuth=20").await;
    site.until("dome", "slewing", false).await;
    let hidden = expose(&site, 20.0, true).await;
    assert_eq!(dome(&site)["slit_free"], 0.0);
    let vignetted_s = dome(&site)["vignetted_s"].as_f64().unwrap();
    assert!((15.0..60.0).contains(&vignetted_s), "{vignetted_s}");
    assert_eq!(dome(&site)["turns"], 1);
    // Hot pixels stay, stars do not.
    assert!(bright(&before) > 2 * bright(&hidden), "{} {}", bright(&before), bright(&hidden));
    site.simulator.world().set_turn_speed(Some(0.0));
    site.put("dome", "slewtoazimuth", "Azimuth=200").await;
    assert_eq!(site.get("dome", "slewing").await, true);
    assert!((site.get("dome", "azimuth").await.as_f64().unwrap() - 20.0).abs() < 1e-6, "it hangs");
}

#[tokio::test]
async fn a_roof_reports_that_it_does_not_turn() {
    let mut options = options(100.0);
    options.dome.slit = None;
    let site = Site::connected(options, &["dome"]).await;
    for word in ["cansetazimuth", "canslave", "canpark"] {
        assert_eq!(site.get("dome", word).await, false, "{word}");
    }
    assert_eq!(site.try_put("dome", "slewtoazimuth", "Azimuth=20").await, (200, 0x400));
    assert_eq!(site.try_put("dome", "slaved", "Slaved=true").await, (200, 0x400));
}

#[tokio::test]
async fn defocus_spreads_the_stars() {
    let options = options(100.0);
    let site = observing(options.clone(), 3.0, -30.0).await;
    let brightest = |image: &Image| {
        let mut sorted = image.pixels.clone();
        sorted.sort_unstable_by(|a, b| b.cmp(a));
        sorted[300]
    };
    let sharp = brightest(&expose(&site, 10.0, true).await);
    site.put("focuser", "move", "Position=24000").await;
    site.until("focuser", "ismoving", false).await;
    let blurred = brightest(&expose(&site, 10.0, true).await);
    assert!(f64::from(blurred) < 0.8 * f64::from(sharp), "{blurred} {sharp}");
}

#[tokio::test]
async fn a_large_frame_is_drawn_in_time() {
    let mut options = options(200.0);
    (options.camera.width, options.camera.height, options.camera.readout_s) = (2048, 2048, 0.0);
    let site = observing(options, 5.6, -5.0).await;
    let _warm_up = expose(&site, 10.0, true).await;
    let started = Instant::now();
    let image = expose(&site, 10.0, true).await;
    println!(
        "2048 x 2048 frame: {:.0} ms from start to pixels, 50 ms of it exposure",
        started.elapsed().as_secs_f64() * 1e3
    );
    assert_eq!(image.pixels.len(), 2048 * 2048);
    let sky = image.median();
    let stars = image.pixels.iter().filter(|count| **count > sky + 1000).count();
    assert!(stars > 200, "{stars} bright pixels");
}

#[tokio::test]
async fn the_twilight_sky_is_bright_and_fades() {
    let mut options = options(30.0);
    options.start = "2026-11-20T23:46:00Z".parse().unwrap();
    let site = observing(options, 1.0, -30.0).await;
    let sun = async || site.control("world").await["sun_altitude_deg"].as_f64().unwrap();
    let before = sun().await;
    assert!((-10.0..-3.0).contains(&before), "{before}");
    let early = expose(&site, 2.0, true).await.median();
    // Three minutes, and the flat is visibly fainter.
    site.pass(180.0).await;
    let late = expose(&site, 2.0, true).await.median();
    assert!(sun().await < before - 0.5);
    assert!(early > 1200 && early < 65_000 && late - 500 < (early - 500) * 4 / 5, "{early} {late}");
}
