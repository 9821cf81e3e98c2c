//! Answers on the bus what a schedule will do: the forecast of `starmesh plan`, with the devices and names that this node
//! knows, and with overheads from the archive's telemetry where the archive answers.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bus::Service;
use contract::Key;
use contract::observatory::{SchedulePlan, SchedulePlanQuestion};
use schedule::plan::{Evidence, Site, forecast_while};
use schedule::validate::accept;

use super::ScheduleFile;
use super::file::known;
use super::put::MOST_BYTES;

/// Longer forecasts are given up: nobody waits for them.
const LONGEST: Duration = Duration::from_secs(15);
/// Spans of bad weather in one question.
const MOST_SPANS: usize = 100;
pub(super) async fn serve(file: &Arc<ScheduleFile>, turn: &Arc<tokio::sync::Mutex<()>>) -> anyhow::Result<Service> {
    let (at, turn) = (file.clone(), turn.clone());
    let key = Key::SchedulePlan(file.authority.node.config.address());
    let service = file.authority.node.bus.serve(&key, move |asked: Result<SchedulePlanQuestion, String>| {
        let (file, turn) = (at.clone(), turn.clone());
        async move {
            let question = match asked {
                Ok(question) => question,
                Err(why) => return problem(format!("the question is no schedule.plan_question: {why}")),
            };
            if let Err(why) = check(&question) {
                return problem(why);
            }
            let evidence = file.earlier_nights.evidence(&file.authority.node).await;
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

fn problem(why: String) -> SchedulePlan {
    SchedulePlan { problem: Some(why), ..SchedulePlan::default() }
}
