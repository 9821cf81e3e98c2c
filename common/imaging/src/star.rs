//! One star, and what is wrong with it.

/// A detected star. Places in px, `(0, 0)` being the centre of the first pixel; FITS numbers are greater by one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Star {
    /// Column of the windowed centroid, px.
    pub x_px: f64,
    /// Row of the windowed centroid, px.
    pub y_px: f64,
    /// Standard error of `x_px`, px; never below 0.01.
    pub x_error_px: f64,
    /// Standard error of `y_px`, px; never below 0.01.
    pub y_error_px: f64,
    /// Flux over the whole profile, ADU.
    pub flux_adu: f64,
    /// Standard error of the flux, from sky and photon noise, ADU.
    pub flux_error_adu: f64,
    /// Flux over its error.
    pub snr: f64,
    /// Significance in the matched filter.
    pub significance: f64,
    /// Brightest raw pixel, ADU.
    pub peak_adu: f64,
    /// Full width at half maximum, geometric mean of both axes, px.
    pub fwhm_px: f64,
    /// 1 - minor axis / major axis; the noise of faint stars raises it.
    pub ellipticity: f64,
    /// Direction of the major axis from +x towards +y, degrees, -90 to 90.
    pub angle_deg: f64,
    /// What is wrong with it.
    pub flags: Flags,
}

/// What is wrong with a star.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Flags {
    /// Its peak is at or above the saturation of its camera, or cut off flat: the place is good for plate solving with
    /// less weight, flux and width are not good for anything.
    pub saturated: bool,
    /// Sharper than a star can be (below 0.6 of the median width): a cosmic ray or a cluster of hot pixels.
    pub cosmic: bool,
    /// Longer than wide by more than 1.6.
    pub trailed: bool,
    /// The frame's edge cuts it.
    pub edge: bool,
    /// Another star within 2 FWHM has at least a tenth of its flux.
    pub blended: bool,
}

impl Flags {
    /// Whether flux, place and width can all be trusted.
    pub fn none(self) -> bool {
        self == Self::default()
    }

    /// The words of the flags that are set.
    pub fn words(self) -> Vec<&'static str> {
        let all = [
            (self.saturated, "saturated"),
            (self.cosmic, "cosmic"),
            (self.trailed, "trailed"),
            (self.edge, "edge"),
            (self.blended, "blended"),
        ];
        all.iter().filter(|(set, _)| *set).map(|(_, word)| *word).collect()
    }
}

/// At most `count` stars that cover the frame evenly: the brightest of each cell of 4 x 4, then the second of each,
/// and so on, so that one cluster or bleeding column cannot take all places. What is
/// flagged as cosmic is left out. Each round is in order of flux.
pub fn spread_evenly(stars: &[Star], width: usize, height: usize, count: usize) -> Vec<Star> {
    const SIDE: usize = 4;
    let cell = |at: f64, length: usize| ((at.max(0.0) * SIDE as f64 / length.max(1) as f64) as usize).min(SIDE - 1);
    let mut order: Vec<&Star> = stars.iter().filter(|star| !star.flags.cosmic).collect();
    order.sort_by(|a, b| b.flux_adu.total_cmp(&a.flux_adu));
    let mut taken = [0_usize; SIDE * SIDE];
    // a star's round is the number of brighter ones in its cell
    let mut rounds: Vec<(usize, &Star)> = order
        .into_iter()
        .map(|star| {
            let place = &mut taken[cell(star.y_px, height) * SIDE + cell(star.x_px, width)];
            *place += 1;
            (*place, star)
        })
        .collect();
    rounds.sort_by_key(|(round, _)| *round);
    rounds.into_iter().take(count).map(|(_, star)| *star).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn star(x_px: f64, y_px: f64, flux_adu: f64) -> Star {
        Star {
            x_px,
            y_px,
            x_error_px: 0.01,
            y_error_px: 0.01,
            flux_adu,
            flux_error_adu: 1.0,
            snr: flux_adu,
            significance: flux_adu,
            peak_adu: flux_adu,
            fwhm_px: 3.0,
            ellipticity: 0.0,
            angle_deg: 0.0,
            flags: Flags::default(),
        }
    }

    #[test]
    fn a_bright_cluster_cannot_take_all_places() {
        let cluster = (0..100).map(|n| star(10.0 + f64::from(n % 10), 10.0 + f64::from(n / 10), 1e6));
        let field = (0..16).map(|n| star(f64::from(n % 4) * 256.0 + 200.0, f64::from(n / 4) * 256.0 + 200.0, 100.0));
        let stars: Vec<Star> = cluster.chain(field).collect();
        let chosen = spread_evenly(&stars, 1024, 1024, 20);
        assert_eq!(chosen.len(), 20);
        assert_eq!(chosen.iter().filter(|s| s.flux_adu < 1e5).count(), 15);
        assert!(spread_evenly(&stars, 1024, 1024, 1000).len() == stars.len());
        assert!(spread_evenly(&[], 0, 0, 5).is_empty());
    }

    #[test]
    fn cosmic_rays_are_not_chosen() {
        let mut ray = star(5.0, 5.0, 1e9);
        ray.flags.cosmic = true;
        assert_eq!(ray.flags.words(), ["cosmic"]);
        assert_eq!(spread_evenly(&[ray, star(50.0, 50.0, 1.0)], 100, 100, 5).len(), 1);
    }
}
