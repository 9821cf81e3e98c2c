//! `starmesh check`: proves a configuration, its star catalogue and its schedule, or a schedule of its own.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, bail};
use clap::Args;
use config::Observatory;
use contract::observatory::{Finding, ScheduleFindings};
use node_observatory::schedule::validate::{self, Known};
use units::Utc;

use crate::console::line;

/// Options of `starmesh check`.
#[derive(Debug, Args)]
pub struct Options {
    /// An observatory.toml, which is proven with all that it names; or a schedule, which ends in .jsonl.
    file: PathBuf,
    /// For a schedule: the configuration that it is for; observatory.toml beside it where absent.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Take windows for past that end before this instant, UTC; now where absent.
    #[arg(long, value_name = "TIME")]
    at: Option<Utc>,
}

/// Proves the file, and the FITS-header table, the star catalogue and the schedule that it names.
///
/// # Errors
/// What refuses a file; a schedule whose rows are only at risk is valid.
pub fn run(options: &Options) -> anyhow::Result<()> {
    if options.file.extension().is_some_and(|ending| ending == "jsonl") {
        let beside = options.file.with_file_name("observatory.toml");
        let of = options.config.as_deref().unwrap_or(&beside);
        let (config, _) = bus::node::read_config(of)
            .context("a schedule is checked with the configuration of its telescope; name it by --config")?;
        return schedule(&options.file, config, options.at);
    }
    let config = configuration(&options.file)?;
    let file = config.schedule.file.clone();
    if !file.exists() {
        line(format_args!("  no schedule yet at {}", file.display()))?;
        return Ok(());
    }
    schedule(&file, config, options.at)
}

fn configuration(file: &Path) -> anyhow::Result<Observatory> {
    let (config, header) = bus::node::read_config(file)?;
    for mount in &config.telescope {
        let name = &mount.common.name;
        let read = mount.horizon.as_ref().map(validate::horizon).transpose();
        read.map_err(anyhow::Error::msg).with_context(|| format!("telescope \"{name}\": horizon"))?;
    }
    line(format_args!("{}: valid", file.display()))?;
    line(format_args!("  telescope {}", config.address()))?;
    for (kind, common) in config.devices() {
        line(format_args!("  {kind:20} {:16} http://{} number {}", common.name, common.server, common.number))?;
    }
    for dome in config.dome.iter().filter(|dome| dome.telescopes.len() > 1 && dome.follow == config::Follow::Auto) {
        let name = &dome.common.name;
        line(format_args!(
            "  dome \"{name}\" stands over several telescopes: no node turns it; say follow = \"off\" if it can turn"
        ))?;
    }
    line(format_args!("  {} rows in the FITS-header table", header.rows.len()))?;
    let catalogue = node_observatory::star_catalogue::open(&config.imaging)?;
    match (&config.imaging.catalogue, catalogue.stars()) {
        (None, _) => line(format_args!("  the star catalogue that is shipped"))?,
        (Some(file), Some(stars)) => line(format_args!("  star catalogue {}: {stars} stars", file.display()))?,
        (Some(file), None) => line(format_args!("  star catalogue {}", file.display()))?,
    }
    if let Some(file) = &config.hooks.script {
        let script = node_observatory::hooks::Script::read(file)?;
        line(format_args!("  the site's script {}: {}", file.display(), script.names().join(", ")))?;
    }
    Ok(config)
}

/// Says all that is found in a schedule, each with its place in the file.
fn schedule(file: &Path, config: Observatory, at: Option<Utc>) -> anyhow::Result<()> {
    let shown = file.display();
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {shown}"))?;
    // a simulated night has another time than this machine
    let now = at.or((config.clock.simulator.is_none()).then(|| bus::Clock::machine_clock().utc()));
    let known = Known::of(Arc::new(config));
    let found = validate::validate(&text, &now.into_iter().fold(known, Known::at));
    let ScheduleFindings { valid, rows, errors, warnings, findings, unchecked } = found;
    say(file, &text, &findings)?;
    let left_out = (errors + warnings) as usize - findings.len();
    if left_out > 0 {
        line(format_args!("{shown}: and {left_out} more"))?;
    }
    for what in unchecked {
        line(format_args!("{shown}: not checked: {what}"))?;
    }
    if !valid {
        bail!("{shown} is not a valid schedule: {errors} errors, {warnings} warnings");
    }
    let at_risk = if warnings > 0 { format!(", {warnings} warnings") } else { String::new() };
    line(format_args!("{shown}: valid ({rows} rows{at_risk})"))?;
    Ok(())
}

/// Says each finding with its place in the file.
pub fn say(file: &Path, text: &str, findings: &[Finding]) -> anyhow::Result<()> {
    for finding in findings {
        let Finding { line: number, column, severity, .. } = finding;
        line(format_args!("{}:{number}:{column}: {severity}: {}", file.display(), finding.words()))?;
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
    use contract::observatory::{Check, Severity};

    use super::*;

    fn at(line: u32, column: u32) -> Finding {
        let (severity, check, what) = (Severity::Error, Check::Schema, String::new());
        Finding { severity, check, line, column, field: None, what, right: None }
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
