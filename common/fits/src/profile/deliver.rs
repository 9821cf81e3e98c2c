//! Writes a delivered copy: the pixels bit for bit, the header by the profile.
//!
//! The copy is written under a temporary name in the target folder, synced, and gets its name only when it is whole, and
//! only where no other file has that name. A kill at any moment leaves the target as it was, and at most a file whose
//! name begins with a dot and ends with `.part`, which a later call for the same name removes after an hour.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, Read, Seek as _, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::cards::{CardEntry, CardList};
use super::check::{Violation, check, of_standard, public_at_once, violations, wrong_sums, wrong_sums_behind};
use super::convert::{convert, file_name, value_without_form};
use super::source::SourceFile;
use super::{Profile, SUMS, is_structural};
use crate::card::Value;
use crate::checksum::{add, encode, sum};
use crate::error::{Fault, FitsError};
use crate::part::{new_part, sync_folder};

/// A copy that is on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Delivered {
    /// Where it is.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// It was there already, the same to the byte: an earlier call wrote it.
    pub was_there: bool,
}

/// What a copy would be, as far as the header of its file shows it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CopyPlan {
    /// Its name.
    pub name: String,
    /// What a person should know before it leaves the house, such as that its archive shows it to everybody at once.
    pub warnings: Vec<String>,
}

/// What breaks the rules of a profile in a file, by what would become of it in a copy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Checked {
    /// What a copy would have, too, or what keeps it from being made.
    pub left: Vec<Violation>,
    /// What no copy has.
    pub mended: Vec<Violation>,
}

/// Why no copy was made. No file got the name of the copy, and no file was changed.
#[derive(Debug, thiserror::Error)]
pub enum DeliveryError {
    /// The file cannot be read as FITS.
    #[error(transparent)]
    Source(#[from] FitsError),
    /// The file is not the one that was written.
    #[error("{} is not as it was written: {violation}; restore it from another copy", file.display())]
    Damaged {
        /// Which file.
        file: PathBuf,
        /// What is wrong with it.
        violation: Violation,
    },
    /// The archive would refuse the copy.
    #[error("{} is not delivered, its archive would refuse it: {}", file.display(), lines(violations))]
    Violations {
        /// Which file.
        file: PathBuf,
        /// What breaks the rules of the profile.
        violations: Vec<Violation>,
    },
    /// A keyword was asked for that FITS has no form for.
    #[error(
        "{keyword} cannot be {value:?}; expected a FITS keyword that is not about the structure of the file, and printable ASCII that fits one card"
    )]
    Value {
        /// Which keyword.
        keyword: String,
        /// Its value.
        value: String,
    },
    /// The name of the copy needs a keyword that is missing.
    #[error("{} has no {keyword}, of which the name of its copy is made", file.display())]
    Name {
        /// Which file.
        file: PathBuf,
        /// Which keyword.
        keyword: String,
    },
    /// Another file has the name.
    #[error("{} is there already and is another file; it is left as it is: move it away, or give another folder", .0.display())]
    Exists(PathBuf),
    /// The target cannot be written.
    #[error("cannot {what} {}: {source}", file.display())]
    Target {
        /// The operation that failed.
        what: &'static str,
        /// With which file.
        file: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
}

fn lines(violations: &[Violation]) -> String {
    violations.iter().map(Violation::to_string).collect::<Vec<_>>().join("; ")
}

/// Writes the copy of a FITS file that a profile makes into a folder, which must be there. `values` are keywords that the
/// caller knows better than the file, such as the site's name at an archive.
///
/// The same call again finds the copy and says so ([`Delivered::was_there`]).
///
/// # Errors
/// [`DeliveryError`]; then no file got the name of the copy.
pub fn deliver_copy(
    source: &Path,
    target_folder: &Path,
    profile: &Profile,
    values: &[(String, String)],
) -> Result<Delivered, DeliveryError> {
    let unreadable = |fault: Fault| FitsError { file: source.to_owned(), fault };
    let mut file = SourceFile::open(source).map_err(unreadable)?;
    let (mut made, name) = made_header(&file, source, profile, values)?;
    let target = target_folder.join(&name);
    let mut part = UnnamedCopy::create(target_folder, &name)?;
    let is_same = profile.unchanged && values.is_empty();
    let header = if is_same { file.header.clone() } else { with_sums(&mut made, 0) };
    let written = part.write(&header);
    written.map_err(|source| part.failed("write", source))?;
    let mut length = header.len() as u64;
    let data_sum = part.copy(&mut length, |take| file.sum_of_data(take))?.map_err(unreadable)?;
    if let Some(violation) = wrong_sums(&file.cards, sum(&file.header), data_sum).into_iter().next() {
        return Err(DeliveryError::Damaged { file: source.to_owned(), violation });
    }
    loop {
        let next = part.copy(&mut length, |take| file.next_hdu(take))?.map_err(unreadable)?;
        let Some(next) = next else { break };
        if let Some(violation) = wrong_sums_behind(&next).into_iter().next() {
            return Err(DeliveryError::Damaged { file: source.to_owned(), violation });
        }
    }
    if !is_same {
        let header = with_sums(&mut made, data_sum);
        part.rewind_and_write(&header).map_err(|source| part.failed("write", source))?;
    }
    part.sync().map_err(|source| part.failed("sync", source))?;
    let was_there = part.take_name(&target)?;
    Ok(Delivered { path: target, bytes: length, was_there })
}

/// The name that the copy of a file would get, and what a person should know of it. Only the header is read.
///
/// # Errors
/// [`DeliveryError`]: no copy would be made.
pub fn plan_copy(source: &Path, profile: &Profile, values: &[(String, String)]) -> Result<CopyPlan, DeliveryError> {
    let file = SourceFile::open(source).map_err(|fault| FitsError { file: source.to_owned(), fault })?;
    let (made, name) = made_header(&file, source, profile, values)?;
    Ok(CopyPlan { name, warnings: public_at_once(&made, profile) })
}

/// What [`check`] finds, divided by what [`deliver_copy`] mends.
///
/// # Errors
/// The file cannot be read, or is no FITS file with an image in its first part.
pub fn check_copy(source: &Path, profile: &Profile) -> Result<Checked, FitsError> {
    let found = check(source, profile)?;
    let file = SourceFile::open(source).map_err(|fault| FitsError { file: source.to_owned(), fault })?;
    let name = plain_name(&file, source);
    let mut left = violations(&convert(&file.cards, &name, profile), profile);
    left.iter_mut().for_each(|violation| explain_missing(violation, &file.cards, &name, profile));
    // A file whose sums are not right is not the one that was written, and is not copied.
    let is_of_sums = |found: &Violation| SUMS.iter().any(|keyword| found.keyword.split(' ').next() == Some(*keyword));
    let (sums, mut mended): (Vec<Violation>, Vec<Violation>) = found.into_iter().partition(is_of_sums);
    left.extend(sums);
    mended.retain(|found| left.iter().all(|left| left.keyword != found.keyword));
    Ok(Checked { left, mended })
}

/// Whether a keyword can be given to the copies of a profile.
///
/// # Errors
/// [`DeliveryError::Value`].
pub fn check_given(profile: &Profile, keyword: &str, value: &str) -> Result<(), DeliveryError> {
    set_by_caller(keyword, value, profile.wants_text(keyword)).map(|_| ())
}

/// The header of a copy without its sums, and the name of the copy.
fn made_header(
    file: &SourceFile,
    source: &Path,
    profile: &Profile,
    values: &[(String, String)],
) -> Result<(CardList, String), DeliveryError> {
    let source_name = plain_name(file, source);
    let mut known = file.cards.clone();
    for (keyword, value) in values {
        let is_text = profile.wants_text(keyword) || known.text(keyword).is_some();
        known.set(set_by_caller(keyword, value, is_text)?);
    }
    let made = convert(&known, &source_name, profile);
    let mut found = if profile.advice { of_standard(&made) } else { violations(&made, profile) };
    if !found.is_empty() {
        found.iter_mut().for_each(|violation| explain_missing(violation, &known, &source_name, profile));
        return Err(DeliveryError::Violations { file: source.to_owned(), violations: found });
    }
    let name = file_name(&made, &source_name, profile);
    let name = name.map_err(|keyword| DeliveryError::Name { file: source.to_owned(), keyword })?;
    Ok((made, name))
}

/// The name of a file, without the ending of one in compressed tiles: its copy is the plain file.
fn plain_name(file: &SourceFile, source: &Path) -> String {
    let mut name = source.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    if file.is_tiled && name.ends_with(".fz") {
        name.truncate(name.len() - ".fz".len());
    }
    name
}

/// A keyword that is missing because its value has no form in FITS: says so, with the value.
fn explain_missing(violation: &mut Violation, cards: &CardList, file: &str, profile: &Profile) {
    if violation.found.is_none()
        && let Some(value) = value_without_form(&violation.keyword, cards, file, profile)
    {
        let expected = "printable ASCII that fits one card; rename what has this name";
        (violation.found, violation.expected) = (Some(format!("'{value}'")), expected.to_owned());
    }
}

/// A keyword with the value that the caller gives: a number where it is one and no text is wanted, else text.
fn set_by_caller(keyword: &str, value: &str, is_text: bool) -> Result<CardEntry, DeliveryError> {
    // What the file's structure and sums are is not the caller's to say.
    let is_ours = |word: &str| {
        is_structural(word)
            || SUMS.contains(&word)
            || ["END", "COMMENT", "HISTORY", "CONTINUE", "HIERARCH"].contains(&word)
    };
    let is_keyword = |word: &str| {
        !is_ours(word)
            && (1..=8).contains(&word.len())
            && word.bytes().all(|byte| byte.is_ascii_uppercase() || byte.is_ascii_digit() || b"-_".contains(&byte))
    };
    let typed = match (value.parse::<i64>(), value.parse::<f64>()) {
        _ if is_text => Value::Text(value.to_owned()),
        (Ok(whole), _) => Value::Whole(whole),
        (_, Ok(number)) if number.is_finite() && value.contains('.') => Value::Number(number),
        _ => Value::Text(value.to_owned()),
    };
    let card = CardEntry::new(keyword, typed, "given for this delivery").filter(|_| is_keyword(keyword));
    card.ok_or_else(|| DeliveryError::Value { keyword: keyword.to_owned(), value: value.to_owned() })
}

/// The header with DATASUM and CHECKSUM for data of this sum; always of the same length.
fn with_sums(cards: &mut CardList, data_sum: u32) -> Vec<u8> {
    let [checksum, datasum] = SUMS;
    let card = |keyword: &str, text: String| {
        let comment = if keyword == checksum { "HDU checksum" } else { "data unit checksum" };
        CardEntry::new(keyword, Value::Text(text), comment)
    };
    let mut set = |keyword: &str, text: String| {
        // Digits and letters always have a form.
        if let Some(card) = card(keyword, text) {
            cards.set(card);
        }
    };
    set(checksum, "0".repeat(16));
    set(datasum, data_sum.to_string());
    let total = add(sum(&cards.to_bytes()), data_sum);
    let text = encode(!total);
    if let Some(card) = card(checksum, text) {
        cards.set(card);
    }
    cards.to_bytes()
}

/// A copy that is being written; its temporary file goes with it.
struct UnnamedCopy {
    path: PathBuf,
    file: BufWriter<File>,
}

impl UnnamedCopy {
    fn create(folder: &Path, name: &str) -> Result<Self, DeliveryError> {
        let path = new_part(folder, name);
        let created = OpenOptions::new().write(true).create_new(true).open(&path);
        let file = created.map_err(|source| DeliveryError::Target { what: "create", file: path.clone(), source })?;
        Ok(Self { path, file: BufWriter::with_capacity(1 << 18, file) })
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)
    }

    /// Writes each piece that `read` hands over, and counts its bytes. The outer error is of this file, the inner one of what
    /// is read.
    fn copy<T>(
        &mut self,
        length: &mut u64,
        read: impl FnOnce(&mut dyn FnMut(&[u8]) -> io::Result<()>) -> Result<T, Fault>,
    ) -> Result<Result<T, Fault>, DeliveryError> {
        let mut refused = None;
        let done = read(&mut |piece| {
            *length += piece.len() as u64;
            // Which side failed is known only here.
            self.write(piece).map_err(|error| {
                refused = Some(error);
                io::Error::from(ErrorKind::Other)
            })
        });
        refused.map_or(Ok(done), |error| Err(self.failed("write", error)))
    }

    fn rewind_and_write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(0))?;
        self.file.write_all(bytes)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.file.flush()?;
        self.file.get_ref().sync_all()
    }

    fn failed(&self, what: &'static str, source: io::Error) -> DeliveryError {
        DeliveryError::Target { what, file: self.path.clone(), source }
    }

    /// Gives the file its name, where no file has it; true when the same file has it already.
    fn take_name(self, target: &Path) -> Result<bool, DeliveryError> {
        // A rename would replace another file; a second name does not.
        let named = match fs::hard_link(&self.path, target) {
            Err(error) if error.kind() != ErrorKind::AlreadyExists && !is_there(target) => {
                // Some file systems, such as those of memory cards and some servers, have no second names.
                fs::rename(&self.path, target)
            }
            named => named,
        };
        match named {
            Err(error) if error.kind() == ErrorKind::AlreadyExists || is_there(target) => {
                match same_bytes(&self.path, target) {
                    Ok(true) => Ok(true),
                    Ok(false) => Err(DeliveryError::Exists(target.to_owned())),
                    Err(source) => Err(DeliveryError::Target { what: "read", file: target.to_owned(), source }),
                }
            }
            named => {
                let synced = named.and_then(|()| sync_folder(target));
                synced.map_err(|source| DeliveryError::Target { what: "name", file: target.to_owned(), source })?;
                Ok(false)
            }
        }
    }
}

impl Drop for UnnamedCopy {
    fn drop(&mut self) {
        // After a rename there is none.
        let _ = fs::remove_file(&self.path);
    }
}

/// Whether something has this name, be it a link that leads nowhere.
fn is_there(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok()
}

fn same_bytes(one: &Path, other: &Path) -> io::Result<bool> {
    // What has the name of a copy may be a folder or a link.
    if !fs::symlink_metadata(other)?.is_file() || fs::metadata(one)?.len() != fs::metadata(other)?.len() {
        return Ok(false);
    }
    let (mut one, mut other) = (File::open(one)?, File::open(other)?);
    let (mut first, mut second) = (Vec::new(), Vec::new());
    loop {
        first.clear();
        second.clear();
        (&mut one).take(1 << 18).read_to_end(&mut first)?;
        (&mut other).take(1 << 18).read_to_end(&mut second)?;
        if first != second {
            return Ok(false);
        }
        if first.is_empty() {
            return Ok(true);
        }
    }
}
