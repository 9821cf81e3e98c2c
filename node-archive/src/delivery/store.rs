//! A destination that is a bucket of an S3-compatible object store.
//!
//! An object appears whole or not at all, and only where nothing has its name. It is read back whole: the hash that a
//! store reports is of what it received.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context as _, anyhow, ensure};
use config::Bucket;
use futures_util::TryStreamExt as _;
use futures_util::stream::BoxStream;
use object_store::aws::{AmazonS3, AmazonS3Builder};
use object_store::path::Path as Key;
use object_store::{
    Attributes, BackoffConfig, Error as StoreError, ObjectStore, ObjectStoreExt as _, PutMode, PutMultipartOptions,
    PutOptions, PutPayload, RetryConfig, UpdateVersion, WriteMultipart,
};
use sha2::{Digest as _, Sha256};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

use super::hash::hex;
use super::item::{Item, MOST_BYTES, short_text, too_large};
use super::manifest::Held;
use super::store_http::Connector;

/// Larger files are sent in parts, so that none is in memory whole.
const WHOLE_BYTES: u64 = 64 << 20;
const PART_BYTES: usize = 16 << 20;
/// An answer that brings nothing for so long is given up.
const SILENT: Duration = Duration::from_secs(if cfg!(test) { 2 } else { 60 });
/// Requests are repeated for so long before the delivery itself waits.
const RETRY: Duration = Duration::from_secs(30);

/// A bucket.
#[derive(Debug)]
pub struct ObjectBucket {
    store: AmazonS3,
    prefix: String,
    description: String,
    url: String,
    /// The last request with a condition was answered by "not implemented".
    has_no_conditions: Arc<AtomicBool>,
}

impl ObjectBucket {
    /// A client for a bucket, which never replaces an object where it is `create_only`; nothing is asked of it yet.
    pub async fn new(place: &Bucket, secret: Option<String>, create_only: bool) -> anyhow::Result<Self> {
        let bucket = &place.bucket;
        let (access_key, secret) = place
            .access_key
            .clone()
            .zip(secret)
            .ok_or_else(|| anyhow!("the bucket {bucket} needs access_key, and secret_file or secret_env"))?;
        let endpoint = place.endpoint.clone();
        let url = endpoint.clone().unwrap_or_else(|| format!("https://s3.{}.amazonaws.com", place.region));
        let client = internet::Client::new(&url, None).await?;
        let retry = RetryConfig { backoff: BackoffConfig::default(), max_retries: 3, retry_timeout: RETRY };
        // From its parts alone: nothing of the environment decides where a night goes.
        let has_no_conditions = Arc::new(AtomicBool::new(false));
        let mut builder = AmazonS3Builder::new()
            .with_bucket_name(bucket)
            .with_region(&place.region)
            .with_access_key_id(access_key)
            .with_secret_access_key(secret)
            .with_allow_http(true)
            .with_retry(retry)
            .with_http_connector(Connector { client, create_only, has_no_conditions: has_no_conditions.clone() });
        if let Some(endpoint) = &endpoint {
            builder = builder.with_endpoint(endpoint.trim_end_matches('/'));
        }
        let description = format!("the bucket {bucket} at {url}");
        let store = builder.build().with_context(|| format!("{description} cannot be used"))?;
        let prefix = place.prefix.trim_matches('/').to_owned();
        let prefix = if prefix.is_empty() { prefix } else { format!("{prefix}/") };
        Ok(Self { store, prefix, description, url, has_no_conditions })
    }

    /// The host that serves it, without its port.
    pub fn host(&self) -> &str {
        let rest = self.url.split_once("://").map_or(self.url.as_str(), |(_, rest)| rest);
        let host = rest.split('/').next().unwrap_or_default();
        match host.rsplit_once(':') {
            Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name.trim_matches(['[', ']']),
            _ => host.trim_matches(['[', ']']),
        }
    }

    fn key(&self, name: &str) -> anyhow::Result<Key> {
        Key::parse(format!("{}{name}", self.prefix))
            .with_context(|| format!("{name:?} cannot be the name of an object: change the template of its file name"))
    }

    /// Reads an object back, whole.
    pub async fn held(&self, name: &str) -> anyhow::Result<Option<Held>> {
        let answer = match self.store.get(&self.key(name)?).await {
            Ok(answer) => answer,
            Err(error) => return self.absent(error, name),
        };
        let (mut stream, mut hasher, mut bytes) = (answer.into_stream(), Sha256::new(), 0);
        while let Some(piece) = self.next_piece(&mut stream, name).await? {
            hasher.update(&piece);
            bytes += piece.len() as u64;
        }
        Ok(Some(Held { bytes, sha256: hex(&hasher.finalize()) }))
    }

    async fn next_piece(
        &self,
        stream: &mut BoxStream<'static, object_store::Result<bytes::Bytes>>,
        name: &str,
    ) -> anyhow::Result<Option<bytes::Bytes>> {
        let silent =
            || format!("{} sent nothing of {name} for {} s: look at the network", self.description, SILENT.as_secs());
        let next = tokio::time::timeout(SILENT, stream.try_next()).await.with_context(silent)?;
        next.map_err(|error| self.failed(&error, "read", name))
    }

    /// The content of a small object.
    pub async fn read(&self, name: &str) -> anyhow::Result<Option<Vec<u8>>> {
        let answer = match self.store.get(&self.key(name)?).await {
            Ok(answer) => answer,
            Err(error) => return self.absent(error, name),
        };
        let (mut stream, mut content) = (answer.into_stream(), Vec::new());
        while let Some(piece) = self.next_piece(&mut stream, name).await? {
            content.extend_from_slice(&piece);
            ensure!(content.len() as u64 <= MOST_BYTES, "{}", too_large(name));
        }
        Ok(Some(content))
    }

    /// Puts a file where nothing has its name; returns whether nothing had it.
    pub async fn send(&self, item: &Item) -> anyhow::Result<bool> {
        self.put(item, PutMode::Create).await
    }

    async fn put(&self, item: &Item, mode: PutMode) -> anyhow::Result<bool> {
        let key = self.key(&item.name)?;
        let is_new = matches!(mode, PutMode::Create);
        if item.bytes > WHOLE_BYTES {
            return self.send_parts(item, &key, is_new).await;
        }
        let bytes = tokio::fs::read(&item.file).await;
        let bytes = bytes.with_context(|| format!("cannot read {}", item.file.display()))?;
        let payload = PutPayload::from(bytes);
        let options = PutOptions { mode, attributes: Attributes::new(), ..PutOptions::default() };
        match self.store.put_opts(&key, payload.clone(), options).await {
            Ok(_) => Ok(true),
            // Somebody else's, or the first of two tries, which arrived without an answer: what is there shows it.
            Err(StoreError::AlreadyExists { .. } | StoreError::Precondition { .. }) => Ok(false),
            // A store without conditions: what was seen a moment ago is looked at again.
            Err(_) if self.has_no_conditions.swap(false, Ordering::Relaxed) => {
                if is_new && self.has(&key, &item.name).await? {
                    return Ok(false);
                }
                let put = self.store.put(&key, payload).await;
                put.map(|_| true).map_err(|error| self.failed(&error, "write", &item.name))
            }
            Err(error) => Err(self.failed(&error, "write", &item.name)),
        }
    }

    async fn has(&self, key: &Key, name: &str) -> anyhow::Result<bool> {
        match self.store.head(key).await {
            Ok(_) => Ok(true),
            Err(error) => self.absent(error, name).map(|none: Option<()>| none.is_some()),
        }
    }

    /// Puts a large file in parts, which become an object when the last one has arrived; returns whether nothing had the
    /// name, where that is asked for.
    async fn send_parts(&self, item: &Item, key: &Key, is_new: bool) -> anyhow::Result<bool> {
        let failed = |error: StoreError| self.failed(&error, "write", &item.name);
        let mut file =
            tokio::fs::File::open(&item.file).await.with_context(|| format!("cannot open {}", item.file.display()))?;
        let upload = self.store.put_multipart_opts(key, PutMultipartOptions::default()).await.map_err(failed)?;
        let mut parts = WriteMultipart::new_with_chunk_size(upload, PART_BYTES);
        let mut chunk = vec![0; 1 << 20];
        loop {
            let read = match file.read(&mut chunk).await {
                Ok(0) => break,
                Ok(read) => read,
                Err(error) => {
                    let _ = parts.abort().await;
                    return Err(error).with_context(|| format!("cannot read {}", item.file.display()));
                }
            };
            if let Err(error) = parts.wait_for_capacity(2).await {
                let _ = parts.abort().await;
                return Err(failed(error));
            }
            parts.write(&chunk[..read]);
        }
        // Of a store that knows no conditions here; the others are asked by a header of the last request.
        if is_new && self.has(key, &item.name).await? {
            let _ = parts.abort().await;
            return Ok(false);
        }
        match parts.finish().await {
            Ok(_) => Ok(true),
            Err(StoreError::AlreadyExists { .. } | StoreError::Precondition { .. }) if is_new => Ok(false),
            Err(error) => Err(failed(error)),
        }
    }

    /// The names of all objects below a folder of the bucket.
    pub async fn list(&self, folder: &str) -> anyhow::Result<Vec<String>> {
        let mut found = Vec::new();
        let mut entries = self.store.list(Some(&self.key(folder)?));
        while let Some(entry) = entries.try_next().await.map_err(|error| self.failed(&error, "list", folder))? {
            let key = entry.location.to_string();
            found.extend(key.strip_prefix(&self.prefix).map(str::to_owned));
        }
        Ok(found)
    }

    /// Writes an object that may be there into a file; returns its version, where it is there.
    pub async fn fetch(&self, name: &str, to: &Path) -> anyhow::Result<Option<UpdateVersion>> {
        let answer = match self.store.get(&self.key(name)?).await {
            Ok(answer) => answer,
            Err(error) => return self.absent(error, name),
        };
        let version = UpdateVersion { e_tag: answer.meta.e_tag.clone(), version: answer.meta.version.clone() };
        let cannot = || format!("cannot write {}", to.display());
        let mut file = tokio::fs::File::create(to).await.with_context(cannot)?;
        let mut stream = answer.into_stream();
        while let Some(piece) = self.next_piece(&mut stream, name).await? {
            file.write_all(&piece).await.with_context(cannot)?;
        }
        file.flush().await.with_context(cannot)?;
        Ok(Some(version))
    }

    /// Puts a file in the place of the version that is there, or where nothing has its name, and reads it back.
    pub async fn replace(&self, item: &Item, version: Option<UpdateVersion>) -> anyhow::Result<()> {
        let mode = version.map_or(PutMode::Create, PutMode::Update);
        ensure!(
            self.put(item, mode).await?,
            "{} has another {} than a moment ago, and it was not replaced: another archive of this telescope writes there. \
             Stop one of them",
            self.description,
            item.name
        );
        let held = self.held(&item.name).await?;
        ensure!(
            held.is_some_and(|held| held.sha256 == item.sha256),
            "{} took {} without an error, and gives back other bytes: look at the store and the network",
            self.description,
            item.name
        );
        Ok(())
    }

    /// Removes an object.
    pub async fn discard(&self, name: &str) -> anyhow::Result<()> {
        self.store.delete(&self.key(name)?).await.map_err(|error| self.failed(&error, "remove", name))
    }

    /// An object that is not there is no failure.
    fn absent<T>(&self, error: StoreError, name: &str) -> anyhow::Result<Option<T>> {
        match error {
            // A bucket that does not exist is "not found" too.
            StoreError::NotFound { .. } if !format!("{error:?}").contains("NoSuchBucket") => Ok(None),
            error => Err(self.failed(&error, "read", name)),
        }
    }

    fn failed(&self, error: &StoreError, verb: &str, name: &str) -> anyhow::Error {
        let advice = match error {
            StoreError::PermissionDenied { .. } | StoreError::Unauthenticated { .. } => {
                "look at access_key, the secret, and what this key may do"
            }
            _ if format!("{error:?}").contains("NoSuchBucket") => "make the bucket, or mend its name",
            _ => "look at the store, its room and the network",
        };
        anyhow!("{} did not {verb} {name}: {}; {advice}", self.description, short_text(&error.to_string()))
    }
}
