//! `starmesh solve`: which piece of the sky FITS files show.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, anyhow, bail, ensure};
use catalogue::{Catalogue, EPOCH_YEAR, Reading};
use clap::Args;
use imaging::solve::{AllSky, Blind, Detected, Hint, KNOWN_OPTICS, Stars, Within, at_epoch, solve};
use imaging::{Measured, NoSolution, Solution, Wcs};
use serde_json::{Value, json};
use units::Angle;

use super::exposure::{Chosen, Exposure};
use super::{Output, blind, each, hint, rounded, significant, write_wcs};

/// Options of `starmesh solve`.
#[derive(Debug, Args)]
pub struct Options {
    /// FITS images, plain or packed (.fz, .gz, .bz2).
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// ICRS right ascension of the frame's centre, degrees, to some degrees; without it the header's.
    #[arg(long, allow_negative_numbers = true)]
    ra_deg: Option<f64>,
    /// ICRS declination of the frame's centre, degrees, to some degrees; without it the header's.
    #[arg(long, allow_negative_numbers = true)]
    dec_deg: Option<f64>,
    /// Size of a (binned) pixel on the sky, arcsec, to 5 %; without it the header's.
    #[arg(long)]
    scale_arcsec_px: Option<f64>,
    /// How far from the hinted place the frame's centre is looked for, degrees, to 180; without it 8. Fields of 1 deg and
    /// more are found at any distance, narrower ones to some degrees.
    #[arg(long)]
    within_deg: Option<f64>,
    /// A catalogue in Starmesh's format, a Gaia-2MASS SQLite file, or a FITS or CSV table; without it the one that
    /// Starmesh ships, to about magnitude 11 to 12.5.
    #[arg(long)]
    catalogue: Option<PathBuf>,
    /// Where there is no hint, the whole sky is looked through (fields of 1 deg and more), and then an installed
    /// `solve-field` is asked, for this time at most, seconds; 0 for neither. Without this option 30 s; and where a hint of
    /// place and scale fits nothing, only with it.
    #[arg(long)]
    blind_s: Option<f64>,
    /// Write the solution into the file itself: its WCS keywords are replaced, all others stay; whole or not at all.
    #[arg(long)]
    write: bool,
    /// Write the solution into this file, a FITS header without data as astrometry.net's .wcs; for one frame.
    #[arg(long, value_name = "FILE")]
    wcs: Option<PathBuf>,
    #[command(flatten)]
    chosen: Chosen,
    #[command(flatten)]
    output: Output,
}

/// Solves one file after the other. One that is not solved has its answer too, and then the whole fails.
pub fn run(options: &Options) -> anyhow::Result<()> {
    let asked = hint::asked_place(options.ra_deg, options.dec_deg)?;
    if let Some(scale) = options.scale_arcsec_px {
        ensure!(scale > 0.0 && scale.is_finite(), "--scale-arcsec-px is {scale}, expected more than 0");
    }
    if let Some(within) = options.within_deg {
        ensure!((0.0..=180.0).contains(&within), "--within-deg is {within}, expected 0 to 180");
    }
    if let Some(file) = &options.wcs {
        ensure!(options.files.len() == 1, "--wcs takes the solution of one frame; give one, or --write");
        for frame in &options.files {
            let same =
                std::fs::canonicalize(frame).ok().zip(std::fs::canonicalize(file).ok()).is_some_and(|(a, b)| a == b);
            ensure!(!same, "--wcs {} is the frame itself; --write puts the solution into it", file.display());
        }
    }
    let catalogue = match &options.catalogue {
        Some(file) => Catalogue::open(file, &Reading::default())?,
        None => Catalogue::of_program(),
    };
    let limit = options.blind_s.map(Duration::try_from_secs_f64).transpose();
    let limit = limit.context("--blind-s is a time in seconds, 0 for never")?;
    // Bright stars hardly move: one epoch serves all files.
    let sky = AllSky::new(at_epoch(simulator::catalogue::default(), EPOCH_YEAR + SINCE_YEARS));
    let is_shipped = options.catalogue.is_none();
    let (scale_arcsec_px, within) = (options.scale_arcsec_px, options.within_deg.map(Angle::from_degrees));
    let task = Task { asked, scale_arcsec_px, within, catalogue: &catalogue, is_shipped, sky: &sky, limit };
    let mut unsolved = 0;
    let done = each(&options.files, |file| {
        let exposure = Exposure::open(file, options.chosen)?;
        let answer = task.answer(&exposure)?;
        unsolved += usize::from(answer.is_err());
        options.output.print(&object(&exposure, &answer), || sentence(&exposure, &answer))?;
        match &answer {
            Ok(solved) => written(options, &exposure, solved),
            Err(_) => Ok(()),
        }
    });
    done?;
    if unsolved > 0 {
        bail!("{unsolved} of {} files are not solved", options.files.len());
    }
    Ok(())
}

/// Writes the solution to the files that the options name.
fn written(options: &Options, exposure: &Exposure, solved: &Solved) -> anyhow::Result<()> {
    if !options.write && options.wcs.is_none() {
        return Ok(());
    }
    let file = exposure.file.display();
    ensure!(solved.verified.is_some(), "{file}: the solution is not written: it is known {BLIND}");
    let size_px = (exposure.width_px(), exposure.height_px());
    if options.write {
        write_wcs::into_frame(&exposure.file, exposure.hdu(), &solved.wcs, size_px)?;
    }
    match &options.wcs {
        Some(file) => write_wcs::into_file(file, &solved.wcs, size_px),
        None => Ok(()),
    }
}

/// The direction of a frame, and how well it is known.
struct Solved {
    ra: Angle,
    dec: Angle,
    scale_arcsec_px: f64,
    rotation_deg: f64,
    mirrored: bool,
    /// Stars that agree with the catalogue, their rms (px) and the probability that it is false; none where only
    /// `solve-field` found the field.
    verified: Option<(usize, f64, f64)>,
    /// Pixels to sky.
    wcs: Wcs,
}

impl From<Solution> for Solved {
    fn from(s: Solution) -> Self {
        let verified = Some((s.matched, s.rms_px, s.false_alarm));
        let Solution { ra, dec, scale_arcsec_px, rotation_deg, mirrored, wcs, .. } = s;
        Self { ra, dec, scale_arcsec_px, rotation_deg, mirrored, verified, wcs }
    }
}

/// Years from the catalogues' epoch to frames that are solved without a hint.
const SINCE_YEARS: f64 = 10.0;
/// Time for `solve-field` where no option gives it.
const BLIND_FOR: Duration = Duration::from_secs(30);
/// The tolerance of a known scale in a blind search, as a share to either side: the scale may be the wrong part of the
/// hint.
const SCALE_SHARE: f64 = 0.15;
/// The widest hint whose surroundings are looked through piece by piece.
const WIDEST_HINT: Angle = Angle::from_degrees(60.0);
/// Longest side of a frame that a blind search has patterns for, deg.
const LEAST_FIELD_DEG: f64 = 0.3;

/// The values that all files share.
struct Task<'a, S> {
    asked: Option<hint::Place>,
    scale_arcsec_px: Option<f64>,
    /// How far from the hint the option allows.
    within: Option<Angle>,
    catalogue: &'a Catalogue,
    /// Whether the catalogue is the shipped one.
    is_shipped: bool,
    /// The shipped catalogue, in which frames are found without a hint.
    sky: &'a AllSky<S>,
    /// Time for `solve-field`, where an option gives it.
    limit: Option<Duration>,
}

/// Why there is no solution, and whether another search may have more.
struct Refused {
    reason: String,
    elsewhere: bool,
    /// A hint of place and scale was there and fits nothing.
    hint_denied: bool,
    /// The catalogue is too shallow, and so is the one of the whole sky.
    too_shallow: bool,
}

impl<S: Stars + Sync> Task<'_, S> {
    /// A solution, or the reason why there is none. Other failures (such as a catalogue that cannot be read) are
    /// errors.
    fn answer(&self, exposure: &Exposure) -> anyhow::Result<Result<Solved, String>> {
        let size_px = (exposure.width_px(), exposure.height_px());
        let header = hint::HeaderHints::of(exposure.header(), size_px);
        let answer = self.search(exposure, &header)?;
        Ok(answer.map_err(|reason| format!("{reason}{}", header.passed_over_words())))
    }

    /// Tries the hints, one after the other, and where none of them fits the whole sky.
    fn search(&self, exposure: &Exposure, header: &hint::HeaderHints) -> anyhow::Result<Result<Solved, String>> {
        let measured = exposure.measure()?;
        let hints = known(header, self.asked, self.scale_arcsec_px).map(|hints| {
            let within = |hint| match self.within {
                Some(within) => Hint { furthest: if within < WIDEST_HINT { within } else { WIDEST_HINT }, ..hint },
                None => hint,
            };
            hints.into_iter().map(within).collect::<Vec<_>>()
        });
        let hint = match &hints {
            Ok(hints) => hints.first().context("no hint was made"),
            Err(error) => Err(anyhow!("{error:#}")),
        };
        let found = match &hints {
            Ok(hints) => self.any_hinted(exposure, &measured, hints)?,
            Err(error) => {
                let reason = format!("no hint: {error:#}");
                Err(Refused { reason, elsewhere: true, hint_denied: false, too_shallow: false })
            }
        };
        let refused = match found {
            Ok(solution) => return Ok(Ok(solution.into())),
            Err(refused) => refused,
        };
        // Beyond the hinted field only the patterns of the whole sky are quick enough.
        let within = match (&hint, self.within) {
            (Ok(hint), Some(furthest)) => Some(Within { ra: hint.ra, dec: hint.dec, furthest }),
            _ => None,
        };
        let limit = match self.limit {
            // A hint that fits nothing is refused at once; a longer search has to be requested.
            None if refused.hint_denied && within.is_none() => {
                return Ok(Err(format!("{}; --blind-s 30 looks through the whole sky too", refused.reason)));
            }
            limit => limit.unwrap_or(BLIND_FOR),
        };
        if !refused.elsewhere || limit.is_zero() {
            return Ok(Err(refused.reason));
        }
        let mut reason = refused.reason;
        // The whole sky is that of the shipped catalogue.
        if !(refused.too_shallow && self.is_shipped) {
            match self.anywhere(exposure, &measured, within)? {
                Ok(solution) => return Ok(Ok(solution.into())),
                Err(nowhere) => reason = format!("{reason}; {nowhere}"),
            }
        }
        match blind::installed() {
            // Another solver looks everywhere.
            _ if within.is_some() => Ok(Err(reason)),
            Some(program) => self.blindly(exposure, &measured, (&program, limit), reason),
            None => Ok(Err(format!("{reason}; solve-field is not installed"))),
        }
    }

    /// The solution by the first hint that fits; where none does, what was wrong with them, in the words of the first.
    fn any_hinted(
        &self,
        exposure: &Exposure,
        measured: &Measured,
        hints: &[Hint],
    ) -> anyhow::Result<Result<Solution, Refused>> {
        let mut refused: Option<Refused> = None;
        for hint in hints {
            let reason = match self.hinted(exposure, measured, hint)? {
                Ok(solution) => return Ok(Ok(solution)),
                Err(reason) => reason,
            };
            let hint_denied = matches!(reason, NoSolution::NoMatch { .. });
            let too_shallow = matches!(reason, NoSolution::CatalogueTooShallow { .. });
            // Where these are not the reason, the frame needs more light; another solver cannot help.
            let elsewhere = hint_denied || too_shallow || matches!(reason, NoSolution::Hint { .. });
            let first = refused.get_or_insert_with(|| Refused {
                reason: reason.to_string(),
                elsewhere: false,
                hint_denied: false,
                too_shallow: true,
            });
            first.elsewhere |= elsewhere;
            first.hint_denied |= hint_denied;
            first.too_shallow &= too_shallow;
        }
        Ok(Err(refused.context("no hint was tried")?))
    }

    /// Size of a pixel from the options, or from the header, arcsec.
    fn stated_scale(&self, exposure: &Exposure) -> Option<f64> {
        let size_px = (exposure.width_px(), exposure.height_px());
        let in_header = || Some(hint::HeaderHints::of(exposure.header(), size_px).scales.first()?.0);
        self.scale_arcsec_px.or_else(in_header)
    }

    /// Looks for the frame on the whole sky of the shipped catalogue; the places are then those of the given catalogue,
    /// where it covers the field.
    fn anywhere(
        &self,
        exposure: &Exposure,
        measured: &Measured,
        within: Option<Within>,
    ) -> anyhow::Result<Result<Solution, String>> {
        let stated = self.stated_scale(exposure);
        let longer_px = exposure.width_px().max(exposure.height_px()) as f64;
        if let Some(field_deg) = stated.map(|scale| scale * longer_px / 3600.0).filter(|deg| *deg < LEAST_FIELD_DEG) {
            return Ok(Err(format!("a field of {field_deg:.3} deg is too narrow for a blind search of our own")));
        }
        let scales_arcsec_px = stated.map(|scale| (scale * (1.0 - SCALE_SHARE), scale * (1.0 + SCALE_SHARE)));
        let blind = Blind { scales_arcsec_px, within, ..Blind::default() };
        let found = self.sky.solve(&detected(exposure, measured), &blind);
        let solution = match found {
            Ok(solution) => solution,
            Err(reason) => return Ok(Err(reason.to_string())),
        };
        let near = Hint {
            learned: Some(solution.learned()),
            furthest: Angle::default(),
            ..Hint::new(solution.ra, solution.dec, solution.scale_arcsec_px)
        };
        // A deeper catalogue, or the frame's own epoch, places it better.
        Ok(Ok(self.hinted(exposure, measured, &near)?.unwrap_or(solution)))
    }

    fn hinted(
        &self,
        exposure: &Exposure,
        measured: &Measured,
        hint: &Hint,
    ) -> anyhow::Result<Result<Solution, NoSolution>> {
        let stars = self.catalogue.at_epoch(hint::epoch_year(exposure.header()).unwrap_or(EPOCH_YEAR));
        let found = solve(&detected(exposure, measured), hint, &stars);
        stars.checked()?;
        Ok(found)
    }

    /// `solve-field` gives the place; our own catalogue verifies or rejects it, where it is deep enough.
    fn blindly(
        &self,
        exposure: &Exposure,
        measured: &Measured,
        (program, limit): (&Path, Duration),
        reason: String,
    ) -> anyhow::Result<Result<Solved, String>> {
        let size_px = (exposure.width_px(), exposure.height_px());
        let stated = self.stated_scale(exposure);
        let field = blind::Field { stars: &measured.stars, size_px, scale_arcsec_px: stated };
        let wcs = match blind::solve(program, &field, limit) {
            Ok(Some(wcs)) => wcs,
            Ok(None) => return Ok(Err(format!("{reason}; solve-field found nothing either"))),
            Err(error) => return Ok(Err(format!("{reason}; solve-field failed: {error:#}"))),
        };
        let (ra, dec) = wcs.pixel_to_sky(0.5 * (size_px.0 as f64 - 1.0), 0.5 * (size_px.1 as f64 - 1.0));
        let scale_arcsec_px = wcs.scale_arcsec_px();
        let near = Hint { furthest: Angle::default(), ..Hint::new(ra, dec, scale_arcsec_px) };
        match self.hinted(exposure, measured, &near)? {
            Ok(solution) => return Ok(Ok(solution.into())),
            // Its answer cannot be verified where the catalogue has too few stars.
            Err(NoSolution::CatalogueTooShallow { .. }) => {}
            Err(against) => {
                let place = format!("RA {:.4} Dec {:+.4} deg", ra.degrees(), dec.degrees());
                return Ok(Err(format!("{reason}; solve-field says {place}, which our catalogue denies: {against}")));
            }
        }
        let (rotation_deg, mirrored) = (wcs.rotation_deg(), wcs.mirrored());
        Ok(Ok(Solved { ra, dec, scale_arcsec_px, rotation_deg, mirrored, verified: None, wcs }))
    }
}

/// Hints of the options, and of the header where they are absent.
fn known(
    header: &hint::HeaderHints,
    asked: Option<hint::Place>,
    scale_arcsec_px: Option<f64>,
) -> anyhow::Result<Vec<Hint>> {
    let pairs = header.pairs(asked, scale_arcsec_px.map(|scale| (scale, imaging::solve::FIRST_LIGHT)))?;
    let hint = |((ra, dec), (scale, tolerance)): (hint::Place, hint::Scale)| {
        let scale_tolerance = tolerance.max(KNOWN_OPTICS);
        Hint { scale_tolerance, wrong_scales: true, ..Hint::new(ra, dec, scale) }
    };
    Ok(pairs.into_iter().map(hint).collect())
}

fn detected<'a>(exposure: &Exposure, measured: &'a Measured) -> Detected<'a> {
    Detected {
        stars: &measured.stars,
        width: exposure.width_px(),
        height: exposure.height_px(),
        quality: Some(&measured.quality),
    }
}

/// The JSON answer: the geometric centre, ICRS at the epoch of the frame; null where there is no solution.
fn object(exposure: &Exposure, answer: &Result<Solved, String>) -> Value {
    let solved = answer.as_ref().ok();
    let verified = solved.and_then(|s| s.verified);
    let blind = solved.filter(|s| s.verified.is_none()).map(|_| BLIND);
    json!({
        "file": exposure.file.display().to_string(),
        "solved": solved.is_some(),
        "ra_deg": solved.and_then(|s| rounded(s.ra.degrees(), 7)),
        "dec_deg": solved.and_then(|s| rounded(s.dec.degrees(), 7)),
        "scale_arcsec_px": solved.and_then(|s| significant(s.scale_arcsec_px, 7)),
        "rotation_deg": solved.and_then(|s| rounded(s.rotation_deg, 4)),
        "mirrored": solved.map(|s| s.mirrored),
        "matched": verified.map(|(matched, ..)| matched),
        "rms_px": verified.and_then(|(_, rms, _)| rounded(rms, 4)),
        "false_alarm": verified.and_then(|(.., chance)| significant(chance, 3)),
        "reason": answer.as_ref().err().map(String::as_str).or(blind),
        "hdu": exposure.hdu(),
        "wcs": solved.map(|s| write_wcs::object(&s.wcs)),
    })
}

/// The text for a solution that our own catalogue does not show.
const BLIND: &str = "by solve-field alone: the catalogue does not show this field";

fn sentence(exposure: &Exposure, answer: &Result<Solved, String>) -> String {
    let file = exposure.file.display();
    let s = match answer {
        Err(reason) => return format!("{file}: not solved: {reason}"),
        Ok(solved) => solved,
    };
    let known = s.verified.map_or(BLIND.to_owned(), |(matched, rms_px, false_alarm)| {
        format!("{matched} stars, rms {rms_px:.2} px, false alarm {false_alarm:.0e}")
    });
    let wcs = write_wcs::sentence(&s.wcs);
    format!(
        "{file}: centre RA {:.6} Dec {:+.6} deg, {:.4} arcsec/px, +y {:.3} deg from north{}, {known}\n{wcs}",
        s.ra.degrees(),
        s.dec.degrees(),
        s.scale_arcsec_px,
        s.rotation_deg,
        if s.mirrored { ", mirrored" } else { "" },
    )
}
