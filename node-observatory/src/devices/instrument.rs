//! One device of any kind: its newest state, and `command and wait until done`.

use std::sync::Arc;
use std::time::Duration;

use bus::{AskError, Bus, Clock, Latest, Received};
use contract::device::DeviceDescription;
use contract::{Command, CommandId, CommandOutcome, Device, DeviceKind, DeviceState, Key, Link, Payload, Reason};
use tokio::sync::{Notify, watch};

use crate::action_error::ActionError;
use crate::command_timeout::command_timeout;
use crate::devices::freshness;
use crate::hold::Hold;

/// A device node answers within milliseconds, or something is wrong.
const ANSWER: Duration = Duration::from_secs(2);
/// An unanswered command is repeated under its own id, which does it at most once.
const REPEATS: u32 = 3;
/// A device that is still at an earlier command is given so long to end it.
const TURN: Duration = Duration::from_secs(30);
/// A device node describes its device within this time.
const DESCRIBED: Duration = Duration::from_secs(15);
/// A device that another command has taken over, and that does not come to rest, is not waited for longer.
const RESTS: Duration = Duration::from_secs(30);
/// A state that arrives so long after a command was taken knows of it.
const SETTLED: Duration = Duration::from_secs(1);

/// In whose name, and with which token, commands are given. Cheap to clone.
#[derive(Clone)]
pub struct CommandSender {
    /// The bus.
    pub bus: Bus,
    /// Such as `observatory/callisto/main`.
    pub signature: String,
    /// The lease, whose token goes with every command.
    pub lease: watch::Receiver<Hold>,
    /// Notified when a device knows a newer token than ours.
    pub doubt: Arc<Notify>,
}

/// A device of kind `K`.
pub struct Instrument<K: DeviceKind> {
    /// Which one.
    pub device: Device,
    state: Latest<DeviceState<K::Fields>>,
    about: Latest<DeviceDescription<K::Capabilities>>,
    sender: CommandSender,
}

impl<K: DeviceKind> Instrument<K> {
    /// Subscribes to a device.
    pub async fn listen(command_sender: &CommandSender, device: Device) -> anyhow::Result<Self> {
        let state = command_sender.bus.latest(&Key::State(device.clone())).await?;
        let about = command_sender.bus.latest(&Key::Capabilities(device.clone())).await?;
        Ok(Self { device, state, about, sender: command_sender.clone() })
    }

    /// The clock.
    pub fn clock(&self) -> &Clock {
        self.sender.bus.clock()
    }

    /// The bus.
    pub fn bus(&self) -> &Bus {
        &self.sender.bus
    }

    /// The newest state, however old.
    pub fn newest(&self) -> Option<Received<DeviceState<K::Fields>>> {
        self.state.get()
    }

    /// A follower of the states.
    pub fn follow(&self) -> Latest<DeviceState<K::Fields>> {
        self.state.clone()
    }

    /// The state, if it arrived recently over a link to the device, and if no second node publishes for the device.
    pub fn fresh(&self) -> Option<DeviceState<K::Fields>> {
        if self.state.has_rivals() {
            return None;
        }
        let received = self.state.get()?;
        let age = self.clock().machine().since(received.arrived);
        let state = received.sample.body;
        (age <= freshness(state.period_s) && state.link == Link::Connected).then_some(state)
    }

    /// As [`Self::fresh`], if this property was read recently too: a state may repeat what was read before its node or
    /// its server hung.
    pub fn fresh_reading(&self, property: &str) -> Option<DeviceState<K::Fields>> {
        let arrived = self.state.get()?.arrived;
        let state = self.fresh()?;
        let read = Duration::try_from_secs_f64(state.age_s(property).unwrap_or(0.0)).unwrap_or(Duration::MAX);
        let age = self.clock().machine().since(arrived).saturating_add(read);
        (age <= freshness(state.period_s)).then_some(state)
    }

    /// The capabilities, once they were received.
    pub fn can(&self) -> Option<K::Capabilities> {
        self.about.get().map(|received| received.sample.body.can)
    }

    /// Could this property, which the capabilities are made of, not be read yet?
    pub fn is_unread(&self, property: &str) -> bool {
        self.about.get().is_some_and(|received| received.sample.body.unread.contains_key(property))
    }

    /// Its capabilities; waits a few seconds for them.
    pub async fn capabilities(&self) -> Result<K::Capabilities, ActionError> {
        self.capabilities_with(&[]).await
    }

    /// As [`Self::capabilities`]; waits as long for these properties, where the device node could not read them yet. What
    /// is unread even then is as its capabilities have it.
    pub async fn capabilities_with(&self, properties: &[&str]) -> Result<K::Capabilities, ActionError> {
        let mut about = self.about.clone();
        let wait = async {
            loop {
                let description = about.get().map(|received| received.sample.body);
                let is_read =
                    |body: &DeviceDescription<_>| properties.iter().all(|name| !body.unread.contains_key(*name));
                if let Some(body) = description.filter(is_read) {
                    return body.can;
                }
                about.changed().await;
            }
        };
        // They are published every 10 s, and when what was unread is read.
        match tokio::time::timeout(DESCRIBED, wait).await {
            Ok(can) => Ok(can),
            Err(_) => self.can().ok_or_else(|| self.late("described by its node", DESCRIBED)),
        }
    }

    /// Gives a command and returns its id as soon as it is taken.
    pub async fn ask(&self, action: K::Command) -> Result<CommandId, ActionError> {
        let id = CommandId::fresh();
        self.ask_as(id.clone(), action).await?;
        Ok(id)
    }

    /// As [`Self::ask`], under an id that was made before.
    pub async fn ask_as(&self, id: CommandId, action: K::Command) -> Result<(), ActionError> {
        let token = self.sender.lease.borrow().token();
        self.send_as(id, action, token).await.map(|_| ())
    }

    /// As [`Self::ask_as`], for a claim; returns the token that was granted. `shows`: the newest token that this node
    /// remembers, beyond which an arbiter that has lost its own goes on.
    pub async fn claim_as(
        &self,
        id: CommandId,
        action: K::Command,
        shows: Option<u64>,
    ) -> Result<Option<u64>, ActionError> {
        self.send_as(id, action, shows).await
    }

    async fn send_as(&self, id: CommandId, action: K::Command, token: Option<u64>) -> Result<Option<u64>, ActionError> {
        let verb = verb(&action);
        let (from, boot_id) = (self.sender.signature.clone(), Some(self.sender.bus.boot_id().clone()));
        let command = Command { id: id.clone(), from, token, boot_id, action };
        let mut asked = 0;
        loop {
            asked += 1;
            match self.sender.bus.command(&self.device, &command, ANSWER).await {
                Ok(accepted) => return Ok(accepted.token),
                Err(AskError::Refused { refusal, .. }) => {
                    if refusal.reason == Reason::StaleToken
                        && token.is_some()
                        && token == self.sender.lease.borrow().token()
                    {
                        self.sender.doubt.notify_one();
                    }
                    let (device, detail) = (self.device.to_string(), refusal.detail);
                    return Err(ActionError::Refused { device, verb, reason: refusal.reason, detail });
                }
                Err(AskError::Unknown { .. } | AskError::Unreadable { .. } | AskError::Contested { .. }) => {
                    // Unknown is not undone: the state shows it.
                    let taken = self.newest().and_then(|received| received.sample.body.last_command);
                    if taken.is_some_and(|last| last.id == id) {
                        return Ok(None);
                    }
                    if asked >= REPEATS {
                        return Err(ActionError::Unanswered { device: self.device.to_string(), verb });
                    }
                }
            }
        }
    }

    /// As [`Self::ask_as`], but waits a while for a command before it to be done.
    pub async fn ask_in_turn(&self, id: &CommandId, action: K::Command) -> Result<(), ActionError> {
        self.ask_within(id, action, TURN).await
    }

    /// As [`Self::ask_in_turn`], for so long.
    pub async fn ask_within(&self, id: &CommandId, action: K::Command, turn: Duration) -> Result<(), ActionError> {
        let started = self.clock().machine();
        loop {
            match self.ask_as(id.clone(), action.clone()).await {
                Err(ActionError::Refused { reason: Reason::Busy, .. })
                    if self.clock().machine().since(started) < turn =>
                {
                    // The end of a readout is caught at once, that of a slew need not be.
                    let long = self.clock().machine().since(started) > Duration::from_secs(5);
                    tokio::time::sleep(Duration::from_millis(if long { 250 } else { 20 })).await;
                }
                asked => return asked,
            }
        }
    }

    /// Gives a command and waits until it is done, at most as long as `sky` of sky time allows.
    pub async fn execute(&self, action: K::Command, sky: Duration) -> Result<DeviceState<K::Fields>, ActionError> {
        let (verb, id) = (verb(&action), CommandId::fresh());
        self.ask_in_turn(&id, action).await?;
        self.done(&id, &verb, command_timeout(self.clock(), sky)).await
    }

    /// Waits until a command that was taken is done, as the state shows; `most` is machine time.
    pub async fn done(
        &self,
        id: &CommandId,
        verb: &str,
        most: Duration,
    ) -> Result<DeviceState<K::Fields>, ActionError> {
        let boot_id = self.newest().map(|received| received.sample.boot_id);
        let taken = self.clock().machine();
        let (mut seen, mut replaced) = (false, None);
        self.until(most, &format!("done with {verb}"), |received| {
            let state = &received.sample.body;
            let is_newest = state.last_command.as_ref().is_some_and(|last| last.id == *id);
            seen |= is_newest;
            let is_restarted = boot_id.as_ref().is_some_and(|boot_id| received.sample.boot_id != *boot_id);
            // A state that is surely newer than the command.
            let is_newer = seen || received.arrived >= taken.plus(SETTLED);
            let replaced_for = (!is_newest && is_newer && state.last_command.is_some())
                .then(|| received.arrived.since(*replaced.get_or_insert(received.arrived)));
            let device = self.device.to_string();
            match sight(state, id, is_restarted, replaced_for) {
                CommandSight::Done => Some(Ok(state.clone())),
                CommandSight::Failed(reason) => {
                    Some(Err(ActionError::Failed { device, verb: verb.to_owned(), reason }))
                }
                CommandSight::Restarted => Some(Err(ActionError::Restarted { device })),
                CommandSight::UnderWay => None,
            }
        })
        .await?
    }

    /// Gives a command of the maker's own and waits for what the device answers, at most `most` of machine time.
    pub async fn ask_for_answer(&self, action: K::Command, most: Duration) -> Result<String, ActionError> {
        let (verb, id) = (verb(&action), CommandId::fresh());
        self.ask_in_turn(&id, action).await?;
        let (taken, mut seen) = (self.clock().machine(), false);
        let failed = |reason: &str| {
            let (device, verb) = (self.device.to_string(), verb.clone());
            Some(Err(ActionError::Failed { device, verb, reason: reason.to_owned() }))
        };
        self.until(most, &format!("done with {verb}"), |received| {
            let last = received.sample.body.last_command.as_ref();
            let mine = last.filter(|last| last.id == id);
            seen |= mine.is_some();
            match mine.map(|last| (&last.outcome, &last.answer)) {
                Some((CommandOutcome::Done, answer)) => Some(Ok(answer.clone().unwrap_or_default())),
                Some((CommandOutcome::Failed { reason }, _)) => failed(reason.as_str()),
                Some((CommandOutcome::Running, _)) => None,
                // Unlike a movement, an answer cannot be seen any more.
                None if seen || received.arrived >= taken.plus(SETTLED) => {
                    failed("another command came in between, so that the answer is lost")
                }
                None => None,
            }
        })
        .await?
    }

    /// Waits until the state shows something; `what` completes "not ... within".
    pub async fn until<T>(
        &self,
        most: Duration,
        what: &str,
        mut shows: impl FnMut(&Received<DeviceState<K::Fields>>) -> Option<T>,
    ) -> Result<T, ActionError> {
        let mut states = self.state.clone();
        let wait = async {
            loop {
                let connected = states.get().filter(|received| received.sample.body.link == Link::Connected);
                if let Some(value) = connected.and_then(|received| shows(&received)) {
                    return value;
                }
                states.changed().await;
            }
        };
        tokio::time::timeout(most, wait).await.map_err(|_| self.late(what, most))
    }

    fn late(&self, what: &str, most: Duration) -> ActionError {
        ActionError::Deadline { device: self.device.to_string(), what: what.to_owned(), after_s: most.as_secs_f64() }
    }
}

/// How far a command is, by a state of its device.
#[derive(Debug, PartialEq)]
enum CommandSight {
    UnderWay,
    Done,
    Failed(String),
    Restarted,
}

/// How far a command is. `is_restarted`: the state is of another incarnation of the device node than the one that took it.
/// `replaced_for`: so long states have named another command as the newest.
fn sight<F>(
    state: &DeviceState<F>,
    id: &CommandId,
    is_restarted: bool,
    replaced_for: Option<Duration>,
) -> CommandSight {
    let last = state.last_command.as_ref();
    match last.filter(|last| last.id == *id).map(|last| &last.outcome) {
        // Its device node has seen the effect. What else the device is at, or says that it is, does not matter.
        Some(CommandOutcome::Done) => return CommandSight::Done,
        Some(CommandOutcome::Failed { reason }) => return CommandSight::Failed(reason.clone()),
        Some(CommandOutcome::Running) => return CommandSight::UnderWay,
        None => {}
    }
    if is_restarted {
        // A new incarnation of the node knows nothing of it, whatever commands it got since.
        return if state.busy { CommandSight::UnderWay } else { CommandSight::Restarted };
    }
    // A later command of another node has replaced ours: that nothing moves is then all that can be seen.
    match (replaced_for, last) {
        (Some(_), _) if !state.busy => CommandSight::Done,
        (Some(since), Some(last)) if since >= RESTS => {
            CommandSight::Failed(format!("{} took its place, and the device does not come to rest", last.verb))
        }
        _ => CommandSight::UnderWay,
    }
}

/// The name of a command in JSON.
fn verb<C: Payload>(command: &C) -> String {
    match serde_json::to_value(command) {
        Ok(serde_json::Value::String(word)) => word,
        Ok(serde_json::Value::Object(map)) => map.keys().next().cloned().unwrap_or_default(),
        _ => "follow a command".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use contract::LastCommand;
    use units::Utc;

    use super::*;

    fn state(busy: bool, last: Option<(&str, CommandOutcome)>) -> DeviceState<()> {
        let last = last.map(|(id, outcome)| LastCommand {
            id: CommandId(id.to_owned()),
            from: "observatory/alpha/main".to_owned(),
            verb: "slew".to_owned(),
            taken_utc: Utc::EPOCH,
            outcome,
            answer: None,
        });
        let readings = Default::default();
        DeviceState {
            link: Link::Connected,
            busy,
            period_s: 1.0,
            poll_s: None,
            last_command: last,
            fields: (),
            readings,
        }
    }

    #[test]
    fn a_command_is_done_by_what_its_device_node_reports_of_it_and_not_by_a_device_that_rests() {
        use CommandOutcome::{Done, Failed, Running};
        let long = Some(RESTS);
        let short = Some(Duration::from_secs(1));
        let failed = || Failed { reason: "stuck".to_owned() };
        let replaced = || CommandSight::Failed("slew took its place, and the device does not come to rest".to_owned());
        let rows = [
            // A flag of the device that stays, such as that of a guide pulse.
            (state(true, Some(("mine", Done))), false, None, CommandSight::Done),
            (state(false, Some(("mine", Running))), false, None, CommandSight::UnderWay),
            (state(true, Some(("mine", failed()))), false, None, CommandSight::Failed("stuck".to_owned())),
            (state(true, None), true, None, CommandSight::UnderWay),
            (state(false, None), true, None, CommandSight::Restarted),
            (state(false, Some(("later", Running))), false, None, CommandSight::UnderWay),
            (state(false, Some(("later", Done))), false, short, CommandSight::Done),
            (state(true, Some(("later", Done))), false, short, CommandSight::UnderWay),
            (state(true, Some(("later", Done))), false, long, replaced()),
        ];
        for (state, is_restarted, replaced_for, expected) in rows {
            let found = sight(&state, &CommandId("mine".to_owned()), is_restarted, replaced_for);
            assert_eq!(found, expected, "{state:?}");
        }
    }
}
