//! A limited number of places, fairly distributed among addresses.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The number of places, and for which peers.
#[derive(Debug, Clone, Copy)]
pub struct Room {
    /// Places in all.
    pub total: usize,
    /// Places of one address, or of one IPv6 network of 64 bits.
    pub per_address: usize,
    /// Places that only trusted peers may have; a peer is trusted when it is on this host.
    pub trusted: usize,
}

/// Places that are taken and given back.
#[derive(Debug)]
pub struct Places {
    room: Room,
    taken: Mutex<Taken>,
}

#[derive(Debug, Default)]
struct Taken {
    by_address: HashMap<IpAddr, usize>,
    total: usize,
    strangers: usize,
}

/// One place; it is given back when this is dropped.
#[derive(Debug)]
pub struct Place {
    places: Arc<Places>,
    address: IpAddr,
}

impl Places {
    /// Places that are all free.
    pub fn new(room: Room) -> Arc<Self> {
        Arc::new(Self { room, taken: Mutex::default() })
    }

    /// A place for a peer, or `None` when it has its share or all are taken.
    pub fn take(self: &Arc<Self>, peer: IpAddr) -> Option<Place> {
        let address = network(peer);
        let mut taken = self.lock();
        let own = taken.by_address.get(&address).copied().unwrap_or_default();
        let strangers = self.room.total.saturating_sub(self.room.trusted);
        let is_full = taken.total >= self.room.total || (!is_trusted(address) && taken.strangers >= strangers);
        if is_full || own >= self.room.per_address {
            return None;
        }
        taken.by_address.insert(address, own + 1);
        taken.total += 1;
        taken.strangers += usize::from(!is_trusted(address));
        drop(taken);
        Some(Place { places: self.clone(), address })
    }

    /// The number of places that are taken.
    pub fn taken(&self) -> usize {
        self.lock().total
    }

    fn lock(&self) -> MutexGuard<'_, Taken> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = self.places.lock();
        let own = taken.by_address.get(&self.address).copied().unwrap_or_default();
        if own > 1 {
            taken.by_address.insert(self.address, own - 1);
        } else {
            taken.by_address.remove(&self.address);
        }
        taken.total = taken.total.saturating_sub(1);
        taken.strangers = taken.strangers.saturating_sub(usize::from(!is_trusted(self.address)));
    }
}

/// Until operators sign in, the clients on this host are trusted.
fn is_trusted(address: IpAddr) -> bool {
    address.is_loopback()
}

/// Addresses of one client: one host may have as many IPv6 addresses as it likes within its network of 64 bits.
pub fn network(peer: IpAddr) -> IpAddr {
    match peer.to_canonical() {
        IpAddr::V6(ip) if !ip.is_loopback() => {
            let [a, b, c, d, ..] = ip.segments();
            Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0).into()
        }
        ip => ip,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ip(text: &str) -> IpAddr {
        text.parse().unwrap()
    }

    #[test]
    fn one_address_has_its_share_and_strangers_leave_room_for_the_trusted() {
        let places = Places::new(Room { total: 10, per_address: 4, trusted: 3 });
        let of = |address: &str| std::iter::repeat_with(|| places.take(ip(address))).take(100).flatten().collect();
        let first: Vec<Place> = of("10.0.0.1");
        let second: Vec<Place> = of("10.0.0.2");
        let third: Vec<Place> = of("::ffff:10.0.0.1");
        assert_eq!([first.len(), second.len(), third.len()], [4, 3, 0], "the third is the first in another notation");
        let own: Vec<Place> = of("127.0.0.1");
        assert_eq!((own.len(), places.taken()), (3, 10));
        drop((first, own));
        assert_eq!(places.taken(), 3);
        let again: Vec<Place> = of("10.0.0.3");
        assert_eq!(again.len(), 4, "what is given back is free");
    }

    #[test]
    fn an_ipv6_network_counts_as_one_address() {
        let places = Places::new(Room { total: 100, per_address: 2, trusted: 0 });
        let taken: Vec<Place> = (0..50).filter_map(|i| places.take(ip(&format!("2001:db8::{i:x}")))).collect();
        assert_eq!(taken.len(), 2);
    }
}
