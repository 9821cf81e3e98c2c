//! A camera's image as rows of pixels, and its shape.

use contract::device::camera::Pixel;

/// More pixels than any camera has; a larger declaration is an error.
pub const MAX_PIXELS: u64 = 512 << 20;

/// Pixels in the order of the contract: rows one after another from the first, plane after plane, little endian.
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
        // In square blocks, so that both sides stay in the cache.
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
