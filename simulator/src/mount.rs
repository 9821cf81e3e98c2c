//! The machine under the telescope: axes that take time, and the differences between the direction that they report and
//! the direction in which the telescope looks.

use std::f64::consts::TAU;

use sky::{Horizontal, Icrs, Observer};
use units::Angle;

use crate::chance::Chance;
use crate::gear::Gear;
use crate::options::MountOptions;

/// Sidereal rate, arcsec per second.
pub const SIDEREAL_ARCSEC_PER_S: f64 = 15.041_067;
/// Ways of this length and more, deg, end with the whole scatter.
const SCATTERED_DEG: f64 = 1.0;

/// The next state when a slew arrives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// The mount goes on as before.
    Target,
    /// The mount is parked.
    Park,
    /// The mount is at home.
    Home,
}

#[derive(Debug, Clone, Copy)]
struct Slew {
    from: [f64; 2],
    by: [f64; 2],
    elapsed_s: f64,
    duration_s: f64,
    arrival: Arrival,
    /// The whole turn of the declination motor, deg; it turns forward to the north with the tube east of the pier.
    dec_motor_deg: f64,
}

impl Slew {
    /// The part of the way that is done.
    fn part(&self) -> f64 {
        if self.elapsed_s < self.duration_s { self.elapsed_s / self.duration_s } else { 1.0 }
    }
}

/// The mount: the position of its axes, and their errors.
#[derive(Debug)]
pub struct Mount {
    options: MountOptions,
    /// Right ascension and declination that the encoders report, ICRS degrees.
    axes: [f64; 2],
    slew: Option<Slew>,
    /// Rest after a slew before it counts as over, sky seconds.
    pub settle_s: f64,
    settle_left_s: f64,
    /// Whether the right ascension axis follows the sky.
    pub tracking: bool,
    /// Parked.
    pub parked: bool,
    /// At home.
    pub home: bool,
    /// Tube west of the pier, looking east.
    pub pier_west: bool,
    /// Slews to the other side of the meridian leave the tube on its side of the pier.
    pub ignores_flip: bool,
    /// Extra rates while tracking, arcsec per second, in right ascension (coordinate) and declination.
    pub rates: [f64; 2],
    /// `MoveAxis` rates, deg per second.
    pub axis_rates: [f64; 2],
    /// Pulses still to run: seconds left and arcsec per second, per axis.
    pulses: [(f64, f64); 2],
    /// Telescope less encoders, arcsec on the sky (east, north): syncs and drift.
    offset: [f64; 2],
    scatter: [f64; 2],
    /// Of declination, arcsec.
    gear: Gear,
    /// As in the options, unless ordered otherwise.
    dec_pulses_reverse_west: bool,
    tracked_s: f64,
    chance: Chance,
}

impl Mount {
    /// A parked mount whose axes stand at `axes`.
    pub fn parked_at(axes: Icrs, options: MountOptions, seed: u64) -> Self {
        Self {
            options,
            axes: [axes.ra.degrees(), axes.dec.degrees()],
            slew: None,
            settle_s: options.settle_s,
            settle_left_s: 0.0,
            tracking: false,
            parked: true,
            home: false,
            pier_west: false,
            ignores_flip: false,
            rates: [0.0; 2],
            axis_rates: [0.0; 2],
            pulses: [(0.0, 0.0); 2],
            offset: [0.0; 2],
            scatter: [0.0; 2],
            gear: Gear::driving_forward(options.dec_backlash_arcsec),
            dec_pulses_reverse_west: options.dec_pulses_reverse_west,
            tracked_s: 0.0,
            chance: Chance::new(seed, 0x3007),
        }
    }

    /// Where the encoders report that the telescope points.
    pub fn encoders(&self) -> Icrs {
        Icrs::from_degrees(self.axes[0].rem_euclid(360.0), self.axes[1])
    }

    /// Where the telescope looks.
    pub fn looks_at(&self, observer: &Observer) -> Icrs {
        let [east, north] = self.error_arcsec(observer);
        let dec = (self.axes[1] + north / 3600.0).clamp(-90.0, 90.0);
        let ra = self.axes[0] + east / 3600.0 / self.axes[1].to_radians().cos().max(0.01);
        Icrs::from_degrees(ra.rem_euclid(360.0), dec)
    }

    /// The telescope slips in its mount, arcsec to the east and to the north, which no encoder shows.
    pub fn slip(&mut self, [east, north]: [f64; 2]) {
        self.offset[0] += east;
        self.offset[1] += north;
    }

    /// Moving under a slew, an axis rate, or settling.
    pub fn is_slewing(&self) -> bool {
        self.slew.is_some() || self.settle_left_s > 0.0 || self.axis_rates != [0.0; 2]
    }

    /// A guide pulse runs.
    pub fn is_pulse_guiding(&self) -> bool {
        self.pulses.iter().any(|(left_s, _)| *left_s > 0.0)
    }

    /// Where a slew to `target` would put the tube: west of the pier for stars in the east.
    pub fn destination_is_west(&self, observer: &Observer, target: Icrs) -> bool {
        self.options.german && observer.hour_angle(&target).wrapped_signed().degrees() < 0.0
    }

    /// Starts a slew.
    pub fn slew_to(&mut self, observer: &Observer, target: Icrs, arrival: Arrival) {
        let west = if self.ignores_flip { self.pier_west } else { self.destination_is_west(observer, target) };
        let by = [
            Angle::from_degrees(target.ra.degrees() - self.axes[0]).wrapped_signed().degrees(),
            target.dec.degrees() - self.axes[1],
        ];
        // Through the pole both axes of a German mount turn: half a turn less what the target asks anyway.
        let flip_deg = if west == self.pier_west { 0.0 } else { 180.0 - by[0].abs() };
        let dec_motor_deg = if west == self.pier_west {
            self.dec_sense() * by[1]
        } else {
            // Over the pole that is up: what is left of half a turn there, forward or back.
            let zenith = observer.to_icrs(&Horizontal::from_degrees(90.0, 0.0));
            let pole_deg = 180.0_f64.copysign(zenith.dec.degrees());
            (pole_deg - self.axes[1] - target.dec.degrees()) * if west { 1.0 } else { -1.0 }
        };
        let way_deg = flip_deg.max(by[0].abs()).max(by[1].abs());
        let duration_s = way_deg / self.options.slew_deg_per_s;
        self.slew = Some(Slew { from: self.axes, by, elapsed_s: 0.0, duration_s, arrival, dec_motor_deg });
        self.pier_west = west;
        (self.parked, self.home) = (false, false);
        self.axis_rates = [0.0; 2];
        self.pulses = [(0.0, 0.0); 2];
        // A short way leaves the error where it was: gears and tube hardly move.
        let share = (way_deg / SCATTERED_DEG).min(1.0);
        let rest = (1.0 - share * share).sqrt();
        self.scatter =
            self.scatter.map(|arcsec| rest * arcsec + share * self.chance.normal() * self.options.scatter_arcsec);
    }

    /// Stops all motion but tracking.
    pub fn abort(&mut self) {
        self.slew = None;
        self.settle_left_s = 0.0;
        self.axis_rates = [0.0; 2];
        self.pulses = [(0.0, 0.0); 2];
    }

    /// Sets the encoders so that the telescope looks at `here`; the telescope stays where it is.
    pub fn sync(&mut self, here: Icrs) {
        let ra = Angle::from_degrees(self.axes[0] - here.ra.degrees()).wrapped_signed().arcseconds();
        self.offset[0] += ra * here.dec.cos();
        self.offset[1] += (self.axes[1] - here.dec.degrees()) * 3600.0;
        self.axes = [here.ra.degrees(), here.dec.degrees()];
    }

    /// Moves the telescope at `arcsec_per_s` (coordinate rate) along an axis (0 right ascension, 1 declination).
    pub fn pulse(&mut self, axis: usize, arcsec_per_s: f64, duration_s: f64) {
        let reversed = axis == 1 && self.pier_west && self.dec_pulses_reverse_west;
        self.pulses[axis] = (duration_s, if reversed { -arcsec_per_s } else { arcsec_per_s });
    }

    /// Is under way to somewhere; settling is over already.
    pub fn is_under_way(&self) -> bool {
        self.slew.is_some()
    }

    /// Gives the declination gear another play, arcsec; None: as at the start.
    pub fn set_dec_backlash(&mut self, arcsec: Option<f64>) {
        self.gear.set_play(arcsec.unwrap_or(self.options.dec_backlash_arcsec));
    }

    /// Lets pulses to the north go south with the tube west of the pier, or not; None: as at the start.
    pub fn reverse_dec_pulses_west(&mut self, reverse: Option<bool>) {
        self.dec_pulses_reverse_west = reverse.unwrap_or(self.options.dec_pulses_reverse_west);
    }

    /// Play of the declination gear, arcsec.
    pub fn dec_backlash_arcsec(&self) -> f64 {
        self.gear.play()
    }

    /// Lets sky time pass.
    pub fn advance(&mut self, dt: f64) {
        if let Some(mut slew) = self.slew.take() {
            let before = slew.part();
            slew.elapsed_s += dt;
            let part = slew.part();
            self.gear.turn((part - before) * slew.dec_motor_deg * 3600.0);
            self.axes = [slew.from[0] + part * slew.by[0], slew.from[1] + part * slew.by[1]];
            if part < 1.0 {
                self.slew = Some(slew);
                return;
            }
            self.settle_left_s = self.settle_s;
            (self.parked, self.home) = (slew.arrival == Arrival::Park, slew.arrival == Arrival::Home);
            if self.parked {
                self.tracking = false;
            }
            return;
        }
        self.settle_left_s = (self.settle_left_s - dt).max(0.0);
        self.axes[0] += self.axis_rates[0] * dt;
        let mut dec_deg = self.axes[1] + self.axis_rates[1] * dt;
        let [right_ascension, declination] = &mut self.pulses;
        self.axes[0] += run(right_ascension, dt) / 3600.0;
        dec_deg += run(declination, dt) / 3600.0;
        if self.tracking {
            self.tracked_s += dt;
            self.axes[0] += self.rates[0] * dt / 3600.0;
            dec_deg += self.rates[1] * dt / 3600.0;
            let (east, north) = self.options.drift_arcsec_per_min;
            self.offset[0] += east * dt / 60.0;
            self.offset[1] += north * dt / 60.0;
        } else {
            self.axes[0] += SIDEREAL_ARCSEC_PER_S * dt / 3600.0;
        }
        self.turn_dec(dec_deg);
    }

    /// Turns the declination axis from its encoder's reading to another, through its gear.
    fn turn_dec(&mut self, to_deg: f64) {
        let to_deg = to_deg.clamp(-90.0, 90.0);
        self.gear.turn(self.dec_sense() * (to_deg - self.axes[1]) * 3600.0);
        self.axes[1] = to_deg;
    }

    /// Whether the declination motor turns forward (1) or backward (-1) towards the north: through the pole, what was
    /// up on the axis is down.
    fn dec_sense(&self) -> f64 {
        if self.pier_west { -1.0 } else { 1.0 }
    }

    /// Telescope less encoders on the sky, arcsec to the east and to the north.
    ///
    /// Index errors, a polar axis that misses the pole, a tube that bends, worm, drift, syncs, play and chance.
    fn error_arcsec(&self, observer: &Observer) -> [f64; 2] {
        let size = self.options.pointing_error_arcmin * 60.0;
        let (sin_h, cos_h) = observer.hour_angle(&self.encoders()).radians().sin_cos();
        let (sin_dec, cos_dec) = self.axes[1].to_radians().sin_cos();
        let worm = self.options.periodic_error_arcsec * (TAU * self.tracked_s / self.options.worm_period_s).sin();
        [
            size * (0.6 * cos_dec + 0.25 * sin_h * sin_dec) + worm * cos_dec + self.offset[0] + self.scatter[0],
            size * (-0.5 + 0.25 * cos_h + 0.2 * sin_dec) + self.offset[1] + self.scatter[1]
                - self.dec_sense() * self.gear.lag(),
        ]
    }
}

/// Runs a pulse (seconds left, arcsec per second) for so long; gives how far it went, arcsec.
fn run((left_s, arcsec_per_s): &mut (f64, f64), dt: f64) -> f64 {
    let ran_s = left_s.min(dt);
    *left_s -= ran_s;
    *arcsec_per_s * ran_s
}

#[cfg(test)]
mod tests {
    use sky::{EarthOrientation, Place};
    use units::Utc;

    use super::*;

    fn slewed(mount: &mut Mount, observer: &Observer, to: Icrs) -> Icrs {
        mount.slew_to(observer, to, Arrival::Target);
        mount.tracking = true;
        while mount.is_slewing() {
            mount.advance(0.1);
        }
        mount.looks_at(observer)
    }

    #[test]
    fn the_default_mount_is_brought_within_the_default_gate_by_two_corrections() {
        let place = Place::new(Angle::from_degrees(-24.6), Angle::from_degrees(-70.4), 2600.0).unwrap();
        let observer = Observer::new(&place, &EarthOrientation::default(), Utc::from_seconds(1.8e9)).unwrap();
        let gate_deg = 0.1 / 60.0;
        let mut missed_first = 0;
        for seed in 0..60_u32 {
            let target = observer.to_icrs(&Horizontal::from_degrees(60.0, 90.0 + f64::from(seed)));
            let start = observer.to_icrs(&Horizontal::from_degrees(40.0, 120.0));
            let mut mount = Mount::parked_at(start, MountOptions::default(), u64::from(seed));
            let (mut commanded, mut off_deg) = (target, Vec::new());
            for _ in 0..3 {
                let seen = slewed(&mut mount, &observer, commanded);
                let [ra, dec] = [seen.ra.degrees() - target.ra.degrees(), seen.dec.degrees() - target.dec.degrees()];
                let ra = (ra + 180.0).rem_euclid(360.0) - 180.0;
                off_deg.push((ra * target.dec.radians().cos()).hypot(dec));
                commanded =
                    Icrs::from_degrees((commanded.ra.degrees() - ra).rem_euclid(360.0), commanded.dec.degrees() - dec);
            }
            missed_first += usize::from(off_deg.first().is_some_and(|first| *first > gate_deg));
            assert!(off_deg.last().is_some_and(|last| *last < gate_deg), "{seed}: {off_deg:?} deg");
        }
        assert!(missed_first > 50, "without a correction it misses: {missed_first} of 60");
    }
}
