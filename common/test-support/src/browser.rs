//! A browser that has subscribed to Web Push, as RFC 8291 describes it.

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ring::aead::{AES_128_GCM, Aad, LessSafeKey, Nonce, UnboundKey};
use ring::agreement::{ECDH_P256, EphemeralPrivateKey, UnparsedPublicKey, agree_ephemeral};
use ring::hmac::{HMAC_SHA256, Key, sign};
use ring::rand::SystemRandom;

/// The keys of one browser. It reads one message: ring's private keys agree on one secret.
pub struct Browser {
    key: EphemeralPrivateKey,
    public: Vec<u8>,
    auth: [u8; 16],
}

impl Default for Browser {
    fn default() -> Self {
        Self::new()
    }
}

impl Browser {
    /// With new keys.
    pub fn new() -> Self {
        let key = EphemeralPrivateKey::generate(&ECDH_P256, &SystemRandom::new()).unwrap();
        let public = key.compute_public_key().unwrap().as_ref().to_vec();
        let auth = ring::rand::generate(&SystemRandom::new()).unwrap().expose();
        Self { key, public, auth }
    }

    /// Its public key.
    pub fn public(&self) -> &[u8] {
        &self.public
    }

    /// The secret that it shares with the server.
    pub fn auth(&self) -> &[u8] {
        &self.auth
    }

    /// `p256dh` and `auth` of its subscription.
    pub fn keys(&self) -> [String; 2] {
        [self.public(), self.auth()].map(|bytes| URL_SAFE_NO_PAD.encode(bytes))
    }

    /// The text of a message, if it is for this browser and whole.
    pub fn read(self, body: &[u8]) -> Option<String> {
        let (salt, rest) = body.split_at_checked(16)?;
        let (_, rest) = rest.split_at_checked(4)?;
        let (length, rest) = rest.split_first()?;
        let (server, sealed) = rest.split_at_checked(usize::from(*length))?;
        let hmac = |key: &[u8], text: &[u8]| sign(&Key::new(HMAC_SHA256, key), text).as_ref().to_vec();
        let shared = agree_ephemeral(self.key, &UnparsedPublicKey::new(&ECDH_P256, server), <[u8]>::to_vec).ok()?;
        // Section 3.4 of the RFC, line by line.
        let info = [&b"WebPush: info\0"[..], &self.public, server, &[1]].concat();
        let prk = hmac(salt, &hmac(&hmac(&self.auth, &shared), &info));
        let key = hmac(&prk, b"Content-Encoding: aes128gcm\0\x01");
        let nonce = hmac(&prk, b"Content-Encoding: nonce\0\x01");
        let key = LessSafeKey::new(UnboundKey::new(&AES_128_GCM, &key[..16]).unwrap());
        let nonce = Nonce::try_assume_unique_for_key(&nonce[..12]).unwrap();
        let mut sealed = sealed.to_vec();
        let text = key.open_in_place(nonce, Aad::empty(), &mut sealed).ok()?;
        String::from_utf8(text.strip_suffix(&[2])?.to_vec()).ok()
    }
}
