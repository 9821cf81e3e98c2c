//! The running median as scipy computes it: of an even number of points the upper one, the ends mirrored.

/// Points in a window: five to the left, the point itself, four to the right.
const SIZE: usize = 10;

/// At the points' own positions. `points` are in order of position.
#[allow(clippy::unnecessary_wraps)] // all smoothers have one shape
pub(super) fn curve(points: &[(f64, f64)]) -> Option<Vec<(f64, f64)>> {
    let values: Vec<f64> = points.iter().map(|(_, y)| *y).collect();
    Some(points.iter().zip(filter(&values, SIZE)).map(|((x, _), y)| (*x, y)).collect())
}

fn filter(values: &[f64], size: usize) -> Vec<f64> {
    let count = values.len() as isize;
    // d c b a | a b c d | d c b a
    let mirrored = |at: isize| {
        let folded = at.rem_euclid(2 * count);
        values[if folded < count { folded } else { 2 * count - 1 - folded } as usize]
    };
    let left = (size / 2) as isize;
    let middle = |n: isize| {
        let mut window: Vec<f64> = (0..size as isize).map(|k| mirrored(n - left + k)).collect();
        window.sort_by(f64::total_cmp);
        window[size / 2]
    };
    (0..count).map(middle).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The golden numbers are from scipy 1.17.1.
    #[test]
    fn the_filter_agrees_with_the_golden_numbers() {
        let values = super::super::tests::RUN.map(|(_, y)| y);
        assert_eq!(filter(&values, 4), [9.0, 9.0, 8.0, 7.2, 3.3, 2.2, 2.2, 3.9, 5.2, 7.1]);
    }
}
