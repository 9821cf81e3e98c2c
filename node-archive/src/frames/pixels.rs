//! Pictures, tiles and values of a frame's pixels. The frame that was decoded last stays in memory for a while: whoever looks
//! at a frame asks for many of its tiles.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use contract::archived_frame::{
    ArchiveRefusal, Base64, FrameDetails, FramePicture, FramePixels, FrameTile, LEAST_PICTURE_PX, MOST_PICTURE_PX,
    MOST_PIXELS, NotGiven, PictureWanted, Stretch, TILE_PX,
};
use fits::rows::Rows;
use fits::{Image, Pixels};
use picture::jpeg::encode_within;
use picture::shrink::{Region, block, shrink, shrink_rows};
use picture::stretch::{Curve, Look};
use picture::tile::{Scaling, highest_level, tile};

use super::file::damaged;
use super::found::Shelf;
use super::refused;

/// A frame of more pixels is not decoded: some 1.3 GB with its file.
const MOST_DECODED_PX: u64 = 220_000_000;
/// A frame of more pixels does not stay in memory.
const MOST_REMEMBERED_PX: usize = 40_000_000;
/// The frame that was decoded last is forgotten when nobody asked for it so long.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(30);
/// The bytes of a JPEG: as base64 it still fits into a message.
const MOST_JPEG_BYTES: usize = 2_900_000;

/// Decodes frames, and remembers the last one.
#[derive(Debug, Clone, Default)]
pub struct Decoder {
    last: Arc<Mutex<Option<Remembered>>>,
}

#[derive(Debug)]
struct Remembered {
    version: String,
    used: Instant,
    frame: Arc<DecodedFrame>,
}

/// A frame in memory.
#[derive(Debug)]
pub struct DecodedFrame {
    image: Image,
    scaling: Scaling,
}

impl Decoder {
    /// The pixels of a frame. Called by one thread at a time, so that one frame is decoded once.
    pub fn of(&self, shelf: &Shelf, details: &FrameDetails) -> Result<Arc<DecodedFrame>, ArchiveRefusal> {
        let opened = shelf.open(details)?;
        let version = format!("{} {}", details.frame.id, opened.version);
        if let Some(last) = self.lock().as_mut().filter(|last| last.version == version) {
            last.used = Instant::now();
            return Ok(last.frame.clone());
        }
        let pixels = u64::from(details.frame.width_px) * u64::from(details.frame.height_px);
        if pixels > MOST_DECODED_PX {
            let detail = format!("the frame has {pixels} px; at most {MOST_DECODED_PX} are shown. Fetch its file");
            return Err(refused(NotGiven::TooLarge, detail));
        }
        // Before a new one comes into memory the old one goes.
        *self.lock() = None;
        let image = fits::read(&opened.path).map_err(|error| damaged(&opened.name, &error))?;
        let scaling = Scaling::of(view(&image).pixels);
        let frame = Arc::new(DecodedFrame { image, scaling });
        if frame.image.pixels.len() <= MOST_REMEMBERED_PX {
            *self.lock() = Some(Remembered { version, used: Instant::now(), frame: frame.clone() });
        }
        Ok(frame)
    }

    /// A JPEG of a frame: from its rows where the file has them as they are, so that it needs little memory.
    pub fn picture(
        &self,
        shelf: &Shelf,
        details: &FrameDetails,
        wanted: &PictureWanted,
    ) -> Result<FramePicture, ArchiveRefusal> {
        let look = look(wanted)?;
        let longest = wanted.longest_px as usize;
        let opened = shelf.open(details)?;
        let unreadable = |error| damaged(&opened.name, &error);
        let small = match Rows::open(&opened.path).map_err(unreadable)? {
            Some(mut rows) => {
                let size = (rows.width_px, rows.height_px);
                shrink_rows(size, block(size.0, size.1, longest), |most, into| rows.read(most, into))
                    .map_err(unreadable)?
            }
            None => {
                let decoded = self.of(shelf, details)?;
                let frame = view(&decoded.image);
                let whole = Region { x: 0, y: 0, width: frame.width, height: frame.height };
                shrink(frame, whole, block(frame.width, frame.height, longest))
            }
        };
        let bytes = encode_within(&small, look, MOST_JPEG_BYTES)
            .map_err(|error| refused(NotGiven::TooLarge, error.to_string()))?;
        Ok(FramePicture { width_px: small.width as u32, height_px: small.height as u32, bytes: Base64(bytes) })
    }

    /// Forgets the last frame when it was not used for a while.
    pub fn forget_later(&self) {
        let last = Arc::downgrade(&self.last);
        tokio::spawn(async move {
            tokio::time::sleep(FORGOTTEN_AFTER).await;
            if let Some(last) = last.upgrade() {
                let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
                if last.as_ref().is_some_and(|last| last.used.elapsed() >= FORGOTTEN_AFTER) {
                    *last = None;
                }
            }
        });
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Option<Remembered>> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn view(image: &Image) -> picture::Frame<'_> {
    let pixels = match &image.pixels {
        Pixels::U16(counts) => picture::Pixels::Counts(counts),
        Pixels::F32(values) => picture::Pixels::Values(values),
    };
    picture::Frame { width: image.width_px, height: image.height_px, pixels }
}

impl DecodedFrame {
    /// A tile by its level, column and row.
    pub fn tile(&self, place: (u32, u32, u32)) -> Result<FrameTile, ArchiveRefusal> {
        let frame = view(&self.image);
        let highest_z = highest_level(frame, TILE_PX as usize);
        let Some(tile) = tile(frame, self.scaling, TILE_PX as usize, place) else {
            let (z, x, y) = place;
            let detail = format!(
                "the frame of {} x {} px has no tile {z}/{x}/{y}: z is 0 to {highest_z}, and a tile has {TILE_PX} x {TILE_PX} px",
                frame.width, frame.height
            );
            return Err(refused(NotGiven::OutOfRange, detail));
        };
        let bytes = tile.numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        Ok(FrameTile {
            width_px: tile.width as u32,
            height_px: tile.height as u32,
            zero: tile.scaling.zero,
            scale: tile.scaling.scale,
            blank: tile.scaling.blank,
            highest_z,
            bytes: Base64(bytes),
        })
    }

    /// Values of pixels.
    pub fn values(&self, (x, y): (u32, u32), (width_px, height_px): (u32, u32)) -> Result<FramePixels, ArchiveRefusal> {
        let frame = view(&self.image);
        let count = u64::from(width_px) * u64::from(height_px);
        if count == 0 || count > MOST_PIXELS {
            let detail = format!("{width_px} x {height_px} values were asked for; expected 1 to {MOST_PIXELS}");
            return Err(refused(NotGiven::OutOfRange, detail));
        }
        let is_within = |at: u32, length: u32, whole: usize| u64::from(at) + u64::from(length) <= whole as u64;
        if !is_within(x, width_px, frame.width) || !is_within(y, height_px, frame.height) {
            let detail = format!(
                "the frame has {} x {} px; columns {x} to {} and rows {y} to {} are not all within",
                frame.width,
                frame.height,
                u64::from(x) + u64::from(width_px) - 1,
                u64::from(y) + u64::from(height_px) - 1
            );
            return Err(refused(NotGiven::OutOfRange, detail));
        }
        let region = Region { x: x as usize, y: y as usize, width: width_px as usize, height: height_px as usize };
        let values = shrink(frame, region, 1).pixels;
        let values = values.into_iter().map(|value| value.is_finite().then_some(value)).collect();
        Ok(FramePixels { x, y, width_px, height_px, values })
    }
}

fn look(wanted: &PictureWanted) -> Result<Look, ArchiveRefusal> {
    if !(LEAST_PICTURE_PX..=MOST_PICTURE_PX).contains(&wanted.longest_px) {
        let detail =
            format!("a longest side of {} px; expected {LEAST_PICTURE_PX} to {MOST_PICTURE_PX}", wanted.longest_px);
        return Err(refused(NotGiven::OutOfRange, detail));
    }
    let limits = [wanted.low_adu, wanted.high_adu];
    let is_number = |limit: &f64| (*limit as f32).is_finite();
    let is_order = match limits {
        [Some(low), Some(high)] => low < high,
        _ => true,
    };
    if !limits.iter().flatten().all(is_number) || !is_order {
        let detail = format!(
            "black at {:?} and white at {:?}; expected numbers, the first below the second",
            limits[0], limits[1]
        );
        return Err(refused(NotGiven::OutOfRange, detail));
    }
    let curve = match wanted.stretch {
        Stretch::Asinh => Curve::Asinh,
        Stretch::Zscale => Curve::Zscale,
        Stretch::Linear => Curve::Linear,
        Stretch::Sqrt => Curve::Sqrt,
        Stretch::Log => Curve::Log,
    };
    let [low, high] = limits.map(|limit| limit.map(|limit| limit as f32));
    Ok(Look { curve, low, high, inverted: wanted.inverted })
}
