//! Runs an installed `solve-field` (astrometry.net) as the last resort: it needs no hint of the place, only index
//! files, which it finds by itself. It gets our stars, not the frame, and a bounded time.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use imaging::{Star, Wcs};

use super::hint;

/// More stars do not help it.
const MOST_STARS: usize = 300;
/// The tolerance of the scale that it gets, as a share.
const SCALE_TOLERANCE: f64 = 0.1;
/// It is killed this long after the end of its own time limit.
const GRACE: Duration = Duration::from_secs(2);

/// The data about a frame that `solve-field` gets.
pub struct Field<'a> {
    /// All stars.
    pub stars: &'a [Star],
    /// Columns and rows, px.
    pub size_px: (usize, usize),
    /// Size of a pixel, arcsec, where it is known.
    pub scale_arcsec_px: Option<f64>,
}

/// The path of `solve-field`, if it is on PATH.
pub fn installed() -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).map(|folder| folder.join("solve-field")).find(|file| file.is_file())
}

/// The solution of `program`; None when it found nothing within `limit`.
pub fn solve(program: &Path, field: &Field, limit: Duration) -> anyhow::Result<Option<Wcs>> {
    let folder = tempfile::Builder::new().prefix("starmesh-solve-field-").tempdir()?;
    let (list, answer) = (folder.path().join("field.xyls"), folder.path().join("field.wcs"));
    write_list(&list, field.stars).with_context(|| format!("{} cannot be written", list.display()))?;
    let mut command = Command::new(program);
    command.args(["--overwrite", "--no-plots", "--new-fits", "none", "--x-column", "X", "--y-column", "Y"]);
    command.args(["--sort-column", "FLUX", "--width", &field.size_px.0.to_string()]);
    command.args(["--height", &field.size_px.1.to_string(), "--cpulimit", &limit.as_secs().max(1).to_string()]);
    if let Some(scale) = field.scale_arcsec_px {
        let bound = |share: f64| format!("{:.5}", scale * share);
        command.args(["--scale-units", "arcsecperpix", "--scale-low", &bound(1.0 - SCALE_TOLERANCE)]);
        command.args(["--scale-high", &bound(1.0 + SCALE_TOLERANCE)]);
    }
    command.arg("--dir").arg(folder.path()).arg("--wcs").arg(&answer).arg(&list);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let child = own_group(&mut command).spawn().with_context(|| format!("{} cannot be started", program.display()))?;
    if !ended_in_time(child, limit + GRACE)? || !answer.exists() {
        return Ok(None);
    }
    let header = fits::table::primary_header(&answer)?;
    let wcs = hint::solution(&header);
    wcs.map(Some).with_context(|| format!("{} wrote a solution that cannot be read", program.display()))
}

/// Waits for the program, and ends it with all that it has started when it takes longer.
fn ended_in_time(mut child: Child, limit: Duration) -> anyhow::Result<bool> {
    let started = Instant::now();
    loop {
        if child.try_wait()?.is_some() {
            return Ok(true);
        }
        if started.elapsed() > limit {
            end_group(&mut child);
            child.wait()?;
            return Ok(false);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The program starts programs of its own, which must end with it.
#[cfg(unix)]
fn own_group(command: &mut Command) -> &mut Command {
    use std::os::unix::process::CommandExt as _;
    command.process_group(0)
}

#[cfg(not(unix))]
fn own_group(command: &mut Command) -> &mut Command {
    command
}

fn end_group(child: &mut Child) {
    #[cfg(unix)]
    if let Some(group) = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw) {
        let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
    }
    let _ = child.kill(); // It may have ended meanwhile.
}

/// A FITS table of the brightest stars, the brightest first; FITS pixels begin with 1.
fn write_list(file: &Path, stars: &[Star]) -> anyhow::Result<()> {
    let mut stars: Vec<&Star> = stars.iter().filter(|star| !star.flags.cosmic && star.flux_adu.is_finite()).collect();
    stars.sort_by(|a, b| b.flux_adu.total_cmp(&a.flux_adu));
    stars.truncate(MOST_STARS);
    if stars.is_empty() {
        bail!("no star to solve with");
    }
    let rows = format!("NAXIS2  = {:20}", stars.len());
    let primary =
        ["SIMPLE  =                    T", "BITPIX  =                    8", "NAXIS   =                    0"];
    let table = [
        "XTENSION= 'BINTABLE'",
        "BITPIX  =                    8",
        "NAXIS   =                    2",
        "NAXIS1  =                   12",
        &rows,
        "PCOUNT  =                    0",
        "GCOUNT  =                    1",
        "TFIELDS =                    3",
        "TTYPE1  = 'X       '",
        "TFORM1  = 'E       '",
        "TTYPE2  = 'Y       '",
        "TFORM2  = 'E       '",
        "TTYPE3  = 'FLUX    '",
        "TFORM3  = 'E       '",
    ];
    let mut bytes = Vec::new();
    let fill = |bytes: &mut Vec<u8>, with: u8| bytes.resize(bytes.len().div_ceil(2880) * 2880, with);
    for (first, cards) in [(Some("EXTEND  =                    T"), &primary[..]), (None, &table[..])] {
        for card in cards.iter().copied().chain(first).chain(["END"]) {
            bytes.extend(format!("{card:80}").bytes());
        }
        fill(&mut bytes, b' ');
    }
    for star in stars {
        for number in [star.x_px + 1.0, star.y_px + 1.0, star.flux_adu] {
            bytes.extend((number as f32).to_be_bytes());
        }
    }
    fill(&mut bytes, 0);
    std::fs::File::create(file)?.write_all(&bytes)?;
    Ok(())
}
