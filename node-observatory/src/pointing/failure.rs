//! What to do about a frame that does not show where it looks.

use imaging::NoSolution;

/// What may help.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Remedy {
    /// Twice the exposure.
    Longer,
    /// A quarter of the exposure.
    Shorter,
    /// Time, for clouds to pass.
    Wait,
    /// Another frame.
    Again,
    /// Nothing that the sky or the camera could do.
    Nothing,
}

/// The step that follows a class of failure.
pub fn remedy(failure: &NoSolution) -> Remedy {
    match failure {
        NoSolution::TooFewStars { .. } => Remedy::Longer,
        NoSolution::Saturated { .. } => Remedy::Shorter,
        NoSolution::Clouds { .. } => Remedy::Wait,
        NoSolution::Trailed { .. }
        | NoSolution::NoMatch { .. }
        | NoSolution::Blind { .. }
        | NoSolution::Ambiguous { .. } => Remedy::Again,
        NoSolution::CatalogueTooShallow { .. } | NoSolution::Hint { .. } => Remedy::Nothing,
    }
}

/// How often an exposure is lengthened or shortened, at most.
pub const CHANGES: u32 = 3;

/// The exposure time that follows, s; none where it was changed often enough.
pub fn exposure_s(remedy: Remedy, exposure_s: f64, changes: u32) -> Option<f64> {
    let factor = match remedy {
        Remedy::Longer => 2.0,
        Remedy::Shorter => 0.25,
        Remedy::Wait | Remedy::Again | Remedy::Nothing => return None,
    };
    (changes < CHANGES).then_some(exposure_s * factor)
}

/// The first exposure, s: as configured, else that of the row where stars show on it and it wastes no time.
pub fn first_exposure_s(configured_s: Option<f64>, row_s: f64) -> f64 {
    configured_s.unwrap_or_else(|| row_s.clamp(0.5, 30.0))
}

#[cfg(test)]
mod tests {
    use units::Angle;

    use super::*;

    #[test]
    fn the_class_of_a_failure_decides() {
        let far = Angle::from_degrees(1.0);
        let no_match = NoSolution::NoMatch {
            stars: 9,
            catalogue_stars: 20,
            hypotheses: 5,
            searched: far,
            scale_arcsec_px: 1.0,
            others_arcsec_px: Vec::new(),
        };
        for (failure, expected) in [
            (NoSolution::TooFewStars { stars: 1, needed: 4 }, Remedy::Longer),
            (NoSolution::Saturated { stars: 9, pixels_percent: 30.0 }, Remedy::Shorter),
            (NoSolution::Clouds { stars: 3, expected: 40, limit_mag: 14.0 }, Remedy::Wait),
            (NoSolution::Trailed { stars: 20, length_px: 30.0 }, Remedy::Again),
            (no_match, Remedy::Again),
            (NoSolution::Ambiguous { apart: far, matched: 4 }, Remedy::Again),
            (NoSolution::CatalogueTooShallow { stars: 1, field: far }, Remedy::Nothing),
        ] {
            assert_eq!(remedy(&failure), expected, "{failure}");
        }
    }

    #[test]
    fn an_exposure_is_doubled_three_times_and_no_more() {
        let mut exposed_s = first_exposure_s(None, 600.0);
        assert_eq!(exposed_s, 30.0);
        for changes in 0..3 {
            exposed_s = exposure_s(Remedy::Longer, exposed_s, changes).unwrap();
        }
        assert_eq!((exposed_s, exposure_s(Remedy::Longer, exposed_s, 3)), (240.0, None));
        assert_eq!(exposure_s(Remedy::Shorter, first_exposure_s(Some(8.0), 1.0), 0), Some(2.0));
        assert_eq!((first_exposure_s(None, 0.01), exposure_s(Remedy::Wait, 1.0, 0)), (0.5, None));
    }
}
