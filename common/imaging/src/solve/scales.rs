//! Scales that are tried when the hinted one does not fit, and how they are reported.

/// Greatest error of a scale around each of [`FACTORS`], as a share: together they leave no gap.
pub(super) const TOLERANCE: f64 = 0.05;
/// Scales in units of the hinted one: a forgotten or unexpected binning, then another reducer or camera, up to 1.43 times
/// the hinted one or its inverse (an error of 30 % of either scale).
pub(super) const FACTORS: [f64; 14] =
    [2.0, 0.5, 1.06, 1.0 / 1.06, 1.17, 1.0 / 1.17, 1.29, 1.0 / 1.29, 1.42, 1.0 / 1.42, 3.0, 1.0 / 3.0, 4.0, 0.25];

/// The scales that were tried, for a sentence; nothing where there were none.
pub(super) fn text_of(others_arcsec_px: &[f64]) -> String {
    if others_arcsec_px.is_empty() {
        return String::new();
    }
    let numbers: Vec<String> = others_arcsec_px.iter().map(|scale| format!("{scale:.3}")).collect();
    let within = 100.0 * TOLERANCE;
    format!(", nor in the hinted field within {within:.0} % of {} arcsec/px", numbers.join(", "))
}

/// The scales that were allowed, for a sentence.
pub(super) fn range_text(scales_arcsec_px: Option<(f64, f64)>) -> String {
    scales_arcsec_px.map_or(String::new(), |(low, high)| format!(" at {low:.3} to {high:.3} arcsec/px"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_thirty_percent_either_way_leave_no_gap() {
        for n in 0..=1000 {
            // the hint's own tolerance is 2 % at least
            let truth = 0.7 + (1.0 / 0.7 - 0.7) * f64::from(n) / 1000.0;
            let own = (truth - 1.0).abs() <= 0.02;
            // a search at `hinted` covers hinted (1 - t) to hinted (1 + t) px per px, that is the same of the truth
            let other = FACTORS.iter().any(|factor| (factor / truth - 1.0).abs() <= TOLERANCE);
            assert!(own || other, "{truth}");
        }
        for binning in [2.0, 3.0, 4.0] {
            assert!(FACTORS.contains(&binning) && FACTORS.iter().any(|f| (f * binning - 1.0).abs() < 1e-9));
        }
    }

    #[test]
    fn a_sentence_names_the_scales() {
        assert_eq!(text_of(&[]), "");
        assert_eq!(text_of(&[0.5, 2.0]), ", nor in the hinted field within 5 % of 0.500, 2.000 arcsec/px");
        assert_eq!(range_text(Some((1.0, 2.5))), " at 1.000 to 2.500 arcsec/px");
        assert_eq!(range_text(None), "");
    }
}
