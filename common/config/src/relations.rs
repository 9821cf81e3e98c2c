//! What must hold between the parts of a configuration, in addition to what each value may be.

use std::collections::{BTreeMap, BTreeSet, HashSet};

use contract::device::dome::CloseWithMount;
use contract::{Address, Kind, Name};

use crate::device::{Limit, blocks};
use crate::device_faults;
use crate::findings::Findings;
use crate::host::{host_port, same_host};
use crate::limits;
use crate::nearest::nearest;
use crate::network_archive::NetworkArchive;
use crate::observatory::Observatory;
use crate::visibility::{Horizon, HorizonSource};

/// Action types that may have a file name template of their own.
const TEMPLATES: [&str; 7] =
    ["object", "calibration", "flats", "autofocus", "calibrate_guiding", "pointing_model", "default"];

/// The longest poll period of a mount under a dome that closes over parked mounts only, s: half of the age at which a
/// guard no longer takes it for parked (`node-device`).
const PARK_SEEN_S: f64 = 5.0;

/// Everything; cameras are paired on the way.
pub(crate) fn prove(observatory: &mut Observatory, findings: &mut Findings<'_>, torn: bool) {
    sections(observatory, findings);
    names(observatory, findings);
    devices(observatory, findings);
    limits::prove(observatory, findings);
    pairings(observatory, findings, torn);
    for (dome, message) in device_faults::torn_slits(observatory) {
        let index = observatory.dome.iter().position(|block| block.common.name == dome).unwrap_or(0);
        findings.error(&format!("dome[{index}].name"), message);
    }
    for (quoted, message) in observatory.alerts.faults() {
        findings.quoted(&quoted, message);
    }
}

fn sections(observatory: &Observatory, findings: &mut Findings<'_>) {
    let mut found = Vec::new();
    found.extend(observatory.names.faults());
    found.extend(observatory.schedule.check.faults());
    found.extend(observatory.pointing.faults());
    found.extend(observatory.faults.faults());
    found.extend(observatory.hooks.faults());
    found.extend(observatory.guiding.faults(observatory.camera.iter().map(|camera| &camera.common.name)));
    found.extend(observatory.focusing.faults());
    for fault in found {
        findings.block("", "", &fault);
    }
    deliveries(observatory, findings);
    for (key, what) in observatory.web.faults() {
        findings.error(&key, what);
    }
    for (key, what) in observatory.web.warnings() {
        findings.warning(&key, what);
    }
    let (page, spool) = (observatory.web.listen, observatory.spool.listen);
    if page.port() != 0 && page.port() == spool.port() && (page.ip() == spool.ip() || spool.ip().is_unspecified()) {
        findings.error(
            "spool.listen",
            format!("spool.listen = \"{spool}\": the page has this port; choose another, or port 0"),
        );
    }
    let nodes: BTreeSet<_> = observatory.camera.iter().map(|camera| &camera.common.node).collect();
    if nodes.len() > 1 && spool.port() != 0 {
        let what = format!(
            "spool.listen = \"{spool}\": the cameras are served by {} device nodes, of which only one can have this port; \
             choose port 0",
            nodes.len()
        );
        findings.warning("spool.listen", what);
    }
    for (key, what) in observatory.bus.warnings() {
        findings.warning(key, what);
    }
    for action in observatory.archive.filename.keys().filter(|action| !TEMPLATES.contains(&action.as_str())) {
        let help = crate::nearest::meant(action, TEMPLATES);
        let what = format!("archive.filename.{action}: no frames are named by this; {help}");
        findings.warning(&format!("archive.filename.{action}"), what);
    }
}

fn deliveries(observatory: &Observatory, findings: &mut Findings<'_>) {
    let mut seen = HashSet::new();
    for (index, delivery) in observatory.delivery.iter().enumerate() {
        let name = &delivery.name;
        if !seen.insert(name) {
            let what = format!("delivery \"{name}\": another destination has this name");
            findings.error(&format!("delivery[{index}].name"), what);
        }
        for (key, fault) in delivery.faults() {
            findings.error(&format!("delivery[{index}].{key}"), format!("delivery \"{name}\": {fault}"));
        }
        for (key, what) in delivery.warnings() {
            findings.warning(&format!("delivery[{index}].{key}"), format!("delivery \"{name}\": {what}"));
        }
    }
    if let Some(NetworkArchive::Bucket(bucket)) = &observatory.archive.parquet {
        for (key, fault) in bucket.faults() {
            findings.error(&format!("archive.parquet.{key}"), format!("archive.parquet: {fault}"));
        }
    }
    if observatory.archive.remove_delivered_after_days.is_some() && observatory.delivery.is_empty() {
        let what = "archive.remove_delivered_after_days: nothing is removed without a destination: add [[delivery]]";
        findings.error("archive.remove_delivered_after_days", what.to_owned());
    }
}

fn names(observatory: &Observatory, findings: &mut Findings<'_>) {
    let (mut seen, mut served) = (HashSet::new(), BTreeMap::new());
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for (kind, common) in observatory.devices() {
        let index = counts.entry(kind.to_string()).or_default();
        let path = format!("{kind}[{index}]");
        *index += 1;
        let name = &common.name;
        if !seen.insert((kind, name.clone())) {
            let what = format!("two {kind} blocks are named \"{name}\"; names must be unique: give one another name");
            findings.error(&format!("{path}.name"), what);
        }
        if let Err(why) = host_port(&common.server) {
            let what = format!(
                "{kind} \"{name}\": server \"{}\" is no host:port, such as 10.0.0.5:11111; {why}",
                common.server
            );
            findings.error(&format!("{path}.server"), what);
        }
        let device = (kind.to_string(), same_host(&common.server), common.number);
        if let Some((other, line)) = served.get(&device) {
            let what = format!(
                "{kind} \"{name}\" is the same device as {kind} \"{other}\" on line {line}: number {} of {}; give each its \
                 own number, or leave one block out",
                common.number, common.server
            );
            findings.error(&format!("{path}.number"), what);
        }
        let line = findings.line_of(&format!("{path}.name"));
        served.entry(device).or_insert((name.clone(), line));
    }
    let own = |kind: Kind| {
        let devices = observatory.devices().into_iter();
        devices.filter(move |(of, _)| *of == kind).map(|(_, common)| common.name.clone()).collect::<BTreeSet<_>>()
    };
    let is_shared = observatory.place.telescope.as_str() == Address::SHARED;
    for (kind, shared) in [
        (Kind::SafetyMonitor, &observatory.shared.safetymonitor),
        (Kind::ObservingConditions, &observatory.shared.observingconditions),
        (Kind::Dome, &observatory.shared.dome),
    ] {
        let (path, own) = (format!("shared.{kind}"), own(kind));
        let mut listed = BTreeSet::new();
        for name in shared {
            if !listed.insert(name) {
                findings.error(&path, format!("shared.{kind}: \"{name}\" stands there twice; keep one"));
            }
            if is_shared {
                let what = format!("shared.{kind}: this is the file of the shared devices itself; leave it out");
                findings.error(&path, what);
            } else if own.contains(name) {
                let what = format!(
                    "shared.{kind}: \"{name}\" is a [[{kind}]] of this file too; leave one of them out, or rename it"
                );
                findings.error(&path, what);
            }
        }
    }
}

/// What stands at a shared device and is decided by each telescope: who writes it here would believe that it protects.
fn decided_elsewhere(observatory: &Observatory, findings: &mut Findings<'_>) {
    let in_its_own = |key| format!("each telescope decides by {key} in [shared] of its own file; write it there");
    let mut ignored = |path: &str, shown: &str, key: &str, instead: &str| {
        let what = format!("{shown}{key} has no effect in the file of the shared devices: {instead}");
        findings.warning(&format!("{path}.{key}"), what);
    };
    for (path, shown, station) in blocks(&observatory.observingconditions) {
        if !station.limit.is_empty() {
            ignored(&path, &shown, "limit", &in_its_own("limit"));
        }
    }
    for (path, shown, monitor) in blocks(&observatory.safetymonitor) {
        if monitor.dwell_min.to_bits() != crate::device::default_dwell_min().to_bits() {
            ignored(&path, &shown, "dwell_min", &in_its_own("dwell_min"));
        }
        if monitor.max_age_s.is_some() {
            ignored(&path, &shown, "max_age_s", &in_its_own("max_age_s"));
        }
        if monitor.disabled.is_some() {
            let instead = "each telescope goes on to use it, until it is taken out of [shared] of its own file";
            ignored(&path, &shown, "disabled", instead);
        }
    }
    for (path, shown, switch) in blocks(&observatory.switch) {
        if !switch.limit.is_empty() {
            ignored(&path, &shown, "limit", "write the [[switch]] with its limit in each telescope's own file");
        }
    }
}

fn devices(observatory: &Observatory, findings: &mut Findings<'_>) {
    let own = observatory.place.telescope.as_str();
    let shared = own == Address::SHARED;
    for (path, shown, dome) in blocks(&observatory.dome) {
        let name = &dome.common.name;
        if shared && dome.telescopes.is_empty() {
            let what = format!("shared dome \"{name}\" lists no telescopes; add telescopes = [\"...\"]");
            findings.error(&format!("{path}.name"), what);
        }
        if !shared && !dome.telescopes.is_empty() && dome.telescopes.iter().all(|one| one.as_str() != own) {
            let what = format!(
                "{shown}telescopes does not list \"{own}\", the telescope of this file, so that its permit would open \
                 nothing; add it, or leave telescopes out"
            );
            findings.error(&format!("{path}.telescopes"), what);
        }
        let distinct: BTreeSet<&str> = dome.telescopes.iter().map(contract::Chunk::as_str).collect();
        if distinct.len() < dome.telescopes.len() {
            findings
                .error(&format!("{path}.telescopes"), format!("{shown}telescopes lists one of them twice; keep one"));
        }
        for fault in device_faults::dome(dome, &observatory.telescope, shared) {
            findings.block(&path, &shown, &fault);
        }
        if dome.watchdog_action.is_some() && dome.watchdog_s.is_none() {
            findings.block(&path, &shown, "watchdog_action needs watchdog_s, its time limit");
        }
    }
    if shared {
        decided_elsewhere(observatory, findings);
    }
    for (path, shown, camera) in blocks(&observatory.camera) {
        let pulses = camera.guide_calibration.iter().flat_map(crate::GuideStart::faults);
        for fault in device_faults::camera(camera).into_iter().chain(camera.flats.faults()).chain(pulses) {
            findings.block(&path, &shown, &fault);
        }
    }
    for (path, shown, focuser) in blocks(&observatory.focuser) {
        for fault in device_faults::focuser(focuser) {
            findings.block(&path, &shown, &fault);
        }
    }
    for (path, shown, mount) in blocks(&observatory.telescope) {
        if let Some(HorizonSource::Points(points)) = &mount.horizon
            && let Err(fault) = Horizon::new(points)
        {
            findings.block(&path, &shown, &format!("horizon: {fault}"));
        }
        for fault in device_faults::mount(mount) {
            findings.block(&path, &shown, &fault);
        }
        park_is_seen(observatory, mount.common.period_s, &path, &shown, findings);
        let (limits, flip_min) = (&mount.limits, mount.meridian_flip_min);
        if let Some(past_min) = limits.meridian_past_min.filter(|past_min| mount.meridian_flip && *past_min <= flip_min)
        {
            let fault = format!(
                "meridian_flip_min = {flip_min}: the mount is stopped before, at limits.meridian_past_min = {past_min}; \
                 make that greater"
            );
            findings.block(&path, &shown, &fault);
        }
    }
    for (path, shown, monitor) in blocks(&observatory.safetymonitor) {
        if monitor.disabled.as_ref().is_some_and(|why| why.trim().is_empty()) {
            findings.block(&path, &shown, "disabled needs words: say why");
        }
    }
}

/// A mount that is read seldom is not known to be parked between two readings, and the roof over it stays open.
fn park_is_seen(observatory: &Observatory, period_s: f64, path: &str, shown: &str, findings: &mut Findings<'_>) {
    if period_s <= PARK_SEEN_S {
        return;
    }
    let mut waits = observatory.dome.iter().filter(|dome| dome.close_with_mount == CloseWithMount::ParkedOnly);
    let roof = match (waits.next(), observatory.shared.dome.first()) {
        (Some(dome), _) => format!("\"{}\", which closes as parked_only", dome.common.name),
        (None, Some(dome)) => format!("\"{dome}\", if its file has parked_only"),
        (None, None) => return,
    };
    let fault = format!(
        "{shown}period_s = {period_s}: expected at most {PARK_SEEN_S} s under dome {roof}: it would stay open while no \
         newer reading shows that the mount is parked; leave period_s out, which is 1 s"
    );
    findings.warning(&format!("{path}.period_s"), fault);
}

/// Fills each camera's absent pairings with the only device of that kind, and refuses those that name nothing.
fn pairings(observatory: &mut Observatory, findings: &mut Findings<'_>, torn: bool) {
    let mut devices: Vec<(Kind, Name)> =
        observatory.devices().into_iter().map(|(kind, common)| (kind, common.name.clone())).collect();
    for (kind, shared) in [
        (Kind::SafetyMonitor, &observatory.shared.safetymonitor),
        (Kind::ObservingConditions, &observatory.shared.observingconditions),
        (Kind::Dome, &observatory.shared.dome),
    ] {
        devices.extend(shared.iter().map(|name| (kind, name.clone())));
    }
    for (index, camera) in observatory.camera.iter_mut().enumerate() {
        let pairs = [
            (Kind::Telescope, &mut camera.telescope),
            (Kind::FilterWheel, &mut camera.filterwheel),
            (Kind::Focuser, &mut camera.focuser),
            (Kind::Dome, &mut camera.dome),
            (Kind::Rotator, &mut camera.rotator),
            (Kind::CoverCalibrator, &mut camera.covercalibrator),
            (Kind::SafetyMonitor, &mut camera.safetymonitor),
            (Kind::ObservingConditions, &mut camera.observingconditions),
            (Kind::Switch, &mut camera.switch),
        ];
        for (kind, pair) in pairs {
            let of_kind = || devices.iter().filter(move |(k, _)| *k == kind).map(|(_, name)| name);
            match pair {
                // what was mended has no name to be found by
                Some(name)
                    if !torn && !of_kind().any(|other| other == name || other.as_str().starts_with("stand-in")) =>
                {
                    let near = nearest(name.as_str(), of_kind().map(Name::as_str));
                    let help = near
                        .map(|near| format!("; did you mean \"{near}\"?"))
                        .unwrap_or_else(|| format!("; add a [[{kind}]] of this name, or leave the line out"));
                    let camera = &camera.common.name;
                    let what = format!("camera \"{camera}\": {kind} = \"{name}\" names no {kind} of this file{help}");
                    findings.error(&format!("camera[{index}].{kind}"), what);
                }
                Some(_) => {}
                None => {
                    let mut of_kind = of_kind();
                    let first = of_kind.next().cloned();
                    *pair = if of_kind.next().is_none() { first } else { None };
                }
            }
        }
    }
}

/// What leaves nothing to run, and what a person should know before the night.
pub(crate) fn whole(observatory: &Observatory, findings: &mut Findings<'_>) {
    let shared = observatory.place.telescope.as_str() == Address::SHARED;
    if observatory.devices().is_empty() {
        let what = "the file has no device, so that there is nothing to run: add blocks such as [[telescope]] and [[camera]]; \
                    `starmesh discover` prints them";
        findings.error("", what.to_owned());
        return;
    }
    // An input that is disabled decides nothing.
    let own = observatory.safetymonitor.iter().filter(|monitor| monitor.disabled.is_none()).count();
    let monitors = own + observatory.shared.safetymonitor.len();
    let closes = |limit: &Limit| limit.response == crate::Response::Close && limit.disabled.is_none();
    let limited = observatory.observingconditions.iter().any(|station| station.limit.iter().any(closes))
        || (!observatory.shared.observingconditions.is_empty() && observatory.shared.limit.iter().any(closes))
        || observatory.switch.iter().any(|switch| switch.limit.iter().any(closes));
    let enclosed = !observatory.enclosures().is_empty();
    match (monitors > 0, limited) {
        _ if shared => {}
        (true, _) => {}
        (false, true) => findings.warning(
            "",
            "no safety monitor: the weather limits and the Sun alone decide whether the sky is safe; add a [[safetymonitor]] \
             if the site has one"
                .to_owned(),
        ),
        (false, false) => findings.warning(
            "",
            "no safety monitor and no weather limit: no input shows whether it rains, so that nothing is observed and a dome stays \
             closed; add a [[safetymonitor]], or an [[observingconditions]] with limits, or name shared ones under [shared]"
                .to_owned(),
        ),
    }
    for (path, shown, station) in blocks(&observatory.observingconditions) {
        if station.limit.is_empty() && !shared && !findings.is_spoilt_within(&format!("{path}.limit")) {
            let what = format!("{shown}no limit: its values are kept, and close nothing; add limit = [...]");
            findings.warning(&format!("{path}.name"), what);
        }
    }
    if !shared && !observatory.shared.observingconditions.is_empty() && observatory.shared.limit.is_empty() {
        let what = "shared.observingconditions: no [[shared.limit]]: the shared weather closes nothing here".to_owned();
        findings.warning("shared.observingconditions", what);
    }
    if !shared && observatory.telescope.is_empty() && !enclosed {
        let what =
            "neither a telescope nor a dome: there is no device node that grants the right to command, so that the \
                    schedule is not run; add a [[telescope]]"
                .to_owned();
        findings.warning("", what);
    } else if !shared && observatory.camera.is_empty() {
        findings.warning("", "no camera: nothing can be exposed; add a [[camera]]".to_owned());
    }
    for (path, shown, dome) in blocks(&observatory.dome) {
        if dome.telescopes.len() > 1 && dome.follow == crate::Follow::Auto {
            let what =
                format!("{shown}stands over several telescopes: no node turns it; say follow = \"off\" if it can turn");
            findings.warning(&format!("{path}.telescopes"), what);
        }
    }
}
