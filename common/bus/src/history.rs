//! The earlier samples of publishers: asked of each publisher's cache as soon as it is seen.
//!
//! zenoh-ext's subscriber can ask too, but drops the answer when a new sample arrives before it
//! (docs/decisions/0007-history-on-the-bus.md), and a publisher at 10 Hz makes that common.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use contract::Payload;
use tokio::sync::{Semaphore, mpsc};
use zenoh::Session;
use zenoh::key_expr::KeyExpr;
use zenoh::query::{ConsolidationMode, QueryTarget, ReplyKeyExpr};
use zenoh::sample::{Sample, SampleKind};

use crate::queue::Queue;

/// How much of the past is asked for.
const PAST: &str = "_time=[now(-600s)..]";
/// Waits before each try, in ms: a publisher that is just seen may not be known to answer yet.
const TRIES_MS: [u64; 3] = [0, 300, 1500];
/// A cache of ten minutes takes well under a second on one network.
const TIMEOUT: Duration = Duration::from_secs(10);

/// Publishers that are asked at the same time; a site has some hundred.
const MOST_ASKED: usize = 2048;

/// Watches for publishers; ends when dropped.
pub type Watch = zenoh::pubsub::Subscriber<()>;

/// Fills `queue` with the earlier samples of every publisher of `expression`, now and whenever one (re)appears.
pub async fn recall<T: Payload>(
    session: &Session,
    expression: &str,
    queue: &Arc<Queue<T>>,
) -> Result<Watch, zenoh::Error> {
    // Where zenoh-ext's publishers show that they live; the same key asks their cache.
    let publishers = format!("{expression}/@adv/pub/**");
    let (asker, queue) = (session.clone(), Arc::downgrade(queue));
    let runtime = tokio::runtime::Handle::current();
    let places = Arc::new(Semaphore::new(MOST_ASKED));
    let seen = move |token: Sample| {
        if token.kind() == SampleKind::Put {
            let Ok(place) = places.clone().try_acquire_owned() else {
                tracing::warn!(most = MOST_ASKED, "too many publishers came at once; one was not asked for its past");
                return;
            };
            let cache = token.key_expr().clone().into_owned();
            let asking = ask(asker.clone(), cache, queue.clone());
            runtime.spawn(async move {
                asking.await;
                drop(place);
            });
        }
    };
    session.liveliness().declare_subscriber(publishers).history(true).callback(seen).await
}

async fn ask<T: Payload>(session: Session, cache: KeyExpr<'static>, queue: Weak<Queue<T>>) {
    for pause_ms in TRIES_MS {
        tokio::time::sleep(Duration::from_millis(pause_ms)).await;
        let answered = Arc::new(AtomicBool::new(false));
        let (end, mut ended) = mpsc::channel::<()>(1);
        let (noted, into) = (answered.clone(), queue.clone());
        let asked = session
            .get((&cache, PAST))
            .accept_replies(ReplyKeyExpr::Any)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .timeout(TIMEOUT)
            .callback(move |reply| {
                let _until_dropped = &end;
                if let (Ok(sample), Some(into)) = (reply.result(), into.upgrade()) {
                    noted.store(true, Ordering::Relaxed);
                    into.push(sample);
                }
            });
        if let Err(error) = asked.await {
            tracing::debug!(%error, %cache, "a publisher could not be asked for its past");
        }
        // zenoh drops the callback after the last answer.
        ended.recv().await;
        if answered.load(Ordering::Relaxed) {
            return;
        }
    }
}
