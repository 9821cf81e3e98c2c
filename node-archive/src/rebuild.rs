//! Frames that lie in the folder of images and are not in the database, as after an older database was put back: the
//! archive finds them by their FRAMEID and records them, and a frame that is announced again is not written twice.

mod found;

use std::collections::{HashMap, HashSet};
use std::fs;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use contract::CommandId;
use contract::device::camera::Frame;
use node::Node;
use tokio::sync::{Notify, watch};
use units::Utc;

use self::found::{Found, read};
use crate::database::{Database, StoredImage, Write};
use crate::fits::Shape;
use crate::folder::{PART_FOLDER, exact_text, relative_text as relative};
use crate::name::COMPRESSED;
use crate::reader::Reader;
use crate::stored_header::Header;

/// Folders within folders that are looked into.
const DEEPEST: usize = 16;

/// The files that name each frame: one of several may be a half copy of another.
type Files = HashMap<CommandId, Vec<PathBuf>>;

/// The files that the database did not know when this archive began, once they are found.
#[derive(Debug)]
pub struct OnDisk {
    images_of_before: Utc,
    found: watch::Receiver<Option<Arc<Files>>>,
}

impl OnDisk {
    /// Nothing is known yet; `began` is the sky time of the archive's start.
    pub fn new(began: Utc) -> (Self, watch::Sender<Option<Arc<Files>>>) {
        let (sender, found) = watch::channel(None);
        (Self { images_of_before: began, found }, sender)
    }

    /// The file of a frame that the database does not know, relative to the folder of images, and its length. A frame
    /// that began after this archive did has none, and is not waited for.
    pub async fn find(&self, frame: &Frame, images: &Path) -> Option<(String, u64)> {
        if frame.started_utc >= self.images_of_before {
            return None;
        }
        let mut found = self.found.clone();
        let files = found.wait_for(Option::is_some).await.ok()?.clone()?;
        let paths = files.get(&frame.id)?.clone();
        let (images, frame) = (images.to_owned(), frame.clone());
        let prove = move || {
            first_of(&images, &paths, |image, path| {
                let is_same = image.shape == Shape::of(&frame) && image.sha256.eq_ignore_ascii_case(&frame.sha256);
                is_same.then(|| (relative(&images, path), image.bytes))
            })
        };
        match tokio::task::spawn_blocking(prove).await {
            Ok(Ok(proven)) => proven,
            Ok(Err(error)) => {
                tracing::warn!(%error, "a file that seems to hold a frame cannot be read; the frame is written anew");
                None
            }
            Err(_) => None,
        }
    }
}

/// Looks through the folder of images, and records the frames of this telescope; again where a new database has begun.
pub async fn keep(
    node: Node,
    database: Database,
    incomplete: Arc<Notify>,
    found: watch::Sender<Option<Arc<Files>>>,
) -> anyhow::Result<()> {
    loop {
        let (images, path) = (node.config.folders.images.clone(), database.path().to_owned());
        let telescope = node.config.place.telescope.clone();
        let files = tokio::task::spawn_blocking(move || unknown(&images, &path, telescope.as_str())).await?;
        // Frames wait for the answer: after an error the answer is empty.
        let files = Arc::new(files.unwrap_or_else(|error| {
            tracing::warn!(error = format!("{error:#}"), "files that the database does not know are not looked for");
            Files::new()
        }));
        found.send_replace(Some(files.clone()));
        let (mut recorded, mut left_out, mut example) = (0, 0, None);
        for (id, paths) in files.iter() {
            let (node, id, of, file) = (node.clone(), id.clone(), paths.clone(), database.path().to_owned());
            let images = node.config.folders.images.clone();
            let work = move || -> anyhow::Result<Look> {
                let config = &node.config;
                // A copy of a file that is known has another name and the same frame.
                if Reader::open(&file, config.place.telescope.as_str())?.image(&id)?.is_some() {
                    return Ok(Look::Known);
                }
                let row = |image: Found, path: &Path| image.row(config, &node.header, id.clone(), path.to_owned());
                let row = first_of(&config.folders.images, &of, row)?;
                Ok(row.map_or(Look::NotOurs, |(image, is_complete)| Look::Ours(Box::new(image), is_complete)))
            };
            match tokio::task::spawn_blocking(work).await? {
                Ok(Look::Ours(image, is_complete)) => {
                    let id = image.frame.id.clone();
                    let path = image.path(&images);
                    let mut writes = vec![Write::Stored(image, path)];
                    writes.extend(is_complete.then_some(Write::Complete(id)));
                    database.commit(writes).await?;
                    recorded += 1;
                }
                Ok(Look::Known) => {}
                Ok(Look::NotOurs) => {
                    left_out += 1;
                    example = example.or(paths.first());
                }
                Err(error) => tracing::warn!(error = format!("{error:#}"), "a file is not recorded"),
            }
        }
        if let Some(example) = example {
            tracing::info!(
                files = left_out, example = %example.display(),
                "frames in the folder of images are not in the database and not recorded: they are not whole, or by TELESCOP and INSTRUME of no camera here"
            );
        }
        if recorded > 0 {
            tracing::warn!(
                frames = recorded,
                "the database did not know frames in the folder of images; they are recorded"
            );
            incomplete.notify_one();
        }
        database.renewed().await;
    }
}

/// The files of frames that the database does not know. Blocks.
fn unknown(images: &Path, database: &Path, telescope: &str) -> anyhow::Result<Files> {
    let mut known = HashSet::new();
    Reader::open(database, telescope)?.each_file(|file| {
        known.insert(short(file));
    })?;
    let (mut files, mut unnamed) = (Files::new(), None);
    walk(images, images, DEEPEST, &mut |path| {
        // A row could not lead to it.
        if exact_text(images, &path).is_none() {
            unnamed.get_or_insert(path);
            return;
        }
        // Of telescopes that share the database, others have their own folders, with the same names.
        if known.contains(&short(&relative(images, &path))) || known.contains(&short(&path.to_string_lossy())) {
            return;
        }
        if let Ok(Some(id)) = Header::read(&path).map(|header| header?.value("FRAMEID")) {
            files.entry(CommandId(id)).or_default().push(path);
        }
    });
    if let Some(example) = unnamed {
        tracing::warn!(
            ?example,
            "files whose names are not UTF-8, or have control characters, are passed over; rename them if they are frames"
        );
    }
    for paths in files.values_mut() {
        // Copies lie deeper and have longer names.
        paths.sort_by_cached_key(|path| (path.components().count(), path.as_os_str().len(), path.clone()));
    }
    Ok(files)
}

/// What is made of the first file of which something is made.
///
/// # Errors
/// Of none, and a file cannot be read.
fn first_of<T>(
    images: &Path,
    paths: &[PathBuf],
    mut make: impl FnMut(Found, &Path) -> Option<T>,
) -> io::Result<Option<T>> {
    let mut fault = None;
    for path in paths {
        match read(images, path) {
            Ok(found) => {
                let made = found.and_then(|found| make(found, path));
                if made.is_some() {
                    return Ok(made);
                }
            }
            Err(error) => fault = Some(error),
        }
    }
    fault.map_or(Ok(None), Err)
}

/// What a file proves to be.
enum Look {
    /// The database has its frame under another name.
    Known,
    /// A frame of this telescope, and whether its header is complete.
    Ours(Box<StoredImage>, bool),
    NotOurs,
}

/// Hands over every FITS file in a folder, without following links.
fn walk(images: &Path, folder: &Path, deep: usize, take: &mut impl FnMut(PathBuf)) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let Ok(kind) = entry.file_type() else { continue };
        let path = entry.path();
        let is_parts = folder == images && entry.file_name() == PART_FOLDER;
        if kind.is_dir() && deep > 0 && !is_parts {
            walk(images, &path, deep - 1, take);
        } else if kind.is_file() && is_image(&entry.file_name().to_string_lossy()) {
            take(path);
        }
    }
}

/// Whether a file of this name may be one of ours, compressed or not.
fn is_image(name: &str) -> bool {
    name.strip_suffix(COMPRESSED).unwrap_or(name).ends_with(".fits")
}

/// A name in eight bytes: a folder may hold a million.
fn short(file: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    file.hash(&mut hasher);
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use std::fs::File;

    use config::Observatory;
    use config::header::HeaderTable;
    use contract::device::camera::Pixel;

    use super::*;
    use crate::card::Card;

    pub(super) const TWO_CAMERAS: &str =
        "[[camera]]\nname = \"blue\"\nserver = \"h:1\"\n[[camera]]\nname = \"red\"\nserver = \"h:2\"\n";

    /// Writes the file of a frame.
    fn write(path: &Path, id: &str) {
        let shape = Shape { pixel: Pixel::U16, width_px: 4, height_px: 2, planes: 1 };
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let mut file = crate::fits::FitsFile::create(path, &shape).unwrap();
        for (keyword, text) in [("FRAMEID", id), ("DATE-OBS", "2026-11-21T03:00:00.5"), ("INSTRUME", "red")] {
            file.set(&Card::new(keyword, text.into(), "")).unwrap();
        }
        file.write_pixels(&shape, &[7; 16]).unwrap();
        file.close().unwrap();
    }

    /// A folder of images with a database that knows none of its frames.
    async fn bare() -> (tempfile::TempDir, Observatory) {
        let folder = tempfile::tempdir().unwrap();
        let config = config::parse(&format!("{}{TWO_CAMERAS}", test_support::PARANAL), folder.path()).unwrap();
        let alerts = node::NodeAlerts::new(bus::Clock::machine_clock());
        let (database, writer) = Database::open(&config.archive.database, "callisto", alerts).unwrap();
        drop(database);
        writer.end().await;
        (folder, config)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn of_several_files_of_a_frame_the_first_whole_one_is_recorded() {
        let (_folder, config) = bare().await;
        let images = &config.folders.images;
        let names = ["20261121/a.fits", "20261121/a-half.fits", "20261121/a-whole.fits", "backup/20261121/a.fits"];
        for name in names {
            write(&images.join(name), "frame-1");
        }
        let cut = |name: &str, bytes| {
            File::options().write(true).open(images.join(name)).unwrap().set_len(bytes).unwrap();
        };
        let whole = fs::metadata(images.join(names[0])).unwrap().len();
        let files = || unknown(images, &config.archive.database, "callisto").unwrap();
        let recorded = || {
            let row = |found: Found, path: &Path| {
                found.row(&config, &HeaderTable::default(), CommandId("frame-1".to_owned()), path.to_owned())
            };
            let paths = files().remove(&CommandId("frame-1".to_owned())).unwrap();
            first_of(images, &paths, row).unwrap().map(|(image, _)| image.file)
        };
        assert_eq!(recorded().as_deref(), Some(names[0]));
        // The copy of a full disk ends behind the header, another one has no byte.
        cut(names[0], whole - 2880);
        cut(names[1], 0);
        assert_eq!(recorded().as_deref(), Some(names[2]));
        cut(names[2], whole - 2880);
        assert_eq!(recorded().as_deref(), Some(names[3]));
        cut(names[3], whole - 2880);
        assert_eq!(recorded(), None);
    }

    #[cfg(target_os = "linux")]
    #[tokio::test(flavor = "multi_thread")]
    async fn a_file_is_recorded_only_under_a_name_that_leads_back_to_it() {
        use std::os::unix::ffi::OsStrExt as _;
        let (_folder, config) = bare().await;
        let images = &config.folders.images;
        let name = |bytes: &'static [u8]| images.join(std::ffi::OsStr::from_bytes(bytes));
        let plain = images.join("plain.fits");
        write(&plain, "frame");
        let odd: [&[u8]; 4] = [b"with blanks/a b.fits", b"latin-\xe9.fits", b"old\xff/a.fits", b"two\nlines.fits"];
        for name in odd.map(name) {
            fs::create_dir_all(name.parent().unwrap()).unwrap();
            fs::copy(&plain, name).unwrap();
        }
        let found = unknown(images, &config.archive.database, "callisto").unwrap();
        assert_eq!(found[&CommandId("frame".to_owned())], [plain.clone(), images.join("with blanks/a b.fits")]);
    }
}
