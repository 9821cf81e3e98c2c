//! Makes `catalogue/default.smcat` from the all-sky star table:
//! `cargo run --release -p imaging --example build_catalogue -- stars.fits.gz catalogue/default.smcat`
//!
//! The table is the FITS binary table STARS (ra, dec, pmra, pmdec, mag, gaia, pm_known; see
//! `catalogue/ATTRIBUTION.md`). Stars without Gaia stand at 2000.0 and are moved to 2016.0, where all others are;
//! the few stars that the table holds twice (once as Gaia, once as Tycho saw them earlier) are kept once.

use std::collections::HashMap;
use std::io::Read;

use anyhow::{Context, Result, bail, ensure};
use imaging::catalogue::{Entry, build};
use units::Angle;

const EPOCH: f64 = 2016.0;
const ORDER: u8 = 7;

struct Row {
    entry: Entry,
    gaia: bool,
    moves: bool,
}

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (Some(input), Some(output)) = (arguments.next(), arguments.next()) else {
        bail!("usage: build_catalogue STARS.FITS.GZ OUT.SMCAT");
    };
    let mut table = Vec::new();
    let file = std::fs::File::open(&input).with_context(|| format!("opening {input}"))?;
    flate2::read::GzDecoder::new(file).read_to_end(&mut table).context("unpacking")?;
    let rows = read_rows(&table)?;
    let total = rows.len();
    let entries = without_doubles(rows);
    let bytes = build(&entries, ORDER, EPOCH);
    std::fs::write(&output, &bytes).with_context(|| format!("writing {output}"))?;
    println!("{output}: {} of {total} stars, {} bytes", entries.len(), bytes.len());
    Ok(())
}

/// The rows of the first extension, whose columns must be those of the table's README.
fn read_rows(table: &[u8]) -> Result<Vec<Row>> {
    let (_, start) = header(table, 0)?;
    let (cards, data) = header(table, start)?;
    let number = |key: &str| -> Result<f64> {
        cards.get(key).context(format!("{key} is missing"))?.parse().context(format!("{key} is no number"))
    };
    let forms: Vec<&str> = (1..=7).filter_map(|n| cards.get(&format!("TFORM{n}")).map(|s| s.trim())).collect();
    ensure!(forms == ["J", "J", "E", "E", "I", "L", "L"], "unexpected columns {forms:?}");
    let (width, count) = (number("NAXIS1")? as usize, number("NAXIS2")? as usize);
    ensure!(width == 20 && table.len() >= data + width * count, "table is cut short");
    let mut rows = Vec::with_capacity(count);
    for row in table[data..data + width * count].chunks_exact(width) {
        let integer = |at: usize| f64::from(i32::from_be_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]]));
        let real = |at: usize| f64::from(f32::from_be_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]]));
        let (gaia, moves) = (row[18] == b'T', row[19] == b'T');
        let (pm_ra, pm_dec) = if moves { (real(8), real(12)) } else { (0.0, 0.0) };
        let years = if gaia { 0.0 } else { EPOCH - 2000.0 };
        let dec = integer(4) * 1e-7 + pm_dec * years / 3.6e6;
        let ra = integer(0) * 1e-7 + 180.0 + pm_ra * years / 3.6e6 / dec.to_radians().cos();
        rows.push(Row {
            entry: Entry {
                ra: Angle::from_degrees(ra).wrapped_positive(),
                dec: Angle::from_degrees(dec),
                pm_ra_mas: pm_ra,
                pm_dec_mas: pm_dec,
                mag: f64::from(i16::from_be_bytes([row[16], row[17]])) * 1e-3,
            },
            gaia,
            moves,
        });
    }
    Ok(rows)
}

/// The cards of the FITS header that starts at `at`, and where its data start.
fn header(table: &[u8], at: usize) -> Result<(HashMap<String, String>, usize)> {
    let mut cards = HashMap::new();
    for (n, card) in table.get(at..).context("no header")?.chunks_exact(80).enumerate() {
        let card = String::from_utf8_lossy(card);
        if card.trim() == "END" {
            return Ok((cards, at + (n + 1).div_ceil(36) * 2880));
        }
        if let Some((key, value)) = card.split_once('=') {
            let value = value.split('/').next().unwrap_or_default().trim().trim_matches('\'').trim();
            cards.insert(key.trim().to_owned(), value.to_owned());
        }
    }
    bail!("header has no END")
}

/// Drops a row without Gaia data that is another row's star: at the same place now (1"), or where a star with
/// known motion stood up to 25 years before 2016 (the table's brightest Tycho positions are of epoch 1991).
fn without_doubles(mut rows: Vec<Row>) -> Vec<Entry> {
    rows.sort_by(|a, b| a.entry.dec.degrees().total_cmp(&b.entry.dec.degrees()));
    let mut doubled = vec![false; rows.len()];
    for (i, star) in rows.iter().enumerate() {
        let speed_arcsec = star.entry.pm_ra_mas.hypot(star.entry.pm_dec_mas) * 1e-3;
        if !(star.gaia || (star.moves && speed_arcsec > 1.0)) {
            continue;
        }
        let reach = if star.moves { 1.0 + 25.0 * speed_arcsec } else { 1.0 };
        let dec = star.entry.dec.arcseconds();
        let first = rows.partition_point(|r| r.entry.dec.arcseconds() < dec - reach);
        for (j, other) in rows.iter().enumerate().skip(first) {
            if other.entry.dec.arcseconds() > dec + reach {
                break;
            }
            let alike = (other.entry.mag - star.entry.mag).abs() < 2.0; // red dwarfs: G and VT differ by 1.6
            if i != j && !other.gaia && !(doubled[i] || doubled[j]) && alike && stood_there(star, other) {
                doubled[j] = true;
            }
        }
    }
    rows.iter().zip(doubled).filter(|(_, doubled)| !doubled).map(|(row, _)| row.entry).collect()
}

fn stood_there(star: &Row, other: &Row) -> bool {
    let cos_dec = star.entry.dec.cos();
    let east = (other.entry.ra - star.entry.ra).wrapped_signed().arcseconds() * cos_dec;
    let north = (other.entry.dec - star.entry.dec).arcseconds();
    let (pm_east, pm_north) = (star.entry.pm_ra_mas * 1e-3, star.entry.pm_dec_mas * 1e-3);
    let back = if other.moves { 0.0 } else { 25.0 };
    let speed2 = pm_east * pm_east + pm_north * pm_north;
    let years = if speed2 > 0.0 { (-(east * pm_east + north * pm_north) / speed2).clamp(0.0, back) } else { 0.0 };
    (east + years * pm_east).hypot(north + years * pm_north) < 1.0
}
