//! The results of the newest frames, for the tasks that act on them while the night goes on: pointing, guiding, focus.
//!
//! Pixels are handed on as soon as they are fetched, before they are measured, and only to who follows them; what was
//! found on a frame is kept for a while for who asks late.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use contract::CommandId;
use contract::device::camera::Frame;
use contract::observatory::FrameFacts;
use imaging::{Camera, Measured, NoSolution, Solution};
use tokio::sync::broadcast;

use super::measure::Plane;

/// Frames whose pixels wait for a follower, at most.
const PIXELS: usize = 2;
/// Frames whose stars wait for a follower, and are kept for who asks late.
const LOOKS: usize = 32;

/// A frame that was fetched.
#[derive(Debug)]
pub struct Fetched {
    /// As it was announced.
    pub frame: Frame,
    /// Its pixels.
    pub plane: Plane,
    /// What took it.
    pub camera: Camera<'static>,
}

/// A frame that was looked at.
#[derive(Debug, Clone)]
pub struct Looked {
    /// As it was announced.
    pub frame: Frame,
    /// The facts to publish; with a reason where something could not be had.
    pub facts: FrameFacts,
    /// Its stars; `None` where it shows none by its nature, or could not be measured.
    pub measured: Option<Measured>,
    /// Where it points; `None` where nobody tried.
    pub solved: Option<Result<Solution, NoSolution>>,
}

/// Where those who look at frames meet those who act on what they show.
pub struct Looks {
    pixels: broadcast::Sender<Arc<Fetched>>,
    looked: broadcast::Sender<Arc<Looked>>,
    recent: Mutex<VecDeque<Arc<Looked>>>,
}

impl Default for Looks {
    fn default() -> Self {
        let (pixels, looked) = (broadcast::Sender::new(PIXELS), broadcast::Sender::new(LOOKS));
        Self { pixels, looked, recent: Mutex::default() }
    }
}

impl Looks {
    /// Follows the pixels of all cameras from now on; who is slow misses the older ones.
    pub fn follow_pixels(&self) -> broadcast::Receiver<Arc<Fetched>> {
        self.pixels.subscribe()
    }

    /// Sends pixels to all subscribers.
    pub fn fetched(&self, fetched: &Arc<Fetched>) {
        // There may be no receiver.
        let _ = self.pixels.send(fetched.clone());
    }

    /// Hands on what a frame showed.
    pub fn looked(&self, looked: Looked) {
        let looked = Arc::new(looked);
        let mut recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        recent.push_back(looked.clone());
        if recent.len() > LOOKS {
            recent.pop_front();
        }
        // Within the lock, so that who subscribes and then looks back misses nothing.
        let _ = self.looked.send(looked);
    }

    /// Follows what frames of all cameras show from now on; who is slow misses the older ones.
    pub fn follow(&self) -> broadcast::Receiver<Arc<Looked>> {
        self.looked.subscribe()
    }

    /// Waits for what this frame shows, which may be known already. It has no timeout: the caller sets one.
    pub async fn of(&self, frame: &CommandId) -> Arc<Looked> {
        let (mut next, known) = {
            let recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
            let known = recent.iter().rev().find(|looked| looked.frame.id == *frame).cloned();
            (self.looked.subscribe(), known)
        };
        if let Some(known) = known {
            return known;
        }
        loop {
            match next.recv().await {
                Ok(looked) if looked.frame.id == *frame => return looked,
                Ok(_) => {}
                Err(broadcast::error::RecvError::Lagged(_)) => {
                    let recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
                    if let Some(known) = recent.iter().find(|looked| looked.frame.id == *frame) {
                        return known.clone();
                    }
                }
                // The sender lives in self.
                Err(broadcast::error::RecvError::Closed) => std::future::pending().await,
            }
        }
    }
}

/// Waits for the pixels of a frame; None when they went by while nobody looked.
pub async fn caught(pixels: &mut broadcast::Receiver<Arc<Fetched>>, frame: &CommandId) -> Option<Arc<Fetched>> {
    loop {
        match pixels.recv().await {
            Ok(fetched) if fetched.frame.id == *frame => return Some(fetched),
            Ok(_) | Err(broadcast::error::RecvError::Lagged(_)) => {}
            Err(broadcast::error::RecvError::Closed) => return None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::frame;
    use super::*;

    fn looked(id: &str) -> Looked {
        Looked { frame: frame(id), facts: FrameFacts::default(), measured: None, solved: None }
    }

    #[tokio::test]
    async fn a_frame_is_answered_for_whether_it_was_looked_at_before_the_question_or_after() {
        let looks = Arc::new(Looks::default());
        looks.looked(looked("a"));
        assert_eq!(looks.of(&CommandId("a".to_owned())).await.frame.id.0, "a");
        let asked = looks.clone();
        let waiting = tokio::spawn(async move { asked.of(&CommandId("c".to_owned())).await.frame.id.0.clone() });
        tokio::task::yield_now().await;
        for n in 0..2 * LOOKS {
            looks.looked(looked(&format!("b{n}")));
        }
        looks.looked(looked("c"));
        assert_eq!(waiting.await.unwrap(), "c", "also to who fell behind");
    }

    #[tokio::test]
    async fn pixels_go_to_the_followers_and_are_stored_for_nobody_else() {
        let looks = Looks::default();
        let fetched =
            Arc::new(Fetched { frame: frame("a"), plane: Plane::Counts(vec![1, 2]), camera: Camera::default() });
        looks.fetched(&fetched);
        assert_eq!(Arc::strong_count(&fetched), 1);
        let mut follower = looks.follow_pixels();
        looks.fetched(&fetched);
        assert_eq!(follower.recv().await.unwrap().frame.id.0, "a");
        assert_eq!(Arc::strong_count(&fetched), 1, "seen by all");
    }
}
