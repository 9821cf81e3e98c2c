//! A destination: the few things that are asked of every one, whatever it is.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use anyhow::{Context as _, anyhow, ensure};
use config::{Delivery, Observatory};

use super::directory::Directory;
use super::item::{Holdings, Item, is_this_machine, taken};
use super::manifest::ManifestFile;
use super::record::work_folder;
use super::rsync::Rsync;
use super::store::ObjectBucket;

/// A folder that does not answer is given up after this, plus what its bytes take at this rate.
const TIMEOUT: Duration = Duration::from_secs(60);
const SLOWEST_BYTES_PER_S: u64 = 100_000;

/// Threads that work in folders at this moment. Each destination has one, and more only where shares do not answer.
static STUCK: AtomicUsize = AtomicUsize::new(0);
const MOST_STUCK: usize = 32;

/// A place to which files are copied.
#[derive(Debug)]
pub enum Destination {
    /// A folder.
    Directory(Directory),
    /// A folder that rsync reaches.
    Rsync(Rsync),
    /// A bucket of an object store.
    Bucket(Box<ObjectBucket>),
}

impl Destination {
    /// Makes what is needed to reach a destination; nothing is asked of it yet.
    ///
    /// # Errors
    /// A secret or the configuration cannot be used.
    pub async fn open(config: &Observatory, delivery: &Delivery) -> anyhow::Result<Arc<Self>> {
        let secret = notify::secret::secret(delivery.secret_file.as_deref(), delivery.secret_env.as_deref()).await?;
        let opened = match (&delivery.directory, &delivery.rsync, delivery.bucket()) {
            (Some(root), _, _) => {
                let mounted_apart_from = delivery.must_be_mounted.then(|| config.folders.images.clone());
                Self::Directory(Directory::new(root.clone(), mounted_apart_from))
            }
            (_, Some(place), _) => Self::Rsync(Rsync {
                place: place.clone(),
                ssh_config: delivery.ssh_config.clone(),
                password: secret,
                work: work_folder(config, delivery.name.as_str()),
            }),
            (_, _, Some(bucket)) => Self::Bucket(Box::new(ObjectBucket::new(&bucket, secret, true).await?)),
            _ => return Err(anyhow!("it has neither directory, rsync nor bucket")),
        };
        Ok(Arc::new(opened))
    }

    /// Proves that the destination can be reached.
    pub async fn check(self: &Arc<Self>) -> anyhow::Result<()> {
        match &**self {
            Self::Directory(directory) => {
                let directory = directory.clone();
                blocking(0, move || directory.check()).await
            }
            Self::Rsync(rsync) => rsync.check().await,
            // The first answer about the manifest shows it.
            Self::Bucket(_) => Ok(()),
        }
    }

    /// Reads files back, as they are there; `bytes` is their size, which limits the time that it may take.
    pub async fn held(self: &Arc<Self>, names: &[String], bytes: u64) -> anyhow::Result<Holdings> {
        match &**self {
            Self::Directory(directory) => {
                let (directory, names) = (directory.clone(), names.to_vec());
                blocking(bytes, move || {
                    let mut holdings = Holdings::new();
                    for name in names {
                        if let Some(held) = directory.held(&name)? {
                            holdings.insert(name, held);
                        }
                    }
                    Ok(holdings)
                })
                .await
            }
            Self::Rsync(rsync) => rsync.held(names, bytes).await,
            Self::Bucket(bucket) => {
                let mut holdings = Holdings::new();
                for name in names {
                    if let Some(held) = bucket.held(name).await? {
                        holdings.insert(name.clone(), held);
                    }
                }
                Ok(holdings)
            }
        }
    }

    /// The content of a small file that may be there.
    pub async fn read(self: &Arc<Self>, name: &str) -> anyhow::Result<Option<Vec<u8>>> {
        match &**self {
            Self::Directory(directory) => {
                let (directory, name) = (directory.clone(), name.to_owned());
                blocking(0, move || directory.read(&name)).await
            }
            Self::Rsync(rsync) => rsync.read(name).await,
            Self::Bucket(bucket) => bucket.read(name).await,
        }
    }

    /// Sends files to names that nothing has, and returns what was read back of each.
    pub async fn send(self: &Arc<Self>, items: &[Item]) -> anyhow::Result<Holdings> {
        match &**self {
            Self::Directory(directory) => {
                let mut holdings = Holdings::new();
                for item in items {
                    let (directory, sent) = (directory.clone(), item.clone());
                    let held = blocking(item.bytes * 2, move || directory.send(&sent)).await?;
                    holdings.insert(item.name.clone(), held);
                }
                Ok(holdings)
            }
            Self::Rsync(rsync) => rsync.send(items).await,
            Self::Bucket(bucket) => {
                let mut holdings = Holdings::new();
                for item in items {
                    let is_ours = bucket.send(item).await?;
                    if let Some(held) = bucket.held(&item.name).await? {
                        ensure!(is_ours || held.sha256 == item.sha256, "{}", taken(&item.name));
                        holdings.insert(item.name.clone(), held);
                    }
                }
                Ok(holdings)
            }
        }
    }

    /// Removes a file that was sent a moment ago and is not there as it was sent.
    pub async fn discard(self: &Arc<Self>, name: &str) -> anyhow::Result<()> {
        match &**self {
            // It never got its name.
            Self::Directory(_) => Ok(()),
            Self::Rsync(rsync) => rsync.discard(name).await,
            Self::Bucket(bucket) => bucket.discard(name).await,
        }
    }

    /// Proves, where that is cheap, that files which were read while a long try ran are still there: a disk may have
    /// been taken away meanwhile.
    ///
    /// # Errors
    /// A file is not there any more.
    pub async fn still_has(self: &Arc<Self>, files: &[ManifestFile]) -> anyhow::Result<()> {
        let Self::Directory(directory) = &**self else { return Ok(()) };
        let (directory, files) = (directory.clone(), files.to_vec());
        blocking(0, move || {
            for ManifestFile { name, bytes, .. } in &files {
                ensure!(directory.has(name, *bytes)?, "{name} was there and is not any more: look at the destination");
            }
            Ok(())
        })
        .await
    }

    /// Is it on the disk of the folder of images, as far as that can be known? Whatever is on this machine counts as
    /// being there, except a folder.
    pub async fn is_on_disk_of(&self, images: &Path) -> anyhow::Result<bool> {
        match self {
            Self::Directory(directory) => directory.is_on_disk_of(images),
            Self::Rsync(rsync) => rsync.is_here().await,
            Self::Bucket(bucket) => Ok(is_this_machine(bucket.host())),
        }
    }
}

/// Runs something that blocks, for a time that so many bytes may take.
async fn blocking<T: Send + 'static>(
    bytes: u64,
    work: impl FnOnce() -> anyhow::Result<T> + Send + 'static,
) -> anyhow::Result<T> {
    let most = TIMEOUT + Duration::from_secs(bytes / SLOWEST_BYTES_PER_S);
    ensure!(
        STUCK.load(Ordering::Relaxed) < MOST_STUCK,
        "{MOST_STUCK} earlier tries still wait for folders that do not answer: look at the shares and their network"
    );
    let (report, done) = tokio::sync::oneshot::channel();
    // A thread that a dead share holds for ever must not be one of those that frames are written by, and not keep the
    // process from ending.
    let thread = std::thread::Builder::new().name("destination".to_owned());
    let spawned = thread.spawn(move || {
        STUCK.fetch_add(1, Ordering::Relaxed);
        let result = work();
        STUCK.fetch_sub(1, Ordering::Relaxed);
        let _ = report.send(result);
    });
    spawned.context("no thread could be started")?;
    let done = tokio::time::timeout(most, done).await;
    let seconds = most.as_secs();
    done.with_context(|| format!("it did not answer within {seconds} s: look at the share and its network"))?
        .context("reading or writing the folder ended badly")?
}
