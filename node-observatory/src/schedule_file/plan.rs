//! Answers on the bus what a schedule will do: the forecast of `starmesh plan`, with the devices and names that this node
//! knows, and with overheads from the archive's telemetry where the archive answers.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bus::{AskError, Service};
use contract::Key;
use contract::archive::{ArchiveAnswer, ArchiveQuestion, ArchiveRow, Ask};
use contract::observatory::{SchedulePlan, SchedulePlanQuestion};
use schedule::plan::overheads::TOOK;
use schedule::plan::{Evidence, Site, forecast_while};
use schedule::validate::accept;

use super::ScheduleFile;
use super::file::known;
use super::put::MOST_BYTES;

/// Longer forecasts are given up: nobody waits for them.
const LONGEST: Duration = Duration::from_secs(15);
/// Spans of bad weather in one question.
const MOST_SPANS: usize = 100;
/// Frames and lines of the archive that overheads are measured from, the newest ones.
const MOST_FRAMES: u32 = 3000;
const MOST_LINES: u32 = 5000;
/// The archive answers within this, or overheads are assumed.
const ARCHIVE: Duration = Duration::from_secs(3);
/// Overheads change from night to night; the archive is not asked for each draft.
const AGAIN: Duration = Duration::from_secs(600);
/// ... and again after this where it did not answer.
const SILENT_AGAIN: Duration = Duration::from_secs(60);

/// What the archive had, and until when it is not asked again.
type Remembered = Option<(Instant, Arc<Evidence>)>;

pub(super) async fn serve(file: &Arc<ScheduleFile>, turn: &Arc<tokio::sync::Mutex<()>>) -> anyhow::Result<Service> {
    let (at, turn) = (file.clone(), turn.clone());
    let remembered: Arc<tokio::sync::Mutex<Remembered>> = Arc::default();
    let key = Key::SchedulePlan(file.authority.node.config.address());
    let service = file.authority.node.bus.serve(&key, move |asked: Result<SchedulePlanQuestion, String>| {
        let (file, turn, remembered) = (at.clone(), turn.clone(), remembered.clone());
        async move {
            let question = match asked {
                Ok(question) => question,
                Err(why) => return problem(format!("the question is no schedule.plan_question: {why}")),
            };
            if let Err(why) = check(&question) {
                return problem(why);
            }
            let evidence = evidence(&file, &mut *remembered.lock().await).await;
            let _turn = turn.lock().await;
            let planned = tokio::task::spawn_blocking(move || plan(&file, &question, &evidence)).await;
            planned.unwrap_or_else(|lost| problem(format!("the forecast was lost: {lost}")))
        }
    });
    Ok(service.await?)
}

fn check(question: &SchedulePlanQuestion) -> Result<(), String> {
    let (bytes, spans) = (question.text.len(), &question.unsafe_utc);
    if bytes > MOST_BYTES {
        return Err(format!("{bytes} bytes; a schedule on the bus has at most {MOST_BYTES}"));
    }
    if spans.len() > MOST_SPANS {
        return Err(format!("unsafe_utc: {} spans; expected at most {MOST_SPANS}", spans.len()));
    }
    match spans.iter().find(|[from, to]| from >= to) {
        Some([from, to]) => Err(format!("unsafe_utc: {from} to {to}: expected a begin before its end")),
        None => Ok(()),
    }
}

/// Blocks.
fn plan(file: &ScheduleFile, question: &SchedulePlanQuestion, evidence: &Evidence) -> SchedulePlan {
    let rows = match accept(&question.text, &known(file)) {
        Ok(rows) => rows,
        Err(fault) => return SchedulePlan { findings: fault.findings, ..SchedulePlan::default() },
    };
    let config = file.authority.node.config.clone();
    let overheads = evidence.overheads(&config);
    let mut site = match Site::new(config, overheads) {
        Ok(site) => site,
        Err(error) => return problem(format!("the place of the site: {error}")),
    };
    site.unsafe_spans = question.unsafe_utc.iter().map(|[from, to]| (*from, *to)).collect();
    site.begun.clone_from(&question.begun);
    let began = Instant::now();
    match forecast_while(rows, &mut site, &|| began.elapsed() < LONGEST) {
        Ok(Some(night)) => night.published(&site),
        Ok(None) => {
            problem(format!("the forecast took more than {} s; ask for fewer rows at a time", LONGEST.as_secs()))
        }
        Err(error) => problem(format!("its sky: {error}")),
    }
}

/// The telemetry of earlier nights; nothing where the archive does not answer.
async fn evidence(file: &ScheduleFile, remembered: &mut Remembered) -> Arc<Evidence> {
    if let Some((_, evidence)) = remembered.as_ref().filter(|(until, _)| Instant::now() < *until) {
        return evidence.clone();
    }
    let node = &file.authority.node;
    let key = Key::History(node.config.address());
    let ask = async |ask: Ask, limit: u32| {
        let question = ArchiveQuestion { ask, from_utc: None, to_utc: None, limit: Some(limit) };
        node.bus.ask::<_, ArchiveAnswer>(&key, &question, ARCHIVE).await.map(|answer| answer.rows)
    };
    let found = async {
        let frames = ask(Ask::FindFrames(Box::default()), MOST_FRAMES).await?;
        Ok::<_, AskError>((frames, ask(Ask::Log, MOST_LINES).await?))
    };
    let (frames, lines) = match found.await {
        Ok(found) => found,
        Err(error) => {
            tracing::debug!(%error, "the archive does not answer: the overheads of a forecast are assumed");
            let assumed = Arc::<Evidence>::default();
            *remembered = Some((Instant::now() + SILENT_AGAIN, assumed.clone()));
            return assumed;
        }
    };
    let frames = frames.into_iter().filter_map(|row| match row {
        ArchiveRow::FoundFrame(frame) => Some((*frame).into()),
        _ => None,
    });
    let lines = lines.into_iter().filter_map(|row| match row {
        ArchiveRow::Log { at_utc, message, .. } if message.starts_with(TOOK) => Some((at_utc, message)),
        _ => None,
    });
    let evidence = Arc::new(Evidence { frames: frames.collect(), lines: lines.collect() });
    *remembered = Some((Instant::now() + AGAIN, evidence.clone()));
    evidence
}

fn problem(why: String) -> SchedulePlan {
    SchedulePlan { problem: Some(why), ..SchedulePlan::default() }
}
