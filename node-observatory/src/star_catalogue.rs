//! The star catalogue of this telescope, opened once and read by all code that looks at the sky.
//!
//! A large table may take a while to open, so a thread does it while the node already judges and closes. One that
//! cannot be opened is reported and tried again: the night goes on without it.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use catalogue::{Catalogue, Reading};
use contract::observatory::AlertKind;
use node::Node;
use tokio::sync::watch;

/// A catalogue that cannot be opened is tried again after this.
const AGAIN: Duration = Duration::from_secs(60);

/// The catalogue, as soon as it is open.
#[derive(Debug)]
pub struct StarCatalogue {
    opened: watch::Sender<Option<Arc<Catalogue>>>,
}

impl Default for StarCatalogue {
    fn default() -> Self {
        Self { opened: watch::channel(None).0 }
    }
}

impl StarCatalogue {
    /// The catalogue; `None` until it is open, and for as long as it cannot be opened.
    pub fn get(&self) -> Option<Arc<Catalogue>> {
        self.opened.borrow().clone()
    }

    /// Waits until it is open. It has no timeout: the caller sets one.
    pub async fn opened(&self) -> Arc<Catalogue> {
        let mut opened = self.opened.subscribe();
        loop {
            let now = opened.borrow_and_update().clone();
            if let Some(catalogue) = now {
                return catalogue;
            }
            // The sender lives in self, so waiting cannot fail.
            let _ = opened.changed().await;
        }
    }
}

/// Opens the catalogue that the configuration names, or the one that is shipped.
pub fn open(config: &config::Imaging) -> anyhow::Result<Catalogue> {
    match &config.catalogue {
        None => Ok(Catalogue::of_program()),
        Some(file) => Catalogue::open(file, &Reading::default())
            .with_context(|| format!("the star catalogue {} of [imaging] cannot be opened", file.display())),
    }
}

/// Opens it, again and again until that succeeds.
pub async fn keep_open(node: Node, catalogue: Arc<StarCatalogue>) -> anyhow::Result<()> {
    loop {
        let config = node.config.imaging.clone();
        match tokio::task::spawn_blocking(move || open(&config)).await? {
            Ok(opened) => {
                node.alerts.clear(AlertKind::CatalogueUnusable, "");
                tracing::info!(stars = opened.stars(), "the star catalogue is open");
                catalogue.opened.send_replace(Some(Arc::new(opened)));
                // It stays open for as long as the node lives.
                return std::future::pending().await;
            }
            Err(error) => node.alerts.raise(AlertKind::CatalogueUnusable, "", &format!("{error:#}")),
        }
        tokio::time::sleep(AGAIN).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn who_waits_for_the_catalogue_gets_it_when_it_is_open() {
        let room = Arc::new(StarCatalogue::default());
        assert!(room.get().is_none());
        let asked = room.clone();
        let waiting = tokio::spawn(async move { asked.opened().await.stars() });
        tokio::task::yield_now().await;
        room.opened.send_replace(Some(Arc::new(open(&config::Imaging::default()).unwrap())));
        assert!(waiting.await.unwrap().is_some_and(|stars| stars > 1_000_000));
        assert!(room.get().is_some());
    }

    #[test]
    fn a_file_that_is_no_catalogue_is_named_in_the_error() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("stars.smcat");
        let config = config::Imaging { catalogue: Some(file.clone()), ..Default::default() };
        let error = format!("{:#}", open(&config).unwrap_err());
        assert!(error.contains("stars.smcat of [imaging] cannot be opened"), "{error}");
        std::fs::write(&file, "no catalogue").unwrap();
        assert!(open(&config).is_err());
    }
}
