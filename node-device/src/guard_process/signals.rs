//! The requests to the guard process, by signals and by its parent, also while it waits for its turn.

use std::fs::File;
use std::time::Duration;

use super::GUARD_LOCK;
use super::places::Places;

/// What this process is asked for.
#[derive(Debug, Clone, Copy)]
pub enum EndRequest {
    /// Close, and then end.
    End,
    /// End, whatever is open.
    EndAtOnce,
    /// The process that started this one has ended.
    ParentDied,
}

/// What was asked for, one after another.
pub struct Signals {
    asked: tokio::sync::mpsc::UnboundedReceiver<EndRequest>,
}

impl Signals {
    /// Listens from now on.
    pub fn listen(with_parent: bool) -> Self {
        let (sender, asked) = tokio::sync::mpsc::unbounded_channel();
        let parent = sender.clone();
        tokio::spawn(async move {
            node::signals::end_asked().await;
            let mut word = EndRequest::End;
            while sender.send(word).is_ok() {
                node::signals::termination().await;
                word = EndRequest::EndAtOnce;
            }
        });
        if with_parent {
            tokio::spawn(async move {
                node::signals::parent_end().await;
                // The receiver is gone when this process ends.
                let _ = parent.send(EndRequest::ParentDied);
            });
        }
        Self { asked }
    }

    /// The next one.
    pub async fn next(&mut self) -> EndRequest {
        match self.asked.recv().await {
            Some(asked) => asked,
            None => std::future::pending().await,
        }
    }
}

/// Waits until no other guard process looks after the same domes; none where an end was asked for meanwhile.
pub async fn lock(places: &Places, id: &str, signals: &mut Signals) -> Option<Option<File>> {
    let mut has_reported = false;
    loop {
        match places.lock(GUARD_LOCK) {
            Ok(lock) => return Some(lock),
            Err(taken) if !has_reported => {
                has_reported = true;
                let file = taken.path.display().to_string();
                tracing::warn!(
                    file,
                    "another guard process of the device node {id} runs on this host, maybe one that still closes a dome; \
                     this one waits until it ends"
                );
            }
            Err(_) => {}
        }
        node::service_manager::alive();
        tokio::select! {
            _ = signals.next() => return None,
            () = tokio::time::sleep(Duration::from_millis(500)) => {}
        }
    }
}
