//! Answers a device's commands at once; what is accepted is done by the device's own loop.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use contract::audit::Outcome;
use contract::{Accepted, Command, CommandId, Link, Reason, Refusal, Reply};
use interlock::{Claimant, Hinders, Need, Turned};
use tokio::sync::mpsc;
use units::Utc;

use crate::accounts::{Accounts, Asked};
use crate::driver::{Capabilities, Command as Deed, Driver, Fields};
use crate::gate::Gate;

/// Answers of so many commands are remembered, so that a repeat is answered again and not done again.
const REMEMBERED: usize = 200;

/// An accepted command on its way to the device's loop.
#[derive(Debug, Clone)]
pub struct Order<C> {
    /// Its id.
    pub id: CommandId,
    /// The sender.
    pub from: String,
    /// What to do.
    pub deed: C,
    /// With which token.
    pub token: Option<u64>,
    /// Sky time when it was taken.
    pub taken_utc: Utc,
}

impl<C> Order<C> {
    /// The sender, id and token, for the audit log.
    pub fn asked(&self) -> Asked {
        Asked { from: self.from.clone(), id: self.id.clone(), token: self.token }
    }
}

/// What the loop shows to those who take commands.
pub struct Face<D: Driver + ?Sized> {
    /// Does the device answer?
    pub link: Link,
    /// What it can do, once it was connected.
    pub can: Option<Capabilities<D>>,
    /// What is true of it.
    pub fields: Fields<D>,
    /// The command that is being done.
    pub running: Option<CommandId>,
}

/// The counter where commands are taken.
pub struct Front<D: Driver> {
    /// The driver.
    pub driver: Arc<D>,
    /// Decides which commands are accepted.
    pub gate: Gate,
    /// What is kept of it.
    pub accounts: Accounts,
    /// What is true of the device.
    pub face: Mutex<Face<D>>,
    answered: Mutex<VecDeque<Reply>>,
    claiming: tokio::sync::Mutex<()>,
    orders: mpsc::UnboundedSender<Order<Deed<D>>>,
}

impl<D: Driver> Front<D> {
    /// A counter, and the end where accepted commands come out.
    pub fn new(driver: Arc<D>, gate: Gate, accounts: Accounts) -> (Self, mpsc::UnboundedReceiver<Order<Deed<D>>>) {
        let (orders, taken) = mpsc::unbounded_channel();
        let face = Face { link: Link::Connecting, can: None, fields: Fields::<D>::default(), running: None };
        let front = Self {
            driver,
            gate,
            accounts,
            face: Mutex::new(face),
            answered: Mutex::default(),
            claiming: tokio::sync::Mutex::default(),
            orders,
        };
        (front, taken)
    }

    /// Answers one command.
    pub async fn answer(&self, command: Result<Command<Deed<D>>, String>) -> Reply {
        let command = match command {
            Ok(command) => command,
            Err(detail) => {
                self.accounts.unreadable(&detail);
                let id = CommandId(String::new());
                return Reply::Refusal(Refusal { id, reason: Reason::Malformed, detail });
            }
        };
        let id = command.id.clone();
        if let Some(reply) = self.repeat(&id) {
            return reply;
        }
        if let Some(reply) = self.driver.answer(&id, &command.action) {
            return reply;
        }
        let (asked, deed) = (Asked::from(&command), command.action.clone());
        match self.take(command).await {
            Ok(token) => {
                let reply = Reply::Accepted(Accepted { id, token });
                self.remember(reply.clone());
                reply
            }
            Err((reason, detail)) => {
                // A sender that finds the device busy asks again soon, and again.
                match reason {
                    Reason::Busy => tracing::debug!(command = %id, detail, "command refused: busy"),
                    _ => tracing::info!(command = %id, %reason, detail, "command refused"),
                }
                let turned = (reason, detail);
                if self.driver.moves(&deed) {
                    let is_claim = self.driver.need(&deed) == Need::Claim;
                    self.accounts.refused(asked, &deed, is_claim, &turned);
                }
                let (reason, detail) = turned;
                Reply::Refusal(Refusal { id, reason, detail })
            }
        }
    }

    /// A command from this node itself, such as the guard's; it needs no authorization.
    pub fn insist(&self, from: &str, deed: Deed<D>) {
        let id = CommandId::fresh();
        self.face().running = Some(id.clone());
        let order = Order { id, from: from.to_owned(), deed, token: None, taken_utc: self.gate.clock.utc() };
        let (asked, deed) = (order.asked(), order.deed.clone());
        // The loop is gone only while the node ends.
        let _ = self.orders.send(order);
        // After the sending, so that whatever noting takes, moving does not wait for it.
        self.accounts.note(asked, &deed, Outcome::Accepted);
    }

    async fn take(&self, command: Command<Deed<D>>) -> Result<Option<u64>, Turned> {
        let Command { id, from, token, boot_id, action } = command;
        let need = self.driver.need(&action);
        let who = Claimant { name: &from, life: boot_id.as_ref() };
        if matches!(need, Need::Claim | Need::Resume) {
            let _claiming = self.claiming.lock().await;
            if let Some(Reply::Accepted(repeated)) = self.repeat(&id) {
                return Ok(repeated.token);
            }
            let granted = self.gate.admit((need, Hinders::No), who, token).await?;
            let asked = Asked { from, id, token };
            match granted {
                Some(granted) => self.accounts.granted(asked, &action, granted),
                None => self.accounts.note(asked, &action, Outcome::Accepted),
            }
            return Ok(granted);
        }
        let hinders = self.driver.hinders(&action);
        let before = self.reserve(&id, &action)?;
        match self.gate.admit((need, hinders), who, token).await {
            Ok(granted) => {
                let taken_utc = self.gate.clock.utc();
                let order = Order { id, from, deed: action, token, taken_utc };
                let (asked, deed) = (order.asked(), order.deed.clone());
                let sent = self.orders.send(order);
                sent.map_err(|_| (Reason::NotNow, "the node is ending".to_owned()))?;
                if self.driver.moves(&deed) {
                    self.accounts.note(asked, &deed, Outcome::Accepted);
                }
                Ok(granted)
            }
            Err(turned) => {
                let mut face = self.face();
                if face.running.as_ref() == Some(&id) {
                    face.running = before;
                }
                Err(turned)
            }
        }
    }

    /// Takes the device for this command, if it makes sense now; returns which command had it.
    fn reserve(&self, id: &CommandId, deed: &Deed<D>) -> Result<Option<CommandId>, Turned> {
        let mut face = self.face();
        let interrupts = self.driver.interrupts(deed);
        if !interrupts {
            match &face.link {
                Link::Connected => {}
                Link::Connecting => return Err((Reason::NotConnected, "not connected yet".to_owned())),
                Link::Lost { reason } => return Err((Reason::NotConnected, reason.to_string())),
            }
        }
        if let Some(can) = &face.can
            && let Some(turned) = self.driver.refuse(id, deed, can, &face.fields)
        {
            return Err(turned);
        }
        match &face.running {
            Some(running) if running != id && !interrupts => {
                Err((Reason::Busy, format!("command {running} is being done")))
            }
            _ => Ok(face.running.replace(id.clone())),
        }
    }

    fn face(&self) -> std::sync::MutexGuard<'_, Face<D>> {
        self.face.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn repeat(&self, id: &CommandId) -> Option<Reply> {
        let answered = self.answered.lock().unwrap_or_else(PoisonError::into_inner);
        let same = |reply: &&Reply| matches!(reply, Reply::Accepted(accepted) if accepted.id == *id);
        answered.iter().rev().find(same).cloned()
    }

    fn remember(&self, reply: Reply) {
        let mut answered = self.answered.lock().unwrap_or_else(PoisonError::into_inner);
        answered.push_back(reply);
        if answered.len() > REMEMBERED {
            answered.pop_front();
        }
    }
}
