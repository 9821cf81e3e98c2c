//! How long a piece of work takes, for the benchmarks of this folder.

use std::time::Instant;

/// Wall times of so many runs, ms, the shortest first.
pub fn times_ms<T>(runs: usize, work: impl Fn() -> T) -> Vec<f64> {
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let started = Instant::now();
            std::hint::black_box(work());
            started.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times
}
