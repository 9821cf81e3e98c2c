//! A camera's image: as it comes over the wire, and as rows of pixels.

use contract::device::camera::Pixel;
use reqwest::Response;
use reqwest::header::CONTENT_TYPE;

use super::client::read_capped;
use super::image_bytes::{self, Header};
use super::transaction::{Echo, Transactions};
use super::{AlpacaError, image_json, response};

/// More pixels than any camera has; a larger declaration is an error.
pub const MAX_PIXELS: u64 = 512 << 20;

/// Pixels as the contract wants them: rows one after another from the first, plane after plane, little endian.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Colour planes.
    pub planes: u32,
    /// Type of a pixel.
    pub pixel: Pixel,
    /// The pixels.
    pub bytes: Vec<u8>,
}

/// An image as the camera sent it, checked as far as is quick.
#[derive(Debug)]
pub enum RawImage {
    /// ImageBytes: a binary header and column-wise elements.
    Binary {
        /// Its header.
        header: Header,
        /// The whole body, header included.
        body: Vec<u8>,
    },
    /// JSON `imagearray`.
    Json(Vec<u8>),
}

impl RawImage {
    /// Receives the answer to request `asked` for `imagearray`.
    pub(super) async fn receive(
        mut response: Response,
        pixels: u64,
        transactions: &Transactions,
        asked: u32,
    ) -> Result<Self, AlpacaError> {
        let status = response.status().as_u16();
        let kind = response.headers().get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
        if !kind.to_ascii_lowercase().contains("imagebytes") || status != 200 {
            // 12 digits and commas a pixel, and room for an error in words
            let cap = usize::try_from(pixels.saturating_mul(12)).unwrap_or(usize::MAX).clamp(1 << 20, 4 << 30);
            let body = read_capped(response, cap).await?;
            if status != 200 || body.len() < 4096 {
                // an error, or an image so small that reading it twice costs nothing
                response::parse(status, &body, transactions, asked)?;
            }
            return Ok(Self::Json(body));
        }
        let mut body = Vec::new();
        let mut header = None;
        while let Some(chunk) = response.chunk().await.map_err(|error| AlpacaError::from_http(&error))? {
            body.extend_from_slice(&chunk);
            if header.is_none() && body.len() >= image_bytes::HEADER {
                let read = Header::read(&body).map_err(AlpacaError::Protocol)?;
                transactions.check(asked, &Echo::Number(i64::from(read.client_transaction)))?;
                body.reserve_exact(read.bytes().saturating_sub(body.len()));
                header = Some(read);
            }
            let cap = header.as_ref().map_or(1 << 20, Header::bytes) + (64 << 10);
            if body.len() > cap {
                return Err(AlpacaError::Protocol(format!("the image is longer than its header says, {cap} bytes")));
            }
        }
        let header = header.ok_or_else(|| AlpacaError::Protocol("the image ends within its header".to_owned()))?;
        if header.error_number != 0 {
            return Err(header.error(&body));
        }
        if body.len() < header.bytes() {
            let (have, want) = (body.len(), header.bytes());
            return Err(AlpacaError::Protocol(format!("the image has {have} of {want} bytes")));
        }
        Ok(Self::Binary { header, body })
    }

    /// Columns and rows, where they are known before decoding.
    pub fn size_px(&self) -> Option<(u32, u32)> {
        match self {
            Self::Binary { header, .. } => Some(header.size_px()),
            Self::Json(_) => None,
        }
    }

    /// Turns it into rows; heavy, so not for an async thread. `max_adu` decides whether 16 bits are enough.
    pub fn into_image(self, max_adu: Option<f64>) -> Result<Image, AlpacaError> {
        match self {
            Self::Binary { header, body } => image_bytes::decode(&header, &body, max_adu),
            Self::Json(body) => image_json::decode(&body, max_adu),
        }
        .map_err(AlpacaError::Protocol)
    }
}

/// Shape of an image: columns, rows, planes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Colour planes.
    pub planes: usize,
}

impl Shape {
    /// From declared dimensions; `planes` is 1 for a plain image.
    pub fn new(dimensions: [i64; 3]) -> Result<Self, String> {
        let mut pixels: u64 = 1;
        for size in dimensions {
            let size = u64::try_from(size).ok().filter(|size| *size > 0);
            let product = size.and_then(|size| pixels.checked_mul(size));
            pixels = product
                .filter(|pixels| *pixels <= MAX_PIXELS)
                .ok_or_else(|| format!("dimensions {dimensions:?}: expected 1 to {MAX_PIXELS} pixels"))?;
        }
        let [width, height, planes] = dimensions.map(|size| size as usize);
        Ok(Self { width, height, planes })
    }

    /// Pixels of all planes.
    pub fn pixels(self) -> usize {
        self.width * self.height * self.planes
    }

    /// Type that keeps whole numbers of this range without loss, in the fewest bytes that the archive knows.
    pub fn pixel_for(range: (i64, i64), sixteen_bits: bool) -> Pixel {
        match range {
            (low, high) if sixteen_bits && low >= 0 && high <= i64::from(u16::MAX) => Pixel::U16,
            (low, high) if low >= i64::from(i32::MIN) && high <= i64::from(i32::MAX) => Pixel::I32,
            _ => Pixel::F64,
        }
    }

    /// Writes rows from ASCOM's order, in which columns follow one another and planes change fastest.
    pub fn rows<const N: usize>(self, element: impl Fn(usize) -> [u8; N]) -> Vec<u8> {
        let Self { width, height, planes } = self;
        let mut rows = vec![0; self.pixels() * N];
        // in square blocks, so that both sides stay in the cache
        const BLOCK: usize = 32;
        for plane in 0..planes {
            for top in (0..height).step_by(BLOCK) {
                for left in (0..width).step_by(BLOCK) {
                    for y in top..(top + BLOCK).min(height) {
                        let row = (plane * height + y) * width;
                        for x in left..(left + BLOCK).min(width) {
                            let value = element((x * height + y) * planes + plane);
                            rows[(row + x) * N..(row + x + 1) * N].copy_from_slice(&value);
                        }
                    }
                }
            }
        }
        rows
    }

    /// An image of this shape.
    pub fn image(self, pixel: Pixel, bytes: Vec<u8>) -> Image {
        let [width_px, height_px, planes] = [self.width, self.height, self.planes].map(|size| size as u32);
        Image { width_px, height_px, planes, pixel, bytes }
    }
}
