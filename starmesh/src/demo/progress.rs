//! Prints the progress of the demo's night, and a summary at the end.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{IsTerminal as _, Write as _};
use std::time::Duration;

use bus::{Bus, Catch, Subscriber};
use contract::archive::Stored;
use contract::node::{DiaryLine, Level};
use contract::observatory::{Alerts, GuidingState, NightState, RowStatus, SafetyState, ScheduleState, Verdict};
use contract::{Address, NodeTopic, Part, Topic, printable};
use units::Utc;

/// Follows the night on the bus, as any subscriber could.
pub struct Progress {
    night: Subscriber<NightState>,
    safety: Subscriber<SafetyState>,
    schedule: Subscriber<ScheduleState>,
    alerts: Subscriber<Alerts>,
    guiding: Subscriber<GuidingState>,
    stored: Subscriber<Stored>,
    diary: Subscriber<DiaryLine>,
    facts: Facts,
    live_line: bool,
}

/// The numbers of the summary.
#[derive(Default)]
pub struct Facts {
    stored: BTreeSet<String>,
    complete: BTreeSet<String>,
    frames: u64,
    open_s: f64,
    alerts: BTreeMap<String, String>,
    closings: u32,
    errors: u32,
    rows: Vec<(String, RowStatus, String)>,
    last: Option<(Utc, NightState, Option<Verdict>)>,
    verdict: Option<Verdict>,
    /// Whether a field is guided now, and how many were.
    guides: bool,
    guided: u32,
}

impl Progress {
    /// Subscribes to the states of a telescope's nodes.
    pub async fn listen(bus: &Bus, address: &Address) -> anyhow::Result<Self> {
        let part = |part| Topic::Observatory(part).at(address);
        Ok(Self {
            night: bus.subscribe(part(Part::Night), Catch::Newest, 64).await?,
            safety: bus.subscribe(part(Part::Safety), Catch::Newest, 64).await?,
            schedule: bus.subscribe(part(Part::Schedule), Catch::Newest, 64).await?,
            alerts: bus.subscribe(part(Part::Alerts), Catch::Newest, 64).await?,
            guiding: bus.subscribe(part(Part::Guiding), Catch::Newest, 64).await?,
            stored: bus.subscribe(Topic::Stored.at(address), Catch::All, 4096).await?,
            diary: bus.subscribe(Topic::Node(NodeTopic::Diary).at(address), Catch::All, 4096).await?,
            facts: Facts::default(),
            live_line: std::io::stdout().is_terminal(),
        })
    }

    /// Prints the progress of the night until it has ended with all headers complete, or nothing was received for a
    /// minute.
    pub async fn follow(&mut self, start: Utc, end: Utc) -> anyhow::Result<()> {
        let mut printed = String::new();
        loop {
            tokio::select! {
                received = self.night.recv() => {
                    let now = received.sample.at_utc;
                    let night = received.sample.body;
                    self.change_of_posture(now, &night);
                    self.facts.frames = night.frames;
                    self.facts.open_s = night.open_s;
                    let ended = night.ended;
                    self.facts.last = Some((now, night, self.facts.verdict));
                    if ended {
                        break;
                    }
                    let line = self.progress(start, end);
                    if line != printed {
                        self.show(&line);
                        printed = line;
                    }
                }
                received = self.safety.recv() => {
                    let verdict = received.sample.body.verdict;
                    if self.facts.verdict.is_some_and(|before| before != verdict) || self.facts.verdict.is_none() {
                        let why = received.sample.body.reasons.first().map_or(String::new(), |r| format!(": {} {}", r.input, r.why));
                        self.print(received.sample.at_utc, &format!("{}{why}", if verdict == Verdict::Safe { "SAFE" } else { "UNSAFE" }));
                    }
                    self.facts.verdict = Some(verdict);
                }
                received = self.schedule.recv() => self.rows(received.sample.at_utc, received.sample.body),
                received = self.alerts.recv() => {
                    for alert in received.sample.body.alerts {
                        if self.facts.alerts.insert(alert.id.clone(), alert.cause.clone()).is_none() {
                            self.print(received.sample.at_utc, &format!("ALERT {}: {} ({})", alert.id, alert.cause, alert.action));
                        }
                    }
                }
                received = self.guiding.recv() => self.guiding(received.sample.at_utc, &received.sample.body),
                received = self.stored.recv() => self.stored(received.sample.body),
                received = self.diary.recv() => {
                    if received.sample.body.level == Level::Error {
                        self.facts.errors += 1;
                        self.print(received.sample.at_utc, &format!("ERROR {}", received.sample.body.message));
                    }
                }
                () = tokio::time::sleep(Duration::from_secs(60)) => {
                    anyhow::bail!("nothing was received from the nodes for a minute; their logs give the reason");
                }
            }
        }
        self.last_headers().await;
        Ok(())
    }

    /// The archive may still be busy when the night has ended.
    async fn last_headers(&mut self) {
        while (self.facts.complete.len() as u64) < self.facts.frames {
            match tokio::time::timeout(Duration::from_secs(20), self.stored.recv()).await {
                Ok(received) => self.stored(received.sample.body),
                Err(_) => return,
            }
        }
    }

    fn stored(&mut self, stored: Stored) {
        if stored.header_complete {
            self.facts.complete.insert(stored.frame.0.clone());
        }
        self.facts.stored.insert(stored.frame.0);
    }

    fn change_of_posture(&mut self, now: Utc, night: &NightState) {
        let before = self.facts.last.as_ref().map(|(_, night, _)| night.posture);
        if before != Some(night.posture) {
            self.print(now, &format!("dome {}", night.posture.word()));
            if before.is_some() && night.posture == contract::observatory::Posture::Closed {
                self.facts.closings += 1;
            }
        }
    }

    fn rows(&mut self, now: Utc, schedule: ScheduleState) {
        if let Some(refused) = &schedule.refused {
            self.print(now, &format!("schedule refused: {refused}"));
        }
        for (index, row) in schedule.rows.iter().enumerate() {
            let name = format!("{}{}", row.action, row.object.as_deref().map_or(String::new(), |o| format!(" {o}")));
            if self.facts.rows.len() <= index {
                self.facts.rows.push((name.clone(), RowStatus::Pending, String::new()));
            }
            if self.facts.rows[index].1 != row.status {
                let word = match row.status {
                    RowStatus::Pending => "waits",
                    RowStatus::Running => "started",
                    RowStatus::Interrupted => "interrupted",
                    RowStatus::Finished => "finished",
                    RowStatus::Failed => "FAILED",
                    RowStatus::Skipped => "skipped",
                };
                let frames = if row.frames > 0 { format!(", {} frames", row.frames) } else { String::new() };
                let detail = if row.detail.is_empty() { String::new() } else { format!(" ({})", row.detail) };
                self.print(now, &format!("{name} {word}{frames}{detail}"));
            }
            self.facts.rows[index] = (name, row.status, row.detail.clone());
        }
    }

    fn guiding(&mut self, now: Utc, state: &GuidingState) {
        if state.active != self.facts.guides {
            self.facts.guides = state.active;
            self.facts.guided += u32::from(state.active);
            let word = if state.active { "begins" } else { "ends" };
            self.print(now, &format!("guiding {word}: {}", state.detail));
        }
    }

    fn progress(&self, start: Utc, end: Utc) -> String {
        let Some((now, night, _)) = &self.facts.last else { return String::new() };
        let part = (now.seconds_since(start) / end.seconds_since(start)).clamp(0.0, 1.0);
        let filled = (part * 24.0) as usize;
        let doing = night.actions.first().map_or("waiting".to_owned(), |action| {
            format!("{} {}: {}", action.action, action.object.as_deref().unwrap_or_default(), action.step)
        });
        format!(
            "{} [{}{}] {} frames, {} headers, {doing}",
            now.strftime("%H:%M"),
            "#".repeat(filled),
            ".".repeat(24 - filled),
            night.frames,
            self.facts.complete.len(),
        )
    }

    /// The progress line stays at the bottom of a terminal; into a file it is not written.
    fn show(&self, line: &str) {
        if self.live_line {
            print!("\r\x1b[2K{}", printable(line).chars().take(110).collect::<String>());
            let _ = std::io::stdout().flush();
        }
    }

    fn print(&self, at: Utc, line: &str) {
        let clear = if self.live_line { "\r\x1b[2K" } else { "" };
        println!("{clear}{}  {}", at.strftime("%H:%M:%S"), printable(line));
    }

    /// The summary, and whether the night went well.
    pub fn summary(&self) -> (String, bool) {
        let facts = &self.facts;
        let closed =
            facts.last.as_ref().is_some_and(|(_, night, _)| night.posture == contract::observatory::Posture::Closed);
        let unfinished: Vec<String> = facts
            .rows
            .iter()
            .filter(|(_, status, _)| *status != RowStatus::Finished)
            .map(|(name, status, detail)| {
                format!("    {}: {} {}", printable(name), format!("{status:?}").to_lowercase(), printable(detail))
            })
            .collect();
        let text = format!(
            "\nsummary\n  frames taken      {}\n  files stored      {}\n  headers complete  {}\n  dome open         {:.1} h, closed {} times, {} now\n  fields guided     {}\n  rows finished     {} of {}\n  alerts            {}\n  errors            {}\n{}",
            facts.frames,
            facts.stored.len(),
            facts.complete.len(),
            facts.open_s / 3600.0,
            facts.closings,
            if closed { "closed" } else { "NOT CLOSED" },
            facts.guided,
            facts.rows.len() - unfinished.len(),
            facts.rows.len(),
            facts.alerts.len(),
            facts.errors,
            unfinished.join("\n"),
        );
        let well = closed && facts.frames > 0 && facts.complete.len() as u64 == facts.frames && facts.errors == 0;
        (text, well)
    }
}
