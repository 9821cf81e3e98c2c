//! Measures how long the validation of 500 rows takes: `cargo run --release -p schedule --example validates_500_rows`.
//!
//! Half of the rows follow each other through one night, the other half may run all night long, which is the most that
//! visibility has to look at. The goal is less than 50 ms.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use schedule::validate::{KnownFacts, validate};
use units::Utc;

const SITE: &str = concat!(
    include_str!("../../config/tests/paranal.toml"),
    r#"[schedule.check]
altitude_min_deg = 20.0
[[telescope]]
name = "mount"
server = "10.0.0.5:11111"
horizon = [[0, 10], [90, 45], [200, 12], [225, 55], [250, 12]]
[[camera]]
name = "main"
server = "10.0.0.5:11111"
[[filterwheel]]
name = "wheel"
server = "10.0.0.5:11111"
filters = ["B", "V", "R"]
"#
);

fn schedule() -> anyhow::Result<String> {
    let dusk: Utc = "2026-11-21T00:30:00Z".parse()?;
    let night_s = 8.0 * 3600.0;
    let rows = (0..500).map(|number| {
        let (share, is_queued) = (f64::from(number) / 500.0, number % 2 == 1);
        let (start, end) = match is_queued {
            true => (dusk, dusk.plus_seconds(night_s)),
            false => (dusk.plus_seconds(share * night_s), dusk.plus_seconds(share * night_s + 100.0)),
        };
        let (ra_deg, dec_deg) = (15.0 * (8.0 * share), -60.0 + f64::from(number % 80));
        format!(
            "{{\"device_name\": \"main\", \"action_type\": \"object\", \"action_value\": {{\"object\": \"t{number}\", \
             \"exptime\": 10, \"ra\": {ra_deg:.4}, \"dec\": {dec_deg}, \"filter\": \"V\", \"n\": 2, \"guiding\": true}}, \
             \"start_time\": \"{start}\", \"end_time\": \"{end}\"}}\n"
        )
    });
    Ok(rows.collect())
}

fn main() -> anyhow::Result<()> {
    let (text, config) = (schedule()?, Arc::new(config::parse(SITE, Path::new("."))?));
    let mut took_ms = Vec::new();
    let mut report = String::new();
    for _ in 0..20 {
        let begun = Instant::now();
        let found = validate(&text, &KnownFacts::of(config.clone()));
        took_ms.push(1000.0 * begun.elapsed().as_secs_f64());
        anyhow::ensure!(found.rows == 500 && found.valid, "{found:?}");
        report = format!("{} warnings", found.warnings);
    }
    took_ms.sort_by(f64::total_cmp);
    let (median_ms, worst_ms) = (took_ms[took_ms.len() / 2], took_ms[took_ms.len() - 1]);
    println!("500 rows, {} bytes, {report}: median {median_ms:.1} ms, worst of 20 {worst_ms:.1} ms", text.len());
    anyhow::ensure!(cfg!(debug_assertions) || median_ms < 50.0, "expected less than 50 ms in release");
    Ok(())
}
