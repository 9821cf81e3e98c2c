//! The newest sample of each incarnation that publishes under one key: a name can be used by two, and a stranger takes
//! nothing away from the real one by using it too.

use std::collections::BTreeMap;
use std::time::Duration;

use contract::BootId;
use units::MachineTime;

/// So many incarnations are kept; those that are known keep their places, however many strangers come.
const MOST: usize = 8;

/// What each incarnation published last.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Incarnations<T> {
    /// One that was silent for longer makes room.
    remembered_for: Duration,
    newest: BTreeMap<BootId, (T, MachineTime)>,
    /// When one was last turned away for want of room.
    turned_away: Option<MachineTime>,
}

impl<T> Incarnations<T> {
    /// Nobody has published yet. An incarnation that was silent for longer than `remembered_for` makes room for others.
    pub fn new(remembered_for: Duration) -> Self {
        Self { remembered_for, newest: BTreeMap::new(), turned_away: None }
    }

    /// Takes in a sample.
    pub fn observe(&mut self, boot_id: &BootId, payload: T, arrived: MachineTime) {
        self.newest.retain(|known, (_, at)| known == boot_id || arrived.since(*at) <= self.remembered_for);
        if self.newest.len() < MOST || self.newest.contains_key(boot_id) {
            self.newest.insert(boot_id.clone(), (payload, arrived));
        } else {
            self.turned_away = Some(arrived);
        }
    }

    /// Those that published within this time.
    pub fn within(&self, time: Duration, now: MachineTime) -> impl Iterator<Item = (&BootId, &T)> {
        let young = move |(_, (_, at)): &(&BootId, &(T, MachineTime))| now.since(*at) <= time;
        self.newest.iter().filter(young).map(|(boot_id, (payload, _))| (boot_id, payload))
    }

    /// One of them, and when it published.
    pub fn get(&self, boot_id: &BootId) -> Option<&(T, MachineTime)> {
        self.newest.get(boot_id)
    }

    /// Was there one within this time that had no room? Its payload is not known.
    pub fn had_no_room_within(&self, time: Duration, now: MachineTime) -> bool {
        self.turned_away.is_some_and(|at| now.since(at) <= time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_strangers_push_nobody_out_and_the_silent_make_room() {
        let at = |seconds| MachineTime::from_boot(Duration::from_secs(seconds));
        let (five, real) = (Duration::from_secs(5), BootId::fresh());
        let mut incarnations = Incarnations::new(five);
        incarnations.observe(&real, 7, at(100));
        for _ in 0..30 {
            incarnations.observe(&BootId::fresh(), 1, at(101));
        }
        assert_eq!(incarnations.within(five, at(101)).count(), MOST);
        assert!(incarnations.within(five, at(101)).any(|(boot_id, payload)| *boot_id == real && *payload == 7));
        assert!(incarnations.had_no_room_within(five, at(106)) && !incarnations.had_no_room_within(five, at(107)));
        incarnations.observe(&real, 8, at(106));
        assert_eq!(
            (incarnations.within(five, at(107)).count(), incarnations.get(&real).map(|(payload, _)| *payload)),
            (1, Some(8))
        );
    }
}
