//! Payloads on their way from zenoh to a subscriber: a bounded queue in which newer ones overwrite older ones.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use contract::{Key, Payload};
use tokio::sync::Notify;
use zenoh::sample::{Sample, SampleKind};

use crate::heard::Heard;
use crate::machine;
use crate::numbers::Numbers;
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
}

/// Payloads with their sizes.
struct Waiting<T> {
    payloads: VecDeque<(Heard<T>, usize)>,
    bytes: usize,
}

impl<T> Waiting<T> {
    fn pop(&mut self) -> Option<Heard<T>> {
        let (heard, bytes) = self.payloads.pop_front()?;
        self.bytes -= bytes;
        Some(heard)
    }

    /// Puts a payload at the end; returns how many older ones gave way to it.
    fn push(&mut self, heard: Heard<T>, bytes: usize, capacity: usize) -> u64 {
        let mut lost = 0;
        while self.payloads.len() >= capacity || (self.bytes + bytes > MOST_WAITING_BYTES && self.bytes > 0) {
            if self.pop().is_none() {
                break;
            }
            lost += 1;
        }
        self.payloads.push_back((heard, bytes));
        self.bytes += bytes;
        lost
    }
}

impl<T> Queue<T> {
    /// An empty queue. `once`: each payload counts once, however often it comes.
    pub(crate) fn new(capacity: usize, once: bool, transit: Arc<Mutex<Transit>>) -> Self {
        Self {
            waiting: Mutex::new(Waiting { payloads: VecDeque::new(), bytes: 0 }),
            capacity,
            numbers: once.then(Mutex::default),
            arrived: Notify::new(),
            transit,
            lost: AtomicU64::new(0),
            malformed: AtomicU64::new(0),
        }
    }

    /// Waits for the next payload.
    pub(crate) async fn next(&self) -> Heard<T> {
        loop {
            // Registered before looking, so that an arrival in between is not missed.
            let arrived = self.arrived.notified();
            let next = lock(&self.waiting).pop();
            match next {
                Some(heard) => return heard,
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
            Ok(said) => {
                let arrived = lock(&self.transit).arrived(&said, machine::now());
                self.push_heard(Heard { key, said, arrived }, bytes.len());
            }
            Err(error) => {
                if self.malformed.fetch_add(1, Ordering::Relaxed) == 0 {
                    tracing::warn!(%key, %error, "a malformed payload was dropped; later ones are only counted");
                }
            }
        }
    }

    fn push_heard(&self, heard: Heard<T>, bytes: usize) {
        let is_new = |numbers: &Mutex<Numbers>| lock(numbers).hear(&heard.said.boot_id, &heard.key, heard.said.seq);
        if !self.numbers.as_ref().is_none_or(is_new) {
            return;
        }
        let lost = lock(&self.waiting).push(heard, bytes, self.capacity);
        self.lost.fetch_add(lost, Ordering::Relaxed);
        self.arrived.notify_one();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
