//! The newest image of each camera, made in memory: fetched from the spool, shrunk, stretched, JPEG.
//!
//! At most one a second while a page is open, one in ten seconds while no page is open; frames in between are passed
//! over. Images are also made while no page is open, because the spool forgets a frame once the archive has it.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::body::Bytes;
use bus::MachineTime;
use contract::device::camera::Frame;
use contract::{Address, CommandId, Device, Name};
use futures_util::StreamExt as _;
use picture::jpeg::{JpegError, encode};
use picture::stretch::Look;
use tokio::sync::{Notify, mpsc};

use crate::model::Image;
use crate::network::Network;
use crate::shrink::Shrink;

/// Longest side of the image, pixels: a phone's and a tile's worth.
const LONGEST_SIDE_PX: usize = 1024;
/// A frame of more pixels is a mistake or an attack.
const MOST_PIXELS: u64 = 500_000_000;
/// Cameras of all telescopes whose images are kept.
const MOST_CAMERAS: usize = 256;
const WATCHED_EVERY: Duration = Duration::from_secs(1);
const UNWATCHED_EVERY: Duration = Duration::from_secs(10);
const FETCH_TIMEOUT: Duration = Duration::from_secs(60);

/// Why a frame has no image.
#[derive(Debug, thiserror::Error)]
pub enum PreviewError {
    /// The pixels could not be fetched.
    #[error("its pixels cannot be fetched: {}", .0.to_string().split(" for url").next().unwrap_or("no answer"))]
    Fetch(reqwest::Error),
    /// Fewer pixels came than were announced.
    #[error("its pixels ended early")]
    CutShort,
    /// The announced size is none that a sensor has.
    #[error("it is announced with {width_px} x {height_px} pixels")]
    Size {
        /// Columns.
        width_px: u32,
        /// Rows.
        height_px: u32,
    },
    /// The JPEG could not be written.
    #[error("its image cannot be encoded: {0}")]
    Encode(#[from] JpegError),
}

/// An image ready to be served.
#[derive(Debug, Clone)]
pub struct Jpeg {
    /// Which frame it shows.
    pub frame: CommandId,
    /// The file.
    pub bytes: Bytes,
}

/// Images made and frames that wait for theirs.
pub struct Previews {
    network: Arc<Network>,
    client: reqwest::Client,
    waiting: Mutex<BTreeMap<Device, (Frame, MachineTime)>>,
    made: Mutex<BTreeMap<Address, BTreeMap<Name, Jpeg>>>,
    wake: Notify,
    watchers: AtomicUsize,
}

/// Counts as a watcher until it is dropped.
pub struct Watching(Arc<Previews>);

impl Drop for Watching {
    fn drop(&mut self) {
        self.0.watchers.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Previews {
    /// None yet.
    pub fn new(network: Arc<Network>) -> Result<Self, reqwest::Error> {
        // Spools are hosts of the observatory's own network, never behind a proxy.
        let client = local_http::client_builder().connect_timeout(Duration::from_secs(5));
        Ok(Self {
            network,
            client: client.timeout(FETCH_TIMEOUT).build()?,
            waiting: Mutex::default(),
            made: Mutex::default(),
            wake: Notify::new(),
            watchers: AtomicUsize::new(0),
        })
    }

    /// Registers a page that is open: images are made more often.
    pub fn watch(self: &Arc<Self>) -> Watching {
        self.watchers.fetch_add(1, Ordering::Relaxed);
        self.wake.notify_one();
        Watching(self.clone())
    }

    /// The number of pages that are open.
    pub fn watchers(&self) -> usize {
        self.watchers.load(Ordering::Relaxed)
    }

    /// Takes an announced frame; it replaces an older one of its camera that still waits.
    pub fn want(&self, camera: Device, frame: Frame, arrived: MachineTime) {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        if waiting.len() >= MOST_CAMERAS && !waiting.contains_key(&camera) {
            tracing::debug!(%camera, "too many cameras announce frames; this one is passed over");
            return;
        }
        waiting.insert(camera, (frame, arrived));
        drop(waiting);
        self.wake.notify_one();
    }

    /// The newest image of a telescope, or of one of its cameras.
    pub fn newest(&self, address: &Address, camera: Option<&str>) -> Option<Jpeg> {
        // Held for both looks, as by `show`: the image that is displayed is among those that are made.
        let made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        let displayed = self.network.read().telescopes.get(address)?.image.as_ref().map(|image| image.id.clone());
        let cameras = made.get(address)?;
        match camera {
            Some(camera) => cameras.iter().find(|(name, _)| name.as_str() == camera).map(|(_, jpeg)| jpeg.clone()),
            None => cameras.values().find(|jpeg| Some(&jpeg.frame) == displayed.as_ref()).cloned(),
        }
    }

    /// Makes images for ever.
    pub async fn make(self: Arc<Self>) -> anyhow::Result<()> {
        let mut last: Option<MachineTime> = None;
        loop {
            let every = if self.watchers() > 0 { WATCHED_EVERY } else { UNWATCHED_EVERY };
            let left =
                last.map_or(Duration::ZERO, |last| every.saturating_sub(self.network.clock().machine().since(last)));
            let anything = !self.waiting.lock().unwrap_or_else(PoisonError::into_inner).is_empty();
            if !anything {
                self.wake.notified().await;
                continue;
            }
            if !left.is_zero() {
                // A page that opens shortens the wait.
                let _ = tokio::time::timeout(left, self.wake.notified()).await;
                continue;
            }
            last = Some(self.network.clock().machine());
            let waiting = std::mem::take(&mut *self.waiting.lock().unwrap_or_else(PoisonError::into_inner));
            for (camera, (frame, arrived)) in waiting {
                self.make_one(camera, frame, arrived).await;
            }
        }
    }

    async fn make_one(&self, camera: Device, frame: Frame, arrived: MachineTime) {
        match self.fetch(&frame).await {
            Ok(bytes) => self.show(camera, frame, bytes, arrived),
            Err(error) => {
                tracing::warn!(frame = %frame.id, camera = %camera.name, "no image of a frame: {error}");
                self.network.miss_image(&camera.address, format!("frame {} is not shown: {error}", frame.id));
            }
        }
    }

    /// Displays an image that was made.
    fn show(&self, camera: Device, mut frame: Frame, bytes: Vec<u8>, arrived: MachineTime) {
        let id = frame.id.clone();
        frame.url.clear();
        let jpeg = Jpeg { frame: id.clone(), bytes: bytes.into() };
        let body = serde_json::to_value(&frame).unwrap_or_default();
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        let is_known = made.get(&camera.address).is_some_and(|cameras| cameras.contains_key(&camera.name));
        if !is_known && made.values().map(BTreeMap::len).sum::<usize>() >= MOST_CAMERAS {
            return;
        }
        made.entry(camera.address.clone()).or_default().insert(camera.name, jpeg);
        self.network.show_image(&camera.address, Image { frame: Arc::new(body), id, arrived, problem: None });
    }

    /// Fetches, shrinks on the way and encodes; all arithmetic on a thread of its own.
    async fn fetch(&self, frame: &Frame) -> Result<Vec<u8>, PreviewError> {
        let (width, height) = (frame.width_px, frame.height_px);
        let pixels = u64::from(width) * u64::from(height);
        // JPEG sides are 16 bit, and the longest side of the image is shorter than that.
        if pixels == 0 || pixels > MOST_PIXELS {
            return Err(PreviewError::Size { width_px: width, height_px: height });
        }
        let response = self.client.get(&frame.url).send().await.map_err(PreviewError::Fetch)?;
        let mut body = response.error_for_status().map_err(PreviewError::Fetch)?.bytes_stream();
        let (portions, mut arrive) = mpsc::channel::<Bytes>(4);
        let mut shrink = Shrink::new(width as usize, height as usize, frame.pixel, LONGEST_SIDE_PX);
        let work = tokio::task::spawn_blocking(move || {
            while let Some(portion) = arrive.blocking_recv() {
                shrink.take(&portion);
            }
            Ok(encode(&shrink.finish().ok_or(PreviewError::CutShort)?, Look::default())?)
        });
        let mut left = pixels * frame.pixel.bytes() as u64;
        while left > 0
            && let Some(portion) = body.next().await
        {
            let portion = portion.map_err(PreviewError::Fetch)?;
            left = left.saturating_sub(portion.len() as u64);
            if portions.send(portion).await.is_err() {
                break;
            }
        }
        drop(portions);
        // The thread only ends early when the runtime does.
        work.await.unwrap_or(Err(PreviewError::CutShort))
    }
}

#[cfg(test)]
mod tests {
    use contract::Kind;
    use contract::device::camera::Pixel;
    use serde_json::json;

    use super::*;
    use crate::model::tests::received;

    #[test]
    fn an_image_that_is_displayed_can_always_be_had_also_while_the_next_one_takes_its_place() {
        let address = Address::new("paranal", "callisto").unwrap();
        let network = Arc::new(Network::new(bus::Clock::machine_clock(), address.clone()));
        assert!(network.accept(received("paranal/callisto/observatory/night/state", "b", 0, 0, json!({}))));
        let previews = Previews::new(network.clone()).unwrap();
        let announced: Frame =
            serde_json::from_str(include_str!("../../common/contract/golden/v1/camera.frame.json")).unwrap();
        let camera = Device { address: address.clone(), kind: Kind::Camera, name: "main".parse().unwrap() };
        let show = || {
            let frame = Frame { id: CommandId::fresh(), ..announced.clone() };
            previews.show(camera.clone(), frame, vec![0], network.clock().machine());
        };
        show();
        let is_over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                (0..5000).for_each(|_| show());
                is_over.store(true, Ordering::Relaxed);
            });
            while !is_over.load(Ordering::Relaxed) {
                assert!(previews.newest(&address, None).is_some());
            }
        });
    }

    #[test]
    fn a_wide_frame_becomes_a_jpeg_within_the_longest_side() {
        let mut shrink = Shrink::new(3000, 40, Pixel::U16, LONGEST_SIDE_PX);
        for i in 0..3000 * 40u32 {
            shrink.take(&((i % 4096) as u16).to_le_bytes());
        }
        let jpeg = encode(&shrink.finish().unwrap(), Look::default()).unwrap();
        assert_eq!(jpeg[..3], [0xFF, 0xD8, 0xFF]);
        // Start-of-frame marker: height and width follow the precision.
        let sof = jpeg.windows(2).position(|pair| pair == [0xFF, 0xC0]).unwrap();
        let side = |at: usize| u16::from_be_bytes([jpeg[sof + at], jpeg[sof + at + 1]]);
        assert_eq!((side(5), side(7)), (14, 1000));
    }
}
