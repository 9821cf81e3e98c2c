//! The permissions of the files that a node writes: files of the data folder belong to its user alone; images are for
//! everybody whom the system's own settings (umask) let read them; a file that takes the place of another one has the
//! permissions of that.

use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The umask that this process was started with, once [`keep_files_private`] has set another one.
static STARTED_WITH: OnceLock<u32> = OnceLock::new();
/// Entries of a data folder that are looked at, so that a wrong `folders.data` costs no minutes.
const MOST_ENTRIES: usize = 10_000;
const DEEPEST: usize = 3;

/// From now on, files that this process makes are its user's alone (0600), and folders too (0700).
pub fn keep_files_private() {
    #[cfg(unix)]
    {
        let before = rustix::process::umask(rustix::fs::Mode::from_raw_mode(0o077));
        let _ = STARTED_WITH.set(before.as_raw_mode());
    }
}

/// Makes a folder for this user alone, with those above it.
pub fn make_folder(folder: &Path) -> io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder)
}

/// Writes a file: afterwards the old one or the new one is there, whole, whatever happens. It is for this user alone, or
/// has the permissions of the old one. Programs that share a folder do not write the same file. Blocks.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut part = path.to_owned().into_os_string();
    part.push(".part");
    let part = PathBuf::from(part);
    if let Err(error) = write_synced(&part, bytes, path).and_then(|()| fs::rename(&part, path)) {
        // Half a file would only take the room that is missing.
        let _ = fs::remove_file(&part);
        return Err(error);
    }
    // The new name is on disk with its folder; Windows opens no folders.
    #[cfg(unix)]
    {
        // A file named without its folder is in the working folder.
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::File::open(folder)?.sync_all()?;
    }
    Ok(())
}

fn write_synced(part: &Path, bytes: &[u8], old: &Path) -> io::Result<()> {
    let mut options = fs::OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(part)?;
    file.write_all(bytes)?;
    keep_permissions(old, &file);
    file.sync_all()
}

/// Gives a new file the permissions of the one whose place it takes, and its owner and group as far as the system lets
/// this process; nothing where there is none. A file system that knows no permissions has none to keep.
pub fn keep_permissions(old: &Path, new: &fs::File) {
    #[cfg(unix)]
    if let (Ok(found), Ok(made)) = (fs::metadata(old), new.metadata()) {
        use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, fchown};
        if (found.uid(), found.gid()) != (made.uid(), made.gid()) {
            let _ = fchown(new, Some(found.uid()), Some(found.gid())).or_else(|_| fchown(new, None, Some(found.gid())));
        }
        let _ = new.set_permissions(fs::Permissions::from_mode(found.permissions().mode() & 0o777));
    }
    #[cfg(not(unix))]
    let _ = (old, new);
}

/// Makes a folder that others may read, as far as the system's settings let them.
pub fn make_public_folder(folder: &Path) -> io::Result<()> {
    match fs::create_dir(folder) {
        // Another process made it meanwhile, with permissions of its own.
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(()),
        made => made.and_then(|()| make_public(folder, 0o777)),
    }
}

/// Lets others read a file, as far as the system's settings let them.
pub fn make_public_file(file: &Path) -> io::Result<()> {
    make_public(file, 0o666)
}

fn make_public(path: &Path, mode: u32) -> io::Result<()> {
    #[cfg(unix)]
    if let Some(umask) = STARTED_WITH.get() {
        use std::os::unix::fs::PermissionsExt as _;
        // A folder of a group hands the group on to those in it.
        let group = fs::metadata(path)?.permissions().mode() & 0o2000;
        return fs::set_permissions(path, fs::Permissions::from_mode((mode & !umask) | group));
    }
    let _ = (path, mode);
    Ok(())
}

/// Takes from others what they may do with files of a data folder that an older version wrote. What belongs to another
/// user stays as it is, links are not followed, and `images` within it stays as it is with the folders on the way
/// there.
pub fn tighten(data: &Path, images: &Path) {
    #[cfg(unix)]
    tighten_below(data, images, DEEPEST, &mut MOST_ENTRIES.clone());
    #[cfg(not(unix))]
    let _ = (data, images, MOST_ENTRIES, DEEPEST);
}

#[cfg(unix)]
fn tighten_below(path: &Path, images: &Path, deep: usize, left: &mut usize) {
    use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
    let Ok(found) = fs::symlink_metadata(path) else { return };
    let is_mine = found.uid() == rustix::process::geteuid().as_raw();
    if found.is_symlink() || !is_mine || *left == 0 || path == images {
        return;
    }
    *left -= 1;
    let mode = found.permissions().mode() & 0o777;
    if mode & 0o077 != 0 && !images.starts_with(path) {
        // A file system without rights has nothing to take away.
        let _ = fs::set_permissions(path, fs::Permissions::from_mode(mode & 0o700));
    }
    if found.is_dir() && deep > 0 {
        for entry in fs::read_dir(path).into_iter().flatten().flatten() {
            tighten_below(&entry.path(), images, deep - 1, left);
        }
    }
}

/// Warns of a file with a secret that others may read. Logs nothing for one that cannot be looked at.
pub fn is_open_to_others(file: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        fs::metadata(file).is_ok_and(|found| found.permissions().mode() & 0o077 != 0)
    }
    #[cfg(not(unix))]
    {
        let _ = file;
        false
    }
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().permissions().mode() & 0o777
    }

    #[test]
    fn files_of_an_older_version_are_taken_from_others_and_links_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let (data, outside) = (folder.path().join("data"), folder.path().join("outside"));
        fs::create_dir_all(data.join("spool")).unwrap();
        fs::write(&outside, "").unwrap();
        fs::write(data.join("spool/tokens.json"), "").unwrap();
        fs::write(data.join("journal.jsonl"), "").unwrap();
        for path in ["", "spool", "spool/tokens.json", "journal.jsonl", "../outside"] {
            fs::set_permissions(data.join(path), fs::Permissions::from_mode(0o755)).unwrap();
        }
        std::os::unix::fs::symlink(&outside, data.join("link")).unwrap();
        assert!(is_open_to_others(&data.join("journal.jsonl")));
        fs::create_dir(data.join("images")).unwrap();
        fs::set_permissions(data.join("images"), fs::Permissions::from_mode(0o755)).unwrap();
        tighten(&data, &data.join("images"));
        assert_eq!([mode(&data), mode(&data.join("images"))], [0o755; 2], "images within it are for others too");
        tighten(&data, Path::new("elsewhere"));
        let modes = ["", "spool", "spool/tokens.json", "journal.jsonl"].map(|path| mode(&data.join(path)));
        assert_eq!(modes, [0o700; 4], "what was executable stays so for its user");
        assert_eq!(mode(&outside), 0o755);
        assert!(!is_open_to_others(&data.join("journal.jsonl")));
    }

    #[test]
    fn a_file_is_written_whole_for_its_user_alone_or_stays_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("draft.json");
        write_whole(&file, b"one").unwrap();
        assert_eq!((fs::read_to_string(&file).unwrap().as_str(), mode(&file)), ("one", 0o600));
        // A folder where the new one is to be written: no disk takes that.
        fs::create_dir(folder.path().join("draft.json.part")).unwrap();
        assert!(write_whole(&file, b"two").is_err());
        assert_eq!(fs::read_to_string(&file).unwrap(), "one");
    }

    #[test]
    fn a_file_that_takes_the_place_of_another_has_its_permissions() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("schedule.jsonl");
        for wanted in [0o644, 0o640, 0o664, 0o600] {
            fs::write(&file, "by hand").unwrap();
            fs::set_permissions(&file, fs::Permissions::from_mode(wanted)).unwrap();
            write_whole(&file, b"by order").unwrap();
            assert_eq!((fs::read_to_string(&file).unwrap().as_str(), mode(&file)), ("by order", wanted));
        }
    }

    #[test]
    fn a_new_folder_belongs_to_its_user_alone() {
        let folder = tempfile::tempdir().unwrap();
        make_folder(&folder.path().join("a/b")).unwrap();
        assert_eq!([mode(&folder.path().join("a")), mode(&folder.path().join("a/b"))], [0o700; 2]);
    }
}
