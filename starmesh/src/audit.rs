//! `starmesh audit`: proves and shows the records of every order and every movement in the audit files of nodes and the
//! databases of archives.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use audit::audit_file::{BROKEN, Examined, examine};
use audit::chain::prove;
use clap::{Args, Subcommand};
use contract::audit::{AuditOutcome, AuditRecord};
use contract::printable;
use node_archive::reader::Reader;
use units::Utc;

use crate::console::foreign_line;

/// Options of `starmesh audit`.
#[derive(Debug, Args)]
pub struct Options {
    #[command(subcommand)]
    what: AuditCommand,
}

#[derive(Debug, Subcommand)]
enum AuditCommand {
    /// Prove files: a node's data/audit-*.jsonl (older ones first) or an archive.db; together they are compared too.
    Verify {
        /// The files.
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
    /// Print the records of files, one line each.
    Show {
        /// The files.
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// From this time on, UTC, such as 2026-11-21T03:00:00Z.
        #[arg(long)]
        since: Option<String>,
        /// Only this device, such as dome/roof, or all of a kind, such as dome.
        #[arg(long)]
        device: Option<String>,
    },
}

/// One chain of lines: its name and its text.
struct Chain {
    name: String,
    text: Vec<u8>,
}

/// Runs the command; an error where a file is broken.
pub fn run(options: Options) -> anyhow::Result<()> {
    match options.what {
        AuditCommand::Verify { files } => verify(&read(&files)?),
        AuditCommand::Show { files, since, device } => {
            let since = since.map(|since| since.parse::<Utc>()).transpose().context("--since")?;
            show(&read(&files)?, since, device.as_deref())
        }
    }
}

/// A file of lines is one `Chain`; a database has one for each node.
fn read(files: &[PathBuf]) -> anyhow::Result<Vec<Chain>> {
    let mut chains = Vec::new();
    for file in files {
        let name = file.display().to_string();
        if is_sqlite(file).with_context(|| format!("cannot read {name}"))? {
            let mut by_node: Vec<Chain> = Vec::new();
            // The audit is that of all nodes, whatever telescope is named.
            for (node, line) in Reader::open(file, "")?.audit_lines()? {
                let name = format!("{name}, {node}");
                if by_node.last().is_none_or(|chain| chain.name != name) {
                    by_node.push(Chain { name, text: Vec::new() });
                }
                if let Some(chain) = by_node.last_mut() {
                    chain.text.extend(line.bytes().chain([b'\n']));
                }
            }
            chains.append(&mut by_node);
        } else {
            let text = fs::read(file).with_context(|| format!("cannot read {name}"))?;
            chains.push(Chain { name, text });
        }
    }
    Ok(chains)
}

fn is_sqlite(file: &Path) -> std::io::Result<bool> {
    use std::io::Read as _;
    let mut head = Vec::new();
    fs::File::open(file)?.take(16).read_to_end(&mut head)?;
    Ok(head == *b"SQLite format 3\0")
}

fn verify(chains: &[Chain]) -> anyhow::Result<()> {
    let (mut broken, mut records) = (0, 0);
    let mut before = None;
    let mut places: HashMap<(String, u64), (String, &str)> = HashMap::new();
    for file in chains {
        // A file that continues the chain of the one before it, and is no other copy of it.
        let first = file.text.split(|byte| *byte == b'\n').next().and_then(|first| std::str::from_utf8(first).ok());
        let first = first.and_then(|first| prove(first).ok());
        let goes_on = |link: &audit::Link| {
            first.as_ref().is_some_and(|first| first.record.chain == link.chain && first.record.number > link.number)
        };
        let found = examine(&file.text, before.as_ref().filter(|link| goes_on(link)));
        before = found.last();
        records += found.good.len();
        broken += print(file, &found)?;
        for AuditRecord { chain, number, sha256, .. } in found.good.iter().map(|proven| &proven.record) {
            let (same, other) =
                places.entry((chain.clone(), *number)).or_insert_with(|| (sha256.clone(), file.name.as_str()));
            if same != sha256 {
                broken += 1;
                foreign_line(format_args!(
                    "{}: number {number} of chain {chain} is another one in {other}",
                    file.name
                ))?;
            }
        }
    }
    if broken > 0 {
        bail!("{broken} of {} chains are broken or differ", chains.len());
    }
    foreign_line(format_args!("{} records, {} of them different ones: every chain is whole", records, places.len()))?;
    Ok(())
}

/// Prints the findings about one `Chain`; returns 1 where it is broken.
fn print(chain: &Chain, found: &Examined) -> anyhow::Result<usize> {
    let name = &chain.name;
    if let (Some(first), Some(last)) = (found.good.first(), found.good.last()) {
        let (first, last) = (&first.record, &last.record);
        foreign_line(format_args!(
            "{name}: {} records of {}, {} to {}, numbers {} to {}, the last with sha256 {}",
            found.good.len(),
            first.node,
            first.at_utc.to_second(),
            last.at_utc.to_second(),
            first.number,
            last.number,
            last.sha256
        ))?;
    } else {
        foreign_line(format_args!("{name}: no records"))?;
    }
    for (index, record) in found.good.iter().map(|proven| &proven.record).enumerate() {
        match &record.outcome {
            AuditOutcome::Noted { detail } if record.verb == BROKEN => {
                foreign_line(format_args!("{name}: a new chain begins in line {}: {detail}", index + 1))?;
            }
            AuditOutcome::Lost { missing } => {
                foreign_line(format_args!("{name}: line {}: {missing} records were lost before it", index + 1))?;
            }
            _ => {}
        }
    }
    if let Some((number, broken)) = &found.broken {
        foreign_line(format_args!("{name}: line {number} is broken: {broken}"))?;
        return Ok(1);
    }
    if !found.half.is_empty() {
        let number = found.good.len() + 1;
        foreign_line(format_args!("{name}: line {number} is broken: expected the end of the line, found half a line"))?;
        return Ok(1);
    }
    Ok(0)
}

fn show(chains: &[Chain], since: Option<Utc>, device: Option<&str>) -> anyhow::Result<()> {
    let mut records = Vec::new();
    for chain in chains {
        for (index, text) in chain.text.split(|byte| *byte == b'\n').enumerate().filter(|(_, text)| !text.is_empty()) {
            match prove(&String::from_utf8_lossy(text)) {
                Ok(proven) => records.push(proven.record),
                Err(broken) => {
                    let broken = broken.to_string();
                    eprintln!("{}: line {} is broken: {}", chain.name, index + 1, printable(&broken));
                }
            }
        }
    }
    records.sort_by(|a, b| (a.at_utc, &a.node, a.number).cmp(&(b.at_utc, &b.node, b.number)));
    // A file and the archive's copy of it show each record once.
    records.dedup_by(|a, b| a.sha256 == b.sha256);
    let wanted = |record: &&AuditRecord| {
        since.is_none_or(|since| record.at_utc >= since)
            && device.is_none_or(|device| {
                record.device == device || record.device.split('/').next().is_some_and(|kind| kind == device)
            })
    };
    for record in records.iter().filter(wanted) {
        foreign_line(format_args!("{}", sentence(record)))?;
    }
    Ok(())
}

/// A record as a line for people.
fn sentence(record: &AuditRecord) -> String {
    let AuditRecord { at_utc, node, from, from_host, device, verb, parameters, token, reason, outcome, .. } = record;
    let mut text = format!("{} {node}: {from}", at_utc.to_second());
    if !from_host.is_empty() {
        text.push_str(&format!("@{from_host}"));
    }
    for word in [device, verb, parameters] {
        if !word.is_empty() {
            text.push_str(&format!(" {word}"));
        }
    }
    if let Some(token) = token {
        text.push_str(&format!(" token {token}"));
    }
    if !reason.is_empty() {
        text.push_str(&format!(" because {reason:?}"));
    }
    let detail = match outcome {
        AuditOutcome::Accepted | AuditOutcome::Done => String::new(),
        AuditOutcome::Refused { reason, detail } => format!(" ({reason}: {detail})"),
        AuditOutcome::Granted { granted_token } => format!(" (token {granted_token})"),
        AuditOutcome::Failed { detail } | AuditOutcome::Noted { detail } => format!(" ({detail})"),
        AuditOutcome::Superseded { by } => format!(" (by {by})"),
        AuditOutcome::Lost { missing } => format!(" ({missing} records)"),
    };
    format!("{text}: {}{detail}", outcome.word())
}
