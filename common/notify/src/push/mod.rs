//! Web Push: messages to browsers that have subscribed (RFC 8030). Each is encrypted for its browser ([`encryption`]) and signed with the key
//! of this server ([`signing`]), so that the push service of the browser's maker sees neither its content nor can anybody else send one.

mod encryption;
mod endpoint;
mod signing;
mod subscriptions;

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use contract::observatory::Priority;
use ring::digest::{SHA256, digest};
use serde::{Deserialize, Serialize};
use units::Utc;

pub use subscriptions::{NotTaken, Refused, Subscriptions};

use self::endpoint::Endpoint;

/// A browser that has subscribed.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
pub struct Subscription {
    /// Whose it is.
    pub user: String,
    /// How its user calls the device.
    pub device: String,
    /// The address at the push service; whoever has it and the key of this server can send to the browser.
    pub endpoint: String,
    /// The browser's public key, base64url.
    pub p256dh: String,
    /// A secret that the browser shares with this server, base64url.
    pub auth: String,
    /// Nothing less urgent than this.
    pub min_priority: Priority,
    /// Only what nobody has acknowledged for so many minutes, machine time.
    pub after_min: f64,
    /// When it was made, by the host's clock.
    pub since_utc: Utc,
}

impl Subscription {
    /// A name for the endpoint, which can be shown: the first 16 hexadecimal digits of its SHA-256.
    pub fn id(&self) -> String {
        digest(&SHA256, self.endpoint.as_bytes()).as_ref().iter().take(8).map(|byte| format!("{byte:02x}")).collect()
    }

    /// Its name as a receiver of alerts.
    pub fn receiver(&self) -> String {
        format!("push/{}/{}", self.user, self.id())
    }

    /// A message for this browser alone.
    fn encrypt(&self, text: &[u8]) -> anyhow::Result<Vec<u8>> {
        let key = |text: &str| URL_SAFE_NO_PAD.decode(text.trim_end_matches('=')).unwrap_or_default();
        encryption::encrypt(text, &key(&self.p256dh), &key(&self.auth))
    }

    /// What replaces an earlier message that has not reached the browser yet: nobody else can tell which alert it is about.
    fn topic(&self, tag: &str) -> String {
        let hash = digest(&SHA256, format!("{} {tag}", self.auth).as_bytes());
        URL_SAFE_NO_PAD.encode(&hash.as_ref()[..24])
    }
}
