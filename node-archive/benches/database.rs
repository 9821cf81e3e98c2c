//! How many values a second the database takes, and how fast it draws three days of a year:
//! `cargo bench -p node-archive --bench database`. Needs some 2 GB in the system's folder for temporary files.

#![allow(clippy::unwrap_used, reason = "a benchmark ends by panicking")]

use std::time::Instant;

use bus::Clock;
use contract::archive::{ArchiveQuestion, Ask, SeriesName};
use contract::{Address, Device, Kind, Scalar};
use node::NodeAlerts;
use node_archive::database::{Database, Write};
use node_archive::reader::Reader;
use units::Utc;

const DAY_S: i64 = 86_400;
const PARAMETERS: usize = 12;
const QUERIES: usize = 20;

fn at(second: i64) -> Utc {
    Utc::from_micros((1_767_225_600 + second) * 1_000_000)
}

fn property(number: usize) -> String {
    format!("Parameter{number}")
}

async fn fill(database: &Database, device: &Device, from_s: i64, to_s: i64, every_s: i64) {
    let (began, mut count) = (Instant::now(), 0);
    for second in (from_s..to_s).step_by(every_s as usize) {
        for number in 0..PARAMETERS {
            let value = Ok(Scalar::Float((second % 977) as f64 * 0.125 + number as f64));
            let write = Write::Reading { device: device.clone(), property: property(number), value, at: at(second) };
            database.put(write).await.unwrap();
            count += 1;
        }
    }
    // All that was handed over is committed when this is.
    database.commit(vec![Write::ForgetOld { days: 1000 }]).await.unwrap();
    let took_s = began.elapsed().as_secs_f64();
    println!("{count} values, one each {every_s} s: {took_s:.1} s, {:.0} values/s", f64::from(count) / took_s);
}

#[tokio::main]
async fn main() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("archive.db");
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let device = Address::new("paranal", "callisto").unwrap().device(Kind::ObservingConditions, &"wx".parse().unwrap());
    fill(&database, &device, 0, 362 * DAY_S, 60).await;
    fill(&database, &device, 362 * DAY_S, 365 * DAY_S, 1).await;
    drop(database);
    writer.end().await;
    println!("the database of a year: {:.0} MB", std::fs::metadata(&path).unwrap().len() as f64 / 1e6);
    let properties = (0..PARAMETERS)
        .map(|number| SeriesName {
            kind: Kind::ObservingConditions,
            device: "wx".to_owned(),
            property: property(number),
        })
        .collect();
    for (days, points) in [(3, 1000), (3, 300), (365, 1000)] {
        let ask = Ask::Series { properties: Vec::clone(&properties), points };
        let (from, to) = (at((365 - days) * DAY_S), at(365 * DAY_S));
        let question = ArchiveQuestion { ask, from_utc: Some(from), to_utc: Some(to), limit: None };
        let mut took_ms: Vec<f64> = (0..QUERIES)
            .map(|_| {
                let began = Instant::now();
                let answer = Reader::open(&path, "callisto").unwrap().answer(&question, to).unwrap();
                assert_eq!(answer.rows.len(), PARAMETERS);
                began.elapsed().as_secs_f64() * 1e3
            })
            .collect();
        took_ms.sort_by(f64::total_cmp);
        let (median, slowest) = (took_ms[QUERIES / 2], took_ms[QUERIES - 1]);
        println!(
            "{days} days, {PARAMETERS} parameters, {points} points: median {median:.1} ms, slowest {slowest:.1} ms"
        );
    }
}
