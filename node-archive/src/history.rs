//! Answers questions about the past.

use std::sync::Arc;

use bus::{BusError, Node, Service};
use contract::Key;
use contract::archive::{Answer, Question};
use tokio::sync::Semaphore;

use crate::reader::Reader;

/// Questions that are looked up at the same time; more wait their turn.
const AT_ONCE: usize = 4;

/// Serves the telescope's history from the database, until the service is dropped.
///
/// A question that cannot be read or looked up is answered with no rows, and the diary says why.
pub async fn serve(node: &Node) -> Result<Service, BusError> {
    let file = node.config.archive.database.clone();
    let turns = Arc::new(Semaphore::new(AT_ONCE));
    node.bus
        .serve(&Key::History(node.config.address()), move |question: Result<Question, String>| {
            let (file, turns) = (file.clone(), turns.clone());
            async move {
                let question = match question {
                    Ok(question) => question,
                    Err(fault) => return nothing(&fault),
                };
                let _turn = turns.acquire().await;
                let look = move || Reader::open(&file).and_then(|reader| reader.answer(&question));
                match tokio::task::spawn_blocking(look).await {
                    Ok(Ok(answer)) => answer,
                    Ok(Err(fault)) => nothing(&fault.to_string()),
                    Err(fault) => nothing(&fault.to_string()),
                }
            }
        })
        .await
}

fn nothing(fault: &str) -> Answer {
    tracing::warn!(fault, "a question about the past has no answer");
    Answer { rows: Vec::new(), truncated: false }
}
