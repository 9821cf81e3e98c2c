//! `starmesh check`: proves a configuration, its star catalogue and its schedule, or a schedule of its own.

mod files;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use config::Observatory;
use contract::device::DeviceDescription;
use contract::device::filter_wheel::Capabilities;
use contract::observatory::{Check, Finding, ScheduleFindings, Severity};
use contract::{Key, Kind, Name, Topic};
use schedule::read_text;
use schedule::validate::{self, KnownFacts};
use units::Utc;

pub use self::files::writable;

use crate::console::{foreign_line, line};
use crate::join::Join;

/// A session that has just opened does not know all its peers: so often filter wheels are asked.
const TRIES: u32 = 4;
const ANSWER: Duration = Duration::from_secs(1);

/// Options of `starmesh check`.
#[derive(Debug, Args)]
pub struct Options {
    /// An observatory.toml, which is proven with all that it names; or a schedule, which ends in .jsonl.
    file: PathBuf,
    /// For a schedule: the configuration that it is for; observatory.toml next to it where absent.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Take windows for past that end before this instant, UTC; now where absent.
    #[arg(long, value_name = "TIME")]
    at: Option<Utc>,
    /// Send everybody who gets alerts, by `[alerts]`, a message that says that it is a test.
    #[arg(long)]
    send_test_message: bool,
    #[command(flatten)]
    join: Join,
}

/// Proves the file, and the FITS-header table, the star catalogue and the schedule that it names.
///
/// # Errors
/// The reason why a file is refused; a schedule whose rows are only at risk is valid.
pub async fn run(options: Options) -> anyhow::Result<()> {
    if options.file.extension().is_some_and(|ending| ending == "jsonl") {
        ensure!(
            !options.send_test_message,
            "--send-test-message needs an observatory.toml: its [alerts] names who gets alerts"
        );
        let default = options.file.with_file_name("observatory.toml");
        let of = options.config.as_deref().unwrap_or(&default);
        let read = node::configuration::read_config(of);
        if read.is_err() {
            let text = node::configuration::config_text(of).unwrap_or_default();
            let (readable, _) = config::examine(&text, of.parent().unwrap_or(Path::new(".")));
            rows_alone(&options.file, readable.as_ref())?;
        }
        let (config, _) =
            read.context("a schedule is checked with the configuration of its telescope; name it by --config")?;
        return schedule(&options.file, config, options.at, &options.join).await;
    }
    let config = configuration(&options.file)?;
    let sent = if options.send_test_message { send_test_message(&config).await } else { Ok(()) };
    let file = config.schedule.file.clone();
    if file.exists() {
        schedule(&file, config, options.at, &options.join).await?;
    } else {
        line(format_args!("  no schedule yet at {}", file.display()))?;
    }
    sent
}

/// Prints what came of it for each receiver.
async fn send_test_message(config: &Observatory) -> anyhow::Result<()> {
    let by = format!("starmesh check on {}", sysinfo::System::host_name().unwrap_or_default());
    let sent = notify::send_test(config, None, &by, bus::Clock::machine_clock().utc()).await;
    if sent.is_empty() {
        bail!("no test message was sent: [alerts] names nobody who gets any");
    }
    for notify::TestSent { receiver, way, error } in &sent {
        match error {
            None => line(format_args!(
                "  test message to {receiver} ({way}): taken by its server; look whether it arrives"
            ))?,
            Some(why) => foreign_line(format_args!("  test message to {receiver} ({way}): not sent: {why}"))?,
        }
    }
    let missed = sent.iter().filter(|one| one.error.is_some()).count();
    if missed > 0 {
        bail!("{missed} of {} who get alerts were not reached", sent.len());
    }
    Ok(())
}

/// Prints all faults of a configuration and of the files that it names, and its content if there are none.
fn configuration(file: &Path) -> anyhow::Result<Observatory> {
    let text = node::configuration::config_text(file)?;
    let folder = file.parent().unwrap_or(Path::new("."));
    let (config, mut faults) = config::examine(&text, folder);
    let mut held = Vec::new();
    if let Some(config) = &config {
        // A key that is not there is located where it would stand.
        let names_schedule = config::locate(&text, "schedule.file") != config::locate(&text, "schedule.another-key");
        let (found, what) = files::look(config, names_schedule);
        faults.extend(found.into_iter().map(|(severity, path, what)| {
            let (line, column) = config::locate(&text, &path);
            config::Fault { line, column, severity, what }
        }));
        held = what;
    }
    faults.sort_by_key(|fault| (fault.line, fault.column));
    let shown = file.display();
    for config::Fault { line: number, column, severity, what } in &faults {
        match number {
            0 => foreign_line(format_args!("{shown}: {severity}: {what}"))?,
            _ => foreign_line(format_args!("{shown}:{number}:{column}: {severity}: {what}"))?,
        }
    }
    let errors = faults.iter().filter(|fault| fault.severity == Severity::Error).count();
    let warnings = faults.len() - errors;
    if errors > 0
        && let Some(config) = &config
    {
        rows_alone(&config.schedule.file, Some(config))?;
    }
    let Some(config) = config.filter(|_| errors == 0) else {
        bail!("{shown} is not a valid configuration: {errors} errors, {warnings} warnings");
    };
    let at_risk = if warnings > 0 { format!(" ({warnings} warnings)") } else { String::new() };
    line(format_args!("{shown}: valid{at_risk}"))?;
    line(format_args!("  telescope {}", config.address()))?;
    for (kind, common) in config.devices() {
        let node = common.node_id(kind);
        line(format_args!(
            "  {kind:20} {:16} http://{} number {} (device node {node})",
            common.name, common.server, common.number
        ))?;
    }
    for id in config.crowded_enclosure_nodes() {
        line(format_args!(
            "  the device node \"{id}\" serves an enclosure and other devices: a fault of those ends its guard's process too; \
             leave node = out of the dome's block, and the enclosure has a process of its own"
        ))?;
    }
    for what in held {
        line(format_args!("  {what}"))?;
    }
    Ok(config)
}

/// Prints the faults that the rows of a schedule have by themselves, as far as a configuration can be read that is not
/// valid; nothing where there is no schedule yet.
fn rows_alone(file: &Path, config: Option<&Observatory>) -> anyhow::Result<()> {
    let Ok(text) = read_text(file) else { return Ok(()) };
    let cameras = config.map(|config| config.camera.as_slice()).unwrap_or_default();
    let names: Vec<Name> = cameras.iter().map(|camera| camera.common.name.clone()).collect();
    let mut findings = schedule::read_with(&text, &names, &schedule::defaults_of(cameras)).findings;
    // Its cameras and their defaults may be what is wrong.
    findings.retain(|finding| match finding.check {
        Check::Device => false,
        Check::Schema => config.is_some(),
        _ => true,
    });
    print_findings(file, &text, &findings)?;
    let shown = file.display();
    foreign_line(format_args!("{shown}: not checked: devices and sky, which need a configuration that is valid"))
}

/// The filters that the wheels of a telescope report now, where its nodes run here or an address leads to them.
async fn reported_filters(config: &Observatory, join: &Join) -> BTreeMap<Name, Vec<String>> {
    let (address, mut found) = (config.address(), BTreeMap::new());
    if config.filterwheel.is_empty() || !join.leads_to(&address) {
        return found;
    }
    let bus = match join.open().await {
        Ok(bus) => bus,
        Err(error) => {
            node::lines::complain(format_args!("starmesh: the filter wheels are not asked: {error:#}"));
            return found;
        }
    };
    let keys = Topic::Capabilities.at(&address).of_kind(Kind::FilterWheel);
    for _ in 0..TRIES {
        for (key, sample) in bus.get_all::<DeviceDescription<Capabilities>>(keys, ANSWER).await {
            if let Key::Capabilities(wheel) = key {
                found.insert(wheel.name, sample.body.can.names);
            }
        }
        if found.len() >= config.filterwheel.len() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    bus.close().await;
    found
}

/// Prints all findings of a schedule, each with its place in the file.
async fn schedule(file: &Path, config: Observatory, at: Option<Utc>, join: &Join) -> anyhow::Result<()> {
    let shown = file.display();
    let text = read_text(file).with_context(|| format!("cannot read {shown}"))?;
    // A simulated night has another time than this machine.
    let now = at.or((config.clock.simulator.is_none()).then(|| bus::Clock::machine_clock().utc()));
    let reported = reported_filters(&config, join).await;
    let known = reported
        .into_iter()
        .fold(KnownFacts::of(Arc::new(config)), |known, (wheel, filters)| known.with_filters(&wheel, filters));
    let found = validate::validate(&text, &now.into_iter().fold(known, KnownFacts::at));
    let ScheduleFindings { valid, rows, errors, warnings, findings, unchecked } = found;
    print_findings(file, &text, &findings)?;
    let left_out = (errors + warnings) as usize - findings.len();
    if left_out > 0 {
        line(format_args!("{shown}: and {left_out} more"))?;
    }
    for what in unchecked {
        foreign_line(format_args!("{shown}: not checked: {what}"))?;
    }
    if !valid {
        bail!("{shown} is not a valid schedule: {errors} errors, {warnings} warnings");
    }
    let at_risk = if warnings > 0 { format!(", {warnings} warnings") } else { String::new() };
    line(format_args!("{shown}: valid ({rows} rows{at_risk})"))?;
    Ok(())
}

/// Prints each finding with its place in the file.
pub fn print_findings(file: &Path, text: &str, findings: &[Finding]) -> anyhow::Result<()> {
    for finding in findings {
        let Finding { line: number, column, severity, .. } = finding;
        foreign_line(format_args!("{}:{number}:{column}: {severity}: {}", file.display(), finding.words()))?;
        if let Some(quoted) = quoted(text, finding) {
            line(format_args!("{quoted}"))?;
        }
    }
    Ok(())
}

/// So much of a long line is shown before and after the place.
const AROUND: usize = 45;

/// The place in its line, with a caret under it.
fn quoted(text: &str, finding: &Finding) -> Option<String> {
    let line = text.trim_start_matches('\u{feff}').lines().nth(finding.line.checked_sub(1)? as usize)?;
    let at = finding.column.checked_sub(1)? as usize;
    let from = at.saturating_sub(AROUND);
    let part: String = line.chars().skip(from).take(2 * AROUND).map(|c| if c.is_control() { ' ' } else { c }).collect();
    (!part.trim().is_empty()).then(|| format!("    {part}\n    {}^", " ".repeat(at - from)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(line: u32, column: u32) -> Finding {
        let (severity, check, what) = (Severity::Error, Check::Schema, String::new());
        Finding { severity, check, line, column, field: None, what, right: None, fix: None }
    }

    #[test]
    fn the_caret_stands_under_the_place_also_in_a_long_line_of_many_bytes() {
        assert_eq!(quoted("x\n\té: 5", &at(2, 4)).unwrap(), "     é: 5\n       ^");
        let long = format!("{}X{}", "é".repeat(300), "b".repeat(300));
        let shown = quoted(&long, &at(1, 301)).unwrap();
        let (part, caret) = shown.split_once('\n').unwrap();
        assert_eq!(part.chars().nth(caret.chars().count() - 1), Some('X'));
        assert!(part.chars().count() < 100);
        assert_eq!(quoted("one line", &at(2, 1)), None);
    }
}
