//! The limits that IRAF's display chose: a line through the sorted counts of a sample of pixels (IRAF, `zscale`; the numbers
//! are those of its help page).

/// Pixels that are looked at.
const SAMPLE: usize = 1000;
const CONTRAST: f64 = 0.25;
const MOST_REJECTED_PART: f64 = 0.5;
const LEAST_PIXELS: usize = 5;
const REJECT_SIGMA: f64 = 2.5;
const ITERATIONS: usize = 5;

/// Black and white; `None` where no pixel has a value.
pub(crate) fn limits(pixels: &[f32]) -> Option<(f32, f32)> {
    // A step that shares no factor with the length of a row meets all columns.
    let step = (pixels.len() / SAMPLE).max(1) | 1;
    let mut sample: Vec<f32> = pixels.iter().step_by(step).copied().filter(|value| value.is_finite()).collect();
    sample.sort_unstable_by(f32::total_cmp);
    let (low, high) = (*sample.first()?, *sample.last()?);
    let (slope, used) = fit(&sample);
    let least = LEAST_PIXELS.max((sample.len() as f64 * MOST_REJECTED_PART) as usize);
    if used < least {
        return Some((low, high));
    }
    let middle = (sample.len() - 1) / 2;
    let median = f64::from(*sample.get(middle)?);
    let slope = slope / CONTRAST;
    let black = median - middle as f64 * slope;
    let white = median + (sample.len() - 1 - middle) as f64 * slope;
    Some(((black as f32).max(low), (white as f32).min(high)))
}

/// The slope of a line through the sorted sample without what is far from it and from the next ones, and how many stayed.
fn fit(sample: &[f32]) -> (f64, usize) {
    let mut is_used = vec![true; sample.len()];
    let grow = (sample.len() / 100).max(1) / 2;
    let (mut slope, mut left) = (0.0, sample.len());
    for _ in 0..ITERATIONS {
        let used = || sample.iter().zip(&is_used).enumerate().filter(|(_, (_, used))| **used);
        let count = used().count() as f64;
        if count < 2.0 {
            return (slope, count as usize);
        }
        let mean_x = used().map(|(x, _)| x as f64).sum::<f64>() / count;
        let mean_y = used().map(|(_, (y, _))| f64::from(*y)).sum::<f64>() / count;
        let (mut xx, mut xy) = (0.0, 0.0);
        for (x, (y, _)) in used() {
            xx += (x as f64 - mean_x).powi(2);
            xy += (x as f64 - mean_x) * (f64::from(*y) - mean_y);
        }
        slope = if xx > 0.0 { xy / xx } else { 0.0 };
        let away = |x: usize, y: f32| f64::from(y) - mean_y - slope * (x as f64 - mean_x);
        let variance = used().map(|(x, (y, _))| away(x, *y).powi(2)).sum::<f64>() / count;
        let limit = REJECT_SIGMA * variance.sqrt();
        let far: Vec<usize> = used().filter(|(x, (y, _))| away(*x, **y).abs() > limit).map(|(x, _)| x).collect();
        for x in far {
            let last = (x + grow).min(sample.len() - 1);
            is_used.iter_mut().take(last + 1).skip(x.saturating_sub(grow)).for_each(|used| *used = false);
        }
        let now = is_used.iter().filter(|used| **used).count();
        if now == left {
            break;
        }
        left = now;
    }
    (slope, left)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stars_do_not_move_the_limits_of_a_sky() {
        let mut pixels: Vec<f32> =
            (0..100_000_u32).map(|i| 1000.0 + (i.wrapping_mul(2_654_435_761) >> 20) as f32 / 100.0).collect();
        let (black, white) = limits(&pixels).unwrap();
        assert!((1000.0..1010.0).contains(&black) && (1030.0..1041.0).contains(&white), "{black} {white}");
        pixels.iter_mut().step_by(997).for_each(|pixel| *pixel = 60_000.0);
        let (_, with_stars) = limits(&pixels).unwrap();
        assert!(with_stars < 1200.0, "{with_stars}");
    }

    #[test]
    fn few_equal_or_no_pixels_are_no_division_by_zero() {
        assert_eq!(limits(&[7.0; 100]), Some((7.0, 7.0)));
        assert_eq!(limits(&[3.0]), Some((3.0, 3.0)));
        assert_eq!(limits(&[f32::NAN; 10]), None);
        assert_eq!(limits(&[]), None);
    }
}
