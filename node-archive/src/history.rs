//! Answers questions about the past.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bus::{BusError, MOST_BYTES, Service};
use contract::Key;
use contract::archive::{ArchiveAnswer, ArchiveQuestion};
use node::Node;
use tokio::sync::Semaphore;

use crate::reader::Reader;

/// Questions that are looked up at the same time; more wait their turn.
const AT_ONCE: usize = 4;
/// A question is answered within this time with what was found until then, machine time: those who ask wait 10 s.
const BUDGET: Duration = Duration::from_secs(5);

/// What an answer says that lacks everything, since other questions took all the time.
const BUSY: &str = "the archive answers other questions; ask again in some seconds";
/// What an answer says that lacks what a message cannot take.
const TOO_LARGE: &str =
    "the answer is larger than a message; ask for a shorter time (from_utc, to_utc), a lower limit or fewer points";

/// Serves the telescope's history from the database, until the service is dropped.
///
/// A question that cannot be read or looked up is answered with no rows, and the diary contains the reason.
pub async fn serve(node: &Node) -> Result<Service, BusError> {
    let file = node.config.archive.database.clone();
    let telescope = node.config.place.telescope.clone();
    let (turns, clock) = (Arc::new(Semaphore::new(AT_ONCE)), node.bus.clock().clone());
    node.bus
        .serve(&Key::History(node.config.address()), move |question: Result<ArchiveQuestion, String>| {
            let (file, turns, telescope, now) = (file.clone(), turns.clone(), telescope.clone(), clock.utc());
            let deadline = Instant::now() + BUDGET;
            async move {
                let question = match question {
                    Ok(question) => question,
                    Err(fault) => return nothing(&fault, None),
                };
                let Ok(_turn) = tokio::time::timeout_at(deadline.into(), turns.acquire()).await else {
                    return nothing("questions wait longer than they are answered", Some(BUSY));
                };
                let look = move || Reader::open(&file, telescope.as_str())?.until(deadline)?.answer(&question, now);
                match tokio::task::spawn_blocking(look).await {
                    Ok(Ok(answer)) => within(answer, MOST_BYTES),
                    Ok(Err(fault)) => nothing(&fault.to_string(), None),
                    Err(fault) => nothing(&fault.to_string(), None),
                }
            }
        })
        .await
}

/// The newest rows that fit into one message; the answer says that there are more, and the client asks for less at a
/// time.
fn within(mut answer: ArchiveAnswer, most_bytes: usize) -> ArchiveAnswer {
    let mut sizes: Vec<usize> = Vec::with_capacity(answer.rows.len());
    for row in &answer.rows {
        // A row that cannot be written is left out.
        sizes.push(serde_json::to_vec(row).map_or(0, |bytes| bytes.len() + 1));
    }
    let mut room = most_bytes.saturating_sub(FRAME_BYTES);
    let fitting = sizes.iter().rev().take_while(|size| {
        let fits = **size <= room;
        room = room.saturating_sub(**size);
        fits
    });
    let gone = answer.rows.len() - fitting.count();
    if gone > 0 {
        answer.rows.drain(..gone);
        answer.truncated = true;
        answer.cut.get_or_insert_with(|| TOO_LARGE.to_owned());
    }
    answer
}

/// The bytes of an answer except its rows, and more.
const FRAME_BYTES: usize = 1024;

fn nothing(fault: &str, cut: Option<&str>) -> ArchiveAnswer {
    tracing::warn!(fault, "a question about the past has no answer");
    ArchiveAnswer { rows: Vec::new(), truncated: cut.is_some(), cut: cut.map(str::to_owned) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_that_is_too_large_for_the_bus_keeps_its_newest_rows() {
        let path = format!("{}/../common/contract/golden/v1/archive.answer.json", env!("CARGO_MANIFEST_DIR"));
        let golden: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
        let golden = golden.as_array().map_or(golden.clone(), |samples| samples[0].clone());
        let sample: ArchiveAnswer = serde_json::from_value(golden).unwrap();
        let row = sample.rows[0].clone();
        let answer = || ArchiveAnswer { rows: vec![row.clone(); 1000], truncated: false, cut: None };
        let size = serde_json::to_vec(&row).unwrap().len() + 1;
        let cut = within(answer(), FRAME_BYTES + 10 * size);
        assert_eq!((cut.rows.len(), cut.truncated), (10, true));
        assert!(serde_json::to_vec(&cut).unwrap().len() <= FRAME_BYTES + 10 * size);
        let whole = within(answer(), MOST_BYTES);
        assert_eq!((whole.rows.len(), whole.truncated), (1000, false));
    }
}
