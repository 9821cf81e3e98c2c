//! The image side on frames in files: `cargo run --release -p catalogue --example bench_frames -- CATALOGUE RA_DEG
//! DEC_DEG SCALE_ARCSEC_PX RUNS FILE [MOVED]`. `tests/bench/image_side.py` draws the frames and calls it.
//!
//! Prints one line per work: its name, the best and the median time and the processor time over all cores, ms, and the
//! result. MOVED is the same field a little later; without it the program prints only the memory that one file takes.

use std::path::Path;
use std::time::Instant;

use anyhow::Context as _;
use catalogue::{Catalogue, Reading};
use fits::Image;
use imaging::guide::Reference;
use imaging::hfd::{HfdSearch, hfd_at, measure_hfd};
use imaging::solve::{Detected, LearnedOptics, solve};
use imaging::{Camera, Clean, Frame, Hint, Measured, Pixels, Solution, StarSearch, measure};
use units::Angle;

/// The epoch for which the frames are drawn, Julian year: the proper motion until then is negligible.
const EPOCH_YEAR: f64 = 2016.0;
/// Stars whose diameters are measured.
const SIZED: usize = 100;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [catalogue, ra, dec, scale, runs, file, moved @ ..] = arguments.as_slice() else {
        anyhow::bail!("expected CATALOGUE RA_DEG DEC_DEG SCALE_ARCSEC_PX RUNS FILE [MOVED]");
    };
    let number = |text: &String| text.parse::<f64>().with_context(|| format!("{text} is no number"));
    let hint = Hint::new(Angle::from_degrees(number(ra)?), Angle::from_degrees(number(dec)?), number(scale)?);
    let catalogue = Catalogue::open(Path::new(catalogue), &Reading::default())?;
    let bench = Bench { catalogue, camera: Camera::default(), runs: runs.parse()? };
    match moved {
        [moved] => bench.all(Path::new(file), Path::new(moved), &hint),
        _ => bench.memory(Path::new(file), &hint),
    }
}

struct Bench {
    catalogue: Catalogue,
    camera: Camera<'static>,
    runs: usize,
}

impl Bench {
    fn all(&self, file: &Path, moved: &Path, hint: &Hint) -> anyhow::Result<()> {
        let (image, later) = (fits::read(file)?, fits::read(moved)?);
        let (shot, later) = (frame(&image)?, frame(&later)?);
        let measured = measure(&shot, &self.camera, &StarSearch::default())?;
        let fwhm_px = measured.quality.fwhm_px.context("no star shows the width of this frame")?.value;
        // As in a night: the last frame gave the width.
        let search = StarSearch { fwhm_px: Some(fwhm_px as f32), ..StarSearch::default() };

        let stars = self.time("clean_detect", || Ok(measure(&shot, &self.camera, &search)?.stars.len()))?;
        println!("{stars} stars, FWHM {fwhm_px:.1} px");
        let solved = self.time("solve_field", || self.solved(&measured, &image, hint))?;
        println!("{} stars agree", solved.matched);
        let Solution { scale_arcsec_px, rotation_deg, mirrored, .. } = solved;
        let learned = Hint {
            learned: Some(LearnedOptics { scale_arcsec_px, rotation_deg, mirrored, sip: None }),
            mirrored: Some(mirrored),
            ..hint.clone()
        };
        let solved = self.time("solve_shift", || self.solved(&measured, &image, &learned))?;
        println!("{} stars agree", solved.matched);
        for (name, hint) in [("file_field", hint), ("file_shift", &learned)] {
            let solved = self.time(name, || self.solve_file(file, &search, hint))?;
            let apart = imaging::tangent::separation((solved.ra, solved.dec), (hint.ra, hint.dec));
            let (stars, level) = (solved.matched, solved.level);
            println!("{stars} stars agree, level {level:?}, {:.3} arcsec from where it was drawn", apart.arcseconds());
        }

        let mut reference =
            Reference::from_lists(std::slice::from_ref(&measured.stars), image.width_px, image.height_px)?;
        let name = "guide";
        let mut seen = None;
        self.time(name, || {
            seen = Some(reference.measure(&later, &self.camera, [0.0, 0.0])?.shift);
            Ok(())
        })?;
        let shift = seen.context("no run measured a shift")?;
        println!("{:.4} {:.4} px with {} stars", shift.dx_px, shift.dy_px, reference.stars().len());

        let sizes = HfdSearch { expected_px: Some(fwhm_px), most_stars: SIZED, ..HfdSearch::default() };
        let found = self.time("hfd", || Ok(measure_hfd(&shot, &self.camera, &sizes)?))?;
        println!("{} stars, HFD {:.2} px", found.stars.len(), found.hfd_px.value);
        let clean = Clean::new(&shot, &self.camera, search.fwhm_px)?;
        let places: Vec<(f64, f64)> = found.stars.iter().map(|star| (star.x_px, star.y_px)).collect();
        let hfd_px = found.hfd_px.value;
        let sized = self.time("hfd_at", || Ok(hfd_at(&clean, 1.0, &places, hfd_px).iter().flatten().count()))?;
        println!("{sized} stars");
        Ok(())
    }

    /// One file from disk to WCS, in a process that does nothing else.
    fn memory(&self, file: &Path, hint: &Hint) -> anyhow::Result<()> {
        let solved = self.solve_file(file, &StarSearch::default(), hint)?;
        let status = std::fs::read_to_string("/proc/self/status").context("this system does not report memory")?;
        let line = status.lines().find(|line| line.starts_with("VmHWM")).context("no VmHWM in /proc/self/status")?;
        let peak_kb: u64 = line.split_whitespace().nth(1).context("VmHWM without a number")?.parse()?;
        println!("memory\t{}\t{} stars agree", peak_kb / 1024, solved.matched);
        Ok(())
    }

    fn solve_file(&self, file: &Path, search: &StarSearch, hint: &Hint) -> anyhow::Result<Solution> {
        let image = fits::read(file)?;
        let measured = measure(&frame(&image)?, &self.camera, search)?;
        self.solved(&measured, &image, hint)
    }

    fn solved(&self, measured: &Measured, image: &Image, hint: &Hint) -> anyhow::Result<Solution> {
        let stars = self.catalogue.at_epoch(EPOCH_YEAR);
        let detected = Detected {
            stars: &measured.stars,
            width: image.width_px,
            height: image.height_px,
            quality: Some(&measured.quality),
        };
        let found = solve(&detected, hint, &stars);
        stars.checked()?;
        Ok(found?)
    }

    /// Prints the times of some runs, without ending the line; returns the result of the last one. The first run, which
    /// fills caches, does not count.
    fn time<T>(&self, name: &str, mut work: impl FnMut() -> anyhow::Result<T>) -> anyhow::Result<T> {
        let mut answer = work().with_context(|| name.to_owned())?;
        let before_ms = processor_ms()?;
        let mut times = Vec::with_capacity(self.runs);
        for _ in 0..self.runs.max(1) {
            let started = Instant::now();
            answer = std::hint::black_box(work().with_context(|| name.to_owned())?);
            times.push(started.elapsed().as_secs_f64() * 1e3);
        }
        let processor = (processor_ms()? - before_ms) / times.len() as f64;
        times.sort_by(f64::total_cmp);
        print!("{name}\t{:.2}\t{:.2}\t{processor:.2}\t", times[0], times[times.len() / 2]);
        Ok(answer)
    }
}

fn frame(image: &Image) -> anyhow::Result<Frame<'_>> {
    let pixels = match &image.pixels {
        fits::Pixels::U16(counts) => Pixels::U16(counts),
        fits::Pixels::F32(floats) => Pixels::F32(floats),
    };
    Ok(Frame::new(image.width_px, image.height_px, pixels)?)
}

/// Time that all threads of this process have run, ms, in steps of 10.
fn processor_ms() -> anyhow::Result<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").context("this system does not report processor time")?;
    // User and system time are fields 14 and 15; the name before them may hold spaces.
    let fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    Ok(fields.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() * 10.0)
}
