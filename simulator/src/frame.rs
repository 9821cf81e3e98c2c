//! A finished frame, and how it is sent: as ImageBytes or as JSON.

use bytes::Bytes;
use units::Utc;

/// Pixels of one exposure.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Counts, unsigned 16 bits little-endian, column by column as ASCOM orders arrays: `[x][y]`.
    pub columns: Bytes,
    /// Begin of the exposure.
    pub started: Utc,
    /// Length of the exposure, s.
    pub exposure_s: f64,
    /// Which exposure this is.
    pub number: u64,
}

impl Frame {
    /// The count of a pixel (x = column, y = row).
    pub fn at(&self, x: u32, y: u32) -> u16 {
        let at = 2 * (x as usize * self.height as usize + y as usize);
        u16::from_le_bytes([self.columns[at], self.columns[at + 1]])
    }

    /// ImageBytes version 1: 44 bytes of header, then the pixels; declared Int32, sent as UInt16.
    pub fn image_bytes(&self, client: u32, server: u32) -> Vec<u8> {
        let mut bytes = image_bytes_header(0, client, server, [2, 8, 2], [self.width, self.height]);
        bytes.reserve_exact(self.columns.len());
        bytes.extend_from_slice(&self.columns);
        bytes
    }

    /// The pixels as nested JSON arrays, `[[x0y0, x0y1, ...], ...]`.
    pub fn json(&self) -> String {
        let mut text = String::with_capacity(self.columns.len() * 2 + 16);
        for (x, column) in self.columns.chunks_exact(2 * (self.height as usize).max(1)).enumerate() {
            text.push_str(if x == 0 { "[[" } else { "],[" });
            for (y, pixel) in column.chunks_exact(2).enumerate() {
                if y > 0 {
                    text.push(',');
                }
                push_decimal(&mut text, u16::from_le_bytes([pixel[0], pixel[1]]));
            }
        }
        text.push_str("]]");
        text
    }
}

/// An ImageBytes answer that carries an error instead of pixels.
pub fn image_bytes_error(code: i32, message: &str, client: u32, server: u32) -> Vec<u8> {
    let mut bytes = image_bytes_header(code, client, server, [0, 0, 0], [0, 0]);
    bytes.extend_from_slice(message.as_bytes());
    bytes
}

/// `types`: image element type, transmission type, rank.
fn image_bytes_header(error: i32, client: u32, server: u32, types: [i32; 3], size: [u32; 2]) -> Vec<u8> {
    let mut header = Vec::with_capacity(44);
    header.extend(1_i32.to_le_bytes());
    header.extend(error.to_le_bytes());
    header.extend(client.to_le_bytes());
    header.extend(server.to_le_bytes());
    header.extend(44_i32.to_le_bytes());
    header.extend(types.into_iter().flat_map(i32::to_le_bytes));
    header.extend([size[0], size[1], 0].into_iter().flat_map(u32::to_le_bytes));
    header
}

/// Four million numbers per frame: `write!` would take a second of it in a debug build.
fn push_decimal(text: &mut String, number: u16) {
    let mut divisor = 10_000;
    while divisor > 1 && number < divisor {
        divisor /= 10;
    }
    while divisor > 0 {
        text.push(char::from(b'0' + (number / divisor % 10) as u8));
        divisor /= 10;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_and_image_bytes_hold_the_same_pixels() {
        let counts: [u16; 6] = [0, 7, 65_535, 10, 100, 9999];
        let columns = counts.iter().flat_map(|count| count.to_le_bytes()).collect();
        let frame = Frame { width: 2, height: 3, columns, started: Utc::EPOCH, exposure_s: 1.0, number: 1 };
        assert_eq!(frame.json(), "[[0,7,65535],[10,100,9999]]");
        assert_eq!((frame.at(0, 2), frame.at(1, 0)), (65_535, 10));
        let bytes = frame.image_bytes(5, 6);
        assert_eq!(bytes.len(), 44 + 12);
        let word = |at: usize| i32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let words: Vec<i32> = (0..11).map(|n| word(4 * n)).collect();
        assert_eq!(words, [1, 0, 5, 6, 44, 2, 8, 2, 2, 3, 0]);
    }
}
