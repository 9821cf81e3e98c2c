//! A piece of the sky laid flat: the catalogue's brightest stars around a place where the frame may be.

use units::Angle;

use super::field::FrameStars;
use super::source::{Stars, brightest};
use crate::tangent::TangentPlane;

/// Fewest and most catalogue stars of a tile.
const STARS: (f64, f64) = (30.0, 300.0);
/// ... and so many times the most for a frame that is hidden in part.
const DEEPER: f64 = 3.0;

/// The stars around one direction, px of the hinted scale.
pub(super) struct Tile {
    pub(super) plane: TangentPlane,
    /// xi (east) and eta (north), px; the brightest first.
    pub(super) stars: Vec<(f64, f64)>,
    /// The frame's centre is looked for within this distance of the tile's, px.
    pub(super) radius: f64,
    /// All stars are within this distance of the tile's centre, px.
    pub(super) reach: f64,
    /// Size of a pixel, rad.
    pub(super) scale: f64,
}

impl Tile {
    /// A tile for frames whose centre lies within `radius` px of a direction, with `depth` times as many catalogue
    /// stars as the frame has for its own area.
    pub(super) fn new(
        source: &impl Stars,
        (ra, dec): (Angle, Angle),
        field: &FrameStars,
        scale: f64,
        radius: f64,
        depth: f64,
    ) -> Self {
        let reach = radius + 0.5 * field.diagonal();
        let share = share(reach, field);
        // a part of the frame shows as many stars as the whole of it would of brighter ones
        let deeper = 1.0 / field.seen_share();
        let most = STARS.1 * deeper.min(DEEPER);
        let count = (depth * deeper * field.spots.len() as f64 * share).clamp(STARS.0, most) as usize;
        let plane = TangentPlane::new(ra, dec);
        let cone = Angle::from_radians((reach * scale).atan());
        let found = brightest(source, ra, dec, cone, count);
        let place = |star: &crate::catalogue::CatalogueStar| {
            plane.project(star.ra, star.dec).map(|(xi, eta)| (xi / scale, eta / scale))
        };
        Self { plane, stars: found.iter().filter_map(place).collect(), radius, reach, scale }
    }

    /// Area of the tile in frames, as far as they show stars.
    pub(super) fn share(&self, field: &FrameStars) -> f64 {
        share(self.reach, field) / field.seen_share()
    }

    /// The direction of a place on the tile, px.
    pub(super) fn direction(&self, (xi, eta): (f64, f64)) -> (Angle, Angle) {
        self.plane.direction(xi * self.scale, eta * self.scale)
    }
}

fn share(reach: f64, field: &FrameStars) -> f64 {
    std::f64::consts::PI * reach * reach / field.area()
}

/// Directions of tiles that cover a disc of `furthest` around a centre without gaps, the nearest first: a hexagonal
/// lattice of discs of `radius`. The first is the centre itself.
pub(super) fn covering(centre: (Angle, Angle), radius: Angle, furthest: Angle) -> Vec<(Angle, Angle)> {
    let step = 3.0_f64.sqrt() * radius.radians();
    let limit = furthest.radians();
    let rings = (limit / (step * 0.75_f64.sqrt())).ceil().clamp(0.0, 2000.0) as i32;
    let mut places = Vec::new();
    for row in -rings..=rings {
        for column in -2 * rings..=2 * rings {
            let x = step * (f64::from(column) + 0.5 * f64::from(row));
            let y = step * 0.75_f64.sqrt() * f64::from(row);
            let far = x.hypot(y);
            if far < limit + radius.radians() {
                places.push((far, x, y));
            }
        }
    }
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let plane = TangentPlane::new(centre.0, centre.1);
    // the lattice is laid out in arc: the tangent plane alone would stretch it
    let stretch = |far: f64| if far > 0.0 { far.tan() / far } else { 1.0 };
    places.into_iter().map(|(far, x, y)| plane.direction(x * stretch(far), y * stretch(far))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tangent::separation;

    #[test]
    fn tiles_leave_no_gap() {
        for dec in [0.0, 60.0, 89.5] {
            let centre = (Angle::from_degrees(0.2), Angle::from_degrees(dec));
            let (radius, furthest) = (Angle::from_degrees(0.4), Angle::from_degrees(3.0));
            let tiles = covering(centre, radius, furthest);
            assert!(separation(tiles[0], centre).degrees() < 1e-9);
            assert!(tiles.len() < 110, "{}", tiles.len());
            let plane = TangentPlane::new(centre.0, centre.1);
            for n in 0..2000 {
                let far = furthest.radians() * (f64::from(n) / 2000.0).sqrt();
                let (sin, cos) = (f64::from(n) * 2.4).sin_cos();
                let at = plane.direction(far.tan() * sin, far.tan() * cos);
                let nearest = tiles.iter().map(|t| separation(*t, at).degrees()).fold(f64::MAX, f64::min);
                assert!(nearest <= 0.4005, "{nearest} at {n}");
            }
        }
    }
}
