//! Nights of invented telescopes as Parquet files, by the code that writes real ones, to measure how fast engines answer:
//! `cargo run --release -p parquet_nights --example year -- FOLDER TELESCOPES NIGHTS`.
//!
//! Each night has the minutes of a weather station and of a mount, all day long, and 300 frames with their facts. Stars are
//! wider in the wind, by 0.05 arcsec for each m/s.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a generator ends by panicking")]

use std::path::Path;

use parquet_nights::{Cell, PartWriter, Partition, TABLES};

const DAY_US: i64 = 86_400_000_000;
const MINUTE_US: i64 = 60_000_000;
/// Noon of 2026-01-01.
const FIRST_NOON_US: i64 = 1_767_268_800_000_000;
const FRAMES: i64 = 300;
const SCALE_ARCSEC_PX: f64 = 0.35;
const SERIES: [(&str, &str); 20] = [
    ("ObservingConditions", "CloudCover"),
    ("ObservingConditions", "DewPoint"),
    ("ObservingConditions", "Humidity"),
    ("ObservingConditions", "Pressure"),
    ("ObservingConditions", "RainRate"),
    ("ObservingConditions", "SkyBrightness"),
    ("ObservingConditions", "SkyQuality"),
    ("ObservingConditions", "SkyTemperature"),
    ("ObservingConditions", "Temperature"),
    ("ObservingConditions", "WindDirection"),
    ("ObservingConditions", "WindGust"),
    ("ObservingConditions", "WindSpeed"),
    ("Telescope", "Altitude"),
    ("Telescope", "AtPark"),
    ("Telescope", "Azimuth"),
    ("Telescope", "Declination"),
    ("Telescope", "RightAscension"),
    ("Telescope", "SideOfPier"),
    ("Telescope", "Slewing"),
    ("Telescope", "Tracking"),
];

/// A small generator of numbers from 0 to 1, so that every run writes the same files.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Wind of a minute, m/s: slow waves, which differ from telescope to telescope.
fn wind_mps(telescope: i64, at_us: i64) -> f64 {
    let hours = at_us as f64 / 3.6e9;
    6.0 + 3.0 * (hours / 17.0 + telescope as f64).sin() + 3.0 * (hours / 53.0).cos()
}

fn write(partition: &Partition, name: &str, night: &str, rows: &mut dyn Iterator<Item = Vec<(&str, Cell)>>) -> usize {
    let table = TABLES.iter().find(|table| table.name == name).unwrap();
    let path = partition.part(table, night);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let mut writer = PartWriter::create(&path, table, &partition.about(night)).unwrap();
    for row in rows {
        let mut values = row.into_iter().peekable();
        // The values come in the order of the columns; those that are left out have none, or an empty text.
        let cell = |column: &parquet_nights::Column| match values.next_if(|(name, _)| *name == column.name) {
            Some((_, cell)) => cell,
            None if column.required => Cell::text(""),
            None => Cell::Null,
        };
        writer.push(table.columns.iter().map(cell).collect()).unwrap();
        assert!(values.next().is_none(), "a value has no column");
    }
    writer.finish().unwrap()
}

fn minutes(telescope: i64, noon_us: i64) -> impl Iterator<Item = Vec<(&'static str, Cell)>> {
    let mut numbers = Numbers(noon_us as u64 + telescope as u64);
    let texts = ["ObservingConditions", "Telescope", "wx", "mount", "shared", "callisto"].map(Cell::text);
    let names = SERIES.map(|(_, property)| Cell::text(property));
    (0..SERIES.len()).flat_map(move |series| (0..1440).map(move |minute| (series, minute))).map(
        move |(series, minute)| {
            let (kind, property) = SERIES[series];
            let minute_us = noon_us + minute * MINUTE_US;
            let mean =
                if property.starts_with("Wind") { wind_mps(telescope, minute_us) } else { 10.0 + numbers.next() };
            let place = usize::from(kind == "Telescope");
            let real = |value: f64| Cell::Real((value * 100.0).round() / 100.0);
            vec![
                ("device_type", texts[place].clone()),
                ("device_name", texts[2 + place].clone()),
                ("property", names[series].clone()),
                ("device_telescope", texts[4 + place].clone()),
                ("minute", Cell::Int(minute_us)),
                ("polled", Cell::Int(12)),
                ("missing", Cell::Int(0)),
                ("minimum", real(mean - 0.5)),
                ("mean", real(mean)),
                ("maximum", real(mean + 0.5)),
                ("last_at", Cell::Int(minute_us + 55_000_000)),
                ("last_number", real(mean)),
            ]
        },
    )
}

/// Frames begin 5 h after noon and then every 2 min.
fn begun(noon_us: i64, frame: i64) -> i64 {
    noon_us + 5 * 3_600_000_000 + frame * 2 * MINUTE_US
}

fn facts(telescope: i64, noon_us: i64) -> impl Iterator<Item = Vec<(&'static str, Cell)>> {
    let mut numbers = Numbers(noon_us as u64 ^ telescope as u64);
    (0..FRAMES).map(move |frame| {
        let at_us = begun(noon_us, frame);
        let fwhm_arcsec = 1.0 + 0.05 * wind_mps(telescope, at_us) + 0.4 * (numbers.next() - 0.5);
        vec![
            ("frame_id", Cell::text(&format!("{noon_us}-{telescope}-{frame:04}"))),
            ("camera_name", Cell::text("andor")),
            ("filter", Cell::text("I+z")),
            ("image_type", Cell::text("Light Frame")),
            ("date_obs", Cell::Int(at_us)),
            ("stars", Cell::Int(200)),
            ("fwhm_px", Cell::Real(fwhm_arcsec / SCALE_ARCSEC_PX)),
            ("sky_adu", Cell::Real(900.0 + 50.0 * numbers.next())),
            ("datetime", Cell::Int(at_us + 10_000_000)),
            ("seq", Cell::Int(frame)),
            ("in_header", Cell::Int(1)),
            ("scale_arcsec_px", Cell::Real(SCALE_ARCSEC_PX)),
            ("airmass", Cell::Real(1.0 + numbers.next())),
        ]
    })
}

fn images(telescope: i64, noon_us: i64) -> impl Iterator<Item = Vec<(&'static str, Cell)>> {
    (0..FRAMES).map(move |frame| {
        vec![
            ("frame_id", Cell::text(&format!("{noon_us}-{telescope}-{frame:04}"))),
            ("camera_name", Cell::text("andor")),
            ("complete_hdr", Cell::Bool(true)),
            ("date_obs", Cell::Int(begun(noon_us, frame))),
            ("file", Cell::text(&format!("{telescope}/{noon_us}/{frame:04}.fits"))),
            ("bytes", Cell::Int(8_398_080)),
            ("stored", Cell::Int(begun(noon_us, frame) + 70_000_000)),
            ("object", Cell::text(&format!("TOI-{}", 100 + frame / 100))),
            ("image_type", Cell::text("Light Frame")),
            ("exposure_s", Cell::Real(60.0)),
        ]
    })
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, telescopes, nights] = arguments.as_slice() else { panic!("usage: year FOLDER TELESCOPES NIGHTS") };
    let (telescopes, nights): (i64, i64) = (telescopes.parse().unwrap(), nights.parse().unwrap());
    let (began, mut rows) = (std::time::Instant::now(), 0);
    for telescope in 0..telescopes {
        let root = Path::new(folder).to_owned();
        let partition = Partition { root, site: "paranal".to_owned(), telescope: format!("t{telescope}") };
        for night in 0..nights {
            let noon_us = FIRST_NOON_US + night * DAY_US;
            let date = units::Utc::from_micros(noon_us).strftime("%Y%m%d");
            rows += write(&partition, "minutes", &date, &mut minutes(telescope, noon_us));
            rows += write(&partition, "facts", &date, &mut facts(telescope, noon_us));
            rows += write(&partition, "images", &date, &mut images(telescope, noon_us));
        }
    }
    let took_s = began.elapsed().as_secs_f64();
    println!(
        "{telescopes} telescopes, {nights} nights: {rows} rows in {took_s:.1} s, {:.0} rows/s",
        rows as f64 / took_s
    );
}
