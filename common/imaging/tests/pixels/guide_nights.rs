//! Random nights in a closed loop: what happens to guide cameras and mounts in bad weather, many things in one night. A
//! night is judged by where the star truly was, not by what was measured.

use imaging::NoShift;
use imaging::guide::{Ask, Calibration, Exposure, GuideSettings, Guider, Pier, calibration};
use imaging::shift::Shift;
use rand::{Rng, RngExt, SeedableRng, rngs::StdRng};

use crate::mount::{Mount, shift};

const FRAMES: usize = 160;
/// Nights in a hundred that may have a stretch beyond; with a flip, of which half have a wrong sign, twice as many.
const MOST_PERCENT: usize = 8;
/// The star may be this far off, px, and twice as far as the worm moves it from frame to frame.
const NEAR_PX: f64 = 1.0;
/// After anything happened so many frames are not judged.
const SETTLING: usize = 10;
/// What a slew back may miss by, px.
const SLEW_SCATTER_PX: f64 = 8.0;
/// So many judged frames in a row beyond are a stretch; so many show a loop that keeps itself going.
const STRETCH: usize = 2;
const FED: usize = 20;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Happens {
    /// No star for so many frames.
    Blank(usize),
    /// The star is elsewhere in one frame: wind, or a cosmic particle that was taken for it.
    Gust([f64; 2]),
    /// The field moves and stays there.
    Jump([f64; 2]),
    /// Places are so many times as noisy for so many frames; the errors that go with them state half of it.
    Clouds(usize, f64),
    /// The camera repeats its last frame so many times.
    Stuck(usize),
    /// Nobody exposes for so long, s.
    Gap(f64),
    /// The mount loses the pulses of one decision, and nobody knows.
    PulsesLost,
    /// The tube goes to the other side of the pier.
    Flip,
}

#[derive(Debug)]
struct Night {
    mount: Mount,
    calibration: Calibration,
    cadence_s: f64,
    late_s: f64,
    happens: Vec<(usize, Happens)>,
    /// What is configured of Dec after a flip is wrong.
    sign_is_wrong: bool,
}

#[derive(Debug, Default)]
struct Judged {
    stretches: usize,
    longest: usize,
    worst_px: f64,
    /// Frames that were judged.
    quiet: usize,
    /// Frames in which the guider reported that it cannot hold the field.
    reported: usize,
}

fn vector(rng: &mut impl Rng, from_px: f64, to_px: f64) -> [f64; 2] {
    let (size_px, angle) = (rng.random_range(from_px..to_px), rng.random_range(0.0..std::f64::consts::TAU));
    [size_px * angle.cos(), size_px * angle.sin()]
}

impl Night {
    fn new(seed: u64, with_flip: bool) -> Self {
        let rng = &mut StdRng::seed_from_u64(seed);
        let mut mount = Mount::new(rng.random_range(0.0..360.0), seed);
        mount.scale_arcsec_px = rng.random_range(0.35..2.0);
        mount.mirrored = rng.random();
        let cadence_s = 2.0 * 30_f64.powf(rng.random());
        mount.drift_px_s = [0, 1].map(|_| rng.random_range(-0.05..0.05));
        if rng.random_bool(0.6) {
            mount.worm = (rng.random_range(0.0..3.0), rng.random_range(300.0..1000.0));
        }
        mount.play_s = if rng.random() { 0.0 } else { rng.random_range(0.2..2.0) };
        mount.free_north_s = mount.play_s * rng.random::<f64>();
        let exact = mount.calibration(Some(Pier::East));
        let mut wrong = |[x, y]: [f64; 2]| {
            let (sin, cos) = rng.random_range(-0.1..0.1_f64).sin_cos();
            let factor = rng.random_range(0.85..1.15);
            [factor * (cos * x - sin * y), factor * (sin * x + cos * y)]
        };
        let (east_px_s, north_px_s) = (wrong(exact.east_px_s), wrong(exact.north_px_s));
        let known = [None, Some(mount.play_s), Some(rng.random_range(0.7..1.3) * mount.play_s)];
        let backlash_s = known[rng.random_range(0..3)];
        let calibration = Calibration { east_px_s, north_px_s, backlash_s, ..exact };
        let late_s = if rng.random() { 0.1 } else { rng.random_range(0.05..0.9) * cadence_s };
        let mut happens: Vec<(usize, Happens)> = (0..rng.random_range(2..8))
            .map(|_| {
                let what = match rng.random_range(0..9) {
                    0 | 1 => Happens::Blank(rng.random_range(1..8)),
                    2 => Happens::Gust(vector(rng, 3.0, 25.0)),
                    3 | 4 => Happens::Jump(vector(rng, 2.0, 18.0)),
                    5 => Happens::Clouds(rng.random_range(3..15), rng.random_range(2.0..10.0)),
                    6 => Happens::Stuck(rng.random_range(1..6)),
                    7 => Happens::Gap(rng.random_range(30.0..1500.0)),
                    _ => Happens::PulsesLost,
                };
                (rng.random_range(10..FRAMES - 20), what)
            })
            .collect();
        if with_flip {
            happens.push((70, Happens::Flip));
        }
        happens.sort_by_key(|(frame, _)| *frame);
        Self { mount, calibration, cadence_s, late_s, happens, sign_is_wrong: rng.random() }
    }

    /// One night with three faults: four blank frames, a gust, a jump.
    fn of_the_issue(seed: u64, cadence_s: f64) -> Self {
        let rng = &mut StdRng::seed_from_u64(seed);
        let night = Self::new(seed, false);
        let happens = vec![
            (40, Happens::Blank(4)),
            (50, Happens::Gust(vector(rng, 11.0, 11.1))),
            (56, Happens::Jump(vector(rng, 12.0, 12.1))),
        ];
        Self { cadence_s, late_s: 0.1 * cadence_s, happens, ..night }
    }

    fn observed(mut self) -> Judged {
        let mut guider = Guider::new(GuideSettings::default(), &self.calibration, 0.0).unwrap();
        let rng = &mut StdRng::seed_from_u64(7);
        let (mut judged, mut beyond) = (Judged::default(), 0);
        let (mut blank, mut cloudy, mut noise, mut stuck, mut quiet) = (0, 0, 1.0, 0, 0);
        let mut settling = 2 * SETTLING;
        let (mut start_s, mut last): (f64, Option<Shift>) = (0.0, None);
        for n in 0..FRAMES {
            let (mut gust, mut lost) = ([0.0; 2], false);
            for (_, happens) in self.happens.iter().filter(|(frame, _)| *frame == n) {
                settling = settling.max(SETTLING);
                match *happens {
                    Happens::Blank(frames) => blank = frames,
                    Happens::Gust(by) => gust = by,
                    Happens::Jump([dx, dy]) => self.mount.slew(dx, dy),
                    Happens::Clouds(frames, factor) => (cloudy, noise) = (frames, factor),
                    Happens::Stuck(frames) => stuck = frames,
                    Happens::Gap(gap_s) => start_s += gap_s,
                    Happens::PulsesLost => lost = true,
                    Happens::Flip => {
                        self.mount.rotation_deg += 180.0;
                        self.mount.dec_reversed = true;
                        let side = Some(Pier::West);
                        let west = calibration::for_side(&[self.calibration], side, !self.sign_is_wrong).unwrap();
                        guider.recalibrated(&west, 0.0).unwrap();
                        settling = if self.sign_is_wrong { 4 * SETTLING } else { 2 * SETTLING };
                    }
                }
            }
            let length_s = (self.cadence_s - 1.0).max(0.5 * self.cadence_s);
            let exposure = Exposure { mid_s: start_s + 0.5 * length_s, length_s };
            start_s += self.cadence_s;
            let truth = self.mount.seen(exposure);
            let mut seen = self.mount.measured(exposure);
            let clouds = NoShift::TooFewStars { reference: 20, check: 0 };
            if cloudy > 0 {
                let more = noise * shift(0.0, 0.0).error_px().0;
                seen = shift(seen.dx_px + more * gauss(rng), seen.dy_px + more * gauss(rng));
                (0..2).for_each(|n| seen.covariance[n][n] *= (0.5 * noise).powi(2).max(1.0));
            }
            (seen.dx_px, seen.dy_px) = (seen.dx_px + gust[0], seen.dy_px + gust[1]);
            let is_measured = blank == 0;
            if stuck > 0 {
                seen = last.unwrap_or(seen);
            }
            if is_measured {
                last = Some(seen);
            }
            let decision = guider.step(exposure, if is_measured { Ok(&seen) } else { Err(&clouds) });
            judged.reported += usize::from(decision.log.unstable.is_some());
            if stuck > 0 && is_measured {
                assert_eq!(
                    (decision.pulses.east_ms, decision.pulses.north_ms),
                    (0, 0),
                    "a repeated frame: {decision:?}"
                );
            }
            let begun_s = exposure.mid_s + 0.5 * length_s + self.late_s;
            if !lost {
                self.mount.pulse(begun_s, decision.pulses);
            }
            guider.report([decision.pulses.east_ms, decision.pulses.north_ms].map(|ms| Some((begun_s, ms))));
            self.mount.tidy(exposure.mid_s);
            if let Some(Ask::Recentre { dx_px, dy_px }) = decision.ask {
                let [x, y] = vector(rng, 0.0, SLEW_SCATTER_PX);
                self.mount.slew(dx_px + x, dy_px + y);
                guider.moved();
                settling = settling.max(SETTLING);
            }
            let is_quiet = blank == 0 && cloudy == 0 && stuck == 0 && settling == 0;
            (blank, cloudy, stuck) = (dec(blank), dec(cloudy), dec(stuck));
            if blank + cloudy + stuck > 0 {
                settling = settling.max(SETTLING);
            } else {
                settling = dec(settling);
            }
            let (half_px, period_s) = self.mount.worm;
            let natural_px = half_px * std::f64::consts::TAU * self.cadence_s / period_s;
            let off_px = truth[0].hypot(truth[1]);
            let is_beyond = is_quiet && off_px > NEAR_PX + 2.0 * natural_px;
            quiet += usize::from(is_quiet);
            beyond = if is_beyond { beyond + 1 } else { 0 };
            judged.stretches += usize::from(beyond == STRETCH);
            judged.longest = judged.longest.max(beyond);
            if is_beyond {
                judged.worst_px = judged.worst_px.max(off_px);
            }
        }
        judged.quiet = quiet;
        judged
    }
}

fn dec(count: usize) -> usize {
    count.saturating_sub(1)
}

fn gauss(rng: &mut impl Rng) -> f64 {
    rand_distr::Distribution::<f64>::sample(&rand_distr::StandardNormal, rng)
}

fn print_summary(what: &str, nights: &[(u64, Judged)]) -> (usize, usize) {
    let bad: Vec<&(u64, Judged)> = nights.iter().filter(|(_, judged)| judged.stretches > 0).collect();
    assert!(
        nights.iter().map(|(_, judged)| judged.quiet).sum::<usize>() > 50 * nights.len(),
        "too few frames are judged"
    );
    let fed = nights.iter().filter(|(_, judged)| judged.longest >= FED).count();
    let alerted = nights.iter().filter(|(_, judged)| judged.reported > 0).count();
    println!(
        "{what}: {} of {} nights with a stretch beyond 1 px, {fed} that feed themselves; {alerted} reported",
        bad.len(),
        nights.len()
    );
    for (seed, judged) in bad {
        println!("    {seed}: {judged:?}");
    }
    (nights.iter().filter(|(_, judged)| judged.stretches > 0).count(), fed)
}

#[test]
fn random_nights_are_held_and_none_feeds_itself() {
    random_nights(24);
}

fn random_nights(nights: u64) {
    let nights: Vec<_> = (0..nights).map(|seed| (seed, Night::new(seed, false).observed())).collect();
    let (bad, fed) = print_summary("random nights", &nights);
    assert!(fed == 0 && bad * 100 <= MOST_PERCENT * nights.len());
}

#[test]
fn nights_with_a_flip_are_held_also_where_dec_turns_the_wrong_way() {
    // two of these twelve have one, three of so few may
    nights_with_a_flip(12, 25);
}

fn nights_with_a_flip(nights: u64, most_percent: usize) {
    let nights: Vec<_> = (0..nights).map(|seed| (seed, Night::new(1000 + seed, true).observed())).collect();
    let (bad, fed) = print_summary("nights with a flip", &nights);
    assert!(fed == 0 && bad * 100 <= most_percent * nights.len());
}

#[test]
fn blank_frames_a_gust_and_a_jump_leave_nothing_behind() {
    blank_frames_a_gust_and_a_jump(3);
}

fn blank_frames_a_gust_and_a_jump(each: u64) {
    let mut nights = Vec::new();
    for cadence_s in [2.0, 5.0, 10.0, 30.0, 60.0] {
        nights.extend((0..each).map(|seed| (seed, Night::of_the_issue(2000 + seed, cadence_s).observed())));
    }
    let (bad, fed) = print_summary("blank frames, gust, jump", &nights);
    assert!(fed == 0 && bad * 100 <= MOST_PERCENT * nights.len());
}

/// Hundreds of nights take half a minute of a processor.
mod proof {
    #[test]
    fn hundreds_of_random_nights_are_held_and_none_feeds_itself() {
        super::random_nights(300);
    }

    #[test]
    fn a_hundred_nights_with_a_flip_are_held_also_where_dec_turns_the_wrong_way() {
        super::nights_with_a_flip(100, 2 * super::MOST_PERCENT);
    }

    #[test]
    fn in_a_hundred_nights_blank_frames_a_gust_and_a_jump_leave_nothing_behind() {
        super::blank_frames_a_gust_and_a_jump(20);
    }
}
