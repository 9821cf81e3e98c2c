//! How long a hinted solve takes after detection: `cargo run --release -p imaging --example bench_solve [FIELDS]`.
//!
//! Draws star lists of random fields (0.2 to 2 deg, any rotation and parity, 2048 x 2048 px, 12 to 30 real stars with
//! centroid errors of 0.1 px, a catalogue three times as deep that lacks 5 % of them, the place wrong by up to half a
//! field and the scale by up to 2 %) with a share of false detections added, and prints the time on one thread (best of
//! five runs of each field: what a free core needs) and the share of right answers (centre within 1 px). "learned"
//! knows rotation, scale and parity (level 0), "hinted" the place and the scale (level 1).

#[path = "../tests/drawn/mod.rs"]
mod drawn;

use std::time::Instant;

use imaging::solve;
use imaging::solve::at_epoch;

use drawn::{EPOCHS, Kind, PLAIN, draw};

const RUNS: usize = 5;

fn main() -> anyhow::Result<()> {
    let fields = std::env::args().nth(1).map_or(Ok(300), |count| count.parse())?;
    println!("{fields} fields each; asked for: 10 ms, 99 % right at 60 % spurious (predecessor: 265-330 ms)");
    println!("           spurious   median ms   p99 ms   right %   wrong %");
    for (name, learned) in [("learned", true), ("hinted", false)] {
        for spurious in [0.0, 0.3, 0.6] {
            let kind = Kind { field_deg: (0.2, 2.0), stars: (12, 30), offset_fields: 0.5, learned, spurious, ..PLAIN };
            let (mut times, mut right, mut wrong) = (Vec::new(), 0, 0);
            for seed in 0..fields {
                let frame = draw(&kind, 10_000 + seed);
                let source = at_epoch(&frame.catalogue, EPOCHS.1);
                let mut best_ms = f64::INFINITY;
                let mut answer = None;
                for _ in 0..RUNS {
                    let started = Instant::now();
                    answer = std::hint::black_box(solve(&frame.detected(), &frame.hint, &source)).ok();
                    best_ms = best_ms.min(started.elapsed().as_secs_f64() * 1e3);
                }
                times.push(best_ms);
                if let Some(solution) = answer {
                    let good = frame.errors_px(&solution.wcs).0 < 1.0;
                    right += u32::from(good);
                    wrong += u32::from(!good);
                }
            }
            times.sort_by(f64::total_cmp);
            let share = |count: u32| 100.0 * f64::from(count) / fields as f64;
            println!(
                "{name:>10} {:>7.0} % {:>11.2} {:>8.2} {:>9.1} {:>9.1}",
                100.0 * spurious,
                times[times.len() / 2],
                times[times.len() * 99 / 100],
                share(right),
                share(wrong),
            );
        }
    }
    Ok(())
}
