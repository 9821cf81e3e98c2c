//! Answers from a node's own files, in bounded portions.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::path::PathBuf;

use contract::audit::AuditAnswer;
use serde_json::Value;

use crate::audit_file::{AuditFile, pages};

/// Records of one answer, at most.
pub const PORTION: usize = 500;
/// Bytes of one answer, about.
const LARGEST: usize = 512 * 1024;

/// Reads one node's files.
pub struct Past {
    folder: PathBuf,
    name: String,
    /// The end of the last answer, so that the next one need not search: the hash, the file, and the byte after it.
    ended: Option<(String, PathBuf, u64)>,
}

impl Past {
    /// The files of this node.
    pub fn of(file: &AuditFile) -> Self {
        Self { folder: file.folder().to_owned(), name: file.name().to_owned(), ended: None }
    }

    /// The records after the one with this hash, or from the first on.
    ///
    /// A line that is no JSON cannot be published and is left out; the archive finds the gap.
    pub fn after(&mut self, sha256: Option<&str>, limit: usize) -> io::Result<AuditAnswer<Value>> {
        let files = pages(&self.folder, &self.name)?;
        let mut answer = AuditAnswer { records: Vec::new(), more: false, known: true };
        let (mut index, mut offset) = match sha256 {
            None => (0, 0),
            Some(sha256) => match self.find(&files, sha256)? {
                Some(place) => place,
                None => return Ok(AuditAnswer { known: false, ..answer }),
            },
        };
        let mut bytes = 0;
        while let Some(file) = files.get(index) {
            let text = read_from(file, offset)?;
            let mut at = offset;
            for line in text.split_inclusive(|byte| *byte == b'\n') {
                // A line that is just being written.
                let Some(whole) = line.strip_suffix(b"\n") else { break };
                if answer.records.len() >= limit || bytes >= LARGEST {
                    answer.more = true;
                    return Ok(answer);
                }
                at += line.len() as u64;
                let Ok(record) = serde_json::from_slice::<Value>(whole) else { continue };
                bytes += line.len();
                if let Some(sha256) = record.get("sha256").and_then(Value::as_str) {
                    self.ended = Some((sha256.to_owned(), file.clone(), at));
                }
                answer.records.push(record);
            }
            (index, offset) = (index + 1, 0);
        }
        Ok(answer)
    }

    /// The file and the byte after the line that ends with this hash; the newest files are searched first.
    fn find(&self, files: &[PathBuf], sha256: &str) -> io::Result<Option<(usize, u64)>> {
        let end = format!("\"sha256\":\"{sha256}\"}}\n").into_bytes();
        if let Some((ended, file, at)) = &self.ended
            && ended == sha256
            && let Some(index) = files.iter().position(|one| one == file)
            // The file may have been replaced since.
            && read_from(file, at.saturating_sub(end.len() as u64))?.starts_with(&end)
        {
            return Ok(Some((index, *at)));
        }
        for (index, file) in files.iter().enumerate().rev() {
            let text = read_from(file, 0)?;
            let mut at = 0;
            for line in text.split_inclusive(|byte| *byte == b'\n') {
                at += line.len() as u64;
                if line.ends_with(&end) {
                    return Ok(Some((index, at)));
                }
            }
        }
        Ok(None)
    }
}

fn read_from(file: &PathBuf, offset: u64) -> io::Result<Vec<u8>> {
    let mut file = File::open(file)?;
    file.seek(SeekFrom::Start(offset))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    Ok(bytes)
}
