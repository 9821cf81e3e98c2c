//! The domes over a telescope, as their device nodes publish them: they close without an observatory node and without a
//! token.

use std::collections::BTreeSet;
use std::time::Duration;

use bus::{Bus, Catch};
use contract::device::dome::{self, Shutter};
use contract::{Address, Command, Device, DeviceState, Key, Kind, Link, Order, Topic};
use overview::{DomeView, PublishedGuard};
use tokio::task::JoinSet;

use crate::ANSWER_WITHIN;

/// A guard publishes each second.
const GUARDS_WITHIN: Duration = Duration::from_millis(2500);
/// A plain `get` of the states that device nodes hold.
const STATES_WITHIN: Duration = Duration::from_secs(1);

/// The shutter of a state that is young enough to count: younger than twice its period, 5 s at least.
pub fn shutter(state: &DeviceState<dome::Fields>, held_s: Option<f64>) -> Option<Shutter> {
    let is_young = held_s.unwrap_or(0.0) <= (2.0 * state.period_s).max(5.0);
    let is_linked = state.link == Link::Connected;
    state.fields.shutter.known().copied().filter(|_| is_young && is_linked)
}

/// The domes on the bus that stand over a telescope: its own, and those of its site whose guards name it.
pub async fn over(bus: &Bus, telescope: &Address) -> Vec<Device> {
    let shared = telescope.shared();
    let states = |address| Topic::State.at(address).of_kind(Kind::Dome);
    let (own, of_site) = tokio::join!(
        bus.get_all::<DeviceState<dome::Fields>>(states(telescope), STATES_WITHIN),
        bus.get_all::<DeviceState<dome::Fields>>(states(&shared), STATES_WITHIN),
    );
    let device = |(key, _): (Key, _)| if let Key::State(device) = key { Some(device) } else { None };
    let mut found: Vec<Device> = own.into_iter().filter_map(device).collect();
    let mut unknown: BTreeSet<Device> = of_site.into_iter().filter_map(device).collect();
    let guards = bus.subscribe::<dome::Guard>(Topic::Guard.at(&shared), Catch::Newest, 64);
    if !unknown.is_empty()
        && let Ok(guards) = guards.await
    {
        let naming = async {
            while !unknown.is_empty() {
                let received = guards.recv().await;
                let Key::Guard(dome) = received.key else { continue };
                if !unknown.remove(&dome) {
                    continue;
                }
                let (at_utc, guard) = (received.sample.at_utc, received.sample.body);
                let view = DomeView { dome, shutter: None, guard: Some(PublishedGuard { guard, at_utc, speed: 1.0 }) };
                if view.is_over(telescope) {
                    found.push(view.dome);
                }
            }
        };
        // One whose guard is silent is not known to be over this telescope.
        let _ = tokio::time::timeout(GUARDS_WITHIN, naming).await;
    }
    found.sort();
    found.dedup();
    found
}

/// Asks the device node of each dome to close it, under the id and in the name of a person's order; true if one accepted.
/// Closing needs no token, and a repeat with the same id is answered again and not done again.
pub async fn close(bus: &Bus, domes: &[Device], order: &Order) -> bool {
    let mut asked = JoinSet::new();
    for dome in domes {
        let dome = dome.clone();
        let (bus, id, from) = (bus.clone(), order.id.clone(), order.from.clone());
        let command = Command { id, from, token: None, boot_id: None, action: dome::Command::CloseShutter };
        asked.spawn(async move { bus.command(&dome, &command, ANSWER_WITHIN).await.is_ok() });
    }
    asked.join_all().await.into_iter().any(|accepted| accepted)
}

/// For people.
pub(crate) fn names(domes: &[Device]) -> String {
    let names: Vec<String> = domes.iter().map(ToString::to_string).collect();
    names.join(", ")
}
