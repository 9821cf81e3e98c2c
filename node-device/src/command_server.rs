//! Answers a device's commands at once; what is accepted is done by the device's own loop.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use contract::audit::AuditOutcome;
use contract::{Accepted, Command, CommandId, Link, Reason, Refusal, Reply};
use interlock::{Claimant, CommandNeeds, Hinders, Need, Turned};
use tokio::sync::mpsc;
use units::Utc;

use crate::audit_log::{AuditLog, CommandOrigin};
use crate::command_check::CommandCheck;
use crate::driver::{Capabilities, Command as DeviceCommand, Driver, Fields};

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
    pub command: C,
    /// With which token.
    pub token: Option<u64>,
    /// Sky time when it was taken.
    pub taken_utc: Utc,
}

impl<C> Order<C> {
    /// The sender, id and token, for the audit log.
    pub fn asked(&self) -> CommandOrigin {
        CommandOrigin { from: self.from.clone(), id: self.id.clone(), token: self.token }
    }
}

/// What the loop shows to those who take commands.
pub struct DeviceStatus<D: Driver + ?Sized> {
    /// Does the device answer?
    pub link: Link,
    /// What it can do, once it was connected.
    pub can: Option<Capabilities<D>>,
    /// What is true of it.
    pub fields: Fields<D>,
    /// The command that is being done, or that is being taken.
    pub running: Option<CommandId>,
    /// The newest command that was handed to the loop and has not ended.
    pub handed_over: Option<CommandId>,
}

impl<D: Driver + ?Sized> DeviceStatus<D> {
    /// A command has ended; one that was handed over after it goes on.
    pub fn ended(&mut self, id: &CommandId) {
        for held in [&mut self.running, &mut self.handed_over] {
            if held.as_ref() == Some(id) {
                *held = None;
            }
        }
    }
}

/// The counter where commands are taken.
pub struct CommandServer<D: Driver> {
    /// The driver.
    pub driver: Arc<D>,
    /// Decides which commands are accepted.
    pub command_check: CommandCheck,
    /// What is kept of it.
    pub audit_log: AuditLog,
    /// What is true of the device.
    pub status: Mutex<DeviceStatus<D>>,
    answered: Mutex<VecDeque<Reply>>,
    claiming: tokio::sync::Mutex<()>,
    orders: mpsc::UnboundedSender<Order<DeviceCommand<D>>>,
}

impl<D: Driver> CommandServer<D> {
    /// A counter, and the end where accepted commands come out.
    pub fn new(
        driver: Arc<D>,
        authorization: CommandCheck,
        audit_log: AuditLog,
    ) -> (Self, mpsc::UnboundedReceiver<Order<DeviceCommand<D>>>) {
        let (orders, taken) = mpsc::unbounded_channel();
        let fields = Fields::<D>::default();
        let status = DeviceStatus { link: Link::Connecting, can: None, fields, running: None, handed_over: None };
        let command_server = Self {
            driver,
            command_check: authorization,
            audit_log,
            status: Mutex::new(status),
            answered: Mutex::default(),
            claiming: tokio::sync::Mutex::default(),
            orders,
        };
        (command_server, taken)
    }

    /// Answers one command.
    pub async fn answer(&self, command: Result<Command<DeviceCommand<D>>, String>) -> Reply {
        let command = match command {
            Ok(command) => command,
            Err(detail) => {
                self.audit_log.unreadable(&detail);
                let id = CommandId(String::new());
                return Reply::Refusal(Refusal { id, reason: Reason::Malformed, detail });
            }
        };
        let id = command.id.clone();
        if let Some(reply) = self.repeat(&id) {
            return reply;
        }
        if let Some(reply) = self.driver.answer((&id, &command.from), &command.action) {
            return reply;
        }
        let (asked, action) = (CommandOrigin::from(&command), command.action.clone());
        match self.take(command).await {
            Ok(reply) => reply,
            Err((reason, detail)) => {
                // A sender that finds the device busy asks again soon, and again.
                match reason {
                    Reason::Busy => tracing::debug!(command = %id, detail, "command refused: busy"),
                    _ => tracing::info!(command = %id, %reason, detail, "command refused"),
                }
                let turned = (reason, detail);
                if self.driver.moves(&action) {
                    let is_claim = self.driver.need(&action) == Need::Claim;
                    self.audit_log.refused(asked, &action, is_claim, &turned);
                }
                let (reason, detail) = turned;
                Reply::Refusal(Refusal { id, reason, detail })
            }
        }
    }

    /// A command from this node itself, such as the guard's; it needs no authorization.
    pub fn insist(&self, from: &str, command: DeviceCommand<D>) {
        let (id, taken_utc) = (CommandId::fresh(), self.command_check.clock.utc());
        let order = Order { id, from: from.to_owned(), command, token: None, taken_utc };
        let (asked, command) = (order.asked(), order.command.clone());
        // The loop is gone only while the node ends.
        let _ = self.hand_over(order);
        // After the sending, so that whatever noting takes, moving does not wait for it.
        self.audit_log.note(asked, &command, AuditOutcome::Accepted);
    }

    async fn take(&self, command: Command<DeviceCommand<D>>) -> Result<Reply, Turned> {
        let Command { id, from, token, boot_id, action } = command;
        let need = self.driver.need(&action);
        let who = Claimant { name: &from, boot_id: boot_id.as_ref() };
        if matches!(need, Need::Claim | Need::Resume) {
            let _claiming = self.claiming.lock().await;
            if let Some(reply) = self.repeat(&id) {
                return Ok(reply);
            }
            let granted =
                self.command_check.admit(&id, CommandNeeds { need, hinders: Hinders::No, who, token }).await?;
            let asked = CommandOrigin { from, id: id.clone(), token };
            match granted {
                Some(granted) => self.audit_log.granted(asked, &action, granted),
                None => self.audit_log.note(asked, &action, AuditOutcome::Accepted),
            }
            // Remembered before the next one with this id is let in: it would be granted a second token.
            return Ok(self.accepted(id, granted));
        }
        let hinders = self.driver.hinders(&action);
        self.reserve(&id, &action)?;
        match self.command_check.admit(&id, CommandNeeds { need, hinders, who, token }).await {
            Ok(granted) => {
                let taken_utc = self.command_check.clock.utc();
                let order = Order { id: id.clone(), from, command: action, token, taken_utc };
                let (asked, command) = (order.asked(), order.command.clone());
                self.hand_over(order)?;
                let reply = self.accepted(id, granted);
                if self.driver.moves(&command) {
                    self.audit_log.note(asked, &command, AuditOutcome::Accepted);
                }
                Ok(reply)
            }
            Err(turned) => {
                let mut status = self.status();
                if status.running.as_ref() == Some(&id) {
                    status.running = status.handed_over.clone();
                }
                Err(turned)
            }
        }
    }

    /// Hands a command to the loop. One that was overtaken by a stop while its sender was checked is refused: it would
    /// move the device after the stop.
    fn hand_over(&self, order: Order<DeviceCommand<D>>) -> Result<(), Turned> {
        // Within the lock, so that the loop receives commands in the order of this.
        let mut status = self.status();
        if !self.driver.interrupts(&order.command)
            && let Some(running) = status.running.as_ref().filter(|running| **running != order.id)
        {
            return Err((Reason::Busy, format!("command {running} came in between")));
        }
        (status.running, status.handed_over) = (Some(order.id.clone()), Some(order.id.clone()));
        self.orders.send(order).map_err(|_| (Reason::NotNow, "the node is ending".to_owned()))
    }

    /// Takes the device for this command, if it makes sense now.
    fn reserve(&self, id: &CommandId, command: &DeviceCommand<D>) -> Result<(), Turned> {
        let mut status = self.status();
        let interrupts = self.driver.interrupts(command);
        if !interrupts {
            match &status.link {
                Link::Connected => {}
                Link::Connecting => return Err((Reason::NotConnected, "not connected yet".to_owned())),
                Link::Lost { reason } => return Err((Reason::NotConnected, reason.to_string())),
            }
        }
        if let Some(can) = &status.can
            && let Some(turned) = self.driver.refuse(id, command, can, &status.fields)
        {
            return Err(turned);
        }
        match &status.running {
            Some(running) if running != id && !interrupts => {
                Err((Reason::Busy, format!("command {running} is being done")))
            }
            _ => {
                status.running = Some(id.clone());
                Ok(())
            }
        }
    }

    fn status(&self) -> std::sync::MutexGuard<'_, DeviceStatus<D>> {
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn repeat(&self, id: &CommandId) -> Option<Reply> {
        let answered = self.answered.lock().unwrap_or_else(PoisonError::into_inner);
        let same = |reply: &&Reply| matches!(reply, Reply::Accepted(accepted) if accepted.id == *id);
        answered.iter().rev().find(same).cloned()
    }

    /// The answer to a command that was accepted; one that comes again gets it again.
    fn accepted(&self, id: CommandId, token: Option<u64>) -> Reply {
        let reply = Reply::Accepted(Accepted { id, token, not_written: None });
        let mut answered = self.answered.lock().unwrap_or_else(PoisonError::into_inner);
        answered.push_back(reply.clone());
        if answered.len() > REMEMBERED {
            answered.pop_front();
        }
        reply
    }
}
