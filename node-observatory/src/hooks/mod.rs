//! The site's own script: what a site does before, after or instead of opening and closing (`[hooks]`).
//!
//! A script is Rhai, run in this process on a thread of its own, with limits on time, work and memory, and nothing to
//! reach the world by but the functions of [`engine`]. It asks; this node does, under the same verdict, permits, tokens
//! and audit as ever. So a script can delay an opening or refuse it, and can never open what may not be open.
//!
//! ```text
//!  opening:  before_open  ->  open, or the default  ->  is_ready, each second  ->  after_open
//!            any failure: closed by default, and the row rests
//!
//!  closing:  before_close ->  close, or nothing     ->  the default closing, until verified  ->  after_close
//!            |<-- at most close_wait_s ---------------->|   any failure: the default closing, at once
//! ```
//! The guards of the domes, the verdict and the permits never wait for a script.

mod call;
#[cfg(test)]
mod call_tests;
mod calls;
mod closing;
pub mod engine;
#[cfg(test)]
mod greedy_tests;
pub(crate) mod host;
pub(crate) mod line;
mod memory;
mod script;

use std::sync::Arc;

use contract::observatory::AlertKind;
use node::Node;

pub use call::CallError;
pub use closing::AtClosing;
pub use script::{FUNCTIONS, Function, Script, ScriptError};

use crate::action_error::ActionError;
use crate::authority::Authority;
use crate::devices::Devices;

/// What the configuration has of a script.
pub enum Hooks {
    /// No script.
    None,
    /// A script that has been proven.
    Script(Script),
    /// A script that cannot be used: nothing is opened, and everything is closed by default.
    Broken(String),
}

/// What a script works with.
pub struct ScriptedSite {
    /// Whether this node may act.
    pub authority: Arc<Authority>,
    /// The devices.
    pub devices: Arc<Devices>,
    /// The script.
    pub hooks: Hooks,
}

impl Hooks {
    /// Reads and proves the script of the configuration; an alert is active if it cannot be used.
    pub async fn load(node: &Node) -> Self {
        let Some(file) = node.config.hooks.script.clone() else { return Self::None };
        let path = file.display().to_string();
        let read = tokio::task::spawn_blocking(move || Script::read(&file)).await;
        let why = match read {
            Ok(Ok(script)) => {
                tracing::info!(file = path, functions = ?script.names(), "the site's script");
                return Self::Script(script);
            }
            Ok(Err(error)) => error.to_string(),
            Err(error) => format!("{path}: {error}"),
        };
        node.alerts.raise(AlertKind::SiteScript, "script", &why);
        Self::Broken(why)
    }

    /// The script, where there is one.
    ///
    /// # Errors
    /// When there is one that cannot be used: what it is for may be needed to open without harm.
    pub fn script(&self) -> Result<Option<&Script>, ActionError> {
        match self {
            Self::None => Ok(None),
            Self::Script(script) => Ok(Some(script)),
            Self::Broken(why) => Err(ActionError::Script { function: "the text".to_owned(), why: why.clone() }),
        }
    }
}
