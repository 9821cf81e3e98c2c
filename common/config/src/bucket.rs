//! A bucket of an S3-compatible object store, of `[[delivery]]` and `[archive] parquet`.

use std::path::PathBuf;

use serde::Deserialize;

/// Where a bucket is, and who may use it.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bucket {
    /// Its name.
    pub bucket: String,
    /// Address of the object store; that of AWS where absent.
    pub endpoint: Option<String>,
    /// Region of the bucket.
    #[serde(default = "first_region")]
    pub region: String,
    /// Keys of objects begin so.
    #[serde(default)]
    pub prefix: String,
    /// Id of the access key.
    pub access_key: Option<String>,
    /// File that holds the secret access key.
    pub secret_file: Option<PathBuf>,
    /// Environment variable that holds it.
    pub secret_env: Option<String>,
}

/// The region where none is named.
pub(crate) fn first_region() -> String {
    "us-east-1".to_owned()
}

impl Bucket {
    /// What does not hold, with the key it is about.
    pub(crate) fn faults(&self) -> Vec<(&'static str, String)> {
        let mut found = Vec::new();
        let bucket = &self.bucket;
        if bucket.is_empty() || bucket.contains(|c: char| !c.is_ascii_alphanumeric() && !"-._".contains(c)) {
            found.push(("bucket", format!("bucket = {bucket:?}: expected the name of a bucket, such as \"nights\"")));
        }
        if self.access_key.is_none() || (self.secret_file.is_none() && self.secret_env.is_none()) {
            found.push(("bucket", "a bucket needs access_key, and secret_file or secret_env".to_owned()));
        }
        if self.secret_file.is_some() && self.secret_env.is_some() {
            found.push(("secret_env", ONE_SECRET.to_owned()));
        }
        if let Some(url) = &self.endpoint {
            found.extend(endpoint_fault(url));
        }
        found
    }
}

/// Two places of one secret.
pub(crate) const ONE_SECRET: &str = "expected one of secret_file and secret_env, not both";

/// What is wrong with the address of a store.
pub(crate) fn endpoint_fault(url: &str) -> Option<(&'static str, String)> {
    let host = url.strip_prefix("https://").or_else(|| url.strip_prefix("http://"));
    // It is not quoted: what stands before an @ may be a password.
    let is_wrong = host.is_none_or(|host| host.is_empty() || host.contains(['@', ' ']));
    is_wrong.then(|| ("endpoint", "endpoint: expected https://host or http://host:port, without a password".to_owned()))
}
