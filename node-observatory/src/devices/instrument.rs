//! One device of any kind: its newest state, and `command and wait until done`.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bus::{AskError, Bus, Clock, Latest, Received};
use contract::device::DeviceDescription;
use contract::{
    Command, CommandId, CommandOutcome, Device, DeviceKind, DeviceState, Key, LastCommand, Link, Payload, Reason,
};
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
/// A state that arrives so long after a command was taken knows of it: up to three stops before it have a second each.
const SETTLED: Duration = Duration::from_secs(4);
/// So many commands are remembered with their ends.
const REMEMBERED: usize = 16;

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
    ended: Arc<Mutex<EndedCommands>>,
    sender: CommandSender,
}

/// The newest commands of a device that have ended: of two that follow each other, who waits may see the state of the
/// second only.
#[derive(Debug, Default)]
struct EndedCommands(VecDeque<LastCommand>);

impl EndedCommands {
    /// Takes in the newest command of a state.
    fn note(&mut self, last: Option<&LastCommand>) {
        let Some(last) = last.filter(|last| last.outcome != CommandOutcome::Running) else { return };
        if self.0.back().is_some_and(|newest| newest.id == last.id) {
            return;
        }
        self.0.push_back(last.clone());
        if self.0.len() > REMEMBERED {
            self.0.pop_front();
        }
    }

    /// The command of this id.
    fn get(&self, id: &CommandId) -> Option<LastCommand> {
        self.0.iter().rev().find(|ended| ended.id == *id).cloned()
    }
}

impl<K: DeviceKind> Instrument<K> {
    /// Subscribes to a device.
    pub async fn listen(command_sender: &CommandSender, device: Device) -> anyhow::Result<Self> {
        let ended = Arc::<Mutex<EndedCommands>>::default();
        let into = ended.clone();
        let each = move |received: &Received<DeviceState<K::Fields>>| {
            let mut ended = into.lock().unwrap_or_else(PoisonError::into_inner);
            ended.note(received.sample.body.last_command.as_ref());
        };
        let state = command_sender.bus.latest_with(&Key::State(device.clone()), each).await?;
        let about = command_sender.bus.latest(&Key::Capabilities(device.clone())).await?;
        Ok(Self { device, state, about, ended, sender: command_sender.clone() })
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

    /// A command as this state shows it, or as one before it showed its end.
    fn shown(&self, id: &CommandId, state: &DeviceState<K::Fields>) -> Option<LastCommand> {
        let newest = state.last_command.as_ref().filter(|last| last.id == *id).cloned();
        newest.or_else(|| self.ended.lock().unwrap_or_else(PoisonError::into_inner).get(id))
    }

    /// Waits until a command that was taken is done, as the state shows; `most` is machine time.
    ///
    /// # Errors
    /// One that another command replaced before is [`ActionError::Superseded`], whatever the device does by then.
    pub async fn done(
        &self,
        id: &CommandId,
        verb: &str,
        most: Duration,
    ) -> Result<DeviceState<K::Fields>, ActionError> {
        let boot_id = self.newest().map(|received| received.sample.boot_id);
        let (taken, mut seen) = (self.clock().machine(), false);
        self.until(most, &format!("done with {verb}"), |received| {
            let state = &received.sample.body;
            let mine = self.shown(id, state);
            seen |= mine.is_some();
            let is_restarted = boot_id.as_ref().is_some_and(|boot_id| received.sample.boot_id != *boot_id);
            // A state that is surely newer than the command.
            let is_newer = seen || received.arrived >= taken.plus(SETTLED);
            let (device, verb) = (self.device.to_string(), verb.to_owned());
            match sight(state, mine.map(|mine| mine.outcome), is_restarted, is_newer) {
                CommandSight::Done => Some(Ok(state.clone())),
                CommandSight::Failed(reason) => Some(Err(ActionError::Failed { device, verb, reason })),
                CommandSight::Superseded(by) => Some(Err(ActionError::Superseded { device, verb, by })),
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
        self.until(most, &format!("done with {verb}"), |received| {
            let state = &received.sample.body;
            let mine = self.shown(&id, state);
            seen |= mine.is_some();
            let is_newer = seen || received.arrived >= taken.plus(SETTLED);
            let (device, verb) = (self.device.to_string(), verb.clone());
            match (mine.map(|mine| (mine.outcome, mine.answer)), &state.last_command) {
                (Some((CommandOutcome::Done, answer)), _) => Some(Ok(answer.unwrap_or_default())),
                (Some((CommandOutcome::Failed { reason }, _)), _) => {
                    Some(Err(ActionError::Failed { device, verb, reason }))
                }
                (None, Some(later)) if is_newer => Some(Err(ActionError::Superseded { device, verb, by: name(later) })),
                (None, None) if is_newer => Some(Err(ActionError::Restarted { device })),
                (Some((CommandOutcome::Running, _)) | None, _) => None,
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
    Superseded(String),
    Restarted,
}

/// How far a command is. `mine`: how far states have shown it to be. `is_restarted`: the state is of another incarnation of
/// the device node than the one that took it. `is_newer`: the state is surely newer than the command.
fn sight<F>(state: &DeviceState<F>, mine: Option<CommandOutcome>, is_restarted: bool, is_newer: bool) -> CommandSight {
    match (mine, &state.last_command) {
        // Its device node has seen the effect. What else the device is at, or says that it is, does not matter.
        (Some(CommandOutcome::Done), _) => CommandSight::Done,
        (Some(CommandOutcome::Failed { reason }), _) => CommandSight::Failed(reason),
        (Some(CommandOutcome::Running), _) => CommandSight::UnderWay,
        // A new incarnation of the node knows nothing of it, whatever commands it got since.
        (None, _) if is_restarted && !state.busy => CommandSight::Restarted,
        (None, _) if is_restarted => CommandSight::UnderWay,
        // That nothing moves is no sign of its effect.
        (None, Some(later)) if is_newer => CommandSight::Superseded(name(later)),
        (None, _) => CommandSight::UnderWay,
    }
}

/// A command and its sender, in words.
fn name(command: &LastCommand) -> String {
    format!("{} of {}", command.verb, command.from)
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
    use contract::device::telescope::{Fields, Telescope};
    use contract::{Address, Kind};
    use test_support::{LIMIT, join, private_bus, until};
    use units::Utc;

    use super::*;

    fn command(id: &str, outcome: CommandOutcome) -> LastCommand {
        LastCommand {
            id: CommandId(id.to_owned()),
            from: "observatory/alpha/main".to_owned(),
            verb: "slew".to_owned(),
            taken_utc: Utc::EPOCH,
            outcome,
            answer: None,
        }
    }

    fn state<F: Default>(busy: bool, last_command: Option<LastCommand>) -> DeviceState<F> {
        DeviceState {
            link: Link::Connected,
            busy,
            period_s: 1.0,
            poll_s: None,
            last_command,
            fields: F::default(),
            readings: Default::default(),
        }
    }

    #[test]
    fn a_command_is_done_by_what_its_device_node_reports_of_it_and_not_by_a_device_that_rests() {
        use CommandOutcome::{Done, Failed, Running};
        let failed = || Failed { reason: "stuck".to_owned() };
        let replaced = || CommandSight::Superseded("slew of observatory/alpha/main".to_owned());
        let rows = [
            // A flag of the device that stays, such as that of a guide pulse.
            (true, None, Some(Done), false, true, CommandSight::Done),
            (false, None, Some(Running), false, true, CommandSight::UnderWay),
            (true, None, Some(failed()), false, true, CommandSight::Failed("stuck".to_owned())),
            (true, None, None, true, false, CommandSight::UnderWay),
            (false, None, None, true, true, CommandSight::Restarted),
            (false, Some(Running), None, true, true, CommandSight::Restarted),
            // The state may be from before the command.
            (false, Some(Done), None, false, false, CommandSight::UnderWay),
            // Two guide pulses: the first was seen to end before the second.
            (true, Some(Running), Some(Done), false, true, CommandSight::Done),
            (false, Some(Done), None, false, true, replaced()),
            (true, Some(Running), None, false, true, replaced()),
        ];
        for (busy, later, mine, is_restarted, is_newer, expected) in rows {
            let state = state::<()>(busy, later.map(|outcome| command("later", outcome)));
            let found = sight(&state, mine.clone(), is_restarted, is_newer);
            assert_eq!(found, expected, "{state:?}, {mine:?}");
        }
    }

    #[test]
    fn the_ends_of_the_newest_commands_are_remembered() {
        use CommandOutcome::{Done, Running};
        let (mut ended, id) = (EndedCommands::default(), |number: usize| number.to_string());
        for number in 0..REMEMBERED + 2 {
            for outcome in [Running, Done, Done] {
                ended.note(Some(&command(&id(number), outcome)));
            }
        }
        ended.note(Some(&command("runs", Running)));
        ended.note(None);
        let is_known = |id: &str| ended.get(&CommandId(id.to_owned())).is_some_and(|ended| ended.outcome == Done);
        assert!(!is_known(&id(1)) && is_known(&id(2)) && is_known(&id(REMEMBERED + 1)) && !is_known("runs"));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn of_two_commands_the_first_is_done_if_that_was_seen_and_names_the_second_if_not() {
        use CommandOutcome::{Done, Running};
        let bus = private_bus(Clock::machine_clock()).await;
        let device = Address::new("test", "alpha").unwrap().device(Kind::Telescope, &"mount".parse().unwrap());
        let states = bus.publisher::<DeviceState<Fields>>(&Key::State(device.clone())).await.unwrap();
        let command_sender = CommandSender {
            bus: join(&bus).await,
            signature: "observatory/alpha/main".to_owned(),
            lease: watch::channel(Hold::Standby).1,
            doubt: Arc::default(),
        };
        let mount = Instrument::<Telescope>::listen(&command_sender, device).await.unwrap();
        let publish = async |id: &str, outcome: CommandOutcome| {
            states.put(state(false, Some(command(id, outcome)))).await.unwrap();
        };
        let newest = || mount.newest().and_then(|received| received.sample.body.last_command).map(|last| last.id.0);
        // The sessions have met when a state arrives that is repeated.
        while newest().is_none() {
            publish("before", Done).await;
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        for (id, outcome) in [("first", Running), ("first", Done), ("second", Running)] {
            publish(id, outcome).await;
        }
        until("the second runs", || newest().as_deref() == Some("second")).await;
        let [first, second] = ["first", "second"].map(|id| CommandId(id.to_owned()));
        assert!(mount.done(&first, "slew", LIMIT).await.is_ok(), "the second came before anybody had looked");
        let mut waiting = std::pin::pin!(mount.done(&second, "slew", LIMIT));
        assert!(tokio::time::timeout(Duration::ZERO, &mut waiting).await.is_err(), "the second runs");
        publish("third", Done).await;
        let error = waiting.await.unwrap_err().to_string();
        let by = "slew was not seen to be done before slew of observatory/alpha/main took its place";
        assert!(error.ends_with(by), "{error}");
    }
}
