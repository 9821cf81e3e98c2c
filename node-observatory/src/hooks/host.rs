//! The answers to a script's requests, of any function: commands of the makers' own, states, waits, notes.

use std::time::Duration;

use contract::Kind;
use contract::device::vendor::VendorCommand;
use contract::device::{dome, telescope};
use contract::observatory::AlertKind;
use contract::{Device, DeviceKind};
use units::seconds;

use super::call::CallError;
use super::line::{Answer, Reply, Request};
use super::script::Function;
use crate::control_room::ControlRoom;
use crate::rig::instrument::Instrument;
use crate::trouble::Trouble;

/// A device node gives a command of the maker's own 5 s; its answer arrives here within this time.
const ANSWER: Duration = Duration::from_secs(10);
/// No single wait of a script is longer, sky s.
const LONGEST_SLEEP_S: f64 = 600.0;
/// No line of the diary is longer, characters.
const LONGEST_NOTE: usize = 500;

/// Answers what every function may ask.
pub async fn answer(room: &ControlRoom, function: Function, request: Request) -> Answer {
    let name = function.name();
    match request {
        Request::Vendor(device, command) => vendor(room, &device, command).await.map(Reply::Text),
        Request::State(device) => state(room, &device).map(Reply::Fields),
        Request::IsSafe => Ok(Reply::Truth(room.is_safe())),
        Request::Sleep(s) if !(0.0..=LONGEST_SLEEP_S).contains(&s) => {
            Err(format!("sleep({s}): expected 0 to {LONGEST_SLEEP_S} s"))
        }
        Request::Sleep(s) => {
            room.node.bus.clock().sleep_sky(seconds(s)).await;
            Ok(Reply::Done)
        }
        Request::Note(text) => {
            let text: String = text.chars().take(LONGEST_NOTE).collect();
            tracing::info!(function = name, "{text}");
            Ok(Reply::Done)
        }
        Request::Default => {
            Err(format!("{name} has no default here: call default_open() in open, default_close() in close"))
        }
        Request::OpenDomes | Request::OpenCovers | Request::Unpark => {
            Err(format!("{name} opens nothing: call open_domes(), open_covers() and unpark() in open"))
        }
    }
}

async fn vendor(room: &ControlRoom, device: &str, command: VendorCommand) -> Result<String, String> {
    let rig = &room.rig;
    let answered = match split(device) {
        (Some(Kind::Telescope), name) => {
            let mounts = rig.mounts.iter().map(|mount| &mount.instrument);
            one(mounts, device, name)?.ask_for_answer(telescope::Command::Vendor(command), ANSWER).await
        }
        (Some(Kind::Dome), name) => {
            let domes = rig.domes.iter().map(|dome| &dome.instrument);
            one(domes, device, name)?.ask_for_answer(dome::Command::Vendor(command), ANSWER).await
        }
        _ => return Err(format!("{device:?}: expected telescope or dome, or with its name, such as dome/roof")),
    };
    answered.map_err(|trouble| trouble.to_string())
}

/// The typed fields of a device, as fresh as decisions need them.
fn state(room: &ControlRoom, device: &str) -> Result<serde_json::Value, String> {
    let rig = &room.rig;
    match split(device) {
        (Some(Kind::Telescope), name) => fields(one(rig.mounts.iter().map(|mount| &mount.instrument), device, name)?),
        (Some(Kind::Dome), name) => fields(one(rig.domes.iter().map(|dome| &dome.instrument), device, name)?),
        (Some(Kind::CoverCalibrator), name) => {
            fields(one(rig.covers.iter().map(|cover| &cover.instrument), device, name)?)
        }
        _ => {
            Err(format!("{device:?}: expected telescope, dome or covercalibrator, or with its name, such as dome/roof"))
        }
    }
}

fn fields<K: DeviceKind>(instrument: &Instrument<K>) -> Result<serde_json::Value, String> {
    let stale = || format!("{}: no fresh state over a standing link", instrument.device);
    let state = instrument.fresh().ok_or_else(stale)?;
    serde_json::to_value(&state.fields).map_err(|error| error.to_string())
}

/// `dome/roof` by its kind and its name, `dome` by its kind.
fn split(device: &str) -> (Option<Kind>, Option<&str>) {
    let (kind, name) = device.split_once('/').map_or((device, None), |(kind, name)| (kind, Some(name)));
    (kind.parse().ok(), name)
}

/// The device of that name, or the only one.
fn one<'a, K: DeviceKind>(
    mut devices: impl Iterator<Item = &'a Instrument<K>> + Clone,
    asked: &str,
    name: Option<&str>,
) -> Result<&'a Instrument<K>, String> {
    let known = devices.clone().map(|it| of(&it.device)).collect::<Vec<_>>().join(", ");
    let found = match name {
        Some(name) => devices.find(|it| it.device.name.as_str() == name),
        None => devices.next().filter(|_| devices.next().is_none()),
    };
    found.ok_or_else(|| format!("{asked:?} is not one device of this telescope; there are: {known}"))
}

fn of(device: &Device) -> String {
    format!("{}/{}", device.kind, device.name)
}

/// Raises or clears the alert of a function, and converts its failure into an error of the action.
pub fn told<T>(room: &ControlRoom, function: Function, result: Result<T, CallError>) -> Result<T, Trouble> {
    let alerts = &room.node.alerts;
    result
        .inspect(|_| alerts.clear(AlertKind::SiteScript, function.name()))
        .map_err(|error| (function.name().to_owned(), error.to_string()))
        .map_err(|(function, why)| {
            tracing::warn!(function, why, "the site's script failed");
            alerts.raise(AlertKind::SiteScript, &function, &format!("{function}: {why}"));
            Trouble::Script { function, why }
        })
}
