//! The sums of an HDU: DATASUM and CHECKSUM (FITS Standard 4.0, section 4.4.2.7 and appendix J).

/// The 32 bits of a sum whose HDU is whole: CHECKSUM makes all words of an HDU add up to this.
pub const WHOLE: u32 = u32::MAX;

/// Ones' complement sum of 32-bit words, most significant byte first; the bytes are whole words.
pub fn sum(bytes: &[u8]) -> u32 {
    bytes.as_chunks().0.iter().fold(0, |total, word| add(total, u32::from_be_bytes(*word)))
}

/// Ones' complement sum of two sums: what overflows is added at the low end.
pub fn add(a: u32, b: u32) -> u32 {
    let (sum, carried) = a.overflowing_add(b);
    sum + u32::from(carried)
}

/// The 16 letters and digits of a checksum, whose own sum, where CHECKSUM stands, is `value`.
pub fn encode(value: u32) -> String {
    let mut text = [0; 16];
    for (place, byte) in value.to_be_bytes().into_iter().enumerate() {
        // Four characters that add up to the byte and four times '0'.
        let mut four = [byte / 4 + b'0'; 4];
        four[0] += byte % 4;
        // Adjacent characters move apart until no punctuation is left between digits, capitals and small letters.
        while four.iter().any(|c| (0x3a..=0x40).contains(c) || (0x5b..=0x60).contains(c)) {
            for pair in four.as_chunks_mut::<2>().0 {
                if pair.iter().any(|c| (0x3a..=0x40).contains(c) || (0x5b..=0x60).contains(c)) {
                    pair[0] += 1;
                    pair[1] -= 1;
                }
            }
        }
        for (row, c) in four.into_iter().enumerate() {
            // The text begins at the card's column 12, the last of a word, so all moves one to the right.
            text[(row * 4 + place + 1) % 16] = c;
        }
    }
    text.iter().map(|c| char::from(*c)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sum_is_written_as_letters_and_digits_that_add_up_to_it() {
        // The example of the FITS standard 4.0, appendix J.
        assert_eq!(encode(!868_229_149), "hcHjjc9ghcEghc9g");
        for value in [0, 1, 0x0a0b_0c0d, 0x7fff_ffff, 0xdead_beef, u32::MAX] {
            let text = encode(value);
            assert!(text.bytes().all(|c| c.is_ascii_alphanumeric()), "{text}");
            let mut turned = text.into_bytes();
            turned.rotate_left(1);
            let zeros = sum(&[b'0'; 16]);
            let total = add(sum(&turned), !zeros);
            assert!(total == value || (total == u32::MAX && value == 0), "{total:x} for {value:x}");
        }
    }

    #[test]
    fn every_byte_in_every_place_is_written_in_letters_and_digits() {
        let zeros = sum(&[b'0'; 16]);
        for byte in 0..=u8::MAX {
            for place in 0..4 {
                for rest in [0, byte, u8::MAX] {
                    let mut bytes = [rest; 4];
                    bytes[place] = byte;
                    let value = u32::from_be_bytes(bytes);
                    let mut turned = encode(value).into_bytes();
                    assert!(turned.len() == 16 && turned.iter().all(u8::is_ascii_alphanumeric), "{value:x}");
                    turned.rotate_left(1);
                    let total = add(sum(&turned), !zeros);
                    assert!(total == value || (total == WHOLE && value == 0), "{total:x} for {value:x}");
                }
            }
        }
    }

    #[test]
    fn a_sum_is_the_same_in_whatever_pieces_it_is_made() {
        let bytes: Vec<u8> = (0..4000_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 23) as u8).collect();
        let whole = sum(&bytes);
        for piece in [4, 8, 36, 1000, 2880, 4000] {
            let forward = bytes.chunks(piece).fold(0, |total, part| add(total, sum(part)));
            let backward = bytes.chunks(piece).rev().fold(0, |total, part| add(total, sum(part)));
            assert_eq!((forward, backward), (whole, whole), "{piece}");
        }
        // What overflows comes back at the low end, so that a lost bit is seen.
        assert_eq!((add(WHOLE, 1), add(WHOLE, WHOLE), add(1 << 31, 1 << 31), add(0, 0)), (1, WHOLE, 1, 0));
        assert_eq!(sum(&[]), 0);
    }
}
