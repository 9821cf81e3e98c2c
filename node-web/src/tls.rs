//! TLS of the page: a certificate and its key from PEM files, read again when they have been renewed.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, SystemTime};

use config::Web;
use contract::observatory::AlertKind;
use node::NodeAlerts;
use rustls::ServerConfig;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::{ClientHello, ResolvesServerCert};
use rustls::sign::CertifiedKey;
use tokio_rustls::TlsAcceptor;

const LOOK_EVERY: Duration = Duration::from_secs(5);
/// Between the two files of a renewal, for a moment, they do not belong together.
const FAILED_BEFORE_ALERT: u32 = 2;
const KEY: &str = "web.certificate";

/// The certificate that is in use.
#[derive(Debug)]
struct Current(RwLock<Arc<CertifiedKey>>);

impl ResolvesServerCert for Current {
    fn resolve(&self, _: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        Some(self.0.read().unwrap_or_else(PoisonError::into_inner).clone())
    }
}

/// The files of the certificate, with when they were written.
#[derive(Debug, Clone)]
pub struct CertificateFiles {
    certificate: PathBuf,
    key: PathBuf,
}

type Written = [Option<SystemTime>; 2];

impl CertificateFiles {
    /// Those of the configuration; absent where the page is served without TLS.
    pub fn of(web: &Web) -> Option<Self> {
        Some(Self { certificate: web.certificate.clone()?, key: web.key.clone()? })
    }

    /// Reads both, and proves that they belong together.
    ///
    /// # Errors
    /// What is wrong with which file.
    pub fn read(&self) -> Result<CertifiedKey, String> {
        let wrong = |key: &str, file: &Path, why: String| format!("{key}: {}: {why}", file.display());
        let chain = CertificateDer::pem_file_iter(&self.certificate).and_then(Iterator::collect::<Result<Vec<_>, _>>);
        let chain = chain.map_err(|why| wrong(KEY, &self.certificate, format!("no certificate in PEM form: {why}")))?;
        if chain.is_empty() {
            return Err(wrong(
                KEY,
                &self.certificate,
                "expected a certificate in PEM form, and then those above it".into(),
            ));
        }
        let key = PrivateKeyDer::from_pem_file(&self.key);
        let key = key.map_err(|why| wrong("web.key", &self.key, format!("no private key in PEM form: {why}")))?;
        CertifiedKey::from_der(chain, key, &ring::default_provider()).map_err(|why| {
            wrong("web.key", &self.key, format!("is not the key of {}: {why}", self.certificate.display()))
        })
    }

    fn written(&self) -> Written {
        [&self.certificate, &self.key].map(|file| std::fs::metadata(file).and_then(|found| found.modified()).ok())
    }

    /// An acceptor with the certificate of now, and what follows its files for ever.
    ///
    /// # Errors
    /// What is wrong with which file.
    pub fn serve(self, alerts: NodeAlerts) -> Result<(TlsAcceptor, impl Future<Output = anyhow::Result<()>>), String> {
        let written = self.written();
        let current = Arc::new(Current(RwLock::new(Arc::new(self.read()?))));
        let versions = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions();
        let builder = versions.map_err(|why| format!("{KEY}: {why}"))?;
        let mut config = builder.with_no_client_auth().with_cert_resolver(current.clone());
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok((TlsAcceptor::from(Arc::new(config)), self.follow(current, written, alerts)))
    }

    async fn follow(self, current: Arc<Current>, mut read: Written, alerts: NodeAlerts) -> anyhow::Result<()> {
        let mut failed = 0;
        loop {
            tokio::time::sleep(LOOK_EVERY).await;
            let files = self.clone();
            let looked = tokio::task::spawn_blocking(move || {
                let written = files.written();
                (written != read || failed > 0).then(|| (written, files.read()))
            });
            match looked.await? {
                None => {}
                Some((written, Ok(renewed))) => {
                    *current.0.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(renewed);
                    (read, failed) = (written, 0);
                    alerts.clear(AlertKind::Configuration, KEY);
                    tracing::info!("the certificate of the page was read again");
                }
                Some((_, Err(why))) => {
                    failed += 1;
                    if failed >= FAILED_BEFORE_ALERT {
                        let why = format!("{why}; the certificate that was read before it is still in use");
                        alerts.raise(AlertKind::Configuration, KEY, &why);
                    }
                }
            }
        }
    }
}
