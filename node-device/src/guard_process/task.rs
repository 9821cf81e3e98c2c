//! The guard process at work: one loop, four times a second, that waits for nothing.

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use bus::{Clock, MachineTime};
use contract::observatory::AlertKind;
use interlock::watch::{Effect, TICK, Watch, Who};
use interlock::{AtEnd, Before, Deadlines, ProcessEnd, Report};
use node::NodeOptions;
use tokio::io::{AsyncBufReadExt as _, BufReader};
use tokio::process::{Child, ChildStdin};
use tokio::time::{MissedTickBehavior, interval};

use super::closer::Closer;
use super::complaint::{Complaint, News};
use super::copy::{Copy, DomeCopy};
use super::disk::{self, Written};
use super::herald::Herald;
use super::leaving::{self, Leaving};
use super::link::{self, NodeLines, SHARES_CLOCK, next_line};
use super::places::Places;
use super::signals::{EndRequest, Signals, lock};
use super::starting::{self, Ready};

/// A configuration that could not be read is read again so often.
const READ_AGAIN: Duration = Duration::from_secs(2);
/// A parent that has died is no order: what is open is closed, but nobody waits for it for long.
const ORPHAN_LIMIT: Duration = Duration::from_secs(30);

/// Guards the enclosures of the device node `id` until a signal.
pub fn main(options: &NodeOptions, id: &str) -> ExitCode {
    node::log::log_to_console();
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().context("cannot start the runtime");
    let ended = runtime.and_then(|runtime| runtime.block_on(run(options, id)));
    if let Err(error) = &ended {
        node::lines::complain(format_args!("guard process: {error:#}"));
    }
    node::lines::flush();
    if ended.is_ok() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

async fn run(options: &NodeOptions, id: &str) -> anyhow::Result<()> {
    let places = Places::of(&options.config, id);
    let mut signals = Signals::listen(options.with_parent);
    let Some(_lock) = lock(&places, id, &mut signals).await else { return Ok(()) };
    let mut work = Work::new(options, id, places);
    let mut tick = interval(TICK);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            biased;
            asked = signals.next() => match asked {
                EndRequest::End => work.end(crate::child::END_LIMIT),
                EndRequest::ParentDied => work.end(ORPHAN_LIMIT),
                EndRequest::EndAtOnce => {
                    work.kill().await;
                    anyhow::bail!("ended at once by a second signal; nobody guards {} now", work.names());
                }
            },
            line = next_line(&mut work.lines) => work.observe_line(line),
            _ = tick.tick() => {}
        }
        if let Some(ended) = work.step().await {
            return ended;
        }
    }
}

/// What to close by: the last-good copy or, where no node has worked yet, that of the configuration.
fn known<'a>(good: &'a Option<(u64, Copy)>, tried: &'a Option<Copy>) -> Option<&'a Copy> {
    good.as_ref().map(|(_, copy)| copy).or(tried.as_ref())
}

struct Work<'a> {
    options: &'a NodeOptions,
    id: &'a str,
    places: Places,
    clock: Clock,
    watch: Watch,
    /// The last-good copy, and the number under which it was last stored.
    good: Option<(u64, Copy)>,
    /// The copy of the configuration that the running node was started with.
    tried: Option<Copy>,
    closers: BTreeMap<String, Closer>,
    /// Domes that the configuration named until now, at their old addresses: closed before they are let go.
    leaving: Vec<Leaving>,
    /// The last-good copy is not on disk yet.
    unsaved: bool,
    /// What a thread finds on disk for the next start of the node.
    asking: Option<Receiver<Ready>>,
    herald: Herald,
    node: Option<Child>,
    orders: Option<ChildStdin>,
    lines: NodeLines,
    /// Why the node does not run as it should.
    error: Option<String>,
    complaint: Complaint,
    /// Domes that this process looks after at present.
    acts_for: Vec<String>,
    read_at: Option<Instant>,
    end_by: Option<Instant>,
    disk: SyncSender<Written>,
    stored: Option<(Deadlines, Instant)>,
}

impl<'a> Work<'a> {
    fn new(options: &'a NodeOptions, id: &'a str, places: Places) -> Self {
        let clock = Clock::machine_clock();
        let (mut good, now) = (places.copy(), clock.machine());
        let leaving = good.as_mut().map(|(_, copy)| Leaving::of(copy)).unwrap_or_default();
        let config =
            node::configuration::read_observatory(&options.config).ok().and_then(|config| Copy::of(&config, id));
        let known = good.as_ref().map(|(_, copy)| copy).or(config.as_ref());
        let domes: Vec<_> = known
            .into_iter()
            .flat_map(|copy| &copy.domes)
            .map(|dome| (dome.name.to_string(), dome.permit_valid()))
            .collect();
        places.forget_last_words();
        let mut herald = Herald::new(id, options, &places);
        if let Some(copy) = known {
            herald.take_back(copy);
        }
        let before = places.countdown();
        if !matches!(before, Before::Nothing) {
            tracing::info!(?before, "the countdown goes on with the value on disk");
        }
        let disk = disk::start(places.clone());
        let mut work = Self {
            options,
            id,
            places,
            watch: Watch::new(now, &domes, &before, SHARES_CLOCK),
            clock,
            good,
            tried: None,
            closers: BTreeMap::new(),
            leaving,
            unsaved: false,
            asking: None,
            herald,
            node: None,
            orders: None,
            lines: None,
            error: None,
            complaint: Complaint::default(),
            acts_for: Vec::new(),
            read_at: None,
            end_by: None,
            disk,
            stored: None,
        };
        work.arm();
        work
    }

    /// Makes a closer for each dome that is known.
    fn arm(&mut self) {
        let Some(copy) = known(&self.good, &self.tried) else { return };
        let mut closers = BTreeMap::new();
        for dome in &copy.domes {
            let name = dome.name.to_string();
            let is_same = self.closers.get(&name).is_some_and(|closer| closer.dome == *dome);
            let old = if is_same { self.closers.remove(&name) } else { None };
            if let Some(closer) = old.or_else(|| Closer::new(dome, &copy.telescope)) {
                closers.insert(name, closer);
            }
        }
        let is_gone = |old: &DomeCopy| closers.values().all(|new: &Closer| new.dome.target != old.target);
        let gone = std::mem::take(&mut self.closers).into_iter().filter(|(_, old)| is_gone(&old.dome));
        self.leaving.retain(|old| is_gone(old.dome()));
        self.leaving.extend(gone.map(|(name, closer)| Leaving::new(&name, closer)));
        self.closers = closers;
    }

    fn names(&self) -> String {
        let names: Vec<&str> = self.watch.deadlines().keys().map(String::as_str).collect();
        if names.is_empty() { "the enclosures of this file".to_owned() } else { format!("dome {}", names.join(", ")) }
    }

    fn end(&mut self, limit: Duration) {
        if self.end_by.is_none() {
            self.end_by = Some(Instant::now() + limit);
            self.watch.end();
            tracing::info!(
                within_s = limit.as_secs(),
                "ending: what is open is closed first; a second signal ends at once"
            );
        }
    }

    async fn kill(&mut self) {
        if let Some(node) = &mut self.node
            && let Err(error) = node.kill().await
        {
            tracing::warn!(%error, "the device node cannot be killed");
        }
    }

    fn observe_line(&mut self, line: Option<String>) {
        let Some(line) = line else { return };
        match serde_json::from_str::<Report>(&line) {
            Ok(report) => {
                self.watch.observe(self.clock.machine(), &report);
                self.learn(report);
            }
            Err(error) => tracing::warn!(%error, "the device node sent a line that cannot be read"),
        }
    }

    /// What works becomes the last-good copy.
    fn learn(&mut self, report: Report) {
        let Some(tried) = &self.tried else { return };
        if !self.watch.works(tried.domes.iter().map(|dome| dome.name.as_str())) {
            return;
        }
        let mut worked = tried.clone();
        worked.tokens = self.good.as_ref().map(|(_, copy)| copy.tokens.clone()).unwrap_or_default();
        worked.raise_tokens(report.tokens);
        if self.good.as_ref().is_some_and(|(_, good)| *good == worked) {
            return;
        }
        let number = self.good.as_ref().map_or(0, |(number, _)| *number);
        let is_new = self.good.as_ref().is_none_or(|(_, good)| !good.closes_as(&worked));
        self.good = Some((number, worked));
        self.unsaved = true;
        if is_new {
            let names = tried.domes.iter().map(|dome| dome.name.as_str()).collect::<Vec<_>>();
            self.watch.keep_only(&names);
            self.arm();
        }
    }

    /// Stores the last-good copy with the domes that are not let go yet: a restart of this process must still know
    /// both.
    fn save(&mut self) {
        if let Some((number, good)) = self.good.as_mut().filter(|_| self.unsaved) {
            let copy = Copy { leaving: self.leaving.iter().map(|old| old.dome().clone()).collect(), ..good.clone() };
            if self.disk.try_send(Written::Copy(*number + 1, Box::new(copy))).is_err() {
                return;
            }
            *number += 1;
            self.unsaved = false;
            tracing::debug!(number, "what is needed to close was stored for the time when nothing else works");
        }
    }

    /// Closes the domes that the configuration names no more.
    fn let_go(&mut self, now: MachineTime) {
        let (herald, good, before) = (&mut self.herald, &self.good, self.leaving.len());
        leaving::close_all(&mut self.leaving, now, |kind, name, cause| {
            if let Some((_, copy)) = good {
                herald.report(copy, kind, name, cause);
            }
        });
        self.unsaved |= self.leaving.len() < before;
    }

    /// One round; returns how this process ends.
    async fn step(&mut self) -> Option<anyhow::Result<()>> {
        node::service_manager::alive();
        let now = self.clock.machine();
        self.reap(now).await;
        match self.watch.tick(now) {
            Some(Effect::Start) => self.start(now),
            _ if self.asking.is_some() => self.start(now),
            Some(Effect::Kill(why)) => {
                self.error = Some(format!("the device node was killed: {why}"));
                self.kill().await;
            }
            None => {}
        }
        self.guard(now);
        self.let_go(now);
        self.save();
        self.complain();
        self.keep(now);
        self.end_by.and_then(|by| self.ending(by, now))
    }

    async fn reap(&mut self, now: MachineTime) {
        let Some(node) = &mut self.node else { return };
        let (ended, well) = match node.try_wait() {
            Ok(None) => return,
            Ok(Some(status)) => (status.to_string(), status.success()),
            Err(error) => (error.to_string(), false),
        };
        // The last lines of its log.
        while self.lines.is_some() {
            match tokio::time::timeout(Duration::from_millis(50), next_line(&mut self.lines)).await {
                Ok(Some(line)) => self.observe_line(Some(line)),
                Ok(None) | Err(_) => self.lines = None,
            }
        }
        (self.node, self.orders) = (None, None);
        if well && self.end_by.is_some() {
            self.watch.ended_closed(now);
        } else {
            self.watch.ended(now);
        }
        if self.end_by.is_none() {
            let why = self.error.take().filter(|why| why.contains("killed"));
            self.error = Some(
                why.unwrap_or_else(|| format!("the device node ended ({ended}); the reason is in its lines above")),
            );
        }
    }

    fn start(&mut self, now: MachineTime) {
        if self.asking.is_none() {
            if self.read_at.is_some_and(|at| at.elapsed() < READ_AGAIN) && self.tried.is_none() {
                return self.watch.not_yet(now);
            }
            self.read_at = Some(Instant::now());
            let deadlines = self.watch.deadlines().clone();
            self.asking = Some(starting::ask(self.options, self.id, &self.places, deadlines, now));
            return;
        }
        let answer = self.asking.as_ref().map(Receiver::try_recv);
        // While the disk does not answer, this process guards alone.
        if matches!(answer, Some(Err(TryRecvError::Empty))) {
            return;
        }
        self.asking = None;
        let Some(Ok(Ready { copy, node })) = answer else { return self.watch.not_yet(now) };
        let copy = match copy {
            Ok(copy) => copy,
            Err(why) => {
                (self.error, self.tried) = (Some(why), None);
                return self.watch.ended(now);
            }
        };
        for dome in &copy.domes {
            self.watch.add(dome.name.as_str(), now.plus(dome.permit_valid()));
        }
        let Some(node) = node else {
            self.error = Some("the device node of the guard process before has not ended yet".to_owned());
            return self.watch.not_yet(now);
        };
        self.tried = Some(copy.clone());
        if self.good.is_none() {
            self.arm();
        }
        match node {
            Ok(mut node) => {
                self.orders = node.stdin.take();
                self.lines = node.stdout.take().map(|out| BufReader::new(out).lines());
                self.node = Some(node);
                let same = copy.at_the_same_server(self.good.as_ref().map_or(&copy, |(_, good)| good));
                self.watch.started(now, same);
            }
            Err(error) => {
                self.error = Some(format!("{error:#}"));
                self.watch.ended(now);
            }
        }
    }

    /// Looks after every dome that nobody else looks after.
    fn guard(&mut self, now: MachineTime) {
        let mut acts_for = Vec::new();
        for (name, closer) in &mut self.closers {
            let who = self.watch.who(name, now);
            if who == Who::This {
                acts_for.push(name.clone());
            }
            for word in closer.step(who, now) {
                word.report(name, |kind, cause| {
                    if let Some(copy) = known(&self.good, &self.tried) {
                        self.herald.report(copy, kind, name, cause);
                    }
                });
            }
        }
        for name in acts_for.iter().filter(|name| !self.acts_for.contains(name)) {
            tracing::info!(
                dome = name,
                "no permit, and no device node that guards yet or any more: the guard process looks"
            );
        }
        self.acts_for = acts_for;
    }

    /// Logs and publishes why the device node does not guard, again each minute, and when it does again.
    fn complain(&mut self) {
        let now = self.clock.machine();
        let names: Vec<String> = self.watch.deadlines().keys().cloned().collect();
        let guards =
            !names.is_empty() && names.iter().all(|name| matches!(self.watch.who(name, now), Who::Node | Who::Both));
        let news = if self.end_by.is_some() {
            self.complaint.end()
        } else {
            self.complaint.next(guards, self.error.as_deref(), self.watch.failures() > 1, now)
        };
        match news {
            Some(News::Over) => self.take_back(&names),
            Some(News::Fault) => self.report_fault(&names),
            None => {}
        }
    }

    fn take_back(&mut self, names: &[String]) {
        // No room in the queue: the file is removed at the next start.
        let _ = self.disk.try_send(Written::NoLastWords);
        tracing::info!(domes = self.names(), "the device node guards again");
        if let Some(copy) = known(&self.good, &self.tried) {
            for name in names {
                self.herald.report(copy, AlertKind::GuardProcess, name, None);
            }
        }
    }

    fn report_fault(&mut self, names: &[String]) {
        let (error, names_text) = (self.error.as_deref().unwrap_or_default(), self.names());
        if self.closers.is_empty() {
            tracing::error!(
                "NOBODY GUARDS {names_text}: {error}; and no copy of a configuration that worked exists: close the dome \
                 by hand, then mend the configuration"
            );
            return;
        }
        let what = if self.acts_for.is_empty() { "closes it when its permit has run out" } else { "keeps it closed" };
        tracing::error!("the device node of {names_text} does not guard: {error}; the guard process {what}");
        if let Some(copy) = known(&self.good, &self.tried) {
            for name in names {
                let cause = format!("the device node of dome {name} does not guard: {error}; the guard process {what}");
                self.herald.report(copy, AlertKind::GuardProcess, name, Some(cause));
            }
        }
    }

    /// Writes the countdown each second, and at once when it is cut short.
    fn keep(&mut self, now: MachineTime) {
        let deadlines = self.watch.deadlines();
        let is_due = self.stored.as_ref().is_none_or(|(stored, at)| {
            let is_shorter = stored.iter().any(|(dome, until)| deadlines.get(dome).is_some_and(|new| new < until));
            stored != deadlines && (is_shorter || at.elapsed() >= Duration::from_secs(1))
        });
        if is_due && self.disk.try_send(Written::Countdown(now, deadlines.clone())).is_ok() {
            self.stored = Some((deadlines.clone(), Instant::now()));
        }
    }

    /// An end was asked for: what this round still lacks for it.
    fn ending(&mut self, by: Instant, now: MachineTime) -> Option<anyhow::Result<()>> {
        if let Some(orders) = self.orders.take() {
            tokio::spawn(link::ask_to_end(orders, crate::child::END_LIMIT * 2));
        }
        let at_end = AtEnd {
            node_runs: self.node.is_some(),
            is_late: Instant::now() >= by,
            domes: self.closers.iter().map(|(name, dome)| (name.as_str(), dome.is_verified_closed(now))).collect(),
            leaving: self
                .leaving
                .iter()
                .filter(|dome| dome.holds_up_the_end(now))
                .map(|dome| dome.name.as_str())
                .collect(),
        };
        match at_end.decide(&self.watch, now) {
            ProcessEnd::Waits => None,
            ProcessEnd::Kill => {
                tracing::warn!(
                    "the device node does not answer or waits for a mount, and the enclosure is closed: the node is killed"
                );
                if let Some(Err(error)) = self.node.as_mut().map(Child::start_kill) {
                    tracing::warn!(%error, "the device node cannot be killed");
                }
                None
            }
            ProcessEnd::Closed => {
                tracing::info!(domes = self.names(), "closed; the guard process ends");
                for dome in &self.leaving {
                    let next = "nobody answers there; the next start looks for it again";
                    tracing::warn!(dome = dome.name, next, "a dome that the configuration named before was not seen");
                }
                Some(Ok(()))
            }
            ProcessEnd::Open(open) => Some(Err(anyhow::anyhow!(
                "NOBODY GUARDS dome {} now, and it is not verified closed: close it by hand",
                open.join(", ")
            ))),
            ProcessEnd::KnowsNothing => {
                Some(Err(anyhow::anyhow!("nobody guards {} now, and nothing is known of it", self.names())))
            }
        }
    }
}
