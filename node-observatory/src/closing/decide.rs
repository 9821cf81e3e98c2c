//! The steps to be closed: a pure function of the devices' present states.

use std::collections::BTreeMap;
use std::time::Duration;

use bus::MachineTime;
use contract::device::cover_calibrator::Cover;
use contract::device::dome::Shutter;

use crate::devices::dome::ParkSight;

/// A dome as it is seen now; `None` where no fresh state over a link that is up shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct DomeSight {
    /// The shutter.
    pub shutter: Option<Shutter>,
    /// It may be open whatever its status: it was opened, and is not proven closed since.
    pub doubted: bool,
    /// Left alone: another telescope works under the same roof, and only a close request, not the sky, asks for
    /// closing.
    pub spared: bool,
    /// How far its parking is, for a dome that is parked when it is closed.
    pub park: Option<ParkSight>,
}

/// A mount as it is seen now.
#[derive(Debug, Clone, PartialEq)]
pub struct MountSight {
    /// It stands at its park position.
    pub parked: Option<bool>,
    /// Its newest command is a park that was done, and its driver does not tell whether it is parked.
    pub parked_unseen: bool,
    /// Moves to a target.
    pub slewing: Option<bool>,
    /// Follows the sky.
    pub tracking: Option<bool>,
    /// It reports that it cannot park.
    pub cannot_park: bool,
    /// Its newest command is a park that is being done.
    pub parking: bool,
}

/// A cover as it is seen now.
#[derive(Debug, Clone, PartialEq)]
pub struct CoverSight {
    /// The cover.
    pub cover: Option<Cover>,
    /// It reports that it has no cover.
    pub has_none: bool,
}

/// All that must be closed or stopped.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sight {
    /// Domes.
    pub domes: Vec<DomeSight>,
    /// Mounts.
    pub mounts: Vec<MountSight>,
    /// Covers.
    pub covers: Vec<CoverSight>,
}

/// One thing to do; the number is the device's index among the devices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Step {
    /// Close a dome's shutter.
    CloseShutter(usize),
    /// Stop a mount: abort its slew, stop tracking, park.
    StopMount(usize),
    /// Close a cover.
    CloseCover(usize),
    /// Turn a dome to its park position.
    ParkDome(usize),
}

/// A shutter waits no longer for the park of its dome, machine time.
pub(super) const PARK_WAIT: Duration = Duration::from_secs(60);
/// A shutter that has not begun to close after so long under a sky that calls for it may be one that has power at the
/// park position alone, machine time.
const PARK_HELPS: Duration = Duration::from_secs(30);

impl DomeSight {
    /// Verified closed.
    pub fn is_closed(&self) -> bool {
        self.spared || (self.shutter == Some(Shutter::Closed) && !self.doubted)
    }

    /// The shutter waits a little for the park of its dome, where no sky calls for closing.
    fn waits_for_park(&self, closing_for: Duration) -> bool {
        self.park.is_some_and(|park| park.may_wait && park.parked != Some(true)) && closing_for < PARK_WAIT
    }

    /// The dome is to be parked now: before its shutter closes where that may wait; else behind it, or where it may
    /// help a shutter that does not move.
    fn is_to_park(&self, closing_for: Duration) -> bool {
        let Some(park) = self.park.filter(|park| park.parked != Some(true) && !self.spared) else { return false };
        let stays_open = matches!(self.shutter, Some(Shutter::Open | Shutter::Error)) && closing_for >= PARK_HELPS;
        park.may_wait || self.is_closed() || stays_open
    }
}

impl MountSight {
    /// Verified stopped, as far as this mount can.
    pub fn is_stopped(&self) -> bool {
        let may_rest = self.tracking != Some(true) && self.slewing != Some(true);
        let at_rest = self.tracking == Some(false) && may_rest;
        self.parked == Some(true) || (self.parked_unseen && may_rest) || (self.cannot_park && at_rest)
    }
}

impl CoverSight {
    /// Verified closed, or not there.
    pub fn is_closed(&self) -> bool {
        self.has_none || matches!(self.cover, Some(Cover::Closed | Cover::NotPresent))
    }
}

impl Sight {
    /// Everything is verified closed and stopped.
    pub fn is_closed(&self) -> bool {
        self.domes.iter().all(DomeSight::is_closed)
            && self.mounts.iter().all(MountSight::is_stopped)
            && self.covers.iter().all(CoverSight::is_closed)
    }

    /// Something is seen to be open or to move, so that this is no closing of what is unknown or closed.
    pub fn is_known_open(&self) -> bool {
        self.domes.iter().any(|dome| dome.shutter.is_some() && !dome.is_closed())
            || self.mounts.iter().any(|mount| mount.parked.is_some() && !mount.is_stopped())
            || self.covers.iter().any(|cover| cover.cover.is_some() && !cover.is_closed())
    }

    /// The steps to take now. A roof that waits for the mounts is asked at once too: its device node, which knows all
    /// mounts under it, moves it as soon as its policy allows, and nobody else does.
    pub fn wanted(&self, closing_for: Duration) -> Vec<Step> {
        let mut steps = Vec::new();
        for (index, dome) in self.domes.iter().enumerate() {
            if !dome.is_closed() && !dome.waits_for_park(closing_for) {
                steps.push(Step::CloseShutter(index));
            }
        }
        let domes = self.domes.iter().enumerate().filter(|(_, dome)| dome.is_to_park(closing_for));
        steps.extend(domes.map(|(index, _)| Step::ParkDome(index)));
        let mounts = self.mounts.iter().enumerate().filter(|(_, mount)| !mount.is_stopped());
        steps.extend(mounts.map(|(index, _)| Step::StopMount(index)));
        let covers = self.covers.iter().enumerate().filter(|(_, cover)| !cover.is_closed());
        steps.extend(covers.map(|(index, _)| Step::CloseCover(index)));
        steps
    }
}

/// When each step was last sent.
#[derive(Debug, Clone)]
pub struct Closing {
    /// When it began.
    pub began: MachineTime,
    due: BTreeMap<Step, MachineTime>,
}

/// Every step is sent again after so long, for ever, until it is seen done.
const AGAIN: Duration = Duration::from_secs(10);
/// A step that was not taken is sent again sooner.
const AGAIN_REFUSED: Duration = Duration::from_secs(2);
/// A mount that reports that it parks is not disturbed for so long.
const PARKING: Duration = Duration::from_secs(60);

impl Closing {
    /// Begins.
    pub fn begin(now: MachineTime) -> Self {
        Self { began: now, due: BTreeMap::new() }
    }

    /// The steps to be sent now; each is then due again after a while.
    pub fn due(&mut self, sight: &Sight, now: MachineTime) -> Vec<Step> {
        let wanted = sight.wanted(now.since(self.began));
        // A step that is done may be undone, and must then be sent at once.
        self.due.retain(|step, _| wanted.contains(step));
        let ripe: Vec<Step> =
            wanted.into_iter().filter(|step| self.due.get(step).is_none_or(|due| *due <= now)).collect();
        for step in &ripe {
            let parks = match step {
                Step::StopMount(index) => sight.mounts.get(*index).is_some_and(|mount| mount.parking),
                Step::ParkDome(index) => {
                    sight.domes.get(*index).and_then(|dome| dome.park).is_some_and(|park| park.parking)
                }
                Step::CloseShutter(_) | Step::CloseCover(_) => false,
            };
            self.due.insert(*step, now.plus(if parks { PARKING } else { AGAIN }));
        }
        ripe
    }

    /// A step was not taken.
    pub fn refused(&mut self, step: Step, now: MachineTime) {
        self.due.insert(step, now.plus(AGAIN_REFUSED));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(seconds))
    }

    fn dome(shutter: Option<Shutter>) -> DomeSight {
        DomeSight { shutter, doubted: false, spared: false, park: None }
    }

    fn mount(parked: Option<bool>) -> MountSight {
        let (slewing, tracking) = (Some(false), Some(true));
        MountSight { parked, parked_unseen: false, slewing, tracking, cannot_park: false, parking: false }
    }

    fn cover(cover: Option<Cover>) -> CoverSight {
        CoverSight { cover, has_none: false }
    }

    const SHUTTERS: [Option<Shutter>; 6] = [
        None,
        Some(Shutter::Open),
        Some(Shutter::Closed),
        Some(Shutter::Opening),
        Some(Shutter::Closing),
        Some(Shutter::Error),
    ];

    #[test]
    fn only_a_fresh_closed_is_closed() {
        for shutter in SHUTTERS {
            assert_eq!(dome(shutter).is_closed(), shutter == Some(Shutter::Closed));
            let doubted = DomeSight { doubted: true, ..dome(shutter) };
            assert!(!doubted.is_closed(), "what is not proven is not closed: {shutter:?}");
        }
        assert!(!mount(None).is_stopped() && !mount(Some(false)).is_stopped() && mount(Some(true)).is_stopped());
        assert!(!cover(None).is_closed() && !cover(Some(Cover::Unknown)).is_closed());
    }

    #[test]
    fn alongside_sends_everything_at_once_whatever_is_there_and_whatever_hangs() {
        // Every subset of devices, each in every state that is not done.
        for domes in [vec![], vec![Some(Shutter::Open)], vec![None], vec![Some(Shutter::Error), Some(Shutter::Closing)]]
        {
            for mounts in [vec![], vec![None], vec![Some(false)], vec![Some(false), None]] {
                for covers in [vec![], vec![None], vec![Some(Cover::Open)], vec![Some(Cover::Error)]] {
                    let sight = Sight {
                        domes: domes.iter().map(|s| dome(*s)).collect(),
                        mounts: mounts.iter().map(|p| mount(*p)).collect(),
                        covers: covers.iter().map(|c| cover(*c)).collect(),
                    };
                    let steps = Closing::begin(at(0)).due(&sight, at(0));
                    assert_eq!(steps.len(), domes.len() + mounts.len() + covers.len(), "{sight:?}");
                    assert_eq!(sight.is_closed(), steps.is_empty());
                    assert!(domes.is_empty() || steps[0] == Step::CloseShutter(0), "the shutter comes first");
                }
            }
        }
    }

    #[test]
    fn a_roof_is_asked_at_once_and_its_mount_parked_whatever_the_mount_reports() {
        let mut sight = Sight { domes: vec![dome(Some(Shutter::Open))], mounts: vec![mount(None)], covers: vec![] };
        assert_eq!(sight.wanted(Duration::ZERO), [Step::CloseShutter(0), Step::StopMount(0)]);
        sight.mounts[0].cannot_park = true;
        sight.mounts[0].tracking = Some(false);
        assert_eq!(sight.wanted(Duration::ZERO), [Step::CloseShutter(0)]);
        sight.mounts[0].parked = Some(true);
        assert_eq!(sight.wanted(Duration::ZERO), [Step::CloseShutter(0)]);
    }

    #[test]
    fn a_mount_that_does_not_tell_whether_it_is_parked_is_parked_once_and_again_when_it_moves() {
        let unseen = MountSight { parked_unseen: true, tracking: Some(false), ..mount(None) };
        for (seen, is_stopped) in [
            (unseen.clone(), true),
            (MountSight { slewing: None, tracking: None, ..unseen.clone() }, true),
            (MountSight { parked_unseen: false, ..unseen.clone() }, false),
            (MountSight { slewing: Some(true), ..unseen.clone() }, false),
            (MountSight { tracking: Some(true), ..unseen }, false),
        ] {
            assert_eq!(seen.is_stopped(), is_stopped, "{seen:?}");
        }
    }

    #[test]
    fn a_dome_that_reports_closed_and_may_be_open_is_asked_all_the_same() {
        let doubted = DomeSight { doubted: true, ..dome(Some(Shutter::Closed)) };
        let sight = Sight { domes: vec![doubted], ..Sight::default() };
        assert_eq!(sight.wanted(Duration::ZERO), [Step::CloseShutter(0)]);
    }

    #[test]
    fn a_stuck_shutter_is_commanded_again_every_10_s_for_ever() {
        let sight = Sight { domes: vec![dome(Some(Shutter::Closing))], ..Sight::default() };
        let mut closing = Closing::begin(at(0));
        let asked: Vec<u64> = (0..3600).filter(|second| !closing.due(&sight, at(*second)).is_empty()).collect();
        assert_eq!(asked, (0..3600).step_by(10).collect::<Vec<u64>>());
    }

    #[test]
    fn a_refused_step_is_sent_again_after_2_s() {
        let sight = Sight { domes: vec![dome(None)], ..Sight::default() };
        let mut closing = Closing::begin(at(0));
        assert_eq!(closing.due(&sight, at(0)), [Step::CloseShutter(0)]);
        closing.refused(Step::CloseShutter(0), at(1));
        assert_eq!(closing.due(&sight, at(2)), []);
        assert_eq!(closing.due(&sight, at(3)), [Step::CloseShutter(0)]);
    }

    #[test]
    fn what_opens_again_is_closed_again_at_once() {
        let sight = |shutter| Sight { domes: vec![dome(Some(shutter))], ..Sight::default() };
        let mut closing = Closing::begin(at(0));
        assert_eq!(closing.due(&sight(Shutter::Open), at(0)).len(), 1);
        assert_eq!(closing.due(&sight(Shutter::Closed), at(1)), []);
        assert_eq!(closing.due(&sight(Shutter::Open), at(2)).len(), 1);
    }

    #[test]
    fn a_mount_that_reports_parking_is_let_alone_for_a_minute() {
        let mut sight = Sight { mounts: vec![mount(Some(false))], ..Sight::default() };
        let mut closing = Closing::begin(at(0));
        assert_eq!(closing.due(&sight, at(0)).len(), 1);
        sight.mounts[0].parking = true;
        let asked: Vec<u64> = (1..150).filter(|second| !closing.due(&sight, at(*second)).is_empty()).collect();
        assert_eq!(asked, [10, 70, 130]);
    }

    #[test]
    fn a_dome_is_parked_before_its_shutter_closes_for_a_minute_at_most_and_never_first_under_a_sky_that_calls_for_closing()
     {
        let sight = |shutter, parked, may_wait| {
            let park = Some(ParkSight { parked, parking: false, may_wait });
            Sight { domes: vec![DomeSight { park, ..dome(Some(shutter)) }], ..Sight::default() }
        };
        let wanted = |sight: Sight, second| sight.wanted(Duration::from_secs(second));
        let (close, park) = (Step::CloseShutter(0), Step::ParkDome(0));
        for parked in [None, Some(false)] {
            assert_eq!(wanted(sight(Shutter::Open, parked, true), 0), [park]);
            assert_eq!(wanted(sight(Shutter::Open, parked, true), 60), [close, park], "the wait is over");
            for second in [0, 29] {
                assert_eq!(wanted(sight(Shutter::Open, parked, false), second), [close], "the sky calls: at once");
            }
            assert_eq!(wanted(sight(Shutter::Open, parked, false), 30), [close, park], "it may need its park position");
            assert_eq!(wanted(sight(Shutter::Closing, parked, false), 40), [close], "it is on its way");
            assert_eq!(wanted(sight(Shutter::Closed, parked, false), 0), [park]);
        }
        assert_eq!(wanted(sight(Shutter::Open, Some(true), true), 0), [close]);
        assert!(sight(Shutter::Closed, Some(false), true).is_closed(), "closed is closed, parked or not");
    }

    #[test]
    fn a_spared_roof_stays_while_the_mount_parks() {
        let mut roof = dome(Some(Shutter::Open));
        roof.spared = true;
        let sight = Sight { domes: vec![roof], mounts: vec![mount(Some(false))], covers: vec![] };
        assert_eq!(sight.wanted(Duration::ZERO), [Step::StopMount(0)]);
    }
}
