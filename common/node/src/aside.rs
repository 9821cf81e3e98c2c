//! A data file that cannot be read is kept for people before anything is written in its place.

use std::fs;
use std::hash::{DefaultHasher, Hasher as _};
use std::path::{Path, PathBuf};

/// Copies of one file that are kept; a disk that spoils it at each start must not be filled by them.
const MOST_COPIES: usize = 20;
/// A larger file is none of ours.
const MOST_BYTES: u64 = 256 << 20;

/// Copies a damaged file to `NAME.bad-HASH` next to it and logs this; the same damage is copied once. The file itself
/// stays where it is: other nodes may read it too, and the node that may write it replaces it. Never fails: if the disk
/// takes no copy, this is logged.
pub fn keep_copy(file: &Path, what_is_wrong: &str, what_now: &str) {
    let shown = file.display();
    match copy(file) {
        Ok(copy) => {
            let copy = copy.display();
            tracing::warn!("{shown} is damaged: {what_is_wrong}. It is kept as {copy}. {what_now}");
        }
        Err(error) => tracing::warn!("{shown} is damaged: {what_is_wrong}. No copy could be kept: {error}. {what_now}"),
    }
}

fn copy(file: &Path) -> std::io::Result<PathBuf> {
    if fs::metadata(file)?.len() > MOST_BYTES {
        return Err(std::io::Error::other("it is larger than any file of a node"));
    }
    let bytes = fs::read(file)?;
    let mut hasher = DefaultHasher::new();
    hasher.write(&bytes);
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(".bad-");
    let begins = name.clone();
    name.push(format!("{:016x}", hasher.finish()));
    let copy = file.with_file_name(&name);
    if copy.exists() {
        return Ok(copy);
    }
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let begins = begins.to_string_lossy().into_owned();
    let copies = fs::read_dir(folder)?.flatten();
    if copies.filter(|entry| entry.file_name().to_string_lossy().starts_with(&begins)).count() >= MOST_COPIES {
        return Err(std::io::Error::other(format!("there are {MOST_COPIES} copies already")));
    }
    fs::write(&copy, bytes)?;
    Ok(copy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_damaged_file_is_copied_once_and_stays_where_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("operator-orders.json");
        let copies = || fs::read_dir(folder.path()).unwrap().count() - 1;
        for (text, wanted) in [("{\"hal", 1), ("{\"hal", 1), ("{", 2)] {
            fs::write(&file, text).unwrap();
            keep_copy(&file, "it ends early", "It begins anew.");
            assert_eq!((copies(), fs::read_to_string(&file).unwrap().as_str()), (wanted, text));
        }
        for number in 0..100 {
            fs::write(&file, format!("{number}")).unwrap();
            keep_copy(&file, "it is no object", "It begins anew.");
        }
        assert_eq!(copies(), MOST_COPIES);
        let text = fs::read_to_string(copy(&file).unwrap_or(file.clone())).unwrap();
        assert_eq!(text, "99");
    }

    #[test]
    fn a_file_that_is_none_of_ours_or_cannot_be_copied_stays_as_it_is_without_a_copy() {
        let folder = tempfile::tempdir().unwrap();
        let files = || fs::read_dir(folder.path()).unwrap().count();
        let large = folder.path().join("large.json");
        fs::File::create(&large).unwrap().set_len(MOST_BYTES + 1).unwrap();
        keep_copy(&large, "it ends early", "It begins anew.");
        assert!(copy(&large).unwrap_err().to_string().contains("larger than any file of a node"));
        // The name of its copy is longer than a file system takes.
        let long = folder.path().join("x".repeat(250));
        fs::write(&long, "{").unwrap();
        keep_copy(&long, "it ends early", "It begins anew.");
        assert_eq!(fs::read_to_string(&long).unwrap(), "{");
        keep_copy(&folder.path().join("absent"), "it is gone", "It begins anew.");
        assert_eq!(files(), 2);
    }
}
