//! What publishers still hold is asked of them: as soon as one is seen, when a gap shows, and now and then whether a
//! payload was the last one and got lost.
//!
//! zenoh-ext's subscriber can ask too, but drops the answer when a new sample arrives before it
//! (docs/decisions/0007-history-on-the-bus.md), gives a gap up after one question, and does not notice that the last
//! sample of a publisher is missing (docs/decisions/0104-gaps-are-asked-for.md).

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use contract::Payload;
use tokio::sync::{Semaphore, mpsc};
use tokio::task::JoinSet;
use tokio::time::Instant;
use zenoh::Session;
use zenoh::query::{ConsolidationMode, QueryTarget, ReplyKeyExpr};
use zenoh::sample::{Sample, SampleKind};

use crate::numbers::Gap;
use crate::queue::Queue;

/// Waits before each question of a publisher that is just seen, and of one that does not answer whole: it may not be
/// known to answer yet.
const TRIES_MS: [u64; 5] = [0, 300, 1500, 5000, 10_000];
/// A publisher is asked so often for its newest payload: the last one before a long silence may be lost.
const LOOK: Duration = Duration::from_secs(60);
/// Gaps are looked for so often; zenoh-ext asks for a sample that it misses at once.
const TICK: Duration = Duration::from_secs(1);
/// A publisher is asked again because of a gap after so long.
const AGAIN: Duration = Duration::from_secs(3);
/// What is held for a quarter of an hour takes well under a second on one network, and a minute on a slow line.
const TIMEOUT: Duration = Duration::from_secs(120);
/// An answer of which nothing comes for so long is given up: its link may be cut in one direction.
const SILENCE: Duration = Duration::from_secs(10);
/// After so many whole answers without a payload it is lost.
const ANSWERS: u32 = 3;
/// Publishers that answer a session with all that they hold at the same time. Twenty that do so share the two batches that a
/// link holds, and one that waits 0.3 s for its turn closes the link (`session.rs`).
pub const AT_ONCE: usize = 2;
/// Keys whose publishers are asked; a site has some hundred.
const MOST_ASKED: usize = 2048;
/// Where zenoh-ext's publishers show that they live, after their key; there they also answer for what they hold.
const CACHES: &str = "/@adv/pub/";

/// Watches for publishers; ends when dropped.
pub type Watch = zenoh::pubsub::Subscriber<()>;

/// Fills `queue` with the earlier samples of every publisher of `expression`, now and whenever one (re)appears or
/// something is missing.
pub async fn recall<T: Payload>(
    session: &Session,
    turns: &Arc<Semaphore>,
    expression: &str,
    queue: &Arc<Queue<T>>,
) -> Result<Watch, zenoh::Error> {
    let publishers = format!("{expression}{CACHES}**");
    let (sender, seen) = mpsc::channel(MOST_ASKED);
    let (turns, queue) = (turns.clone(), Arc::downgrade(queue));
    let asker = Asker { session: session.clone(), turns, queue, keys: HashMap::new() };
    tokio::spawn(asker.run(seen));
    let note = move |token: Sample| {
        // One that goes is asked all the same: after a cut, zenoh may report its going after its coming.
        let key = token.key_expr().as_str().split_once(CACHES).filter(|_| token.kind() == SampleKind::Put);
        if key.is_some_and(|(key, _)| sender.try_send(key.to_owned()).is_err()) {
            tracing::warn!(most = MOST_ASKED, "too many publishers came at once; one was not asked for its past");
        }
    };
    session.liveliness().declare_subscriber(publishers).history(true).callback(note).await
}

/// A key with publishers, and what was asked of them.
struct Known {
    /// They are asked for all that they hold, or for their newest payload only.
    next: (Instant, Question),
    is_asked: bool,
    tries: usize,
    answered: Instant,
    /// What was missing before they answered whole, and how often they did.
    suspected: (Vec<Gap>, u32),
}

impl Known {
    fn new(now: Instant) -> Self {
        Self { next: (now, Question::All), is_asked: false, tries: 0, answered: now, suspected: (Vec::new(), 0) }
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Question {
    All,
    Newest,
}

struct Answered {
    key: String,
    question: Question,
    /// What was missing when it was asked, and how many payloads had been dropped here by then.
    before: (Vec<Gap>, u64),
    /// At least one payload came, and no timeout hides others.
    is_whole: bool,
}

struct Asker<T> {
    session: Session,
    turns: Arc<Semaphore>,
    queue: Weak<Queue<T>>,
    keys: HashMap<String, Known>,
}

impl<T: Payload> Asker<T> {
    /// Until the watch for publishers is dropped.
    async fn run(mut self, mut seen: mpsc::Receiver<String>) {
        let (mut asked, mut ticks) = (JoinSet::new(), tokio::time::interval(TICK));
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            let next = self.keys.values().filter(|known| !known.is_asked).map(|known| known.next.0).min();
            let next = next.unwrap_or_else(|| Instant::now() + LOOK);
            tokio::select! {
                key = seen.recv() => {
                    let Some(key) = key else { return };
                    self.see(key);
                }
                Some(answered) = asked.join_next() => {
                    if let Ok(answered) = answered {
                        self.take(answered);
                    }
                }
                _ = ticks.tick() => self.look_for_gaps(),
                () = tokio::time::sleep_until(next) => self.ask_those_due(&mut asked),
            }
        }
    }

    /// A publisher has come, perhaps again.
    fn see(&mut self, key: String) {
        let now = Instant::now();
        if self.keys.len() >= MOST_ASKED && !self.keys.contains_key(&key) {
            let silent = self.keys.iter().min_by_key(|(_, known)| known.answered).map(|(key, _)| key.clone());
            silent.and_then(|key| self.keys.remove(&key));
        }
        let known = self.keys.entry(key).or_insert_with(|| Known::new(now));
        (known.next, known.tries) = ((now, Question::All), 0);
    }

    /// Publishers of keys with a gap are asked for all that they hold.
    fn look_for_gaps(&mut self) {
        let Some(queue) = self.queue.upgrade() else { return };
        let soon = Instant::now() + AGAIN;
        for gap in queue.gaps() {
            let key = gap.key.to_string();
            match self.keys.get_mut(&key) {
                None => self.see(key),
                Some(known) if known.next.1 == Question::Newest || known.next.0 > soon => {
                    known.next = (soon, Question::All);
                }
                Some(_) => {}
            }
        }
    }

    fn ask_those_due(&mut self, asked: &mut JoinSet<Answered>) {
        let Some(queue) = self.queue.upgrade() else { return };
        let now = Instant::now();
        let due = self.keys.iter_mut().filter(|(_, known)| !known.is_asked && known.next.0 <= now);
        let gaps = queue.gaps();
        for (key, known) in due {
            known.is_asked = true;
            let missing = gaps.iter().filter(|gap| gap.key.to_string() == *key).cloned().collect();
            let before = (missing, queue.lost());
            let question = known.next.1;
            // One that comes while this is under way is asked after it.
            known.next = (now + LOOK, Question::Newest);
            let (session, turns, queue) = (self.session.clone(), self.turns.clone(), self.queue.clone());
            let key = key.clone();
            asked.spawn(async move {
                // The newest payload alone is no burden. The semaphore is never closed.
                let _turn = if question == Question::All { turns.acquire_owned().await.ok() } else { None };
                ask(session, key, question, before, queue).await
            });
        }
    }

    /// Takes the end of an answer: what is missing after several whole ones is lost.
    fn take(&mut self, answered: Answered) {
        let (Some(queue), now) = (self.queue.upgrade(), Instant::now()) else { return };
        let Answered { key, question, before: (missing, lost), is_whole } = answered;
        let Some(known) = self.keys.get_mut(&key) else { return };
        known.is_asked = false;
        if !is_whole && question == Question::All {
            known.tries += 1;
            let wait = TRIES_MS.get(known.tries).copied().map_or(LOOK, Duration::from_millis);
            known.next = (known.next.0.min(now + wait), Question::All);
            return;
        }
        (known.tries, known.answered) = (0, now);
        // What was dropped here because too much waited comes with the next answer.
        if question == Question::Newest || queue.lost() > lost {
            return;
        }
        let (suspected, answers) = &mut known.suspected;
        let still = queue.still_missing(if *answers == 0 { &missing } else { suspected });
        (*suspected, *answers) = if still.is_empty() { (Vec::new(), 0) } else { (still, *answers + 1) };
        if *answers >= ANSWERS {
            queue.give_up(std::mem::take(suspected));
            *answers = 0;
        }
    }
}

async fn ask<T: Payload>(
    session: Session,
    key: String,
    question: Question,
    before: (Vec<Gap>, u64),
    queue: Weak<Queue<T>>,
) -> Answered {
    let (samples, failed) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
    let (end, mut ended) = mpsc::channel::<()>(1);
    let (came, broke) = (samples.clone(), failed.clone());
    // Everything that is held: by the time of zenoh's stamps, a clock that jumped would hide a part.
    let parameters = if question == Question::Newest { "?_max=1" } else { "" };
    let asked = session
        .get(format!("{key}{CACHES}**{parameters}"))
        .accept_replies(ReplyKeyExpr::Any)
        .target(QueryTarget::All)
        .consolidation(ConsolidationMode::None)
        .timeout(TIMEOUT)
        .callback(move |reply| {
            let _until_dropped = &end;
            match (reply.result(), queue.upgrade()) {
                (Ok(sample), Some(into)) => {
                    came.fetch_add(1, Ordering::Relaxed);
                    into.push(sample);
                }
                // zenoh's own word for a timeout.
                (Err(_), _) => broke.store(true, Ordering::Relaxed),
                (Ok(_), None) => {}
            }
        });
    if let Err(error) = asked.await {
        tracing::debug!(%error, key, "a publisher could not be asked for its past");
    }
    let mut before_wait = 0;
    // zenoh drops the callback after the last answer.
    while tokio::time::timeout(SILENCE, ended.recv()).await.is_err() {
        let now = samples.load(Ordering::Relaxed);
        if std::mem::replace(&mut before_wait, now) == now {
            failed.store(true, Ordering::Relaxed);
            break;
        }
    }
    let is_whole = samples.load(Ordering::Relaxed) > 0 && !failed.load(Ordering::Relaxed);
    Answered { key, question, before, is_whole }
}
