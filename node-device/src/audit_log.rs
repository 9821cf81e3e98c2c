//! The records of a device's commands in the audit log: the sender, the command and the outcome.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use audit::{Audit, Entry, verb_and_parameters};
use contract::audit::AuditOutcome;
use contract::{Command, CommandId, Device, Reason};
use interlock::Turned;
use serde::Serialize;

/// Refusals remembered, so that a sender that asks again and again leaves one record and not thousands.
const REMEMBERED: usize = 200;

/// One device's part of the audit.
pub struct AuditLog {
    audit: Audit,
    device: String,
    refused: Mutex<VecDeque<(String, Reason)>>,
}

/// The sender of a command, its id and its token.
#[derive(Debug, Clone)]
pub struct CommandOrigin {
    /// The sender.
    pub from: String,
    /// The command.
    pub id: CommandId,
    /// With which token.
    pub token: Option<u64>,
}

impl<C> From<&Command<C>> for CommandOrigin {
    fn from(command: &Command<C>) -> Self {
        Self { from: command.from.clone(), id: command.id.clone(), token: command.token }
    }
}

impl AuditLog {
    /// The accounts of a device.
    pub fn of(device: &Device, audit: Audit) -> Self {
        Self { audit, device: format!("{}/{}", device.kind, device.name), refused: Mutex::default() }
    }

    /// Notes what became of a command.
    pub fn note<C: Serialize>(&self, asked: CommandOrigin, command: &C, outcome: AuditOutcome) {
        let (verb, parameters) = verb_and_parameters(command);
        self.put(asked, verb, parameters, outcome);
    }

    /// The lease was granted; a process that is refused it after this leaves a record again.
    pub fn granted<C: Serialize>(&self, asked: CommandOrigin, command: &C, granted_token: u64) {
        self.refused.lock().unwrap_or_else(PoisonError::into_inner).clear();
        self.note(asked, command, AuditOutcome::Granted { granted_token });
    }

    /// A command was refused. The same command refused for the same reason again is not noted again, nor is a
    /// claim by the same sender: a standby claims once a second for as long as another node commands.
    pub fn refused<C: Serialize>(&self, asked: CommandOrigin, command: &C, is_claim: bool, turned: &Turned) {
        let (reason, detail) = turned;
        let what = if is_claim { format!("claim by {}", asked.from) } else { asked.id.to_string() };
        let mark = (what, *reason);
        {
            let mut refused = self.refused.lock().unwrap_or_else(PoisonError::into_inner);
            if refused.contains(&mark) {
                return;
            }
            refused.push_back(mark);
            if refused.len() > REMEMBERED {
                refused.pop_front();
            }
        }
        self.note(asked, command, AuditOutcome::Refused { reason: *reason, detail: detail.clone() });
    }

    /// A command could not be read: what it would have moved is not known.
    pub fn unreadable(&self, detail: &str) {
        let asked = CommandOrigin { from: String::new(), id: CommandId::default(), token: None };
        let outcome = AuditOutcome::Refused { reason: Reason::Malformed, detail: detail.to_owned() };
        self.put(asked, "unreadable".to_owned(), String::new(), outcome);
    }

    fn put(&self, asked: CommandOrigin, verb: String, parameters: String, outcome: AuditOutcome) {
        let CommandOrigin { from, id, token } = asked;
        let (device, reason) = (self.device.clone(), String::new());
        self.audit.note(Entry { from, id, device, verb, parameters, token, reason, outcome });
    }
}
