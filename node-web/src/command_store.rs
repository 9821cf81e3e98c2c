//! The commands that this node took, for a day.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use contract::{Address, CommandId, Order, Reason};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};
use tokio::sync::watch;
use units::Utc;

/// So many are remembered, for so long; then the audit has them.
const MOST: usize = 2000;
const REMEMBERED: Duration = Duration::from_secs(24 * 3600);

/// How far a command is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Progress {
    /// It was sent to the observatory node.
    Sent,
    /// The observatory node took it; what it ordered is under way.
    Accepted,
    /// What it ordered is done.
    Done,
    /// The observatory node does not do it.
    Refused,
    /// It was accepted, and what it ordered was not seen done in time, or holds and is not on disk: `detail` says which.
    Failed,
    /// Nobody answered: whether it was done is unknown.
    Unknown,
}

/// A command and what became of it.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize)]
pub struct CommandState {
    /// Its id; the order's id on the bus and in the audit, too.
    pub id: CommandId,
    /// The telescope.
    #[schemars(with = "String")]
    #[serde(serialize_with = "as_text")]
    pub telescope: Address,
    /// The order's word.
    pub command: String,
    /// Its parameters.
    pub parameters: Map<String, Value>,
    /// Why.
    pub reason: String,
    /// The person who ordered it.
    pub requested_by: String,
    /// What stood against it when it was given, so that it changes nothing before that is lifted; empty for orders that
    /// close.
    pub against: Vec<String>,
    /// Where it is.
    pub state: Progress,
    /// What the observatory node says of it, or what was seen.
    pub detail: Option<String>,
    /// Why it was refused, for programs.
    pub refused_because: Option<Reason>,
    /// What happened to it, the oldest first.
    pub events: Vec<CommandEvent>,
}

/// A change of a command.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize)]
pub struct CommandEvent {
    /// Sky time of this server.
    pub at_utc: Utc,
    /// What it became.
    pub state: Progress,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn as_text<S: serde::Serializer>(address: &Address, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(address)
}

impl CommandState {
    /// A command that is sent now.
    pub fn sent(
        order: &Order,
        telescope: &Address,
        word: &str,
        parameters: Map<String, Value>,
        person: &str,
        against: Vec<String>,
        at_utc: Utc,
    ) -> Self {
        Self {
            id: order.id.clone(),
            telescope: telescope.clone(),
            command: word.to_owned(),
            parameters,
            reason: order.reason.clone(),
            requested_by: person.to_owned(),
            against,
            state: Progress::Sent,
            detail: None,
            refused_because: None,
            events: vec![CommandEvent { at_utc, state: Progress::Sent }],
        }
    }

    /// Has the observatory node answered, or nobody?
    pub fn is_answered(&self) -> bool {
        self.state != Progress::Sent
    }

    /// Is nothing more to come?
    pub fn has_ended(&self) -> bool {
        !matches!(self.state, Progress::Sent | Progress::Accepted)
    }
}

/// One command, shared by those who wait for it.
pub struct Command {
    state: watch::Sender<CommandState>,
    key: (String, String, String),
    began: std::time::Instant,
}

impl Command {
    /// As it is now.
    pub fn now(&self) -> CommandState {
        self.state.borrow().clone()
    }

    /// Notes what became of it.
    pub fn note(&self, progress: Progress, detail: Option<String>, at_utc: Utc) {
        self.state.send_modify(|state| {
            state.state = progress;
            state.detail = detail;
            state.events.push(CommandEvent { at_utc, state: progress });
        });
    }

    /// Notes that it was refused.
    pub fn refuse(&self, reason: Reason, detail: String, at_utc: Utc) {
        self.state.send_modify(|state| state.refused_because = Some(reason));
        self.note(Progress::Refused, Some(detail), at_utc);
    }

    /// Waits until it is as wanted, or the time is over; as it is then.
    pub async fn until(&self, time: Duration, wanted: impl Fn(&CommandState) -> bool) -> CommandState {
        let mut state = self.state.subscribe();
        let _ = tokio::time::timeout(time, state.wait_for(|state| wanted(state))).await;
        self.now()
    }
}

/// What was found under a key.
pub enum Stored {
    /// Nothing: it is new.
    New(Arc<Command>),
    /// The command that was given with this key before.
    Again(Arc<Command>),
}

/// All commands of the last day.
#[derive(Default)]
pub struct Commands {
    all: Mutex<VecDeque<Arc<Command>>>,
}

impl Commands {
    /// Begins a command, unless one was given with the same key before: caller, telescope, and the caller's text.
    pub fn begin(&self, key: (String, String, String), state: CommandState) -> Stored {
        let mut all = self.lock();
        while all.len() >= MOST || all.front().is_some_and(|oldest| oldest.began.elapsed() > REMEMBERED) {
            all.pop_front();
        }
        if let Some(known) = all.iter().find(|command| command.key == key) {
            return Stored::Again(known.clone());
        }
        let command = Arc::new(Command { state: watch::Sender::new(state), key, began: std::time::Instant::now() });
        all.push_back(command.clone());
        Stored::New(command)
    }

    /// Was a command given with this key?
    pub fn knows(&self, key: &(String, String, String)) -> bool {
        self.lock().iter().any(|command| command.key == *key)
    }

    /// The newest of those that are wanted, the newest first.
    pub fn newest(&self, most: usize, is_wanted: impl Fn(&CommandState) -> bool) -> Vec<CommandState> {
        let all = self.lock();
        let wanted = all.iter().rev().filter(|command| is_wanted(&command.state.borrow()));
        wanted.take(most).map(|command| command.now()).collect()
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<Arc<Command>>> {
        self.all.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
