//! Work on bands of rows, one thread per core.
//!
//! Threads are scoped and live for one call: no pool, nothing shared that is written.

use std::ops::Range;
use std::thread;

/// More threads than this gain nothing: memory is the limit by then.
const MOST: usize = 8;
/// A band smaller than this is not worth a thread's start (some 20 us).
const FEWEST_PIXELS: usize = 1 << 16;

/// How many threads a frame of `pixels` is worth.
fn threads(pixels: usize) -> usize {
    let worth = (pixels / FEWEST_PIXELS).min(MOST);
    // the system reads files to count the cores: small frames do without
    if worth <= 1 { 1 } else { thread::available_parallelism().map_or(1, usize::from).min(worth) }
}

/// Cuts the rows of `image` into bands and lets `work(first_row, band)` change them; answers in order of the rows.
pub(crate) fn bands_mut<T: Send>(
    image: &mut [f32],
    width: usize,
    work: impl Fn(usize, &mut [f32]) -> T + Sync,
) -> Vec<T> {
    let rows = image.len() / width;
    let per_band = rows.div_ceil(threads(image.len())).max(1);
    let bands = image.chunks_mut(per_band * width).enumerate();
    all(bands.map(|(n, band)| (n * per_band, band)), |(first, band)| work(first, band))
}

/// Cuts `0..count` into ranges, each worth `weight` pixels per item; answers in order.
pub(crate) fn ranges<T: Send>(count: usize, weight: usize, work: impl Fn(Range<usize>) -> T + Sync) -> Vec<T> {
    let per_range = count.div_ceil(threads(count.saturating_mul(weight))).max(1);
    let starts = (0..count).step_by(per_range);
    all(starts.map(|first| first..count.min(first + per_range)), work)
}

fn all<I: Send, T: Send>(items: impl Iterator<Item = I>, work: impl Fn(I) -> T + Sync) -> Vec<T> {
    let items: Vec<I> = items.collect();
    if items.len() <= 1 {
        return items.into_iter().map(work).collect();
    }
    let work = &work;
    thread::scope(|scope| {
        let started: Vec<_> = items.into_iter().map(|item| scope.spawn(move || work(item))).collect();
        started.into_iter().map(|band| band.join().unwrap_or_else(|cause| std::panic::resume_unwind(cause))).collect()
    })
}

/// The greatest of the values, taking NaN for none; in eight lanes, which the compiler keeps in vector registers.
pub(crate) fn highest(values: &[f32]) -> f32 {
    let mut lanes = [f32::NEG_INFINITY; 8];
    let (eights, rest) = values.as_chunks::<8>();
    for eight in eights {
        lanes.iter_mut().zip(eight).for_each(|(lane, value)| *lane = if *value > *lane { *value } else { *lane });
    }
    lanes.iter().chain(rest).fold(f32::NEG_INFINITY, |most, value| if *value > most { *value } else { most })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_worked_on_once_and_answers_stand_in_order() {
        let (width, rows) = (1000, 777);
        let mut image = vec![0.0; width * rows];
        let first_rows = bands_mut(&mut image, width, |first, band| {
            for (row, pixels) in band.chunks_mut(width).enumerate() {
                pixels.iter_mut().for_each(|p| *p += (first + row) as f32);
            }
            first
        });
        assert!(first_rows.is_sorted());
        assert!(image.chunks(width).enumerate().all(|(row, pixels)| pixels.iter().all(|p| *p == row as f32)));
        let covered: Vec<usize> = ranges(777, 1000, |range| range).into_iter().flatten().collect();
        assert_eq!(covered, (0..777).collect::<Vec<_>>());
        assert!(ranges(0, 10, |range| range).is_empty());
    }
}
