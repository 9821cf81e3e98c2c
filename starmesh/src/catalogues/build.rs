//! `starmesh catalogue build`: one file in Starmesh's format of any number of sources.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use catalogue::{Band, Reading, Sorter, Tally, each_star};
use clap::Args;
use serde_json::json;

use super::gaia::{self, Cone, Service};
use crate::console::line;

/// Options of `starmesh catalogue build`.
#[derive(Debug, Args)]
pub struct Options {
    /// The catalogue to make; an older one of that name is replaced when the new one is whole.
    #[arg(long)]
    out: PathBuf,
    /// Gaia-2MASS SQLite files (gaia_tmass_*.db), FITS binary tables, CSV with a line of names; .gz too.
    /// Columns: ra, dec (ICRS, degrees), mag, and as far as known pmra (with cos dec), pmdec (mas/yr), epoch
    /// (Julian year); names as Gaia and VizieR have them are known too.
    sources: Vec<PathBuf>,
    /// The magnitude: G, BP, RP, J, H or Ks; where a star has none of it, another one stands in. Without it: the
    /// column `mag`, else G.
    #[arg(long, value_parser = band)]
    magnitude: Option<Band>,
    /// Epoch of positions whose source does not report it, Julian year. Without it: 2016.0 (Gaia DR3), and 2015.5 for
    /// Gaia-2MASS files without BP and RP (Gaia DR2).
    #[arg(long, value_parser = year)]
    epoch: Option<f64>,
    /// A circle of Gaia DR3 by TAP: its centre and radius, degrees; may be given several times.
    #[arg(long, num_args = 3, value_names = ["RA_DEG", "DEC_DEG", "RADIUS_DEG"], allow_negative_numbers = true)]
    gaia_tap: Vec<f64>,
    /// Faintest magnitude (G) to ask Gaia for.
    #[arg(long, default_value_t = 17.0)]
    faintest: f64,
    /// The server that is asked for Gaia's stars.
    #[arg(long, value_enum, default_value_t = Service::Esa)]
    gaia_service: Service,
    /// Another address of the service's synchronous TAP endpoint.
    #[arg(long)]
    gaia_url: Option<String>,
    /// Where answers are kept; a question that was asked before is answered from here.
    /// Without it: starmesh/gaia in $XDG_CACHE_HOME or ~/.cache.
    #[arg(long)]
    cache: Option<PathBuf>,
    /// Longest time that one answer may take, seconds.
    #[arg(long, default_value_t = 120.0)]
    timeout_s: f64,
    /// One JSON object instead of text.
    #[arg(long)]
    json: bool,
}

fn band(word: &str) -> Result<Band, String> {
    Band::named(word).ok_or_else(|| "expected G, BP, RP, J, H or Ks".to_owned())
}

fn year(word: &str) -> Result<f64, String> {
    let year = word.parse().ok().filter(|year| (1800.0..2200.0).contains(year));
    year.ok_or_else(|| "expected a year such as 2016.0".to_owned())
}

/// Reads all sources, then writes.
pub async fn run(options: &Options) -> anyhow::Result<()> {
    let sources = sources(options).await?;
    for source in &sources {
        ensure!(
            !is_same_file(source, &options.out)?,
            "--out {} is the same file as the source {}: it would be replaced by what is made of it; give another --out",
            options.out.display(),
            source.display()
        );
    }
    let reading = Reading { band: options.magnitude, epoch_year: options.epoch };
    let mut sorter = Sorter::new(&options.out)?;
    let mut all = Tally::default();
    for source in &sources {
        let tally = each_star(source, &reading, &mut |entry| sorter.take(&entry))?;
        if !options.json {
            line(format_args!("{}: {}", source.display(), words(&tally)))?;
        }
        all.add(tally);
    }
    let built = sorter.finish()?;
    if options.json {
        return line(format_args!(
            "{}",
            json!({
                "file": options.out.display().to_string(),
                "stars": built.stars,
                "without_motion": all.unmoving,
                "rows_without_place": all.unplaced,
                "rows_without_magnitude": all.without_mag,
                "epoch_year": catalogue::EPOCH_YEAR,
                "healpix_order": built.order,
                "bytes": built.bytes,
            })
        ));
    }
    let twice = match all.stars - u64::from(built.stars) {
        0 => String::new(),
        twice => format!(" ({twice} were given twice)"),
    };
    line(format_args!(
        "{}: {} stars{twice}, epoch {:.1}, HEALPix order {}, {:.1} MB",
        options.out.display(),
        built.stars,
        catalogue::EPOCH_YEAR,
        built.order,
        built.bytes as f64 * 1e-6
    ))
}

/// Whether two names are the same file, also by links. A name without a file is none.
fn is_same_file(one: &Path, other: &Path) -> anyhow::Result<bool> {
    let (Ok(one), Ok(other)) = (std::fs::canonicalize(one), std::fs::canonicalize(other)) else { return Ok(false) };
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        let number = |file: &Path| std::fs::metadata(file).map(|of| (of.dev(), of.ino()));
        if number(&one)? == number(&other)? {
            return Ok(true);
        }
    }
    Ok(one == other)
}

/// The given files, and the files that hold Gaia's answers.
async fn sources(options: &Options) -> anyhow::Result<Vec<PathBuf>> {
    let (cones, rest) = options.gaia_tap.as_chunks::<3>();
    ensure!(rest.is_empty(), "--gaia-tap takes three numbers: right ascension, declination and radius, degrees");
    if cones.is_empty() && options.sources.is_empty() {
        bail!("nothing to build from: give Gaia-2MASS, FITS or CSV files, or --gaia-tap RA_DEG DEC_DEG RADIUS_DEG");
    }
    let timeout = Duration::try_from_secs_f64(options.timeout_s).ok().filter(|time| !time.is_zero());
    let timeout = timeout.context("--timeout-s is the longest time of an answer in seconds, such as 120")?;
    let mut sources = options.sources.clone();
    for [ra_deg, dec_deg, radius_deg] in cones {
        let (ra_deg, dec_deg, radius_deg) = (*ra_deg, *dec_deg, *radius_deg);
        let cone = Cone { ra_deg, dec_deg, radius_deg, faintest_mag: options.faintest };
        let url = options.gaia_url.as_deref().unwrap_or(options.gaia_service.url());
        let query = gaia::query(options.gaia_service, &cone, options.magnitude)?;
        sources.push(gaia::ask(url, &query, &cone, &gaia::cache(options.cache.as_deref())?, timeout).await?);
    }
    Ok(sources)
}

fn words(tally: &Tally) -> String {
    let mut text = format!("{} stars, {} without proper motion", tally.stars, tally.unmoving);
    if tally.unplaced > 0 {
        text += &format!(", {} rows without a place left out", tally.unplaced);
    }
    if tally.without_mag > 0 {
        text += &format!(", {} rows without a magnitude left out", tally.without_mag);
    }
    text
}
