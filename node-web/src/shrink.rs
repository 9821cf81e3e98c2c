//! Shrinking a frame while its bytes arrive: a big sensor never lies in memory as a whole.

use contract::device::camera::Pixel;
use picture::Small;

/// Averages blocks of pixels; fed with the bytes of a frame as they come.
#[derive(Debug)]
pub struct Shrink {
    width: usize,
    height: usize,
    pixel: Pixel,
    block: usize,
    sums: Vec<f64>,
    counts: Vec<u32>,
    next: usize,
    left_over: Vec<u8>,
}

impl Shrink {
    /// For a frame of so many columns and rows, to at most `limit` pixels a side.
    pub fn new(width: usize, height: usize, pixel: Pixel, limit: usize) -> Self {
        let block = width.max(height).div_ceil(limit.max(1)).max(1);
        let size = width.div_ceil(block) * height.div_ceil(block);
        Self {
            width,
            height,
            pixel,
            block,
            sums: vec![0.0; size],
            counts: vec![0; size],
            next: 0,
            left_over: Vec::new(),
        }
    }

    /// Takes the next bytes; those beyond the first plane are ignored.
    pub fn take(&mut self, mut bytes: &[u8]) {
        let size = self.pixel.bytes();
        if !self.left_over.is_empty() {
            let (head, tail) = bytes.split_at(bytes.len().min(size - self.left_over.len()));
            self.left_over.extend_from_slice(head);
            bytes = tail;
            if self.left_over.len() < size {
                return;
            }
            let whole = std::mem::take(&mut self.left_over);
            self.take_whole(&whole);
        }
        let whole = bytes.len() / size * size;
        self.take_whole(&bytes[..whole]);
        self.left_over.extend_from_slice(&bytes[whole..]);
    }

    /// The picture; `None` when fewer bytes came than the frame has.
    pub fn finish(self) -> Option<Small> {
        if self.next < self.width * self.height {
            return None;
        }
        let mean = |(sum, count): (&f64, &u32)| if *count == 0 { f32::NAN } else { (sum / f64::from(*count)) as f32 };
        Some(Small {
            width: self.width.div_ceil(self.block),
            height: self.height.div_ceil(self.block),
            pixels: self.sums.iter().zip(&self.counts).map(mean).collect(),
        })
    }

    fn take_whole(&mut self, bytes: &[u8]) {
        match self.pixel {
            Pixel::U16 => self.add(bytes.as_chunks().0.iter().map(|b| f64::from(u16::from_le_bytes(*b)))),
            Pixel::I32 => self.add(bytes.as_chunks().0.iter().map(|b| f64::from(i32::from_le_bytes(*b)))),
            Pixel::F64 => self.add(bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b))),
        }
    }

    fn add(&mut self, values: impl Iterator<Item = f64>) {
        let columns = self.width.div_ceil(self.block);
        let (mut x, mut y) = (self.next % self.width.max(1), self.next / self.width.max(1));
        for value in values {
            if y >= self.height {
                break;
            }
            if value.is_finite() {
                let at = y / self.block * columns + x / self.block;
                self.sums[at] += value;
                self.counts[at] += 1;
            }
            self.next += 1;
            x += 1;
            if x == self.width {
                (x, y) = (0, y + 1);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(pixels: &[u16]) -> Vec<u8> {
        pixels.iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    #[test]
    fn blocks_are_averaged_and_the_edge_block_is_smaller() {
        let mut shrink = Shrink::new(3, 2, Pixel::U16, 2);
        shrink.take(&bytes(&[1, 3, 10, 5, 7, 30]));
        assert_eq!(shrink.finish(), Some(Small { width: 2, height: 1, pixels: vec![4.0, 20.0] }));
    }

    #[test]
    fn bytes_may_come_in_any_portions() {
        let all = bytes(&(0..35).collect::<Vec<u16>>());
        let mut whole = Shrink::new(7, 5, Pixel::U16, 3);
        whole.take(&all);
        let mut one_by_one = Shrink::new(7, 5, Pixel::U16, 3);
        all.iter().for_each(|byte| one_by_one.take(std::slice::from_ref(byte)));
        assert_eq!(whole.finish(), one_by_one.finish());
    }

    #[test]
    fn a_frame_cut_short_is_no_picture_and_further_planes_are_ignored() {
        let mut short = Shrink::new(2, 2, Pixel::U16, 8);
        short.take(&bytes(&[1, 2, 3]));
        assert_eq!(short.finish(), None);
        let mut colour = Shrink::new(1, 1, Pixel::U16, 8);
        colour.take(&bytes(&[5, 600, 700]));
        assert_eq!(colour.finish().unwrap().pixels, [5.0]);
    }

    #[test]
    fn a_pixel_that_is_no_number_does_not_spoil_its_block() {
        let mut shrink = Shrink::new(2, 1, Pixel::F64, 1);
        shrink.take(&[f64::NAN.to_le_bytes(), 4.0f64.to_le_bytes()].concat());
        assert_eq!(shrink.finish().unwrap().pixels, [4.0]);
    }
}
