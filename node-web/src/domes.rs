//! The domes over a telescope by what their own device nodes publish.

use std::collections::BTreeSet;

use bus::MachineTime;
use contract::device::dome;
use contract::node::NodeState;
use contract::{Address, Device, DeviceState, Key, Kind, Link, NodeTopic};
use overview::{DomeView, PublishedGuard};
use serde::Deserialize as _;

use crate::freshness::Quality;
use crate::model::{Entry, Telescope};

/// The domes over a telescope among those of itself and of what its site shares. What is not fresh counts for nothing.
pub fn over<'a>(address: &Address, telescopes: impl Iterator<Item = &'a Telescope>, now: MachineTime) -> Vec<DomeView> {
    telescopes.flat_map(|telescope| views(telescope, now)).filter(|view| view.is_over(address)).collect()
}

fn views(telescope: &Telescope, now: MachineTime) -> Vec<DomeView> {
    let dome = |entry: &Entry| match &entry.key {
        Key::State(device) | Key::Guard(device) if device.kind == Kind::Dome => Some(device.clone()),
        _ => None,
    };
    let domes: BTreeSet<Device> = telescope.states.values().filter_map(dome).collect();
    let speed = telescope.states.values().find_map(speed).unwrap_or(1.0);
    let is_fresh = |entry: &Entry| entry.quality(now) == Quality::Fresh;
    let view = |dome: Device| {
        let state = telescope.read::<DeviceState<dome::Fields>>(&Key::State(dome.clone()));
        let state = state.filter(|(entry, state)| is_fresh(entry) && state.link == Link::Connected);
        let guard = telescope.read::<dome::Guard>(&Key::Guard(dome.clone())).filter(|(entry, _)| is_fresh(entry));
        DomeView {
            shutter: state.and_then(|(_, state)| state.fields.shutter.known().copied()),
            guard: guard.map(|(entry, guard)| PublishedGuard { guard, at_utc: entry.at_utc, speed }),
            dome,
        }
    };
    domes.into_iter().map(view).collect()
}

/// How fast the sky turns at a node.
fn speed(entry: &Entry) -> Option<f64> {
    match &entry.key {
        Key::Node(_, _, _, NodeTopic::State) => Some(NodeState::deserialize(entry.body.as_ref()).ok()?.speed),
        _ => None,
    }
}
