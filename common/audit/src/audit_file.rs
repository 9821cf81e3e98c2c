//! A node's own file: lines are appended and synced; the file is repaired at the next start, and a new one begins when
//! it is large.
//!
//! `NAME.jsonl` is written; full files are `NAME.0001.jsonl` and so on, and the chain runs through them. Half a line
//! that a kill left is moved to `NAME.half-1.txt`. A file whose chain is broken is put among the full ones, and a new
//! chain begins that names the break.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use contract::CommandId;

use crate::chain::{Broken, Link, Proven, prove};

/// A file that is larger is put away and a new one begins: a few weeks of a busy telescope, read in a second at the
/// next start.
pub const FULL_BYTES: u64 = 16 * 1024 * 1024;

/// The word of the record that begins a chain because the one before is broken.
pub const BROKEN: &str = "chain_broken";

/// The operations on a file that writing needs; a test lets one fail.
pub(crate) trait Page: Send {
    fn append(&mut self, text: &[u8]) -> io::Result<()>;
    fn sync(&mut self) -> io::Result<()>;
    fn cut(&mut self, length: u64) -> io::Result<()>;
}

impl Page for File {
    fn append(&mut self, text: &[u8]) -> io::Result<()> {
        self.write_all(text)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)
    }
}

/// A node's file.
pub struct AuditFile {
    folder: PathBuf,
    name: String,
    /// A larger file is put away.
    pub(crate) full_bytes: u64,
    pub(crate) page_of: fn(File) -> Box<dyn Page>,
    open: Option<Open>,
    /// The part that is certainly on disk: its length, and the last record.
    sure: Option<(u64, Link)>,
}

struct Open {
    page: Box<dyn Page>,
    _lock: File,
}

/// The result of proving a file.
#[derive(Debug, Default)]
pub struct Examined {
    /// Good records from its beginning on.
    pub good: Vec<Proven>,
    /// The first line that is not good, counted from 1, and why.
    pub broken: Option<(usize, Broken)>,
    /// Bytes of the good lines.
    pub good_bytes: usize,
    /// Bytes after the last end of a line.
    pub half: Vec<u8>,
}

impl Examined {
    /// The end of the chain, which the next record follows.
    pub fn last(&self) -> Option<Link> {
        self.good.last().map(Proven::link)
    }
}

/// Proves a file from its first line on, which follows `before` if that is known.
pub fn examine(bytes: &[u8], before: Option<&Link>) -> Examined {
    let mut found = Examined::default();
    let mut last = before.cloned();
    for (index, line) in bytes.split_inclusive(|byte| *byte == b'\n').enumerate() {
        let Some(whole) = line.strip_suffix(b"\n") else {
            found.half = line.to_vec();
            break;
        };
        let expected = |expected: &str, found: String| Broken { expected: expected.to_owned(), found };
        let proven = std::str::from_utf8(whole)
            .map_err(|error| expected("text in UTF-8", error.to_string()))
            .and_then(prove)
            .and_then(|proven| {
                // The files before this one may have been put away: then its first record is accepted without a proof
                // of its place.
                if last.is_some() || proven.record.number == 0 {
                    proven.follows(last.as_ref())?;
                }
                Ok(proven)
            });
        match proven {
            Ok(proven) => {
                last = Some(proven.link());
                found.good_bytes += line.len();
                found.good.push(proven);
            }
            Err(broken) => {
                found.broken = Some((index + 1, broken));
                break;
            }
        }
    }
    found
}

/// A node's files, the oldest first.
pub(crate) fn pages(folder: &Path, name: &str) -> io::Result<Vec<PathBuf>> {
    let mut full: Vec<(u64, PathBuf)> = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let number = path
            .file_name()
            .and_then(|file| file.to_str())
            .and_then(|file| file.strip_prefix(name)?.strip_prefix('.')?.strip_suffix(".jsonl")?.parse::<u64>().ok());
        full.extend(number.map(|number| (number, path)));
    }
    full.sort();
    let current = folder.join(format!("{name}.jsonl"));
    let mut files: Vec<PathBuf> = full.into_iter().map(|(_, path)| path).collect();
    if current.exists() {
        files.push(current);
    }
    Ok(files)
}

impl AuditFile {
    /// The file of this name in this folder; nothing is opened yet.
    pub fn new(folder: &Path, name: &str) -> Self {
        let page_of = |file| -> Box<dyn Page> { Box::new(file) };
        Self {
            folder: folder.to_owned(),
            name: name.to_owned(),
            full_bytes: FULL_BYTES,
            page_of,
            open: None,
            sure: None,
        }
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// Can lines be appended?
    pub fn is_open(&self) -> bool {
        self.open.is_some()
    }

    fn current(&self) -> PathBuf {
        self.folder.join(format!("{}.jsonl", self.name))
    }

    /// The record that the next one follows, once the file is open.
    pub fn last(&self) -> Option<&Link> {
        self.sure.as_ref().map(|(_, last)| last)
    }

    /// Opens the file unless it is open, repairs it, and returns the records of the repair for the chain: a word and a
    /// sentence each. Blocks.
    pub fn open(&mut self) -> io::Result<Vec<(&'static str, String)>> {
        let lock = File::create(self.folder_made()?.join(format!("{}.lock", self.name)))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let detail = format!("another process writes {}", self.current().display());
                return Err(io::Error::new(io::ErrorKind::ResourceBusy, detail));
            }
            Err(TryLockError::Error(error)) => return Err(error),
        }
        let mut notes = Vec::new();
        let path = self.current();
        let fresh = !path.exists();
        let file = OpenOptions::new().append(true).read(true).create(true).open(&path)?;
        let mut page = (self.page_of)(file);
        if fresh {
            sync_folder(&self.folder);
        }
        if let Some((length, _)) = &self.sure
            && fs::metadata(&path)?.len() >= *length
            && self.still_ends_with_sure(&path)?
        {
            // A write of this process failed: the rest that it left is written again.
            page.cut(*length)?;
            page.sync()?;
            self.open = Some(Open { page, _lock: lock });
            return Ok(notes);
        }
        let expected = self.sure.take().map(|(_, last)| last);
        let mut files = pages(&self.folder, &self.name)?;
        files.pop();
        let bytes = fs::read(&path)?;
        let before = files.last().map(|file| fs::read(file).map(|bytes| (file, examine(&bytes, None)))).transpose()?;
        // A break in the file before was recorded when that file was put away, if this one has begun.
        let link = before.as_ref().and_then(|(_, before)| before.last().filter(|_| before.broken.is_none()));
        let begun = bytes.contains(&b'\n');
        let mut found = examine(&bytes, link.as_ref());
        let mut last = found.last().or_else(|| link.filter(|_| !begun));
        let describe = |file: &Path, (line, broken): &(usize, Broken)| {
            format!("line {line} of {} is broken: {broken}", file_name(file))
        };
        let mut why = before
            .as_ref()
            .filter(|_| !begun)
            .and_then(|(file, before)| before.broken.as_ref().map(|broken| describe(file, broken)));
        if let Some(broken) = &found.broken {
            let put_away = self.turn_over(&path)?;
            why = Some(describe(&put_away, broken));
            let file = OpenOptions::new().append(true).create(true).open(&path)?;
            page = (self.page_of)(file);
            (last, found.good_bytes) = (None, 0);
        } else if !found.half.is_empty() {
            let length = self.mend(&mut page, &found, last.as_ref(), &mut notes)?;
            if length > found.good_bytes {
                last = std::str::from_utf8(&found.half).ok().and_then(|half| prove(half).ok()).map(|half| half.link());
                found.good_bytes = length;
            }
        }
        if let (Some(expected), None) = (&expected, &why)
            && last.as_ref() != Some(expected)
        {
            let ended = format!("number {} of chain {}", expected.number, expected.chain);
            why = Some(format!("the file was changed while this node ran: it ended with {ended}"));
            last = None;
        }
        let length = found.good_bytes as u64;
        let begins = match (why, &last) {
            (Some(why), _) => Some((BROKEN, why)),
            (None, None) => Some(("chain_begins", "nothing was written before".to_owned())),
            (None, Some(_)) => None,
        };
        if let Some(note) = begins {
            notes.insert(0, note);
            last = Some(Link::beginning(CommandId::fresh().0));
        }
        self.sure = last.map(|last| (length, last));
        self.open = Some(Open { page, _lock: lock });
        Ok(notes)
    }

    fn still_ends_with_sure(&self, path: &Path) -> io::Result<bool> {
        let Some((length, last)) = &self.sure else { return Ok(false) };
        if *length == 0 {
            return Ok(true);
        }
        let bytes = fs::read(path)?;
        let end = format!("\"sha256\":\"{}\"}}\n", last.sha256);
        Ok(bytes
            .get(..usize::try_from(*length).unwrap_or(usize::MAX))
            .is_some_and(|sure| sure.ends_with(end.as_bytes())))
    }

    fn folder_made(&self) -> io::Result<&Path> {
        fs::create_dir_all(&self.folder)?;
        Ok(&self.folder)
    }

    /// Completes a line that lacks only its end, and moves any other half line to a file of its own; returns the length
    /// of the good part.
    fn mend(
        &self,
        page: &mut Box<dyn Page>,
        found: &Examined,
        last: Option<&Link>,
        notes: &mut Vec<(&'static str, String)>,
    ) -> io::Result<usize> {
        let whole = std::str::from_utf8(&found.half).ok().and_then(|half| prove(half).ok());
        if whole.is_some_and(|whole| whole.follows(last).is_ok()) {
            page.append(b"\n")?;
            page.sync()?;
            return Ok(found.good_bytes + found.half.len() + 1);
        }
        let (mut aside, path) = (1..)
            .find_map(|number| {
                let path = self.folder.join(format!("{}.half-{number}.txt", self.name));
                match OpenOptions::new().write(true).create_new(true).open(&path) {
                    Err(error) if error.kind() == io::ErrorKind::AlreadyExists => None,
                    opened => Some(opened.map(|file| (file, path))),
                }
            })
            .unwrap_or_else(|| Err(io::Error::from(io::ErrorKind::AlreadyExists)))?;
        if let Err(error) = aside.write_all(&found.half).and_then(|()| aside.sync_data()) {
            // It is tried again each second: no heap of empty files must remain.
            let _ = fs::remove_file(&path);
            return Err(error);
        }
        page.cut(found.good_bytes as u64)?;
        page.sync()?;
        notes.push((
            "half_line_moved",
            format!("{} bytes of a half line lie in {}", found.half.len(), file_name(&path)),
        ));
        Ok(found.good_bytes)
    }

    /// Gives the file the next number.
    fn turn_over(&self, path: &Path) -> io::Result<PathBuf> {
        let files = pages(&self.folder, &self.name)?;
        let numbers = files.iter().filter_map(|file| {
            let stem = file.file_stem()?.to_str()?;
            stem.rsplit_once('.')?.1.parse::<u64>().ok()
        });
        let next = numbers.max().unwrap_or(0) + 1;
        let put_away = self.folder.join(format!("{}.{next:04}.jsonl", self.name));
        fs::rename(path, &put_away)?;
        sync_folder(&self.folder);
        Ok(put_away)
    }

    /// Appends lines, the last of which is `last`, and syncs them. After an error the file is closed: open it again,
    /// and the part that was not certainly written is cut off. Blocks.
    pub fn append(&mut self, lines: &[Proven]) -> io::Result<()> {
        let result = self.try_append(lines);
        if result.is_err() {
            self.open = None;
        }
        result
    }

    fn try_append(&mut self, lines: &[Proven]) -> io::Result<()> {
        if self.sure.as_ref().is_some_and(|(length, _)| *length >= self.full_bytes) {
            self.next_page()?;
        }
        let path = self.current();
        let (Some(open), Some((length, _)), Some(last)) = (&mut self.open, &self.sure, lines.last()) else {
            return Err(io::Error::other("the audit file is not open"));
        };
        let there = fs::metadata(&path).map(|file| file.len());
        if there.as_ref().ok() != Some(length) {
            return Err(io::Error::other(format!("{} was changed by another program: {there:?}", path.display())));
        }
        let text: String = lines.iter().flat_map(|line| [line.line.as_str(), "\n"]).collect();
        open.page.append(text.as_bytes())?;
        open.page.sync()?;
        self.sure = Some((*length + text.len() as u64, last.link()));
        Ok(())
    }

    /// Puts a full file away and continues in an empty one.
    fn next_page(&mut self) -> io::Result<()> {
        let path = self.current();
        self.turn_over(&path)?;
        let file = OpenOptions::new().append(true).create_new(true).open(&path)?;
        sync_folder(&self.folder);
        let page = (self.page_of)(file);
        if let (Some(open), Some((length, _))) = (&mut self.open, &mut self.sure) {
            (open.page, *length) = (page, 0);
        }
        Ok(())
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// A new name is on disk only when its folder is synced; systems that cannot sync a folder do it by themselves.
fn sync_folder(folder: &Path) {
    let _ = File::open(folder).and_then(|folder| folder.sync_all());
}

#[cfg(test)]
#[path = "audit_file_tests.rs"]
mod tests;
