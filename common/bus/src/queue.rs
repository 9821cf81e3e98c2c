//! Payloads on their way from zenoh to a subscriber: a bounded queue in which newer ones overwrite older ones.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use contract::{Key, Payload};
use tokio::sync::Notify;
use zenoh::sample::{Sample, SampleKind};

use crate::machine;
use crate::numbers::{Gap, Numbers};
use crate::received::Received;
use crate::transit::Transit;

/// Payloads of one subscriber that wait take at most so much as they came, whatever its capacity.
const MOST_WAITING_BYTES: usize = 32 << 20;

/// Payloads that wait to be received.
pub(crate) struct Queue<T> {
    waiting: Mutex<Waiting<T>>,
    capacity: usize,
    /// The received numbers, where each payload counts once.
    numbers: Option<Mutex<Numbers>>,
    arrived: Notify,
    transit: Arc<Mutex<Transit>>,
    lost: AtomicU64,
    malformed: AtomicU64,
    /// What nothing can bring any more, until somebody asks.
    given_up: Mutex<Vec<Gap>>,
}

/// Gaps that wait until somebody asks for them; more are only counted.
const MOST_GAPS: usize = 4096;

/// Payloads with their sizes.
struct Waiting<T> {
    payloads: VecDeque<(Received<T>, usize)>,
    bytes: usize,
}

impl<T> Waiting<T> {
    fn pop(&mut self) -> Option<Received<T>> {
        let (received, bytes) = self.payloads.pop_front()?;
        self.bytes -= bytes;
        Some(received)
    }

    /// Puts a payload at the end; returns the older ones that gave way to it.
    fn push(&mut self, received: Received<T>, bytes: usize, capacity: usize) -> Vec<Received<T>> {
        let mut lost = Vec::new();
        while self.payloads.len() >= capacity || (self.bytes + bytes > MOST_WAITING_BYTES && self.bytes > 0) {
            let Some(oldest) = self.pop() else { break };
            lost.push(oldest);
        }
        self.payloads.push_back((received, bytes));
        self.bytes += bytes;
        lost
    }
}

impl<T> Queue<T> {
    /// An empty queue; with `numbers`, each payload counts once, however often it comes.
    pub(crate) fn new(capacity: usize, numbers: Option<Numbers>, transit: Arc<Mutex<Transit>>) -> Self {
        Self {
            waiting: Mutex::new(Waiting { payloads: VecDeque::new(), bytes: 0 }),
            capacity,
            numbers: numbers.map(Mutex::new),
            arrived: Notify::new(),
            transit,
            lost: AtomicU64::new(0),
            malformed: AtomicU64::new(0),
            given_up: Mutex::default(),
        }
    }

    /// Waits for the next payload.
    pub(crate) async fn next(&self) -> Received<T> {
        loop {
            // Registered before looking, so that an arrival in between is not missed.
            let arrived = self.arrived.notified();
            let next = lock(&self.waiting).pop();
            match next {
                Some(received) => return received,
                None => arrived.await,
            }
        }
    }

    /// Payloads that gave way to newer ones.
    pub(crate) fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    /// Payloads that were published between others that were received, and never came; only where each counts once.
    pub(crate) fn missing(&self) -> u64 {
        self.numbers.as_ref().map_or(0, |numbers| lock(numbers).missing())
    }

    /// What is missing and may still come; nothing while half of the queue's room is taken, since what comes again
    /// would only push out what waits.
    pub(crate) fn gaps(&self) -> Vec<Gap> {
        let waiting = lock(&self.waiting);
        let is_behind = waiting.payloads.len() > self.capacity / 2 || waiting.bytes > MOST_WAITING_BYTES / 2;
        drop(waiting);
        self.numbers.as_ref().filter(|_| !is_behind).map_or_else(Vec::new, |numbers| lock(numbers).gaps())
    }

    /// Those of the numbers in `gaps` that are still missing.
    pub(crate) fn still_missing(&self, gaps: &[Gap]) -> Vec<Gap> {
        self.numbers.as_ref().map_or_else(Vec::new, |numbers| lock(numbers).still_missing(gaps))
    }

    /// Nothing can bring these any more.
    pub(crate) fn give_up(&self, gaps: Vec<Gap>) {
        if let Some(numbers) = &self.numbers {
            lock(numbers).give_up(&gaps);
            let mut given_up = lock(&self.given_up);
            let room = MOST_GAPS.saturating_sub(given_up.len());
            given_up.extend(gaps.into_iter().take(room));
        }
    }

    /// What was given up since this was asked last.
    pub(crate) fn take_given_up(&self) -> Vec<Gap> {
        std::mem::take(&mut lock(&self.given_up))
    }

    /// Payloads that could not be read.
    pub(crate) fn malformed(&self) -> u64 {
        self.malformed.load(Ordering::Relaxed)
    }
}

impl<T: Payload> Queue<T> {
    /// Takes a sample in; one that cannot be read is counted.
    pub(crate) fn push(&self, sample: &Sample) {
        if sample.kind() != SampleKind::Put {
            return;
        }
        // Keys of other programs and of zenoh itself (`@adv`) are none of ours.
        let Some(key) = Key::parse(sample.key_expr().as_str()) else { return };
        let bytes = sample.payload().to_bytes();
        match serde_json::from_slice(&bytes) {
            Ok(payload) => {
                let arrived = lock(&self.transit).arrived(&payload, machine::now());
                self.push_received(Received { key, sample: payload, arrived }, bytes.len());
            }
            Err(error) => {
                if self.malformed.fetch_add(1, Ordering::Relaxed) == 0 {
                    tracing::warn!(%key, %error, "a malformed payload was dropped; later ones are only counted");
                }
            }
        }
    }

    fn push_received(&self, received: Received<T>, bytes: usize) {
        let is_new = |numbers: &Mutex<Numbers>| {
            lock(numbers).observe(&received.sample.boot_id, &received.key, received.sample.seq)
        };
        if !self.numbers.as_ref().is_none_or(is_new) {
            return;
        }
        let lost = lock(&self.waiting).push(received, bytes, self.capacity);
        self.lost.fetch_add(lost.len() as u64, Ordering::Relaxed);
        if let Some(numbers) = &self.numbers {
            // The sender still has it: it is asked for once there is room.
            let mut numbers = lock(numbers);
            lost.iter().for_each(|lost| numbers.lose(&lost.sample.boot_id, &lost.key, lost.sample.seq));
        }
        self.arrived.notify_one();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
