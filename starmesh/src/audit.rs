//! `starmesh audit`: proves and shows the records of every order and every movement in the audit files of nodes and the
//! databases of archives.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use audit::book::{BROKEN, Examined, examine};
use audit::chain::prove;
use clap::{Args, Subcommand};
use contract::audit::{Outcome, Record};
use contract::printable;
use node_archive::reader::Reader;
use units::Utc;

use crate::console::foreign_line;

/// Options of `starmesh audit`.
#[derive(Debug, Args)]
pub struct Options {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
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
struct Book {
    name: String,
    text: Vec<u8>,
}

/// Runs the command; an error where a file is broken.
pub fn run(options: Options) -> anyhow::Result<()> {
    match options.what {
        What::Verify { files } => verify(&read(&files)?),
        What::Show { files, since, device } => {
            let since = since.map(|since| since.parse::<Utc>()).transpose().context("--since")?;
            show(&read(&files)?, since, device.as_deref())
        }
    }
}

/// A file of lines is one `Book`; a database has one for each node.
fn read(files: &[PathBuf]) -> anyhow::Result<Vec<Book>> {
    let mut books = Vec::new();
    for file in files {
        let name = file.display().to_string();
        if is_sqlite(file).with_context(|| format!("cannot read {name}"))? {
            let mut by_node: Vec<Book> = Vec::new();
            for (node, line) in Reader::open(file)?.audit_lines()? {
                let name = format!("{name}, {node}");
                if by_node.last().is_none_or(|book| book.name != name) {
                    by_node.push(Book { name, text: Vec::new() });
                }
                if let Some(book) = by_node.last_mut() {
                    book.text.extend(line.bytes().chain([b'\n']));
                }
            }
            books.append(&mut by_node);
        } else {
            let text = fs::read(file).with_context(|| format!("cannot read {name}"))?;
            books.push(Book { name, text });
        }
    }
    Ok(books)
}

fn is_sqlite(file: &Path) -> std::io::Result<bool> {
    use std::io::Read as _;
    let mut head = Vec::new();
    fs::File::open(file)?.take(16).read_to_end(&mut head)?;
    Ok(head == *b"SQLite format 3\0")
}

fn verify(books: &[Book]) -> anyhow::Result<()> {
    let (mut broken, mut records) = (0, 0);
    let mut before = None;
    let mut places: HashMap<(String, u64), (String, &str)> = HashMap::new();
    for book in books {
        // A file that continues the chain of the one before it.
        let first = book.text.split(|byte| *byte == b'\n').next().and_then(|first| std::str::from_utf8(first).ok());
        let first = first.and_then(|first| prove(first).ok());
        let goes_on = |link: &audit::Link| first.as_ref().is_some_and(|first| first.record.chain == link.chain);
        let found = examine(&book.text, before.as_ref().filter(|link| goes_on(link)));
        before = found.last();
        records += found.good.len();
        broken += tell(book, &found)?;
        for Record { chain, number, sha256, .. } in found.good.iter().map(|proven| &proven.record) {
            let (same, other) =
                places.entry((chain.clone(), *number)).or_insert_with(|| (sha256.clone(), book.name.as_str()));
            if same != sha256 {
                broken += 1;
                foreign_line(format_args!(
                    "{}: number {number} of chain {chain} is another one in {other}",
                    book.name
                ))?;
            }
        }
    }
    if broken > 0 {
        bail!("{broken} of {} chains are broken or differ", books.len());
    }
    foreign_line(format_args!("{} records, {} of them different ones: every chain is whole", records, places.len()))?;
    Ok(())
}

/// Prints the findings about one `Book`; returns 1 where it is broken.
fn tell(book: &Book, found: &Examined) -> anyhow::Result<usize> {
    let name = &book.name;
    if let (Some(first), Some(last)) = (found.good.first(), found.good.last()) {
        let (first, last) = (&first.record, &last.record);
        foreign_line(format_args!(
            "{name}: {} records of {}, {} to {}, numbers {} to {}, the last with sha256 {}",
            found.good.len(),
            first.node,
            first.at_utc,
            last.at_utc,
            first.number,
            last.number,
            last.sha256
        ))?;
    } else {
        foreign_line(format_args!("{name}: no records"))?;
    }
    for (index, record) in found.good.iter().map(|proven| &proven.record).enumerate() {
        match &record.outcome {
            Outcome::Noted { detail } if record.verb == BROKEN => {
                foreign_line(format_args!("{name}: a new chain begins in line {}: {detail}", index + 1))?;
            }
            Outcome::Lost { missing } => {
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

fn show(books: &[Book], since: Option<Utc>, device: Option<&str>) -> anyhow::Result<()> {
    let mut records = Vec::new();
    for book in books {
        for (index, text) in book.text.split(|byte| *byte == b'\n').enumerate().filter(|(_, text)| !text.is_empty()) {
            match prove(&String::from_utf8_lossy(text)) {
                Ok(proven) => records.push(proven.record),
                Err(broken) => {
                    let broken = broken.to_string();
                    eprintln!("{}: line {} is broken: {}", book.name, index + 1, printable(&broken));
                }
            }
        }
    }
    records.sort_by(|a, b| (a.at_utc, &a.node, a.number).cmp(&(b.at_utc, &b.node, b.number)));
    // A file and the archive's copy of it show each record once.
    records.dedup_by(|a, b| a.sha256 == b.sha256);
    let wanted = |record: &&Record| {
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
fn sentence(record: &Record) -> String {
    let Record { at_utc, node, from, from_host, device, verb, parameters, token, reason, outcome, .. } = record;
    let mut said = format!("{at_utc} {node}: {from}");
    if !from_host.is_empty() {
        said.push_str(&format!("@{from_host}"));
    }
    for word in [device, verb, parameters] {
        if !word.is_empty() {
            said.push_str(&format!(" {word}"));
        }
    }
    if let Some(token) = token {
        said.push_str(&format!(" token {token}"));
    }
    if !reason.is_empty() {
        said.push_str(&format!(" because {reason:?}"));
    }
    let detail = match outcome {
        Outcome::Accepted | Outcome::Done => String::new(),
        Outcome::Refused { reason, detail } => format!(" ({reason}: {detail})"),
        Outcome::Granted { granted_token } => format!(" (token {granted_token})"),
        Outcome::Failed { detail } | Outcome::Noted { detail } => format!(" ({detail})"),
        Outcome::Superseded { by } => format!(" (by {by})"),
        Outcome::Lost { missing } => format!(" ({missing} records)"),
    };
    format!("{said}: {}{detail}", outcome.word())
}
