//! The questions as they come from the bus: few at a time, each with a deadline.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bus::{BusError, Service};
use contract::Key;
use contract::archived_frame::{
    FrameAnswer, FrameAsk, FrameGiven, FrameQuestion, NotGiven, ReportAnswer, ReportGiven, ReportQuestion,
};
use node::Node;
use tokio::sync::Semaphore;

use super::found::Shelf;
use super::pixels::Decoder;
use super::{ArchiveRefusal, file, refused, report};

/// Questions that are looked up at the same time; more wait their turn.
const AT_ONCE: usize = 3;
/// Frames that are decoded at the same time: each needs its file and its pixels in memory.
const DECODED_AT_ONCE: usize = 1;
/// A question waits so long for its turn, and the database is asked so long, machine time: those who ask wait 10 s.
const BUDGET: Duration = Duration::from_secs(5);
/// What a question is answered that had no turn.
const BUSY: &str = "the archive answers other questions; ask again in some seconds";

/// Serves frames and reports, until the services are dropped.
pub async fn serve(node: &Node) -> Result<[Service; 2], BusError> {
    let shelf = Arc::new(Shelf::of(&node.config));
    let turns = Arc::new(Semaphore::new(AT_ONCE));
    let key = Key::ArchivedFrame(node.config.address());
    let (for_frames, lines) = (shelf.clone(), (turns.clone(), Arc::new(Semaphore::new(DECODED_AT_ONCE))));
    let decoder = Decoder::default();
    let frames = node.bus.serve(&key, move |question| {
        let (shelf, (turns, decoding), decoder) = (for_frames.clone(), lines.clone(), decoder.clone());
        async move { FrameAnswer { gives: frame(&shelf, (&turns, &decoding), &decoder, question).await } }
    });
    let frames = frames.await?;
    let key = Key::NightReport(node.config.address());
    let (config, clock) = (node.config.clone(), node.bus.clock().clone());
    let reports = node.bus.serve(&key, move |question| {
        let (shelf, turns, config, now) = (shelf.clone(), turns.clone(), config.clone(), clock.utc());
        async move {
            let question: ReportQuestion = match question {
                Ok(question) => question,
                Err(fault) => return ReportAnswer { gives: ReportGiven::Refused(refused(NotGiven::Malformed, fault)) },
            };
            let deadline = Instant::now() + BUDGET;
            let gives = match in_turn(&turns, deadline, move || report::make(&config, &shelf, &question, now, deadline))
                .await
            {
                Ok(text) => ReportGiven::Report(text),
                Err(refusal) => ReportGiven::Refused(refusal),
            };
            ReportAnswer { gives }
        }
    });
    Ok([frames, reports.await?])
}

async fn frame(
    shelf: &Arc<Shelf>,
    (turns, decoding): (&Semaphore, &Semaphore),
    decoder: &Decoder,
    question: Result<FrameQuestion, String>,
) -> FrameGiven {
    let question = match question {
        Ok(question) => question,
        Err(fault) => return FrameGiven::Refused(refused(NotGiven::Malformed, fault)),
    };
    let deadline = Instant::now() + BUDGET;
    let is_of_pixels = matches!(question.ask, FrameAsk::Picture(_) | FrameAsk::Tile { .. } | FrameAsk::Pixels { .. });
    let turns = if is_of_pixels { decoding } else { turns };
    let (shelf, decoder_then) = (shelf.clone(), decoder.clone());
    let given = in_turn(turns, deadline, move || answer(&shelf, &decoder_then, &question, deadline)).await;
    if is_of_pixels {
        decoder.forget_later();
    }
    given.unwrap_or_else(FrameGiven::Refused)
}

/// Works on a thread of its own, when it is this question's turn.
async fn in_turn<T: Send + 'static>(
    turns: &Semaphore,
    deadline: Instant,
    work: impl FnOnce() -> Result<T, ArchiveRefusal> + Send + 'static,
) -> Result<T, ArchiveRefusal> {
    let Ok(_turn) = tokio::time::timeout_at(deadline.into(), turns.acquire()).await else {
        return Err(refused(NotGiven::Busy, BUSY));
    };
    tokio::task::spawn_blocking(work).await.unwrap_or_else(|fault| Err(refused(NotGiven::Failed, fault.to_string())))
}

fn answer(
    shelf: &Shelf,
    decoder: &Decoder,
    question: &FrameQuestion,
    deadline: Instant,
) -> Result<FrameGiven, ArchiveRefusal> {
    let details = shelf.find(&question.frame, deadline)?;
    Ok(match &question.ask {
        FrameAsk::About => FrameGiven::About(Box::new(details)),
        FrameAsk::Header { hdu } => FrameGiven::Header(file::header(&shelf.open(&details)?, *hdu)?),
        FrameAsk::Bytes { from, most } => FrameGiven::Bytes(file::piece(shelf.open(&details)?, *from, *most)?),
        FrameAsk::Picture(wanted) => FrameGiven::Picture(decoder.picture(shelf, &details, wanted)?),
        FrameAsk::Tile { z, x, y } => FrameGiven::Tile(decoder.of(shelf, &details)?.tile((*z, *x, *y))?),
        FrameAsk::Pixels { x, y, width_px, height_px } => {
            FrameGiven::Pixels(decoder.of(shelf, &details)?.values((*x, *y), (*width_px, *height_px))?)
        }
    })
}
