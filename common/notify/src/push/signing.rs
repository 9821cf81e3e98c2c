//! The proof of who sends a message, for the push service: VAPID, RFC 8292.

use anyhow::anyhow;
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ring::rand::SystemRandom;
use ring::signature::{ECDSA_P256_SHA256_FIXED_SIGNING, EcdsaKeyPair, KeyPair as _};
use serde_json::json;
use units::Utc;

/// A push service takes a proof of at most 24 h, and clocks differ.
const VALID_S: f64 = 12.0 * 3600.0;

/// The key of this server. A subscription takes messages that are signed with the key that it was made for.
pub struct SigningKey {
    pair: EcdsaKeyPair,
    /// As it is stored.
    document: String,
}

impl SigningKey {
    /// A new one.
    ///
    /// # Errors
    /// This host gives no random numbers.
    pub fn generate() -> anyhow::Result<Self> {
        let document = EcdsaKeyPair::generate_pkcs8(&ECDSA_P256_SHA256_FIXED_SIGNING, &SystemRandom::new());
        let document = document.map_err(|_| anyhow!("this host gives no random numbers"))?;
        Self::read(&URL_SAFE_NO_PAD.encode(document))
    }

    /// The stored one: PKCS#8, base64url.
    ///
    /// # Errors
    /// It is none.
    pub fn read(document: &str) -> anyhow::Result<Self> {
        let bytes = URL_SAFE_NO_PAD.decode(document)?;
        let pair = EcdsaKeyPair::from_pkcs8(&ECDSA_P256_SHA256_FIXED_SIGNING, &bytes, &SystemRandom::new());
        let pair = pair.map_err(|why| anyhow!("it is no private key of P-256: {why}"))?;
        Ok(Self { pair, document: document.to_owned() })
    }

    /// As it is stored.
    pub fn document(&self) -> &str {
        &self.document
    }

    /// What browsers subscribe with: the public key, base64url.
    pub fn public(&self) -> String {
        URL_SAFE_NO_PAD.encode(self.pair.public_key())
    }

    /// The header `Authorization` of a message to a push service; `contact` is whom it may ask about this server.
    ///
    /// # Errors
    /// This host gives no random numbers.
    pub fn authorization(&self, origin: &str, contact: &str, now: Utc) -> anyhow::Result<String> {
        let expires = now.plus_seconds(VALID_S).seconds() as u64;
        let claims = json!({ "aud": origin, "exp": expires, "sub": contact });
        let part = |value: &serde_json::Value| URL_SAFE_NO_PAD.encode(value.to_string());
        let signed = format!("{}.{}", part(&json!({ "typ": "JWT", "alg": "ES256" })), part(&claims));
        let signature = self.pair.sign(&SystemRandom::new(), signed.as_bytes());
        let signature = signature.map_err(|_| anyhow!("this host gives no random numbers"))?;
        Ok(format!("vapid t={signed}.{}, k={}", URL_SAFE_NO_PAD.encode(signature), self.public()))
    }
}

#[cfg(test)]
mod tests {
    use ring::signature::{ECDSA_P256_SHA256_FIXED, UnparsedPublicKey};

    use super::*;

    #[test]
    fn a_proof_is_signed_by_the_key_that_it_names_also_after_it_was_stored() {
        let key = SigningKey::generate().unwrap();
        let key = SigningKey::read(key.document()).unwrap();
        let now = Utc::from_seconds(1_800_000_000.0);
        let header = key.authorization("https://push.example.net", "https://t.example", now).unwrap();
        let (token, named) = header.strip_prefix("vapid t=").unwrap().split_once(", k=").unwrap();
        assert_eq!(named, key.public());
        let (signed, signature) = token.rsplit_once('.').unwrap();
        let bytes = |text: &str| URL_SAFE_NO_PAD.decode(text).unwrap();
        let public = UnparsedPublicKey::new(&ECDSA_P256_SHA256_FIXED, bytes(named));
        public.verify(signed.as_bytes(), &bytes(signature)).unwrap();
        let parts: Vec<String> = signed.split('.').map(|part| String::from_utf8(bytes(part)).unwrap()).collect();
        assert_eq!(parts[0], r#"{"typ":"JWT","alg":"ES256"}"#);
        assert_eq!(parts[1], r#"{"aud":"https://push.example.net","exp":1800043200,"sub":"https://t.example"}"#);
        assert!(SigningKey::read("nonsense").is_err());
    }
}
