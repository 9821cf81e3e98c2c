//! Prints the progress of the demo's night, and a summary at the end.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{IsTerminal as _, Write as _};
use std::time::Duration;

use bus::{Bus, Catch, Subscriber};
use contract::archive::Stored;
use contract::node::{DiaryLine, Level};
use contract::observatory::{
    Alerts, GuidingState, NightState, RowState, RowStatus, SafetyState, ScheduleState, Verdict,
};
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
    address: Address,
    /// It is the only telescope: its lines need no name.
    alone: bool,
    /// Something of it fails on purpose.
    has_fault: bool,
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
    rows: Vec<RowState>,
    last: Option<(Utc, NightState, Option<Verdict>)>,
    verdict: Option<Verdict>,
    /// Whether a field is guided now, and how many were.
    guides: bool,
    guided: u32,
}

impl Progress {
    /// Subscribes to the states of a telescope's nodes.
    pub async fn listen(bus: &Bus, address: &Address, alone: bool, has_fault: bool) -> anyhow::Result<Self> {
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
            live_line: alone && std::io::stdout().is_terminal(),
            address: address.clone(),
            alone,
            has_fault,
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

    /// The archive may still be busy when the night has ended, and the last row's state on its way.
    async fn last_headers(&mut self) {
        while self.facts.rows.iter().any(|row| row.status == RowStatus::Running) {
            match tokio::time::timeout(Duration::from_secs(5), self.schedule.recv()).await {
                Ok(received) => self.rows(received.sample.at_utc, received.sample.body),
                Err(_) => break,
            }
        }
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
            let before = self.facts.rows.get(index).map_or(RowStatus::Pending, |row| row.status);
            if before != row.status {
                self.print(now, &row_words(row, if row.status == RowStatus::Running { "started" } else { word(row) }));
            }
        }
        self.facts.rows = schedule.rows;
    }

    fn guiding(&mut self, now: Utc, state: &GuidingState) {
        if state.active != self.facts.guides {
            self.facts.guides = state.active;
            self.facts.guided += u32::from(state.active);
            let word = if state.active { "begins" } else { "ends" };
            let detail = if state.detail.is_empty() { String::new() } else { format!(": {}", state.detail) };
            self.print(now, &format!("guiding {word}{detail}"));
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
        let name = if self.alone { String::new() } else { format!("{:<13} ", self.address.to_string()) };
        println!("{clear}{}  {name}{}", at.strftime("%H:%M:%S"), printable(line));
    }

    fn is_closed(&self) -> bool {
        let posture = self.facts.last.as_ref().map(|(_, night, _)| night.posture);
        posture == Some(contract::observatory::Posture::Closed)
    }

    /// A telescope of which something fails on purpose has errors, and an alert about it.
    fn went_well(&self) -> bool {
        let facts = &self.facts;
        let whole = facts.frames > 0 && facts.complete.len() as u64 == facts.frames;
        let as_expected = if self.has_fault { !facts.alerts.is_empty() } else { facts.errors == 0 };
        self.is_closed() && whole && as_expected
    }

    /// Its figures, in the order of [`FIGURES`].
    fn figures(&self) -> [String; 10] {
        let facts = &self.facts;
        let finished = facts.rows.iter().filter(|row| row.status == RowStatus::Finished).count();
        let targets = || facts.rows.iter().filter(|row| row.object.is_some());
        let taken: u32 = targets().map(|row| row.frames).sum();
        let wanted: u32 = targets().filter_map(|row| row.frames_wanted).sum();
        let now = if self.is_closed() { "closed" } else { "NOT CLOSED" };
        [
            facts.frames.to_string(),
            format!("{taken} of {wanted}"),
            facts.stored.len().to_string(),
            facts.complete.len().to_string(),
            format!("{:.1} h", facts.open_s / 3600.0),
            format!("{} times, {now} now", facts.closings),
            facts.guided.to_string(),
            format!("{finished} of {}", facts.rows.len()),
            facts.alerts.len().to_string(),
            facts.errors.to_string(),
        ]
    }

    /// The rows without all their frames, and the alerts of the night.
    fn what_went_wrong(&self) -> impl Iterator<Item = String> {
        let is_short = |row: &&RowState| {
            row.status != RowStatus::Finished || row.frames_wanted.is_some_and(|wanted| row.frames < wanted)
        };
        let rows = self.facts.rows.iter().filter(is_short).map(|row| row_words(row, word(row)));
        rows.chain(self.facts.alerts.iter().map(|(id, cause)| format!("alert {id}: {cause}")))
    }
}

/// How a row ended, or that it waits.
fn word(row: &RowState) -> &'static str {
    match row.status {
        RowStatus::Pending => "waits",
        RowStatus::Running => "runs",
        RowStatus::Interrupted => "interrupted",
        RowStatus::Finished => "finished",
        RowStatus::Failed => "FAILED",
        RowStatus::Skipped => "skipped",
    }
}

/// Such as `object 47 Tuc interrupted, 7 of 20 frames (not safe: it rains)`.
fn row_words(row: &RowState, word: &str) -> String {
    let object = row.object.as_deref().map(|object| format!(" {object}")).unwrap_or_default();
    let frames = match row.frames_wanted {
        Some(wanted) if row.frames > 0 || row.status == RowStatus::Skipped => {
            format!(", {} of {wanted} frames", row.frames)
        }
        None if row.frames > 0 => format!(", {} frames", row.frames),
        _ => String::new(),
    };
    let detail = if row.detail.is_empty() { String::new() } else { format!(" ({})", row.detail) };
    format!("{}{object} {word}{frames}{detail}", row.action)
}

/// What the summary says of each telescope.
const FIGURES: [&str; 10] = [
    "frames taken",
    "  of targets",
    "files stored",
    "headers complete",
    "dome open",
    "dome closed",
    "fields guided",
    "rows finished",
    "alerts",
    "errors logged",
];

/// The summary of all telescopes, one column each, and whether their nights went well.
pub fn summary(nights: &[Progress]) -> (String, bool) {
    let columns: Vec<[String; 10]> = nights.iter().map(Progress::figures).collect();
    let mut text = "\nsummary".to_owned();
    if nights.len() > 1 {
        let names: String = nights.iter().map(|night| format!("  {:<21}", night.address.to_string())).collect();
        text.push_str(&format!("{:<11}{}", "", names.trim_end()));
    }
    for (index, name) in FIGURES.into_iter().enumerate() {
        let figures: String = columns.iter().map(|column| format!("  {:<21}", column[index])).collect();
        text.push_str(&format!("\n  {name:<16}{}", figures.trim_end()));
    }
    for night in nights {
        let name = if nights.len() > 1 { format!("{:<13} ", night.address.to_string()) } else { String::new() };
        for line in night.what_went_wrong() {
            text.push_str(&format!("\n  {name}{}", printable(&line)));
        }
    }
    (text, nights.iter().all(Progress::went_well))
}
