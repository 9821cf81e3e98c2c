//! The answers to a script's requests, of any function: commands of the makers' own, states, waits, notes.

use std::time::Duration;

use contract::Kind;
use contract::device::vendor::VendorCommand;
use contract::device::{dome, telescope};
use contract::observatory::AlertKind;
use contract::{Device, DeviceKind};
use units::seconds;

use super::call::CallError;
use super::line::{HostAnswer, Reply, Request};
use super::script::Function;
use crate::action_error::ActionError;
use crate::authority::Authority;
use crate::devices::Devices;
use crate::devices::instrument::Instrument;

/// A device node gives a command of the maker's own 5 s; its answer arrives here within this time.
const ANSWER: Duration = Duration::from_secs(10);
/// No single wait of a script is longer, sky s.
const LONGEST_SLEEP_S: f64 = 600.0;
/// No line of the diary is longer, characters.
const LONGEST_NOTE: usize = 500;

/// Answers what every function may ask.
pub async fn answer(authority: &Authority, devices: &Devices, function: Function, request: Request) -> HostAnswer {
    let name = function.name();
    match request {
        Request::Vendor(device, command) => vendor(devices, &device, command).await.map(Reply::Text),
        Request::State(device) => state(devices, &device).map(Reply::Fields),
        Request::IsSafe => Ok(Reply::Truth(is_safe(authority, devices))),
        Request::Sleep(s) if !(0.0..=LONGEST_SLEEP_S).contains(&s) => {
            Err(format!("sleep({s}): expected 0 to {LONGEST_SLEEP_S} s"))
        }
        Request::Sleep(s) => {
            authority.node.bus.clock().sleep_sky(seconds(s)).await;
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

/// To a script, which may go by it where it opens something itself: safe, and nothing keeps a shut dome shut.
fn is_safe(authority: &Authority, devices: &Devices) -> bool {
    let may_open = devices.are_domes_open() || authority.verdict.borrow().why_kept_shut().is_none();
    authority.is_safe() && may_open
}

async fn vendor(devices: &Devices, device: &str, command: VendorCommand) -> Result<String, String> {
    let answered = match split(device) {
        (Some(Kind::Telescope), name) => {
            let mounts = devices.mounts.iter().map(|mount| &mount.instrument);
            one(mounts, device, name)?.ask_for_answer(telescope::Command::Vendor(command), ANSWER).await
        }
        (Some(Kind::Dome), name) => {
            let domes = devices.domes.iter().map(|dome| &dome.instrument);
            one(domes, device, name)?.ask_for_answer(dome::Command::Vendor(command), ANSWER).await
        }
        _ => return Err(format!("{device:?}: expected telescope or dome, or with its name, such as dome/roof")),
    };
    answered.map_err(|error| error.to_string())
}

/// The typed fields of a device, as fresh as decisions need them.
fn state(devices: &Devices, device: &str) -> Result<serde_json::Value, String> {
    match split(device) {
        (Some(Kind::Telescope), name) => {
            fields(one(devices.mounts.iter().map(|mount| &mount.instrument), device, name)?)
        }
        (Some(Kind::Dome), name) => fields(one(devices.domes.iter().map(|dome| &dome.instrument), device, name)?),
        (Some(Kind::CoverCalibrator), name) => {
            fields(one(devices.covers.iter().map(|cover| &cover.instrument), device, name)?)
        }
        _ => {
            Err(format!("{device:?}: expected telescope, dome or covercalibrator, or with its name, such as dome/roof"))
        }
    }
}

fn fields<K: DeviceKind>(instrument: &Instrument<K>) -> Result<serde_json::Value, String> {
    let stale = || format!("{}: no fresh state over a link that is up", instrument.device);
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
pub fn reported<T>(authority: &Authority, function: Function, result: Result<T, CallError>) -> Result<T, ActionError> {
    let alerts = &authority.node.alerts;
    result
        .inspect(|_| alerts.clear(AlertKind::SiteScript, function.name()))
        .map_err(|error| (function.name().to_owned(), error.to_string()))
        .map_err(|(function, why)| {
            tracing::warn!(function, why, "the site's script failed");
            alerts.raise(AlertKind::SiteScript, &function, &format!("{function}: {why}"));
            ActionError::Script { function, why }
        })
}
