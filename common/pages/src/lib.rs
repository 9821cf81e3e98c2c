//! Room for whole frames, in large pages of memory where the system has some.
//!
//! The work on a frame of 2048 x 2048 px takes some 30 MB that are new each time. In pages of 4 KiB the system hands them out in
//! 8,000 steps, of up to 5 us each on a virtual machine: a third of the time from a file to its place in the sky
//! (docs/imaging.md, "Time"). In pages of 2 MiB they are 16.

/// What the processors of our machines have as the next larger page, bytes.
#[cfg(target_os = "linux")]
const LARGE: usize = 2 << 20;

/// An empty vector with room for `len` values, to be filled at once. Where there is not so much memory it has none, and what
/// fills it fails.
pub fn with_room<T>(len: usize) -> Vec<T> {
    let mut room = Vec::new();
    if room.try_reserve_exact(len).is_ok() {
        ask(&room);
    }
    room
}

/// A vector of all these values.
pub fn collect<T>(values: impl ExactSizeIterator<Item = T>) -> Vec<T> {
    let mut all = with_room(values.len());
    all.extend(values);
    all
}

/// So many zeros.
pub fn zeros(len: usize) -> Vec<f32> {
    // new memory is zero without being written to
    let zeros = vec![0.0; len];
    ask(&zeros);
    zeros
}

/// Asks for large pages below a vector. Nothing depends on the answer: the system may have none, or a page may be in use as a
/// small one already.
#[cfg(target_os = "linux")]
#[allow(unsafe_code, reason = "the standard library does not speak of pages")]
fn ask<T>(room: &Vec<T>) {
    let (start, bytes) = (room.as_ptr().addr(), room.capacity().saturating_mul(size_of::<T>()));
    let skip = start.next_multiple_of(LARGE) - start;
    let whole = bytes.saturating_sub(skip) / LARGE * LARGE;
    if whole > 0 {
        let first = room.as_ptr().cast::<u8>().wrapping_add(skip).cast_mut();
        // SAFETY: the range lies within the vector's own memory, and MADV_HUGEPAGE changes neither its content nor its place.
        unsafe { libc::madvise(first.cast(), whole, libc::MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn ask<T>(_: &Vec<T>) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_of_any_size_has_the_requested_size() {
        for len in [0, 1, 511, 1 << 19, (1 << 20) + 3, 5_000_001] {
            let zeros = zeros(len);
            assert!(zeros.len() == len && zeros.iter().all(|value| *value == 0.0));
            let room = with_room::<u16>(len);
            assert!(room.is_empty() && room.capacity() >= len);
            let all = collect((0..len).map(|n| n as u16));
            assert!(all.len() == len && all.iter().enumerate().all(|(n, value)| *value == n as u16));
        }
        assert_eq!(with_room::<u64>(usize::MAX).capacity(), 0, "no such memory, and no panic");
        // nothing to ask for below values without a size
        assert_eq!(with_room::<()>(7).len(), 0);
    }
}
