//! What the coordinates of a mount show of its motion, whatever its flags say.

use std::collections::VecDeque;

use bus::MachineTime;
use sky::{Icrs, separation};
use units::Angle;

use crate::mount_sight::{MountSight, ReadAt, asked_since};
use crate::now::Now;

/// The sky turns by so much in a second, degrees.
pub const TURN_DEG_PER_S: f64 = 360.985_647_366 / 86_400.0;
/// Readings are compared over at least this long, sky s: some mounts report whole seconds of right ascension.
const LEAST_S: f64 = 4.0;
/// And over no longer than this, sky s: what was before is no motion of now.
const MOST_S: f64 = 30.0;
/// A motion of the sky in altitude and azimuth is not told from none below this, degrees: near the pole.
const LEAST_DEG: f64 = 0.02;

/// How a mount moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// It follows the sky.
    Follows,
    /// It stands: the sky moves past it.
    Stands,
    /// It moves otherwise.
    Moves,
    /// There are too few readings.
    Unknown,
}

/// Pairs of coordinates with the moments of their questions.
#[derive(Debug, Default)]
struct Pairs(VecDeque<([f64; 2], Now)>);

impl Pairs {
    fn note(&mut self, pair: ReadAt<[f64; 2]>, since: MachineTime) {
        self.0.retain(|(_, asked)| asked.machine >= since);
        let Some((pair, asked)) = pair else { return };
        if self.0.back().is_some_and(|(_, last)| last.machine >= asked.machine) {
            return;
        }
        self.0.push_back((pair, asked));
        // The oldest goes where the next one is old enough to compare with.
        while self.0.get(1).is_some_and(|(_, second)| asked.sky.since(second.sky).as_secs_f64() >= MOST_S) {
            self.0.pop_front();
        }
    }

    /// The first and the last pair, and the sky time between them, s.
    fn ends(&self) -> Option<([f64; 2], [f64; 2], f64)> {
        let ((first, then), (last, now)) = self.0.front().zip(self.0.back())?;
        let seconds = now.sky.since(then.sky).as_secs_f64();
        (seconds >= LEAST_S).then_some((*first, *last, seconds))
    }
}

/// The newest coordinates of a mount.
#[derive(Debug, Default)]
pub struct Coordinates {
    /// Right ascension and declination.
    place: Pairs,
    /// Azimuth and altitude.
    horizontal: Pairs,
}

impl Coordinates {
    /// Takes new readings in; what was asked for before `since` shows another movement.
    pub fn note(&mut self, sight: &MountSight, since: MachineTime) {
        self.place.note(pair(sight.ra_deg, sight.dec_deg, since), since);
        self.horizontal.note(pair(sight.azimuth_deg, sight.altitude_deg, since), since);
    }

    /// Forgets all: the mount was moved.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// The motion that right ascension and declination show.
    pub fn motion(&self) -> Motion {
        let Some((first, last, seconds)) = self.place.ends() else { return Motion::Unknown };
        let turn_deg = TURN_DEG_PER_S * seconds;
        let along = Angle::from_degrees(last[0] - first[0]).wrapped_signed().degrees() / turn_deg;
        if (last[1] - first[1]).abs() > turn_deg {
            return Motion::Moves;
        }
        match along {
            along if along.abs() < 0.5 => Motion::Follows,
            along if (0.5..1.5).contains(&along) => Motion::Stands,
            _ => Motion::Moves,
        }
    }

    /// Do altitude and azimuth go along with the sky? `None` where that cannot be told.
    pub fn turns_with_the_sky(&self, dec_deg: f64) -> Option<bool> {
        let (first, last, seconds) = self.horizontal.ends()?;
        let expected_deg = TURN_DEG_PER_S * seconds * dec_deg.to_radians().cos();
        let place = |[azimuth, altitude]: [f64; 2]| Icrs::from_degrees(azimuth, altitude);
        let moved_deg = separation(&place(first), &place(last)).degrees();
        (expected_deg >= LEAST_DEG).then_some(moved_deg >= 0.5 * expected_deg)
    }
}

/// Both coordinates, as old as the older one.
pub fn pair(a: ReadAt<f64>, b: ReadAt<f64>, since: MachineTime) -> ReadAt<[f64; 2]> {
    let ((a, a_asked), (b, b_asked)) = asked_since(a, since).zip(asked_since(b, since))?;
    Some(([a, b], if a_asked.machine < b_asked.machine { a_asked } else { b_asked }))
}
