//! What one program has of one topic, and the messages that it lacks.
//!
//! No program has a queue. States remember the revision up to which it knows them, so that a slow program gets each
//! key's newest value once, when it is ready for it; lines and frames are numbered and stored for all in a ring.

use std::collections::BTreeMap;

use contract::Address;
use serde::Serialize;
use serde_json::{Map, Value, json};
use users::Principal;

use super::message::{Kind, ServerMessage};
use super::topic::Topic;
use crate::alerts::active;
use crate::command_store::{CommandState, Commands};
use crate::model::Model;
use crate::network::{Network, lines, logs};
use crate::routes::network::StateNow;
use crate::routes::parts::AlertOfTelescope;
use crate::summary::Face;

/// The newest lines that a program gets at first.
const FIRST_LINES: usize = 500;
/// The newest commands that are followed.
const COMMANDS: usize = 50;

/// What a program knows of one topic.
pub struct Subscription {
    topic: Topic,
    /// As the program wrote it.
    name: String,
    /// Revision that the program has; absent before the first message.
    seen: Option<u64>,
    known: Known,
}

/// Things with names that come, change and go.
#[derive(Default)]
struct Known {
    faces: BTreeMap<String, Face>,
    alerts: BTreeMap<String, AlertOfTelescope>,
    commands: BTreeMap<String, CommandState>,
}

/// What is sent of things with names: those that are new or differ, and the names of those that are gone.
fn differences<T: PartialEq>(known: &mut BTreeMap<String, T>, now: BTreeMap<String, T>) -> (Vec<String>, Vec<String>) {
    let changed = now.iter().filter(|(name, thing)| known.get(*name) != Some(*thing)).map(|(name, _)| name.clone());
    let gone = known.keys().filter(|name| !now.contains_key(*name)).cloned();
    let found = (changed.collect(), gone.collect());
    *known = now;
    found
}

fn items<T: PartialEq + Serialize>(known: &mut BTreeMap<String, T>, now: BTreeMap<String, T>) -> Map<String, Value> {
    let (changed, gone) = differences(known, now);
    let changed: Map<String, Value> = changed.into_iter().map(|name| (name.clone(), json!(known.get(&name)))).collect();
    content(changed, &gone)
}

fn content(items: Map<String, Value>, gone: &[String]) -> Map<String, Value> {
    let mut data = Map::new();
    if !items.is_empty() {
        data.insert("items".into(), Value::Object(items));
    }
    if !gone.is_empty() {
        data.insert("gone".into(), json!(gone));
    }
    data
}

impl Subscription {
    /// One that begins; `seen` where the program goes on after an interruption.
    pub fn new(topic: Topic, name: String, seen: Option<u64>) -> Self {
        // Of things that come and go only the whole can be given again.
        let goes_on = matches!(topic, Topic::Telescope { .. } | Topic::Frames(_) | Topic::Log { .. });
        Self { topic, name, seen: seen.filter(|_| goes_on), known: Known::default() }
    }

    /// The same topic in other words?
    pub fn is_of(&self, topic: &Topic) -> bool {
        self.topic == *topic
    }

    /// Begins anew, with what the program may see now.
    pub fn begin_anew(&mut self) {
        (self.seen, self.known) = (None, Known::default());
    }

    /// The telescope of which it needs a right, if it is about one.
    pub fn telescope(&self) -> Option<&Address> {
        self.topic.telescope()
    }

    /// As the program wrote it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The messages that the program lacks; `beat`: a second has passed since the last.
    pub fn next(
        &mut self,
        network: &Network,
        commands: &Commands,
        caller: &Principal,
        beat: bool,
    ) -> Vec<ServerMessage> {
        match self.topic.clone() {
            Topic::Network => self.summaries(network, caller, beat),
            Topic::Alerts => self.alerts(network, caller),
            Topic::Commands => self.commands(network, commands, caller),
            Topic::Telescope { address, below } => self.states(network, caller, &address, &below),
            Topic::Frames(address) => {
                let seen = self.seen.unwrap_or(0);
                let model = network.read();
                let telescope = model.telescopes.get(&address).filter(|_| may_see(caller, &address));
                let frames = telescope.into_iter().flat_map(|telescope| telescope.frames.after(seen));
                let frames = frames.map(|(_, frame)| json!(frame)).collect();
                self.happened(&model, network, telescope.map_or(0, |telescope| telescope.forgotten_frame), frames)
            }
            Topic::Log { telescope, level } => {
                let model = network.read();
                let seen = self.seen.unwrap_or(0);
                let mut lines = lines(&model, caller, telescope.as_ref(), level, seen);
                let first = if self.seen.is_none() { lines.len().saturating_sub(FIRST_LINES) } else { 0 };
                let lines = lines.drain(first..).map(|(address, line)| {
                    let mut line = json!(line);
                    line["telescope"] = json!(address.to_string());
                    line
                });
                let lines = lines.collect();
                let logs = logs(&model, caller, telescope.as_ref());
                let forgotten = logs.map(|(_, telescope)| telescope.diary.forgotten(level)).max();
                self.happened(&model, network, forgotten.unwrap_or(0), lines)
            }
        }
    }

    /// Things that happened since the last message, after a gap where some of them are no longer here.
    fn happened(&mut self, model: &Model, network: &Network, forgotten: u64, things: Vec<Value>) -> Vec<ServerMessage> {
        let before = self.seen.replace(model.revision);
        let mut messages = Vec::new();
        if let Some(from) = before.filter(|from| *from < forgotten) {
            messages.push(self.message(network, Kind::Gap, json!({ "from": from, "to": forgotten })));
        }
        match before {
            None => messages.push(self.message(network, Kind::Snap, json!(things))),
            Some(_) if !things.is_empty() => messages.push(self.message(network, Kind::Event, json!(things))),
            Some(_) => {}
        }
        messages
    }

    /// Summaries that differ from those that the program has; the ages of all each second.
    fn summaries(&mut self, network: &Network, caller: &Principal, beat: bool) -> Vec<ServerMessage> {
        let revision = network.read().revision;
        let summaries = network.summaries();
        let visible = || {
            summaries.iter().filter(|summary| {
                let Face { site_id, telescope_id, .. } = &summary.face;
                may_see(caller, &Address { site: site_id.clone(), telescope: telescope_id.clone() })
            })
        };
        let faces = visible().map(|summary| (summary.face.id.clone(), summary.face.clone())).collect();
        let (changed, gone) = differences(&mut self.known.faces, faces);
        let changed = visible().filter(|summary| changed.contains(&summary.face.id));
        let changed: Map<String, Value> = changed.map(|summary| (summary.face.id.clone(), json!(summary))).collect();
        let mut data = content(changed, &gone);
        if beat && self.seen.is_some() {
            let ages = visible().map(|summary| (summary.face.id.clone(), json!(summary.ages)));
            data.insert("ages".into(), Value::Object(ages.collect()));
        }
        self.changed(network, revision, data)
    }

    fn alerts(&mut self, network: &Network, caller: &Principal) -> Vec<ServerMessage> {
        let now = network.clock().machine();
        let model = network.read();
        let visible = model.telescopes.iter().filter(|(address, _)| may_see(caller, address));
        let alerts = visible.flat_map(|(address, telescope)| {
            active(telescope, Vec::new(), now).into_iter().map(move |alert| {
                (format!("{address}/{}", alert.id), AlertOfTelescope { telescope: address.to_string(), alert })
            })
        });
        let data = items(&mut self.known.alerts, alerts.collect());
        self.changed(network, model.revision, data)
    }

    fn commands(&mut self, network: &Network, commands: &Commands, caller: &Principal) -> Vec<ServerMessage> {
        let newest = commands.newest(COMMANDS, |command| may_see(caller, &command.telescope)).into_iter();
        let data = items(&mut self.known.commands, newest.map(|command| (command.id.to_string(), command)).collect());
        self.changed(network, network.read().revision, data)
    }

    /// Payloads after the revision that the program has: whole where they differ, and else only how old they are.
    fn states(&mut self, network: &Network, caller: &Principal, address: &Address, below: &str) -> Vec<ServerMessage> {
        let model = network.read();
        let (first, seen) = (self.seen.is_none(), self.seen.unwrap_or(0));
        let shared = address.shared();
        let wanted: &[&Address] = if below.is_empty() { &[address, &shared] } else { &[address] };
        let prefix = format!("{address}/{below}");
        let is_wanted = |name: &str| below.is_empty() || name == prefix || name.starts_with(&format!("{prefix}/"));
        let (mut whole, mut again) = (Map::new(), Map::new());
        let now = network.clock().machine();
        let visible = wanted.iter().filter(|wanted| may_see(caller, wanted) && may_see(caller, address));
        for telescope in visible.filter_map(|address| model.telescopes.get(*address)) {
            let states = telescope.states.iter().filter(|(name, _)| is_wanted(name));
            for (name, entry) in states.filter(|(_, entry)| first || entry.revision > seen) {
                if first || entry.changed > seen {
                    whole.insert(name.clone(), json!(StateNow::of(entry, network, caller)));
                } else {
                    again.insert(name.clone(), json!([entry.age(now).as_secs_f64(), entry.at_utc]));
                }
            }
        }
        let mut data = Map::new();
        if first || !whole.is_empty() {
            data.insert("states".into(), Value::Object(whole));
        }
        if !again.is_empty() {
            data.insert("again".into(), Value::Object(again));
        }
        self.changed(network, model.revision, data)
    }

    /// A snapshot at first, then what has changed.
    fn changed(&mut self, network: &Network, revision: u64, mut data: Map<String, Value>) -> Vec<ServerMessage> {
        let op = if self.seen.replace(revision).is_none() { Kind::Snap } else { Kind::Delta };
        if op == Kind::Delta && data.is_empty() {
            return Vec::new();
        }
        if op == Kind::Snap && !matches!(self.topic, Topic::Telescope { .. }) {
            data.entry("items").or_insert_with(|| json!({}));
        }
        vec![self.message(network, op, Value::Object(data))]
    }

    fn message(&self, network: &Network, op: Kind, data: Value) -> ServerMessage {
        ServerMessage { op, topic: Some(self.name.clone()), seq: self.seen, at_utc: network.clock().utc(), data }
    }
}

fn may_see(caller: &Principal, address: &Address) -> bool {
    caller.right_at(address).is_some()
}

#[cfg(test)]
#[path = "subscription_tests.rs"]
mod tests;
