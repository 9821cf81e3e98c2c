//! The observatory node measures what a camera announces: with no archive anywhere, from a spool that refuses, as a
//! standby that takes over.

use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::extract::Path;
use axum::http::StatusCode;
use bus::{Bus, Catch, Publisher, Received, Subscriber};
use contract::device::camera::{Frame, Pixel, Purpose};
use contract::observatory::{FrameFacts, TriggerKind};
use contract::{CommandId, Key, Kind, Topic};
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, Normal};
use sha2::{Digest as _, Sha256};
use test_support::serve;

use crate::MOST;
use crate::site::Site;

const SIDE_PX: u32 = 320;
const FWHM_PX: f64 = 3.4;
pub const STARS: u32 = 36;

/// Gaussian stars in rows of six on a sky of 500 ADU with a noise of 6 ADU, as the spool has them.
pub fn sky(stars: u32) -> Vec<u8> {
    let mut chance = rand::rngs::StdRng::seed_from_u64(7);
    let noise = Normal::new(500.0, 6.0).unwrap();
    let place = |n: u32| 30.0 + 52.0 * f64::from(n) + 0.37 * f64::from(n * n % 5);
    let value = |x: u32, y: u32| -> f64 {
        let near = (0..stars).map(|star| (f64::from(x) - place(star % 6), f64::from(y) - place(star / 6)));
        let light = near.map(|(dx, dy)| (-4.0 * std::f64::consts::LN_2 * (dx * dx + dy * dy) / FWHM_PX.powi(2)).exp());
        900.0 * light.sum::<f64>()
    };
    let pixels = (0..SIDE_PX).flat_map(|y| (0..SIDE_PX).map(move |x| (x, y)));
    pixels.flat_map(|(x, y)| ((value(x, y) + noise.sample(&mut chance)).round() as u16).to_le_bytes()).collect()
}

/// A camera's spool: `/stars`, `/empty`, and nothing else.
pub struct Spool {
    url: String,
    frames: Publisher<Frame>,
    facts: Subscriber<FrameFacts>,
}

impl Spool {
    pub async fn start(site: &Site) -> Self {
        let (stars, empty) = (sky(STARS), sky(0));
        let answer = move |Path(what): Path<String>| {
            let answer = match what.as_str() {
                "stars" => Ok(stars.clone()),
                "empty" => Ok(empty.clone()),
                _ => Err(StatusCode::NOT_FOUND),
            };
            async move { answer }
        };
        let url = format!("http://{}", serve(axum::Router::new().route("/{what}", axum::routing::get(answer))).await);
        let bus: &Bus = &site.bus;
        let camera = site.address.device(Kind::Camera, &"guider".parse().unwrap());
        let frames = bus.publisher(&Key::Frame(camera)).await.unwrap();
        let all = Topic::Facts.at(&site.address);
        Self { url, frames, facts: bus.subscribe(all, Catch::All, 100).await.unwrap() }
    }

    /// Announces the nth frame of a row; returns its id.
    pub async fn announce(&self, n: u32, what: &str, sha256_of: &[u8]) -> CommandId {
        let id = CommandId(format!("frame-{n}"));
        let purpose = Purpose {
            action: "object".to_owned(),
            image_type: "Light Frame".to_owned(),
            filter: Some("V".to_owned()),
            row: Some(0),
            ..Purpose::default()
        };
        let frame = Frame {
            id: id.clone(),
            camera: "guider".to_owned(),
            purpose,
            width_px: SIDE_PX,
            height_px: SIDE_PX,
            planes: 1,
            pixel: Pixel::U16,
            bin: 1,
            origin_px: [0, 0],
            started_utc: "2026-11-21T03:00:00Z".parse::<units::Utc>().unwrap().plus_seconds(f64::from(n)),
            exposure_s: 0.5,
            url: format!("{}/{what}", self.url),
            bytes: u64::from(SIDE_PX * SIDE_PX * 2),
            sha256: Sha256::digest(sha256_of).iter().map(|byte| format!("{byte:02x}")).collect(),
            readings: Default::default(),
        };
        self.frames.put(frame).await.unwrap();
        id
    }

    pub async fn facts_of(&self, id: &CommandId) -> Received<FrameFacts> {
        let waiting = async {
            loop {
                let received = self.facts.recv().await;
                if received.sample.body.frame == *id {
                    return received;
                }
            }
        };
        tokio::time::timeout(MOST, waiting).await.unwrap_or_else(|_| panic!("no facts of {id} within {MOST:?}"))
    }
}

fn alerts(site: &Site) -> Vec<String> {
    let published = site.alerts.get().map(|received| received.sample.body.alerts);
    published.unwrap_or_default().into_iter().map(|alert| alert.id).collect()
}

pub fn commands(site: &Site) -> bool {
    site.night.get().is_some()
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_are_measured_without_an_archive_and_vanished_stars_are_reported() {
    let site = Site::new(1.0).await;
    site.write_schedule(&[]);
    let (spool, node) = (Spool::start(&site).await, site.start().await);
    site.until("commanding", MOST, commands).await;
    let (stars, empty) = (sky(STARS), sky(0));
    for n in 0..4 {
        let id = spool.announce(n, "stars", &stars).await;
        let facts = spool.facts_of(&id).await.sample.body;
        assert_eq!((facts.camera.as_deref(), facts.filter.as_deref()), (Some("guider"), Some("V")));
        assert_eq!((facts.stars, facts.trailed, facts.reason), (Some(STARS), Some(false), None));
        assert!((facts.fwhm_px.unwrap() - FWHM_PX).abs() < 0.1, "{:?}", facts.fwhm_px);
        assert!((facts.sky_adu.unwrap() - 500.0).abs() < 1.0, "{:?}", facts.sky_adu);
        assert!((facts.noise_adu.unwrap() - 6.0).abs() < 0.3, "{:?}", facts.noise_adu);
    }
    let id = spool.announce(4, "empty", &empty).await;
    assert_eq!(spool.facts_of(&id).await.sample.body.stars, Some(0));
    let clouds = |site: &Site| {
        let triggers = site.night.get().map(|received| received.sample.body.triggers).unwrap_or_default();
        triggers.iter().any(|trigger| trigger.kind == TriggerKind::Clouds && trigger.camera == "guider")
    };
    site.until("clouds in the night's state", MOST, clouds).await;
    site.until("an alert", MOST, |site| alerts(site).contains(&"stars-gone/guider".to_owned())).await;
    spool.announce(5, "stars", &stars).await;
    site.until("clear again", MOST, |site| !clouds(site)).await;
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_cannot_be_had_gives_the_reason_and_three_of_them_raise_an_alert() {
    let site = Site::new(1.0).await;
    site.write_schedule(&[]);
    let (spool, node) = (Spool::start(&site).await, site.start().await);
    site.until("commanding", MOST, commands).await;
    let id = spool.announce(0, "gone", b"").await;
    let facts = spool.facts_of(&id).await.sample.body;
    assert!(facts.reason.unwrap().starts_with("not fetched: the spool answers HTTP 404"));
    assert_eq!((facts.stars, facts.sky_adu), (None, None));
    let id = spool.announce(1, "stars", b"other pixels").await;
    let reason = spool.facts_of(&id).await.sample.body.reason.unwrap();
    assert!(reason.contains("have the hash") && !reason.contains("http"), "{reason}");
    assert!(!alerts(&site).contains(&"frames-unmeasured/guider".to_owned()));
    spool.announce(2, "gone", b"").await;
    site.until("an alert", MOST, |site| alerts(site).contains(&"frames-unmeasured/guider".to_owned())).await;
    // Announced again, and there this time: measured after all.
    let id = spool.announce(2, "stars", &sky(STARS)).await;
    spool.facts_of(&id).await;
    assert_eq!(spool.facts_of(&id).await.sample.body.stars, Some(STARS), "the second facts of the same frame");
    site.until("no alert", MOST, |site| !alerts(site).contains(&"frames-unmeasured/guider".to_owned())).await;
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_standby_measures_nothing_until_it_commands_and_then_what_nobody_has_measured() {
    let site = Site::new(1.0).await;
    site.write_schedule(&[]);
    site.lease_held.store(true, Ordering::Relaxed);
    let (spool, node) = (Spool::start(&site).await, site.start().await);
    site.until_up("main").await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    let stars = sky(STARS);
    let (first, second) = (spool.announce(0, "stars", &stars).await, spool.announce(1, "stars", &stars).await);
    // The commander's facts of the first of them.
    let key = Key::Facts(site.address.clone(), first.0.parse().unwrap());
    let line = site.bus.publisher::<FrameFacts>(&key).await.unwrap();
    line.put(FrameFacts { frame: first.clone(), stars: Some(1), ..FrameFacts::default() }).await.unwrap();
    assert_eq!(spool.facts_of(&first).await.sample.body.stars, Some(1));
    let more = tokio::time::timeout(Duration::from_secs(2), spool.facts.recv()).await;
    assert!(more.is_err(), "a standby says nothing: {:?}", more.unwrap().sample.body);
    site.lease_held.store(false, Ordering::Relaxed);
    assert_eq!(spool.facts_of(&second).await.sample.body.stars, Some(STARS));
    let more = tokio::time::timeout(Duration::from_secs(1), spool.facts.recv()).await;
    assert!(more.is_err(), "the first is measured already: {:?}", more.unwrap().sample.body);
    node.stop().await;
}
