//! `starmesh schedule`: puts another schedule in force, from any machine on the bus, and prints earlier versions, on
//! the host where the observatory node stores them.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context as _, bail};
use clap::{Args, Subcommand};
use contract::observatory::{
    RowState, RowStatus, ScheduleDraft, ScheduleFindings, ScheduleState, ScheduleTextQuestion, ScheduleTexts,
};
use contract::{Key, OrderKind, Part};
use node_observatory::schedule_file::versions::Versions;
use schedule::read_text;

use crate::console::{document_line, foreign_line};
use crate::join::Join;
use crate::order::{By, Waits};
use crate::{check, order, telescopes};

/// A session that has just opened does not know all its peers.
const TRIES: u32 = 5;
const ASKED: u32 = 3;

/// What `starmesh schedule` does.
#[derive(Debug, Subcommand)]
pub enum ScheduleCommand {
    /// Put a file in the place of the schedule in force; a bad one is refused, and nothing changes.
    Put(Put),
    /// Make a short night of a long one, to try it.
    Compress(crate::compress::Options),
    /// The rows of the schedule in force and how far each is, from any machine on the bus.
    Rows(Rows),
    /// Every schedule that was in force: number, time, author, rows, reason.
    List(VersionsFolder),
    /// Print one of them.
    Show {
        #[command(flatten)]
        folder: VersionsFolder,
        /// Its number in the list; the newest where absent.
        version: Option<u64>,
    },
}

/// Options of `starmesh schedule put`.
#[derive(Debug, Args)]
pub struct Put {
    /// Which telescope, as SITE/TELESCOPE.
    telescope: String,
    /// The new schedule.
    file: PathBuf,
    /// Why, for the list of versions and the log.
    #[arg(long)]
    reason: String,
    /// The name of the person who puts it; by default $STARMESH_OPERATOR, else the name of the account.
    #[arg(long, value_name = "NAME")]
    operator: Option<String>,
    #[command(flatten)]
    join: Join,
}

/// Options of `starmesh schedule rows`.
#[derive(Debug, Args)]
pub struct Rows {
    /// Which telescope, as SITE/TELESCOPE.
    telescope: String,
    #[command(flatten)]
    join: Join,
}

/// Where the versions are: in the data folder of the observatory node, which this must be the host of.
#[derive(Debug, Args)]
pub struct VersionsFolder {
    /// The telescope's configuration.
    #[arg(long, default_value = "observatory.toml")]
    config: PathBuf,
}

impl VersionsFolder {
    fn versions(&self) -> anyhow::Result<Versions> {
        let shown = self.config.display();
        let (config, _) = node::configuration::read_config(&self.config)
            .with_context(|| format!("{shown} names the folder of the versions; name the configuration by --config"))?;
        Ok(Versions::of(&config))
    }
}

/// Runs the command.
pub async fn run(command: ScheduleCommand) -> anyhow::Result<()> {
    match command {
        ScheduleCommand::Put(put) => {
            let shown = put.file.display();
            let text = read_text(&put.file).with_context(|| format!("cannot read {shown}"))?;
            if let Some(ScheduleFindings { valid: false, errors, warnings, .. }) = findings(&put, &text).await? {
                bail!(
                    "refused: {shown} is not a valid schedule: {errors} errors, {warnings} warnings; nothing was changed"
                );
            }
            let by = By { operator: put.operator, reason: put.reason };
            order::give(
                &put.telescope,
                OrderKind::PutSchedule { text, instead_of: None },
                by,
                Waits::default(),
                put.join,
            )
            .await
        }
        ScheduleCommand::Compress(options) => crate::compress::run(&options),
        ScheduleCommand::Rows(rows) => show_rows(rows).await,
        ScheduleCommand::List(folder) => list(&folder.versions()?),
        ScheduleCommand::Show { folder, version } => show(&folder.versions()?, version),
    }
}

/// Asks the telescope's own observatory node for the findings of a schedule, and prints them; nothing where it does not
/// answer, which the order then reports.
async fn findings(put: &Put, text: &str) -> anyhow::Result<Option<ScheduleFindings>> {
    let bus = put.join.open().await?;
    let address = telescopes::read(&put.telescope, &bus, &put.join).await?;
    let (key, draft) = (Key::ScheduleCheck(address), ScheduleDraft { text: text.to_owned() });
    let mut found = None;
    for _ in 0..ASKED {
        found = bus.ask::<_, ScheduleFindings>(&key, &draft, Duration::from_secs(5)).await.ok();
        if found.is_some() {
            break;
        }
    }
    bus.close().await;
    if let Some(found) = &found {
        check::print_findings(&put.file, text, &found.findings)?;
        for what in &found.unchecked {
            foreign_line(format_args!("{}: not checked: {what}", put.file.display()))?;
        }
    }
    Ok(found)
}

/// The rows of the schedule in force, as the observatory node publishes them.
async fn show_rows(rows: Rows) -> anyhow::Result<()> {
    let bus = rows.join.open().await?;
    let address = telescopes::read(&rows.telescope, &bus, &rows.join).await?;
    let key = Key::Observatory(address.clone(), Part::Schedule).to_string();
    let mut found = None;
    for _ in 0..TRIES {
        found = bus.get_all::<ScheduleState>(&key, Duration::from_secs(1)).await.into_iter().next();
        if found.is_some() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    let Some((_, sample)) = found else { return Err(telescopes::unanswered(&address, &bus, &rows.join).await) };
    let (key, question) = (Key::ScheduleTexts(address), ScheduleTextQuestion::default());
    let texts = bus.ask::<_, ScheduleTexts>(&key, &question, Duration::from_secs(2)).await.ok();
    bus.close().await;
    let texts = texts.filter(|texts| texts.sha256 == sample.body.sha256);
    let version = texts.and_then(|texts| texts.versions.first().map(|stored| stored.version));
    for text in row_lines(&sample.body, version) {
        foreign_line(format_args!("{text}"))?;
    }
    Ok(())
}

/// `version`: its number in `starmesh schedule list`, where it is known.
fn row_lines(schedule: &ScheduleState, version: Option<u64>) -> Vec<String> {
    let version = version.map(|version| format!(", version {version}")).unwrap_or_default();
    let mut lines = vec![format!("{} ({} rows{version})", schedule.file, schedule.rows.len())];
    if let Some(why) = &schedule.refused {
        lines.push(format!("the newest file was not taken: {why}"));
    }
    let head = ["row", "status", "action", "object", "camera", "start", "end", "frames", "note"];
    let mut cells: Vec<Vec<String>> = vec![head.map(str::to_owned).to_vec()];
    cells.extend(schedule.rows.iter().map(|row| {
        let wanted = row.frames_wanted.map(|wanted| format!("/{wanted}")).unwrap_or_default();
        vec![
            RowState::told(row.row).to_string(),
            status_word(row.status).to_owned(),
            row.action.clone(),
            row.object.clone().unwrap_or_default(),
            row.camera.clone(),
            row.start_utc.strftime("%m-%d %H:%M:%S"),
            row.end_utc.strftime("%m-%d %H:%M:%S"),
            format!("{}{wanted}", row.frames),
            row.detail.clone(),
        ]
    }));
    let width = |column: usize| cells.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max();
    let widths: Vec<usize> = (0..head.len()).map(|column| width(column).unwrap_or(0)).collect();
    lines.extend(cells.iter().map(|row| {
        let padded = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:width$}"));
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    }));
    lines
}

fn status_word(status: RowStatus) -> &'static str {
    match status {
        RowStatus::Pending => "pending",
        RowStatus::Running => "running",
        RowStatus::Interrupted => "interrupted",
        RowStatus::Finished => "finished",
        RowStatus::Failed => "failed",
        RowStatus::Skipped => "skipped",
    }
}

fn list(versions: &Versions) -> anyhow::Result<()> {
    for stored in versions.list().context("the versions cannot be read")? {
        let (version, at_utc, author, rows) = (stored.version, stored.at_utc.to_second(), stored.author, stored.rows);
        foreign_line(format_args!("{version:6}  {at_utc}  {rows:5} rows  {author}  {}", stored.reason))?;
    }
    Ok(())
}

fn show(versions: &Versions, version: Option<u64>) -> anyhow::Result<()> {
    let newest = || anyhow::Ok(versions.list()?.last().context("no schedule was kept yet")?.version);
    let version = version.map_or_else(newest, Ok)?;
    let text = versions.text(version)?;
    for row in text.lines() {
        document_line(row)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_schedule_has_the_number_that_the_list_of_schedules_gives_it() {
        let sample = include_str!("../../common/contract/golden/v1/observatory.schedule.json");
        let state: ScheduleState = serde_json::from_str(sample).unwrap();
        assert_eq!(row_lines(&state, Some(12))[0], "2026-11-20.jsonl (2 rows, version 12)");
        assert_eq!(row_lines(&state, None)[0], "2026-11-20.jsonl (2 rows)", "not in the list yet");
    }
}
