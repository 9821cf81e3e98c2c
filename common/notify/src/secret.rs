//! Reads passwords and tokens, and warns if other users can read their files.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use anyhow::Context as _;

/// A secret from its file or its environment variable, read anew each time: it may have been renewed.
pub async fn secret(file: Option<&Path>, variable: Option<&str>) -> anyhow::Result<Option<String>> {
    let text = match (file, variable) {
        (Some(file), _) => {
            warn_if_open(file);
            let read = tokio::fs::read_to_string(file).await;
            read.with_context(|| format!("the secret file {} cannot be read", file.display()))?
        }
        (None, Some(variable)) => {
            std::env::var(variable).with_context(|| format!("the environment variable {variable} holds no secret"))?
        }
        (None, None) => return Ok(None),
    };
    Ok(Some(text.trim().to_owned()))
}

/// Logs once that other users of this host can read a secret file.
fn warn_if_open(file: &Path) {
    static REPORTED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    if node::private::is_open_to_others(file)
        && REPORTED.lock().unwrap_or_else(PoisonError::into_inner).insert(file.to_owned())
    {
        let file = file.display();
        tracing::warn!(%file, "other users of this host can read a file with a secret: chmod 600 {file}");
    }
}
