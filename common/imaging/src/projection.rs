//! How far the light moved, for frames whose stars cannot be listed: crowded, defocused, saturated or nebulous fields.
//!
//! The way of donuts (McCormac et al. 2013, PASP 125, 548), sums over rows and over columns, but of each bright patch
//! for itself: sums over a whole frame find a shift between any two frames. Patches are where 4 x 4 pixels together
//! stand out of the noise; their places are the middles of their sums. The shift is the one that most patches agree
//! on, and only if chance alone would hardly bring as many together.

use crate::clean::Clean;
use crate::shift::{Method, NoShift, Shift, chance, most_frequent_difference};

/// Pixels of a block along either axis.
const BLOCK: usize = 4;
/// Significance of a block that belongs to a patch, and share of the frame that patches may cover: where they cover
/// more, a higher significance is asked for.
const SIGNIFICANCE: f32 = 5.0;
const COVERED: f64 = 0.15;
/// Pixels below so many sigma add nothing to the sums of a patch that has one of at least twice as many.
const CORE: f32 = 3.0;
/// A patch with more than this share of its light in one pixel is a defect of the detector.
const ONE_PIXEL: f64 = 0.8;
/// So is one of at most two blocks across and at least so many along: a column or a row.
const LINE_BLOCKS: usize = 12;
/// Patches nearer than this to a brighter one are pieces of it, px.
const APART_PX: f64 = 24.0;
/// Patches that are compared, the brightest.
const MOST: usize = 100;
/// Shifts that are looked for, as a share of the frame.
const REACH: f64 = 0.4;
/// Patches agree on a shift within this, px.
const AGREE_PX: f64 = 3.0;
/// Standard error of a place at least: the pixels' phase, px.
const FLOOR_PX: f64 = 0.03;
/// No other shift may be shared by more than this part of the patches that share the best one.
const OTHER: f64 = 0.7;

/// The shift between two cleaned frames: check minus reference, up to four tenths of the frame. It has no rotation.
///
/// # Errors
/// [`NoShift`] when the frames differ in shape, or have no shift that is better than any other (no stars, clouds, other
/// fields).
pub fn from_projections(reference: &Clean, check: &Clean) -> Result<Shift, NoShift> {
    between(&Profiles::of(reference), &Profiles::of(check))
}

/// The same from profiles that were kept.
///
/// # Errors
/// As [`from_projections`].
pub fn between(reference: &Profiles, check: &Profiles) -> Result<Shift, NoShift> {
    let (width, height) = (reference.width, reference.height);
    if (width, height) != (check.width, check.height) {
        return Err(NoShift::Shapes(width, height, check.width, check.height));
    }
    let (r, c) = (&reference.patches, &check.patches);
    let no_peak = |agree| NoShift::NoPeak { reference: r.len(), check: c.len(), agree };
    let is_near = |(dx, dy): &(f64, f64)| dx.abs() <= REACH * width as f64 && dy.abs() <= REACH * height as f64;
    let differences: Vec<(f64, f64)> =
        r.iter().flat_map(|r| c.iter().map(|c| (c.x - r.x, c.y - r.y))).filter(is_near).collect();
    let mut at = most_frequent_difference(differences.iter().copied()).ok_or(no_peak(0))?;
    let mut found = None;
    // the vote is good to a few px
    for reach_px in [2.0 * AGREE_PX, AGREE_PX, AGREE_PX] {
        let mean = Mean::of(&mutual(r, c, at, reach_px)).ok_or(no_peak(0))?;
        at = (mean.x, mean.y);
        found = Some(mean);
    }
    let mean = found.ok_or(no_peak(0))?;
    let inside = |x: f64, y: f64| (0.0..width as f64).contains(&x) && (0.0..height as f64).contains(&y);
    let of_reference = r.iter().filter(|p| inside(p.x + at.0, p.y + at.1)).count();
    let of_check = c.iter().filter(|p| inside(p.x - at.0, p.y - at.1)).count();
    let common_px2 = (width as f64 - at.0.abs()) * (height as f64 - at.1.abs());
    let by_chance = chance::Agreement {
        agree: mean.agree,
        pairs: of_reference * of_check,
        area_px2: common_px2,
        reach_px: AGREE_PX,
        shift_px: at.0.hypot(at.1),
    };
    let elsewhere = differences.iter().filter(|(dx, dy)| (dx - at.0).hypot(dy - at.1) > 4.0 * AGREE_PX).copied();
    let other = most_frequent_difference(elsewhere).map_or(0, |other| mutual(r, c, other, AGREE_PX).len());
    if !by_chance.is_sure() || other as f64 > OTHER * mean.agree as f64 {
        return Err(no_peak(mean.agree));
    }
    Ok(Shift {
        dx_px: mean.x,
        dy_px: mean.y,
        rotation_deg: 0.0,
        covariance: [[mean.x_variance, 0.0, 0.0], [0.0, mean.y_variance, 0.0], [0.0; 3]],
        stars: 0,
        transparency: None,
        method: Method::Projections,
    })
}

/// Patches that are each other's nearest within `reach_px`, the reference's moved by `at`.
fn mutual<'a>(
    r: &'a [PatchCentroid],
    c: &'a [PatchCentroid],
    at: (f64, f64),
    reach_px: f64,
) -> Vec<(&'a PatchCentroid, &'a PatchCentroid)> {
    let apart = |r: &PatchCentroid, c: &PatchCentroid| (c.x - r.x - at.0).hypot(c.y - r.y - at.1);
    let nearest = |r: &PatchCentroid| c.iter().min_by(|a, b| apart(r, a).total_cmp(&apart(r, b)));
    let owner = |c: &PatchCentroid| r.iter().min_by(|a, b| apart(a, c).total_cmp(&apart(b, c)));
    let pairs = r.iter().filter_map(|r| nearest(r).map(|c| (r, c)));
    pairs.filter(|(r, c)| apart(r, c) <= reach_px && owner(c).is_some_and(|back| std::ptr::eq(back, *r))).collect()
}

/// What is left of a frame for this: its bright patches.
#[derive(Debug, Clone, PartialEq)]
pub struct Profiles {
    width: usize,
    height: usize,
    patches: Vec<PatchCentroid>,
}

/// The middle of a patch's sums, and what noise makes of it, px.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PatchCentroid {
    x: f64,
    y: f64,
    error_px: f64,
    flux: f64,
}

/// The weighted mean of the differences of pairs.
struct Mean {
    x: f64,
    y: f64,
    x_variance: f64,
    y_variance: f64,
    agree: usize,
}

impl Mean {
    /// The scatter of the pairs counts where it is more than their errors say. None of none.
    fn of(pairs: &[(&PatchCentroid, &PatchCentroid)]) -> Option<Self> {
        let weight = |r: &PatchCentroid, c: &PatchCentroid| {
            1.0 / (r.error_px.powi(2) + c.error_px.powi(2) + 2.0 * FLOOR_PX.powi(2))
        };
        let weights: f64 = pairs.iter().map(|(r, c)| weight(r, c)).sum();
        let along = |of: fn(&PatchCentroid) -> f64| {
            let mean = pairs.iter().map(|(r, c)| weight(r, c) * (of(c) - of(r))).sum::<f64>() / weights;
            let squares: f64 = pairs.iter().map(|(r, c)| weight(r, c) * (of(c) - of(r) - mean).powi(2)).sum();
            let scatter = squares / (pairs.len() as f64 - 1.0).max(1.0);
            (mean, scatter.max(1.0) / weights)
        };
        let ((x, x_variance), (y, y_variance)) = (along(|patch| patch.x), along(|patch| patch.y));
        (weights > 0.0).then_some(Self { x, y, x_variance, y_variance, agree: pairs.len() })
    }
}

impl Profiles {
    /// Of a cleaned frame.
    pub fn of(clean: &Clean) -> Self {
        let blocks = Blocks::of(clean);
        let mut significance = SIGNIFICANCE;
        while blocks.covered(significance) > COVERED {
            significance *= 2.0;
        }
        let mut all: Vec<PatchCentroid> =
            blocks.groups(significance).iter().filter_map(|group| blocks.patch(group)).collect();
        all.sort_by(|a, b| b.flux.total_cmp(&a.flux));
        let mut patches: Vec<PatchCentroid> = Vec::new();
        for patch in all {
            if patches.len() < MOST && patches.iter().all(|p| (p.x - patch.x).hypot(p.y - patch.y) >= APART_PX) {
                patches.push(patch);
            }
        }
        Self { width: clean.width, height: clean.height, patches }
    }
}

/// Significance of the light in blocks of pixels.
struct Blocks<'a> {
    clean: &'a Clean,
    columns: usize,
    rows: usize,
    significance: Vec<f32>,
}

impl<'a> Blocks<'a> {
    fn of(clean: &'a Clean) -> Self {
        let (columns, rows) = (clean.width / BLOCK, clean.height / BLOCK);
        let mut significance = vec![0.0; columns * rows];
        let mut sigma = vec![0.0; clean.width];
        for (y, line) in clean.pixels.chunks(clean.width.max(1)).enumerate().take(rows * BLOCK) {
            clean.background.noise.row(y, &mut sigma);
            let out = significance.iter_mut().skip(y / BLOCK * columns).take(columns);
            for ((out, pixels), sigma) in out.zip(line.chunks(BLOCK)).zip(sigma.chunks(BLOCK)) {
                let per_sigma = 1.0 / (sigma.iter().sum::<f32>()).max(f32::MIN_POSITIVE);
                *out += pixels.iter().sum::<f32>() * per_sigma;
            }
        }
        Self { clean, columns, rows, significance }
    }

    fn covered(&self, significance: f32) -> f64 {
        let above = self.significance.iter().filter(|block| **block > significance).count();
        above as f64 / self.significance.len().max(1) as f64
    }

    /// Blocks above the significance that touch each other, as (column, row).
    fn groups(&self, significance: f32) -> Vec<Vec<(usize, usize)>> {
        let mut is_open: Vec<bool> = self.significance.iter().map(|block| *block > significance).collect();
        let mut groups = Vec::new();
        for start in 0..is_open.len() {
            if !std::mem::take(&mut is_open[start]) {
                continue;
            }
            let mut group = vec![(start % self.columns, start / self.columns)];
            let mut next = 0;
            while let Some((x, y)) = group.get(next).copied() {
                next += 1;
                for row in y.saturating_sub(1)..(y + 2).min(self.rows) {
                    for column in x.saturating_sub(1)..(x + 2).min(self.columns) {
                        if std::mem::take(&mut is_open[row * self.columns + column]) {
                            group.push((column, row));
                        }
                    }
                }
            }
            groups.push(group);
        }
        groups
    }

    /// The middle of the sums over rows and columns of a group and the blocks around it; None for defects and for what
    /// the edge of the frame cuts.
    fn patch(&self, group: &[(usize, usize)]) -> Option<PatchCentroid> {
        let range = |of: fn(&(usize, usize)) -> usize| Some((group.iter().map(of).min()?, group.iter().map(of).max()?));
        let ((left, right), (top, bottom)) = (range(|block| block.0)?, range(|block| block.1)?);
        let (across, along) = ((right - left).min(bottom - top) + 1, (right - left).max(bottom - top) + 1);
        let is_cut = left == 0 || top == 0 || right + 1 >= self.columns || bottom + 1 >= self.rows;
        if is_cut || (across <= 2 && along >= LINE_BLOCKS) {
            return None;
        }
        let (width, clean) = (self.clean.width, self.clean);
        let columns = (left - 1) * BLOCK..(right + 2) * BLOCK;
        let rows = (top - 1) * BLOCK..(bottom + 2) * BLOCK;
        let middle = (BLOCK * (left + right + 1) / 2, BLOCK * (top + bottom + 1) / 2);
        let sigma = clean.background.noise.at(middle.0, middle.1);
        let lines = || rows.clone().map(|y| (y, &clean.pixels[y * width + columns.start..y * width + columns.end]));
        let peak = lines().flat_map(|(_, line)| line).fold(0.0_f32, |peak, pixel| peak.max(*pixel));
        let floor = if peak >= 2.0 * CORE * sigma { CORE * sigma } else { 0.0 };
        let (mut sums_x, mut sums_y) = (vec![0.0; columns.len()], vec![0.0; rows.len()]);
        let mut used = Vec::new();
        for ((y, line), sum_y) in lines().zip(&mut sums_y) {
            for ((x, pixel), sum_x) in columns.clone().zip(line).zip(&mut sums_x) {
                if *pixel > floor || floor == 0.0 {
                    let light = f64::from(pixel - floor);
                    *sum_x += light;
                    *sum_y += light;
                    used.push((x as f64, y as f64));
                }
            }
        }
        let flux: f64 = sums_x.iter().sum();
        let middle = |sums: &[f64], from: usize| {
            sums.iter().enumerate().map(|(n, sum)| (from + n) as f64 * sum).sum::<f64>() / flux
        };
        let (x, y) = (middle(&sums_x, columns.start), middle(&sums_y, rows.start));
        let arms: f64 = used.iter().map(|(px, py)| 0.5 * ((px - x).powi(2) + (py - y).powi(2))).sum();
        let error_px = f64::from(sigma) * arms.sqrt() / flux;
        let is_defect = f64::from(peak - floor) > ONE_PIXEL * flux;
        (flux > 0.0 && error_px.is_finite() && !is_defect).then_some(PatchCentroid { x, y, error_px, flux })
    }
}
