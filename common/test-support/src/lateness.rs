//! How late this machine is: a thread that does nothing but wait notes how much later it wakes than it asked to.
//!
//! A test that bounds how fast Starmesh answers must not fail because other programs have the cores. It adds the
//! lateness that was measured meanwhile to its bound: nothing on an idle machine, so that the bound is exact there.
//! Such a test is one of `scripts/proof`, in a module `proof`: with a busy machine its result is a matter of luck all
//! the same.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long the thread asks to wait.
const NAP: Duration = Duration::from_millis(2);
/// Waking so much later is usual on an idle machine.
const USUAL: Duration = Duration::from_millis(1);
/// Threads that act one after the other between a cause and its effect: each may be as late as the one that is
/// measured.
const HOPS: u32 = 4;

/// Measures until it is dropped.
pub struct Lateness {
    late: Arc<Mutex<Duration>>,
}

impl Lateness {
    /// Begins to measure.
    pub fn begin() -> Self {
        let late = Arc::new(Mutex::new(Duration::ZERO));
        let noted = Arc::downgrade(&late);
        std::thread::spawn(move || {
            loop {
                let asked = Instant::now();
                std::thread::sleep(NAP);
                let Some(noted) = noted.upgrade() else { return };
                *noted.lock().unwrap_or_else(PoisonError::into_inner) += asked.elapsed().saturating_sub(NAP + USUAL);
            }
        });
        Self { late }
    }

    /// A bound of Starmesh's own, and what this machine was late since the measuring began.
    pub fn bound(&self, own: Duration) -> Duration {
        own + *self.late.lock().unwrap_or_else(PoisonError::into_inner) * HOPS
    }
}
