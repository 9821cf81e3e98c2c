//! Which mounts under a roof are parked, by the states of their device nodes; pure.
//!
//! A roof that waits for the park may hit a mount, so one that is not known to be parked is not. Every node that
//! publishes for a mount counts, each incarnation for itself: of two that contradict each other, the one with "not
//! parked".

use std::collections::BTreeMap;
use std::time::Duration;

use contract::{Address, BootId, Chunk, Device};
use units::MachineTime;

use crate::incarnations::Incarnations;
use crate::parked::{ParkReading, Parked};

/// A mount that was silent for so long is not known to be parked.
const FRESH: Duration = Duration::from_secs(10);
/// A mount that was silent for so long, while another one of its telescope is not, is no longer there.
const GONE: Duration = Duration::from_secs(600);

/// The mounts under one roof.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct MountsUnder {
    telescopes: Vec<Chunk>,
    /// The mounts of the configuration, where it names them all; those of other telescopes are known by their states.
    known: Option<Vec<Device>>,
    received: BTreeMap<Device, Incarnations<Parked>>,
}

impl MountsUnder {
    /// Nothing is received yet. `known`: all mounts under the roof, where that is known.
    pub fn new(telescopes: Vec<Chunk>, known: Option<Vec<Device>>) -> Self {
        Self { telescopes, known, received: BTreeMap::new() }
    }

    /// A mount's state was received, whose flags were read at `read`.
    pub fn observe(&mut self, device: Device, boot_id: BootId, reading: ParkReading, read: MachineTime) {
        let is_ours = match &self.known {
            Some(known) => known.contains(&device),
            None => self.telescopes.contains(&device.address.telescope),
        };
        if !is_ours {
            return;
        }
        let incarnations = self.received.entry(device).or_insert_with(|| Incarnations::new(FRESH));
        let before = incarnations.get(&boot_id).map(|(parked, _)| *parked).unwrap_or_default();
        incarnations.observe(&boot_id, before.after(reading, read), read);
    }

    /// Is every mount known to be parked?
    pub fn all_parked(&self, now: MachineTime) -> bool {
        let parked = |incarnations: &Incarnations<Parked>| {
            let mut fresh = incarnations.within(FRESH, now).peekable();
            let all = fresh.peek().is_some() && fresh.all(|(_, parked)| parked.is_parked());
            // The one that found no room may be the mount itself.
            all && !incarnations.had_no_room_within(FRESH, now)
        };
        if let Some(known) = &self.known {
            return known.iter().all(|device| self.received.get(device).is_some_and(parked));
        }
        self.telescopes.iter().all(|telescope| {
            let of_it = |address: &Address| address.telescope == *telescope;
            let mut there = self.received.iter().filter(|(device, _)| of_it(&device.address)).peekable();
            let is_there = |incarnations: &Incarnations<Parked>| incarnations.within(GONE, now).next().is_some();
            // Until its state is received, a telescope counts as one mount that is not parked.
            let mut some = false;
            let all = there.all(|(_, incarnations)| {
                some |= parked(incarnations);
                parked(incarnations) || !is_there(incarnations)
            });
            all && some
        })
    }
}

#[cfg(test)]
mod tests {
    use contract::Datum;
    use contract::device::telescope::Fields;

    use super::*;

    fn at(seconds: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(1000 + seconds))
    }

    fn mount(telescope: &str, name: &str) -> Device {
        Address::new("site", telescope).unwrap().device(contract::Kind::Telescope, &name.parse().unwrap())
    }

    /// A mount that has no coordinates.
    fn says(says_parked: bool) -> ParkReading {
        ParkReading { says_parked: Some(says_parked), place: None, has_none: true }
    }

    fn shared() -> MountsUnder {
        MountsUnder::new(vec!["alpha".parse().unwrap(), "beta".parse().unwrap()], None)
    }

    #[test]
    fn a_roof_over_two_telescopes_needs_both_mounts_parked_and_their_states_fresh() {
        let (boot_id, mut mounts) = (BootId::fresh(), shared());
        assert!(!mounts.all_parked(at(0)), "nothing was received");
        mounts.observe(mount("alpha", "m"), boot_id.clone(), says(true), at(0));
        assert!(!mounts.all_parked(at(0)), "the other one was silent");
        mounts.observe(mount("beta", "m"), boot_id.clone(), says(true), at(1));
        assert!(mounts.all_parked(at(1)));
        assert!(!mounts.all_parked(at(11)), "the first has been silent for 11 s");
        mounts.observe(mount("alpha", "m"), boot_id.clone(), says(true), at(11));
        mounts.observe(mount("gamma", "m"), boot_id, says(false), at(11));
        assert!(mounts.all_parked(at(11)), "a mount under another roof is none of its business");
    }

    #[test]
    fn of_two_that_speak_for_one_mount_the_one_that_is_not_parked_counts_until_it_is_silent() {
        let (real, stranger, mut mounts) = (BootId::fresh(), BootId::fresh(), shared());
        for second in 0..3 {
            mounts.observe(mount("alpha", "m"), real.clone(), says(false), at(second));
            mounts.observe(mount("alpha", "m"), stranger.clone(), says(true), at(second));
            mounts.observe(mount("beta", "m"), real.clone(), says(true), at(second));
            assert!(!mounts.all_parked(at(second)));
        }
        for second in 3..14 {
            mounts.observe(mount("alpha", "m"), stranger.clone(), says(true), at(second));
            mounts.observe(mount("beta", "m"), real.clone(), says(true), at(second));
        }
        assert!(mounts.all_parked(at(13)), "a node that was restarted publishes as another incarnation");
    }

    #[test]
    fn a_mount_that_nobody_configured_holds_up_no_roof_of_one_telescope_and_none_for_good() {
        let (boot_id, own) = (BootId::fresh(), mount("alpha", "m"));
        let mut mounts = MountsUnder::new(vec!["alpha".parse().unwrap()], Some(vec![own.clone()]));
        mounts.observe(mount("alpha", "ghost"), BootId::fresh(), says(false), at(0));
        mounts.observe(own, boot_id.clone(), says(true), at(0));
        assert!(mounts.all_parked(at(0)));
        assert!(
            MountsUnder::new(vec!["alpha".parse().unwrap()], Some(Vec::new())).all_parked(at(0)),
            "no mount at all"
        );

        let mut mounts = shared();
        mounts.observe(mount("beta", "ghost"), BootId::fresh(), says(false), at(0));
        for second in [0, 599, 601] {
            mounts.observe(mount("alpha", "m"), boot_id.clone(), says(true), at(second));
            mounts.observe(mount("beta", "m"), boot_id.clone(), says(true), at(second));
            assert_eq!(mounts.all_parked(at(second)), second == 601, "after {second} s of the ghost's silence");
        }
    }

    #[test]
    fn a_mount_that_says_that_it_is_parked_and_moves_is_not_and_each_incarnation_rests_for_itself() {
        let (real, stranger, own) = (BootId::fresh(), BootId::fresh(), mount("alpha", "m"));
        let mut mounts = MountsUnder::new(vec!["alpha".parse().unwrap()], Some(vec![own.clone()]));
        let reading = |altitude_deg: f64, second| {
            let (altitude_deg, azimuth_deg) = (Datum::Known(altitude_deg), Datum::Known(180.0));
            let fields = Fields { altitude_deg, azimuth_deg, ..Fields::default() };
            ParkReading { says_parked: Some(true), ..ParkReading::of(&fields, |_| at(second)) }
        };
        for second in 0..40 {
            mounts.observe(own.clone(), real.clone(), reading(60.0 - second as f64, second), at(second));
            mounts.observe(own.clone(), stranger.clone(), reading(20.0, second), at(second));
            assert!(!mounts.all_parked(at(second)), "{second} s");
        }
        for second in 40..51 {
            mounts.observe(own.clone(), real.clone(), reading(20.0, second), at(second));
            mounts.observe(own.clone(), stranger.clone(), reading(20.0, second), at(second));
            assert_eq!(mounts.all_parked(at(second)), second == 50, "{second} s");
        }
    }
}
