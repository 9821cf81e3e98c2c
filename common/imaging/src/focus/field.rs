//! Where to point for a focus run: a star near the zenith, from the catalogue.
//!
//! Stars are chosen by their real distance from the zenith (the predecessor sorts them and then drops the order);
//! neighbours are counted in the tangent plane of each star, so that neither RA = 0 nor the poles are special.

use units::Angle;

use crate::catalogue::CatalogueStar;

/// How a field is chosen among those near the zenith.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Selection {
    /// The nearest star that is alone in the field; the nearest of all when none is alone.
    #[default]
    Single,
    /// The star with the most others in the field; of equals the nearest.
    Maximal,
    /// The nearest star.
    Any,
}

impl Selection {
    /// From its word in a schedule: single, maximal, any, in any case. None for another word.
    pub fn named(word: &str) -> Option<Self> {
        match word.trim().to_lowercase().as_str() {
            "single" => Some(Self::Single),
            "maximal" => Some(Self::Maximal),
            "any" => Some(Self::Any),
            _ => None,
        }
    }
}

/// What a field must be like.
#[derive(Debug, Clone, PartialEq)]
pub struct Wanted {
    /// Greatest distance from the zenith.
    pub zenith_limit: Angle,
    /// Magnitudes of the stars that count, brightest and faintest, both included.
    pub magnitudes: std::ops::RangeInclusive<f64>,
    /// The camera's field along right ascension and along declination.
    pub field: (Angle, Angle),
    /// How to choose.
    pub selection: Selection,
    /// With more stars than this only the inner half of the distance is looked at, again and again.
    pub most_stars: usize,
}

/// Where to point.
#[derive(Debug, Clone, PartialEq)]
pub struct FocusField {
    /// ICRS right ascension of the field's centre.
    pub ra: Angle,
    /// ICRS declination of the field's centre.
    pub dec: Angle,
    /// Distance from the zenith.
    pub from_zenith: Angle,
    /// The star in the centre; None for the zenith itself, which is taken when no star fits.
    pub star: Option<CatalogueStar>,
    /// Stars within the magnitudes in the field, that one included.
    pub stars: usize,
}

/// Greatest distance from the zenith at which the airmass (secant) is below a limit, on a grid of 0.5 deg: 8 deg for
/// 1.01. Zero for limits of 1 and less, and for NaN.
pub fn zenith_limit(airmass: f64) -> Angle {
    let steps = (0..180).take_while(|n| 1.0 / (0.5 * f64::from(*n)).to_radians().cos() < airmass);
    Angle::from_degrees(0.5 * steps.last().map_or(0.0, f64::from))
}

/// Field of view of so many pixels. The pixels are those of the frame, binned or not, and the size is theirs: the
/// predecessor takes the number of binned pixels and the size of unbinned ones.
pub fn field_of_view(pixels: usize, pixel_um: f64, focal_length_mm: f64) -> Angle {
    let sensor_mm = pixels as f64 * pixel_um * 1e-3;
    Angle::from_radians(2.0 * (0.5 * sensor_mm / focal_length_mm).atan())
}

/// Chooses a field. `stars` is what the catalogue has around the zenith (ICRS, of date); others do no harm.
pub fn choose(stars: &[CatalogueStar], zenith: (Angle, Angle), wanted: &Wanted) -> FocusField {
    let up = unit(zenith.0, zenith.1);
    let mut near: Vec<Near> = stars
        .iter()
        .filter(|star| star.ra.is_finite() && star.dec.is_finite() && wanted.magnitudes.contains(&star.mag))
        .map(|star| Near::of(star, up))
        .filter(|near| near.from_zenith <= wanted.zenith_limit)
        .collect();
    near.sort_by(|a, b| a.from_zenith.degrees().total_cmp(&b.from_zenith.degrees()));
    let mut limit = wanted.zenith_limit;
    while near.len() > wanted.most_stars.max(1) && limit.degrees() > 0.01 {
        limit = limit * 0.5;
        near.truncate(near.partition_point(|near| near.from_zenith <= limit));
    }
    let counts = Counts::new(&near, wanted.field);
    let alone = || (0..near.len()).find(|n| counts.around(*n) == 1);
    let richest = || (0..near.len()).rev().max_by_key(|n| counts.around(*n));
    let chosen = match wanted.selection {
        Selection::Any => None,
        Selection::Single => alone(),
        Selection::Maximal => richest(),
    };
    match near.get(chosen.unwrap_or(0)) {
        Some(star) => FocusField {
            ra: star.star.ra,
            dec: star.star.dec,
            from_zenith: star.from_zenith,
            star: Some(star.star),
            stars: counts.around(chosen.unwrap_or(0)),
        },
        None => FocusField { ra: zenith.0, dec: zenith.1, from_zenith: Angle::default(), star: None, stars: 0 },
    }
}

struct Near {
    star: CatalogueStar,
    at: [f64; 3],
    from_zenith: Angle,
}

impl Near {
    fn of(star: &CatalogueStar, up: [f64; 3]) -> Self {
        let at = unit(star.ra, star.dec);
        // by the chord: exact for small angles
        let chord = (0..3).map(|i| (at[i] - up[i]).powi(2)).sum::<f64>().sqrt();
        Self { star: *star, at, from_zenith: Angle::from_radians(2.0 * (0.5 * chord).clamp(0.0, 1.0).asin()) }
    }
}

/// Stars in order of declination, so that only a strip is searched for each.
struct Counts<'a> {
    near: &'a [Near],
    by_dec: Vec<(f64, usize)>,
    half: (f64, f64),
}

impl<'a> Counts<'a> {
    fn new(near: &'a [Near], field: (Angle, Angle)) -> Self {
        let mut by_dec: Vec<(f64, usize)> = near.iter().enumerate().map(|(n, s)| (s.star.dec.degrees(), n)).collect();
        by_dec.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = |field: Angle| (0.5 * field.degrees().clamp(0.0, 90.0)).to_radians().tan();
        Self { near, by_dec, half: (half(field.0), half(field.1)) }
    }

    /// Stars in the field around one of them, that one included.
    fn around(&self, number: usize) -> usize {
        let Some(centre) = self.near.get(number) else { return 0 };
        let (sin_ra, cos_ra) = centre.star.ra.radians().sin_cos();
        let (sin_dec, cos_dec) = centre.star.dec.radians().sin_cos();
        let east = [-sin_ra, cos_ra, 0.0];
        let north = [-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec];
        // to the corner of the field
        let reach = self.half.0.hypot(self.half.1).atan().to_degrees();
        let dec = centre.star.dec.degrees();
        let first = self.by_dec.partition_point(|(at, _)| *at < dec - reach);
        let strip = self.by_dec[first..].iter().take_while(|(at, _)| *at <= dec + reach);
        let inside = strip.filter(|(_, n)| {
            let at = self.near[*n].at;
            let along = |axis: [f64; 3]| (0..3).map(|i| at[i] * axis[i]).sum::<f64>();
            let depth = along(centre.at);
            depth > 0.0 && along(east).abs() <= self.half.0 * depth && along(north).abs() <= self.half.1 * depth
        });
        inside.count()
    }
}

fn unit(ra: Angle, dec: Angle) -> [f64; 3] {
    [dec.cos() * ra.cos(), dec.cos() * ra.sin(), dec.sin()]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn star(ra_deg: f64, dec_deg: f64, mag: f64) -> CatalogueStar {
        CatalogueStar { ra: Angle::from_degrees(ra_deg), dec: Angle::from_degrees(dec_deg), mag }
    }

    fn wanted(selection: Selection) -> Wanted {
        let field = (Angle::from_degrees(0.5), Angle::from_degrees(0.3));
        Wanted { zenith_limit: zenith_limit(1.01), magnitudes: 0.0..=10.0, field, selection, most_stars: 100_000 }
    }

    /// Offsets in deg from a zenith: a pair near it, a lonely star further out, a cluster at 5 deg.
    fn sky(zenith: (f64, f64)) -> Vec<CatalogueStar> {
        let stretch = 1.0 / zenith.1.to_radians().cos();
        let offsets = [(0.5, 0.0), (0.6, 0.05), (-2.0, 1.0), (0.0, 5.0), (0.1, 5.0), (-0.1, 5.05), (0.05, 4.9)];
        let place = |(x, y): &(f64, f64)| star((zenith.0 + x * stretch).rem_euclid(360.0), zenith.1 + y, 8.0);
        offsets.iter().map(place).collect()
    }

    #[test]
    fn each_selection_finds_its_field_also_across_ra_zero() {
        for zenith in [(120.0, -30.0), (0.2, 10.0), (359.9, -45.0)] {
            let up = (Angle::from_degrees(zenith.0), Angle::from_degrees(zenith.1));
            let field = |selection| choose(&sky(zenith), up, &wanted(selection));
            let dec = |field: &FocusField| field.dec.degrees() - zenith.1;
            let (any, single, maximal) = (field(Selection::Any), field(Selection::Single), field(Selection::Maximal));
            assert!((any.from_zenith.degrees() - 0.5).abs() < 0.01 && any.stars == 2, "{zenith:?} {any:?}");
            assert!((dec(&single) - 1.0).abs() < 1e-9 && single.stars == 1, "{zenith:?} {single:?}");
            assert!(maximal.stars == 4 && dec(&maximal) > 4.8, "{zenith:?} {maximal:?}");
        }
    }

    #[test]
    fn at_the_pole_neighbours_are_counted_by_distance() {
        let stars: Vec<CatalogueStar> = (0..12).map(|n| star(30.0 * f64::from(n), 89.9, 8.0)).collect();
        let field = choose(&stars, (Angle::default(), Angle::from_degrees(89.0)), &wanted(Selection::Maximal));
        // 0.1 deg from the pole all lie within 0.2 deg of each other
        assert!(field.stars >= 7, "{field:?}");
    }

    #[test]
    fn without_a_star_the_zenith_is_taken() {
        let up = (Angle::from_degrees(10.0), Angle::from_degrees(20.0));
        let faint =
            [star(10.0, 20.0, 10.1), star(10.0, 29.0, 5.0), star(f64::NAN, 20.0, 5.0), star(10.0, 20.0, f64::NAN)];
        for stars in [&faint[..], &[]] {
            let field = choose(stars, up, &wanted(Selection::Single));
            assert_eq!((field.ra, field.dec, field.star, field.stars), (up.0, up.1, None, 0));
        }
        let pair = sky((10.0, 20.0));
        let crowded = choose(&pair[..2], up, &wanted(Selection::Single));
        assert!(crowded.star.is_some() && crowded.stars == 2, "the nearest when none is alone");
    }

    #[test]
    fn with_too_many_stars_the_distance_is_halved() {
        let up = (Angle::from_degrees(10.0), Angle::from_degrees(20.0));
        let field = choose(&sky((10.0, 20.0)), up, &Wanted { most_stars: 3, ..wanted(Selection::Maximal) });
        assert!(field.from_zenith.degrees() < 2.5 && field.stars == 2, "{field:?}");
    }

    #[test]
    fn limits_and_fields_are_the_golden_ones() {
        assert_eq!(zenith_limit(1.01).degrees(), 8.0);
        assert_eq!((zenith_limit(1.0).degrees(), zenith_limit(f64::NAN).degrees()), (0.0, 0.0));
        assert!(zenith_limit(f64::INFINITY).degrees() < 90.0);
        // 2048 px of 13.5 um at 8 m: 0.198 deg; 1024 px of 27 um are the same
        let field = field_of_view(2048, 13.5, 8000.0).degrees();
        assert!((field - 0.198_009).abs() < 1e-5 && field == field_of_view(1024, 27.0, 8000.0).degrees(), "{field}");
        assert_eq!(Selection::named("MAXIMAL"), Some(Selection::Maximal));
        assert_eq!(Selection::named("best"), None);
    }

    proptest! {
        #[test]
        fn the_field_is_near_the_zenith_whatever_the_stars(
            stars in prop::collection::vec((0.0_f64..360.0, -90.0_f64..90.0, 0.0_f64..12.0), 0..80),
            ra in 0.0_f64..360.0, dec in -90.0_f64..90.0, which in 0_usize..3,
        ) {
            let stars: Vec<CatalogueStar> = stars.into_iter().map(|(ra, dec, mag)| star(ra, dec, mag)).collect();
            let selection = [Selection::Single, Selection::Maximal, Selection::Any][which];
            let wanted = Wanted { zenith_limit: Angle::from_degrees(40.0), ..wanted(selection) };
            let field = choose(&stars, (Angle::from_degrees(ra), Angle::from_degrees(dec)), &wanted);
            prop_assert!(field.from_zenith.degrees() <= 40.0);
            prop_assert_eq!(field.star.is_none(), field.stars == 0);
        }
    }
}
