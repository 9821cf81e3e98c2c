//! The half-flux diameter of one star: light within a circle against the circle's radius.

use crate::clean::Clean;
use crate::hfd::StarHfd;

/// The circle's radius over the HFD: holds all light of a disc (0.71), a thin ring (0.5) and a Gaussian (1.1).
const RADIUS: f64 = 1.75;
/// Smallest circle, px: a star of one pixel must fit in, and some sky with it.
const SMALLEST_PX: f64 = 3.0;
/// Greatest circle, px; larger stars are binned first.
const LARGEST_PX: f64 = 70.0;
/// Looks at most: each takes the circle of the last HFD.
const LOOKS: usize = 8;
/// Radii at which the light is added up.
const RINGS: usize = 256;
/// Pixels of smaller circles are divided in 3 x 3, so that steps of whole pixels do not show.
const DIVIDED_PX: f64 = 16.0;
/// What dividing a pixel's light evenly over 3 x 3 places adds to the square of a Gaussian's HFD, px^2: 8 ln 2 times the
/// variance (1 - 1/9) / 12.
const DIVIDING_PX2: f64 = 0.410_7;
/// A circle of which neighbours take more than this share shows nothing.
const MOST_MASKED: f64 = 0.4;

/// Another star: where it is, and within which radius (px) its light counts.
pub(super) type Neighbour = (f64, f64, f64);

/// Looks at the star near a place, beginning with the expected HFD; None when there is no light, when the star runs
/// away or off the frame, or when neighbours cover it.
pub(super) fn look(
    clean: &Clean,
    gain_e_per_adu: f64,
    near: (f64, f64),
    expected_px: f64,
    neighbours: &[Neighbour],
) -> Option<StarHfd> {
    let (mut x, mut y) = near;
    let mut radius = (RADIUS * expected_px).clamp(SMALLEST_PX, LARGEST_PX);
    let mut found = None;
    for _ in 0..LOOKS {
        let circle = Circle { clean, x, y, radius, neighbours };
        let sky = circle.sky()?;
        let light = circle.light(sky.level)?;
        let star = light.star(&circle, &sky, gain_e_per_adu)?;
        let next = (RADIUS * star.hfd_px).max(SMALLEST_PX);
        let moved = (star.x_px - x).hypot(star.y_px - y);
        let is_settled = (next / radius - 1.0).abs() < 0.04 && moved < 0.03 * radius;
        // not further than the circle reaches, however often it grew
        if next > LARGEST_PX || (star.x_px - near.0).hypot(star.y_px - near.1) > next.max(radius) {
            return None;
        }
        (x, y, radius) = (star.x_px, star.y_px, next);
        found = Some(star);
        if is_settled {
            break;
        }
    }
    found
}

/// Where is looked.
struct Circle<'a> {
    clean: &'a Clean,
    x: f64,
    y: f64,
    radius: f64,
    neighbours: &'a [Neighbour],
}

/// What the ring around says.
struct RingSky {
    level: f64,
    pixels: f64,
}

/// Light in the circle.
struct ApertureLight {
    /// By radius.
    rings: [f64; RINGS],
    flux: f64,
    x: f64,
    y: f64,
    pixels: f64,
}

impl Circle<'_> {
    /// Median between 1 and 1.5 radii; None when hardly any of it is on the frame and free.
    fn sky(&self) -> Option<RingSky> {
        let (inner, outer) = (self.radius + 1.0, 1.5 * self.radius + 3.0);
        let (columns, rows) = self.window(outer);
        let mut values = Vec::new();
        for row in rows {
            let dy = row as f64 - self.y;
            let line = &self.clean.pixels[row * self.clean.width..][..self.clean.width];
            for column in columns.clone() {
                let dx = column as f64 - self.x;
                let squared = dx * dx + dy * dy;
                if squared > inner * inner && squared <= outer * outer && !self.is_masked(dx, dy) {
                    values.push(line[column]);
                }
            }
        }
        let pixels = values.len() as f64;
        let level = crate::background::median_in_place(&mut values)?;
        (pixels >= 12.0).then_some(RingSky { level: f64::from(level), pixels })
    }

    fn light(&self, level: f64) -> Option<ApertureLight> {
        let (left, right) = (self.x - self.radius, self.x + self.radius);
        let (top, bottom) = (self.y - self.radius, self.y + self.radius);
        let (last_x, last_y) = ((self.clean.width - 1) as f64, (self.clean.height - 1) as f64);
        // a star cut by the edge has no size
        if left < -0.5 || top < -0.5 || right > last_x + 0.5 || bottom > last_y + 0.5 {
            return None;
        }
        let parts: i32 = if self.radius < DIVIDED_PX { 3 } else { 1 };
        let share = 1.0 / f64::from(parts * parts);
        let offsets: Vec<f64> = (0..parts).map(|n| (f64::from(n) + 0.5) / f64::from(parts) - 0.5).collect();
        let per_px = RINGS as f64 / self.radius;
        let mut light = ApertureLight { rings: [0.0; RINGS], flux: 0.0, x: 0.0, y: 0.0, pixels: 0.0 };
        let mut masked = 0.0;
        let (columns, rows) = self.window(self.radius + 1.0);
        for row in rows {
            let dy = row as f64 - self.y;
            for column in columns.clone() {
                let dx = column as f64 - self.x;
                let value = if self.is_masked(dx, dy) {
                    masked += 1.0;
                    // the other side of the star shows what is hidden
                    if self.is_masked(-dx, -dy) { 0.0 } else { self.value_at(-dx, -dy) - level }
                } else {
                    f64::from(self.clean.pixels[row * self.clean.width + column]) - level
                };
                for part_y in &offsets {
                    for part_x in &offsets {
                        let (x, y) = (dx + part_x, dy + part_y);
                        let ring = ((x * x + y * y).sqrt() * per_px) as usize;
                        if ring < RINGS {
                            light.rings[ring] += share * value;
                            light.x += share * value * x;
                            light.y += share * value * y;
                            light.pixels += share;
                        }
                    }
                }
            }
        }
        light.flux = light.rings.iter().sum();
        (masked <= MOST_MASKED * light.pixels && light.flux > 0.0).then_some(light)
    }

    fn window(&self, reach: f64) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        let range = |at: f64, length: usize| {
            let end = ((at + reach).floor() + 1.0).max(0.0) as usize;
            ((at - reach).ceil().max(0.0) as usize).min(length)..end.min(length)
        };
        (range(self.x, self.clean.width), range(self.y, self.clean.height))
    }

    /// Nearer to a neighbour than to the star, and within its light.
    fn is_masked(&self, dx: f64, dy: f64) -> bool {
        self.neighbours.iter().any(|(x, y, reach)| {
            let apart = (self.x + dx - x).powi(2) + (self.y + dy - y).powi(2);
            apart <= reach * reach && apart < dx * dx + dy * dy
        })
    }

    fn value_at(&self, dx: f64, dy: f64) -> f64 {
        let inside = |at: f64, length: usize| (at.round().max(0.0) as usize).min(length - 1);
        let (column, row) = (inside(self.x + dx, self.clean.width), inside(self.y + dy, self.clean.height));
        f64::from(self.clean.pixels[row * self.clean.width + column])
    }
}

impl ApertureLight {
    /// Radius with half of the light, from the flux outwards; None when noise hides it.
    fn star(&self, circle: &Circle, sky: &RingSky, gain_e_per_adu: f64) -> Option<StarHfd> {
        let half = 0.5 * self.flux;
        let width = circle.radius / RINGS as f64;
        let mut inside = 0.0;
        let mut half_radius = None;
        for (ring, light) in self.rings.iter().enumerate() {
            if inside + light >= half {
                half_radius = Some((ring as f64 + (half - inside) / light) * width);
                break;
            }
            inside += light;
        }
        let half_radius = half_radius?;
        let noise = f64::from(circle.clean.background.noise.at(
            (circle.x.round().max(0.0) as usize).min(circle.clean.width - 1),
            (circle.y.round().max(0.0) as usize).min(circle.clean.height - 1),
        ));
        // the ring's median is uncertain too: 1.57 times the variance of its mean
        let sky_variance = self.pixels * noise * noise * (1.0 + 1.57 * self.pixels / sky.pixels);
        let flux_error = (sky_variance + self.flux / gain_e_per_adu).sqrt();
        // light per px of radius about the half-flux radius
        let middle = (half_radius / width) as usize;
        let reach = (middle / 5).max(4);
        let (first, end) = (middle.saturating_sub(reach), (middle + reach + 1).min(RINGS));
        let slope = self.rings[first..end].iter().sum::<f64>() / ((end - first) as f64 * width);
        // the light inside and outside of the half-flux circle, each with half of the variance, share the error
        let error_px = flux_error / slope.max(0.05 * self.flux / circle.radius);
        let hfd_px = 2.0 * half_radius;
        let added = if circle.radius < DIVIDED_PX { DIVIDING_PX2 } else { 0.0 };
        Some(StarHfd {
            x_px: circle.x + self.x / self.flux,
            y_px: circle.y + self.y / self.flux,
            hfd_px: (hfd_px * hfd_px - added).max(0.25 * hfd_px * hfd_px).sqrt(),
            error_px,
            flux_adu: self.flux,
            snr: self.flux / flux_error,
        })
    }
}
