//! The users file: read, changed in one step by one program at a time, and read again when it has changed.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use crate::users::{MOST_BYTES, Users, UsersFault};

const TOO_LARGE: &str = "it is larger than a users file can be (1 MiB)";

/// Why a users file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FileFault {
    /// The system refuses it.
    #[error("cannot {what} {file}: {why}")]
    Io {
        /// What was tried.
        what: &'static str,
        /// Which file.
        file: String,
        /// The system's answer.
        why: io::Error,
    },
    /// Its text is none of a users file.
    #[error("{file}, {fault}")]
    Text {
        /// Which file.
        file: String,
        /// Where and what.
        fault: UsersFault,
    },
    /// Others could make themselves users.
    #[error("{0} may be written by others than its owner: correct that with `chmod 600 {0}`")]
    OpenToOthers(String),
    /// It could not be made a text.
    #[error("the users could not be written: {0}")]
    Write(#[from] toml::ser::Error),
}

fn io_fault(what: &'static str, file: &Path) -> impl FnOnce(io::Error) -> FileFault {
    move |why| FileFault::Io { what, file: file.display().to_string(), why }
}

/// Reads a users file; absent where there is none.
///
/// # Errors
/// It cannot be read, is no users file, or may be written by others.
pub fn read(file: &Path) -> Result<Option<Users>, FileFault> {
    let open = match File::open(file) {
        Ok(open) => open,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(io_fault("read", file)(error)),
    };
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let found = open.metadata().map_err(io_fault("read", file))?;
        if found.permissions().mode() & 0o022 != 0 {
            return Err(FileFault::OpenToOthers(file.display().to_string()));
        }
    }
    let mut text = String::new();
    (&open).take(MOST_BYTES + 1).read_to_string(&mut text).map_err(io_fault("read", file))?;
    if text.len() as u64 > MOST_BYTES {
        return Err(io_fault("read", file)(io::Error::other(TOO_LARGE)));
    }
    let text_fault = |fault| FileFault::Text { file: file.display().to_string(), fault };
    Users::parse(&text).map(Some).map_err(text_fault)
}

/// Changes the users in one step: a program that reads meanwhile gets all of the old file or all of the new one, and a
/// program that changes meanwhile waits.
///
/// # Errors
/// The file cannot be read or written; what `change` refuses, and then nothing is changed.
pub fn edit<T, E: From<FileFault>>(file: &Path, change: impl FnOnce(&mut Users) -> Result<T, E>) -> Result<T, E> {
    // A link stays a link.
    let file = &fs::canonicalize(file).unwrap_or_else(|_| file.to_owned());
    let _lock = lock(file)?;
    let mut users = read(file)?.unwrap_or_default();
    let done = change(&mut users)?;
    let text = users.to_text().map_err(FileFault::from)?;
    if text.len() as u64 > MOST_BYTES {
        return Err(io_fault("write", file)(io::Error::other(TOO_LARGE)).into());
    }
    replace(file, &text).map_err(io_fault("write", file))?;
    Ok(done)
}

/// Held by the one who changes the file; the system takes it back from a program that ends.
fn lock(file: &Path) -> Result<File, FileFault> {
    let path = with_ending(file, ".lock");
    let open = private().create(true).truncate(false).open(&path).map_err(io_fault("write", &path))?;
    owned_like(file, &open).map_err(io_fault("write", &path))?;
    open.lock().map_err(io_fault("lock", &path))?;
    Ok(open)
}

fn replace(file: &Path, text: &str) -> io::Result<()> {
    let part = with_ending(file, ".part");
    // The lock is held: what is there was left by a program that was ended.
    match fs::remove_file(&part) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let written = private().create_new(true).open(&part).and_then(|mut open| {
        open.write_all(text.as_bytes())?;
        owned_like(file, &open)?;
        open.sync_all()
    });
    let replaced = written.and_then(|()| fs::rename(&part, file));
    if replaced.is_err() {
        let _ = fs::remove_file(&part);
    }
    replaced?;
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    #[cfg(unix)]
    File::open(folder)?.sync_all()?;
    let _ = folder;
    Ok(())
}

fn with_ending(file: &Path, ending: &str) -> PathBuf {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(ending);
    file.with_file_name(name)
}

/// For this user alone.
fn private() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.write(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options
}

/// Gives a new file to the owner of the users file, so that a change by root does not take it from the web node.
fn owned_like(file: &Path, new: &File) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        let (Ok(old), made) = (fs::metadata(file), new.metadata()?) else { return Ok(()) };
        if old.uid() != made.uid() {
            std::os::unix::fs::fchown(new, Some(old.uid()), Some(old.gid())).map_err(|_| {
                io::Error::other("it belongs to another user of this host; do this as that user, such as by `sudo -u`")
            })?;
        }
    }
    let _ = (file, new);
    Ok(())
}

/// What of a file shows that it is another one now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stamp {
    changed: Option<SystemTime>,
    bytes: u64,
    inode: u64,
}

impl Stamp {
    fn of(file: &Path) -> io::Result<Self> {
        let found = fs::metadata(file)?;
        #[cfg(unix)]
        let inode = std::os::unix::fs::MetadataExt::ino(&found);
        #[cfg(not(unix))]
        let inode = 0;
        Ok(Self { changed: found.modified().ok(), bytes: found.len(), inode })
    }
}

/// The users of a file that may change at any time.
#[derive(Debug)]
pub struct WatchedUsers {
    file: PathBuf,
    stamp: Option<Stamp>,
    users: Option<Arc<Users>>,
    fault: Option<String>,
}

impl WatchedUsers {
    /// With a first look.
    pub fn new(file: PathBuf) -> Self {
        let mut watched = Self { file, stamp: None, users: None, fault: None };
        watched.look();
        watched
    }

    /// Which file it is.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// The users that count now. Absent while there has never been a file. A damaged file leaves those before it; a file
    /// that is gone, or was damaged from the beginning, leaves nobody.
    pub fn users(&self) -> Option<&Arc<Users>> {
        self.users.as_ref()
    }

    /// Why the file does not count, and what counts instead.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// Reads the file again if it has changed; true if other users count now.
    pub fn look(&mut self) -> bool {
        let stamp = match Stamp::of(&self.file) {
            Err(error) if error.kind() == ErrorKind::NotFound => return self.gone(),
            stamp => stamp.ok(),
        };
        if stamp.is_some() && stamp == self.stamp && self.fault.is_none() {
            return false;
        }
        self.stamp = stamp;
        match read(&self.file) {
            Ok(None) => self.gone(),
            Ok(Some(users)) => {
                self.fault = None;
                self.set(users)
            }
            Err(why) => {
                let instead = match &self.users {
                    Some(users) if !users.users.is_empty() => "the users that were read before it still count",
                    _ => "nobody can log in",
                };
                self.fault = Some(format!("web.users: {why}; {instead}"));
                let none = self.users.is_none();
                none && self.set(Users::default())
            }
        }
    }

    fn gone(&mut self) -> bool {
        self.stamp = None;
        if self.users.is_none() {
            return false;
        }
        self.fault = Some(format!(
            "web.users: {} is gone; nobody can log in until it is back, or `starmesh user add` makes another",
            self.file.display()
        ));
        self.set(Users::default())
    }

    fn set(&mut self, users: Users) -> bool {
        let differs = self.users.as_deref() != Some(&users);
        if differs {
            self.users = Some(Arc::new(users));
        }
        differs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::users::tests::ana;

    fn add(file: &Path) {
        edit(file, |users| {
            *users = ana().0;
            Ok::<_, FileFault>(())
        })
        .unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn the_file_is_its_owners_alone_and_is_replaced_whole() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("users.toml"), folder.path().join("link.toml"));
        assert!(read(&file).unwrap().is_none());
        std::os::unix::fs::symlink(&file, &link).unwrap();
        add(&file);
        fs::write(with_ending(&file, ".part"), "left by a program that was killed").unwrap();
        add(&link);
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(read(&file).unwrap().unwrap().users.len(), 1);
        let before = fs::read_to_string(&file).unwrap();
        let refused: Result<(), FileFault> = edit(&file, |users| {
            users.users.clear();
            Err(FileFault::OpenToOthers(String::new()))
        });
        assert!(refused.is_err() && fs::read_to_string(&file).unwrap() == before, "what is refused changes nothing");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o662)).unwrap();
        assert!(read(&file).unwrap_err().to_string().contains("chmod 600"));
        let names = fs::read_dir(folder.path()).unwrap().flatten().count();
        assert_eq!(names, 3, "file, link and lock");
    }

    #[test]
    fn more_users_than_can_be_read_again_are_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("users.toml");
        add(&file);
        let before = fs::read_to_string(&file).unwrap();
        let refused = edit(&file, |users| {
            users.users.values_mut().for_each(|user| user.grants = vec![user.grants[0].clone(); 100_000]);
            Ok::<_, FileFault>(())
        });
        assert!(refused.unwrap_err().to_string().contains("1 MiB"));
        assert_eq!(fs::read_to_string(&file).unwrap(), before);
    }

    #[test]
    fn programs_that_change_the_file_at_once_lose_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("users.toml");
        add(&file);
        let password = ana().0.users.into_values().next().unwrap();
        std::thread::scope(|scope| {
            for thread in 0..4 {
                let (file, password) = (&file, &password);
                scope.spawn(move || {
                    for number in 0..10 {
                        edit(file, |users| {
                            let name = format!("u{thread}-{number}").parse().unwrap();
                            users.users.insert(name, password.clone());
                            Ok::<_, FileFault>(())
                        })
                        .unwrap();
                    }
                });
            }
        });
        assert_eq!(read(&file).unwrap().unwrap().users.len(), 41);
    }

    #[test]
    fn a_damaged_file_leaves_the_users_before_it_and_a_missing_one_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("users.toml");
        let mut watched = WatchedUsers::new(file.clone());
        assert!(watched.users().is_none() && watched.fault().is_none(), "nobody is asked before there are users");
        add(&file);
        assert!(watched.look() && !watched.look());
        let count = |watched: &WatchedUsers| watched.users().unwrap().users.len();
        assert_eq!(count(&watched), 1);
        let whole = fs::read_to_string(&file).unwrap();
        for cut in [0, 10, whole.find("password =").unwrap() + 15] {
            fs::write(&file, &whole[..cut]).unwrap();
            assert!(!watched.look() && count(&watched) == 1, "{cut}");
            assert!(watched.fault().unwrap().contains("still count"), "{:?}", watched.fault());
        }
        fs::write(&file, &whole).unwrap();
        watched.look();
        assert!(watched.fault().is_none() && count(&watched) == 1);
        fs::remove_file(&file).unwrap();
        assert!(watched.look() && count(&watched) == 0);
        assert!(watched.fault().unwrap().contains("is gone"), "{:?}", watched.fault());
        assert!(!watched.look() && watched.users().is_some(), "nobody, and not everybody");
        fs::write(&file, &whole).unwrap();
        assert!(watched.look() && count(&watched) == 1 && watched.fault().is_none());
    }

    #[test]
    fn a_file_that_was_damaged_from_the_beginning_lets_nobody_in() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("users.toml");
        fs::write(&file, "[[user]]\n").unwrap();
        #[cfg(unix)]
        fs::set_permissions(&file, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
        let watched = WatchedUsers::new(file);
        assert!(watched.users().unwrap().users.is_empty());
        let fault = watched.fault().unwrap();
        assert!(fault.contains("line 1") && fault.contains("nobody can log in"), "{fault}");
        let folder_as_file = WatchedUsers::new(folder.path().to_owned());
        assert!(folder_as_file.users().unwrap().users.is_empty(), "what cannot be read is no open door");
    }
}
