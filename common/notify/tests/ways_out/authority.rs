//! A certificate authority of one test.

use std::sync::Arc;

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, DnType, IsCa, KeyPair, date_time_ymd};
use rustls::ServerConfig;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};

pub struct Authority {
    issuer: CertifiedIssuer<'static, KeyPair>,
}

impl Authority {
    pub fn new(name: &str) -> Self {
        let mut params = CertificateParams::default();
        params.distinguished_name.push(DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        Self { issuer: CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap() }
    }

    /// The authority in the form of a CA file.
    pub fn pem(&self) -> String {
        self.issuer.pem()
    }

    /// A server whose certificate this authority signed for these hosts.
    pub fn server(&self, hosts: &[&str]) -> Arc<ServerConfig> {
        self.signed(CertificateParams::new(names(hosts)).unwrap())
    }

    /// A server whose certificate was valid until 2020.
    pub fn expired_server(&self, hosts: &[&str]) -> Arc<ServerConfig> {
        let mut params = CertificateParams::new(names(hosts)).unwrap();
        (params.not_before, params.not_after) = (date_time_ymd(2019, 1, 1), date_time_ymd(2020, 1, 1));
        self.signed(params)
    }

    /// A server that shows the authority's own certificate, as a quick `openssl req -x509` makes them.
    pub fn server_of_itself(&self) -> Arc<ServerConfig> {
        config(self.issuer.der().clone(), self.issuer.key())
    }

    fn signed(&self, params: CertificateParams) -> Arc<ServerConfig> {
        let key = KeyPair::generate().unwrap();
        config(params.signed_by(&key, &self.issuer).unwrap().der().clone(), &key)
    }
}

fn names(hosts: &[&str]) -> Vec<String> {
    hosts.iter().map(|host| (*host).to_owned()).collect()
}

fn config(certificate: CertificateDer<'static>, key: &KeyPair) -> Arc<ServerConfig> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
    let key = PrivateKeyDer::Pkcs8(key.serialize_der().into());
    Arc::new(builder.with_no_client_auth().with_single_cert(vec![certificate], key).unwrap())
}
