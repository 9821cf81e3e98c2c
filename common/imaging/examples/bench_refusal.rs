//! How long a hopeless frame takes until it is refused: `cargo run --release -p imaging --example bench_refusal [LISTS]`.
//!
//! Random star lists of 30 to 500 stars, and true fields whose hinted place is two fields off and is looked for no further
//! than one, both with a hint of place and scale as `starmesh solve` gives it (other scales tried, up to 8 deg around).
//! Processor time; nothing may be accepted at a wrong place.

#[path = "../tests/drawn/mod.rs"]
mod drawn;

use imaging::solve;
use imaging::solve::at_epoch;
use rand::{RngExt, SeedableRng, rngs::StdRng};

use drawn::{DrawnFrame, EPOCHS, Kind, PLAIN, draw, star};

/// Stars that have nothing to do with the sky behind them.
fn scattered(mut frame: DrawnFrame, count: usize, seed: u64) -> DrawnFrame {
    let mut rng = StdRng::seed_from_u64(seed);
    let (width, height) = (frame.shape.0 as f64 - 1.0, frame.shape.1 as f64 - 1.0);
    frame.stars = (0..count)
        .map(|_| {
            let flux = 10_f64.powf(rng.random_range(2.0..5.0));
            star(rng.random_range(0.0..width), rng.random_range(0.0..height), flux, 0.1)
        })
        .collect();
    frame
}

/// Processor time of this process so far, ms: a busy machine does not count.
fn processor_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|nanoseconds| nanoseconds.parse().ok()).map_or(f64::NAN, |ns: f64| ns * 1e-6)
}

fn main() -> anyhow::Result<()> {
    let lists: u64 = std::env::args().nth(1).map_or(Ok(10), |count| count.parse())?;
    println!("{lists} lists each                      median CPU ms  worst CPU ms     solved   wrong");
    for (name, furthest_deg, tolerance) in
        [("8 deg around", 8.0, 0.05), ("one field", 0.0, 0.05), ("8 deg, 2 %", 8.0, 0.02)]
    {
        for stars in [30, 60, 120, 500] {
            for random in [true, false] {
                let kind = Kind { field_deg: (0.2, 2.0), stars: (stars, stars), offset_fields: 2.0, ..PLAIN };
                let (mut times, mut solved, mut wrong) = (Vec::new(), 0, 0);
                for seed in 0..lists {
                    let mut frame = draw(&kind, 30_000 + seed);
                    if random {
                        frame = scattered(frame, stars, seed);
                    }
                    frame.hint.furthest = drawn::deg(furthest_deg);
                    frame.hint.wrong_scales = true;
                    frame.hint.scale_tolerance = tolerance;
                    let source = at_epoch(&frame.catalogue, EPOCHS.1);
                    let started = processor_ms();
                    let answer = std::hint::black_box(solve(&frame.detected(), &frame.hint, &source));
                    times.push(processor_ms() - started);
                    if std::env::var_os("DEBUG").is_some() {
                        println!(
                            "{:.0} ms {:?}",
                            processor_ms() - started,
                            answer.as_ref().map(|s| (s.level, s.hypotheses)).map_err(|e| e.to_string())
                        );
                    }
                    if let Ok(solution) = answer {
                        solved += 1;
                        wrong += u32::from(random || frame.errors_px(&solution.wcs).0 > 1.0);
                    }
                }
                times.sort_by(f64::total_cmp);
                let kind = if random { "random" } else { "2 fields off" };
                println!(
                    "{name:>13}, {stars:>3} stars, {kind:>12}: {:>9.0} {:>13.0} {solved:>10} {wrong:>7}",
                    times.get(times.len() / 2).copied().unwrap_or_default(),
                    times.last().copied().unwrap_or_default(),
                );
            }
        }
    }
    Ok(())
}
