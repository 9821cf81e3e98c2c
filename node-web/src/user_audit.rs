//! Records in the audit of what was changed about users over the page and the API.

use audit::Entry;
use contract::audit::AuditOutcome;
use contract::{CommandId, Name};
use serde_json::Value;
use users::Principal;

use crate::authentication::Client;
use crate::server::Server;

impl Server {
    /// Records what `by` has done about a user; `what` has never a password or a token.
    pub fn note_user(&self, by: &Principal, client: &Client, verb: &str, user: &Name, what: &Value) {
        self.audit.note(Entry {
            from: format!("web/{by}@{}", client.address),
            id: CommandId::default(),
            device: format!("user/{user}"),
            verb: verb.to_owned(),
            parameters: what.to_string(),
            token: None,
            reason: String::new(),
            outcome: AuditOutcome::Done,
        });
    }
}
