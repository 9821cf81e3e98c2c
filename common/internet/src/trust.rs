//! Which certificates are accepted, and what to do about one that is not.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, ensure};
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject as _;
use rustls::{CertificateError, ClientConfig, RootCertStore};

/// TLS by rustls and ring, which accepts the host's own authorities and those of `ca_file`, which is read anew each
/// time.
///
/// # Errors
///
/// The file cannot be read, holds no certificate, or one that is no authority's; or there is no certificate at all.
pub async fn tls(ca_file: Option<&Path>) -> anyhow::Result<ClientConfig> {
    let ca_file = ca_file.map(Path::to_owned);
    let roots =
        tokio::task::spawn_blocking(|| roots(ca_file)).await.context("reading certificates was cut short")??;
    believing(roots)
}

/// TLS that accepts no authority, for receivers that are reached without it.
pub fn nobody() -> anyhow::Result<ClientConfig> {
    believing(RootCertStore::empty())
}

fn believing(roots: RootCertStore) -> anyhow::Result<ClientConfig> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions()?;
    Ok(config.with_root_certificates(roots).with_no_client_auth())
}

fn roots(ca_file: Option<PathBuf>) -> anyhow::Result<RootCertStore> {
    let mut roots = RootCertStore::empty();
    // One unreadable certificate of a hundred must not block all receivers.
    roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
    for certificate in ca_file.as_deref().map(own).transpose()?.into_iter().flatten() {
        roots.add(certificate).context("alerts.ca_file: a certificate in it cannot be used")?;
    }
    ensure!(!roots.is_empty(), "this host has no root certificates: install the package ca-certificates");
    Ok(roots)
}

/// The certificates of the site's own authorities.
pub fn own(ca_file: &Path) -> anyhow::Result<Vec<CertificateDer<'static>>> {
    let shown = ca_file.display();
    let pem = std::fs::read(ca_file).with_context(|| format!("alerts.ca_file: {shown} cannot be read"))?;
    let certificates: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&pem).collect();
    let certificates = certificates.with_context(|| format!("alerts.ca_file: {shown} is no PEM file"))?;
    ensure!(!certificates.is_empty(), "alerts.ca_file: {shown} holds no certificate: expected PEM");
    Ok(certificates)
}

/// The reason why TLS refused, and what to do; nothing where the error is about something else.
pub fn explain(error: &(dyn std::error::Error + 'static)) -> Option<String> {
    use CertificateError::{BadSignature, Expired, ExpiredContext, NotValidForName, NotValidForNameContext};
    use CertificateError::{NotValidYet, NotValidYetContext, UnknownIssuer};
    let refused = match refusal(error)? {
        rustls::Error::InvalidCertificate(refused) => refused,
        // A server that speaks HTTP or SMTP where TLS was expected.
        rustls::Error::InvalidMessage(_) => {
            return Some("it does not speak TLS on this port: look at the port and at http or https".to_owned());
        }
        rustls::Error::NoCertificatesPresented => return Some("it shows no certificate".to_owned()),
        other => return Some(format!("TLS: {other}")),
    };
    Some(match refused {
        UnknownIssuer => "its certificate is of an authority that this host does not know: have the host trust it, \
            or name the authority's certificate in alerts.ca_file, which holds for alerts"
            .to_owned(),
        BadSignature => {
            "its certificate is not signed by the authority that this host knows under that name: name the \
            authority's present certificate in alerts.ca_file"
                .to_owned()
        }
        Expired | ExpiredContext { .. } => {
            "its certificate has expired: have it renewed, or look at the clock of this host".to_owned()
        }
        NotValidYet | NotValidYetContext { .. } => {
            "its certificate is not valid yet: look at the clock of this host".to_owned()
        }
        NotValidForName | NotValidForNameContext { .. } => {
            format!("its certificate is for another host: write its name as the certificate has it ({refused})")
        }
        other => format!("its certificate is refused ({other}): it needs one that an authority signed for this host"),
    })
}

/// The TLS error at the bottom; an `io::Error` leaves its content out of its chain.
fn refusal<'a>(error: &'a (dyn std::error::Error + 'static)) -> Option<&'a rustls::Error> {
    if let Some(refusal) = error.downcast_ref::<rustls::Error>() {
        return Some(refusal);
    }
    let held = error.downcast_ref::<std::io::Error>().and_then(std::io::Error::get_ref);
    let held = held.map(|held| held as &(dyn std::error::Error + 'static));
    refusal(held.or_else(|| error.source())?)
}
