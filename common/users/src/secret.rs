//! Random secrets: shown once, stored as their SHA-256.

use std::fmt;

use sha2::{Digest as _, Sha256};

/// 256 random bits as text. It is written only where somebody asks for [`Secret::reveal`].
pub struct Secret(String);

/// The system gives no random numbers; nothing can be made that nobody may guess.
#[derive(Debug, thiserror::Error)]
#[error("the system gives no random numbers: {0}")]
pub struct NoRandomness(getrandom::Error);

impl Secret {
    /// A fresh one, after a text by which programs that look for leaked secrets know it.
    ///
    /// # Errors
    /// The system gives no random numbers.
    pub fn fresh(prefix: &str) -> Result<Self, NoRandomness> {
        Ok(Self(format!("{prefix}{}", hex(&random::<32>()?))))
    }

    /// The text itself, for the one who may have it.
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// What is stored of it.
    pub fn hash(&self) -> SecretHash {
        SecretHash::of(&self.0)
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(...)")
    }
}

/// The SHA-256 of a secret. A secret of 256 random bits cannot be guessed from it, and how long a comparison takes
/// shows nothing of the secret.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SecretHash([u8; 32]);

impl SecretHash {
    /// The hash of a text that is presented.
    pub fn of(text: &str) -> Self {
        Self(Sha256::digest(text.as_bytes()).into())
    }

    pub(crate) fn parse(text: &str) -> Option<Self> {
        let digits = text.as_bytes();
        let mut bytes = [0; 32];
        if digits.len() != 64 || !digits.iter().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(b)) {
            return None;
        }
        for (byte, at) in bytes.iter_mut().zip((0..64).step_by(2)) {
            *byte = u8::from_str_radix(text.get(at..at + 2)?, 16).ok()?;
        }
        Some(Self(bytes))
    }
}

impl fmt::Display for SecretHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&hex(&self.0))
    }
}

impl fmt::Debug for SecretHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SecretHash(...)")
    }
}

/// Random bytes of the system.
pub(crate) fn random<const N: usize>() -> Result<[u8; N], NoRandomness> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(NoRandomness)?;
    Ok(bytes)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_is_never_shown_by_itself_and_no_two_are_alike() {
        let (one, two) = (Secret::fresh("starmesh_").unwrap(), Secret::fresh("starmesh_").unwrap());
        assert_ne!(one.reveal(), two.reveal());
        assert_eq!(one.reveal().len(), "starmesh_".len() + 64);
        assert!(!format!("{one:?} {:?}", one.hash()).contains(&one.reveal()[9..13]));
        assert_eq!(SecretHash::parse(&one.hash().to_string()), Some(one.hash()));
        for bad in ["", "00", &"g".repeat(64), &"A".repeat(64), &"é".repeat(32)] {
            assert_eq!(SecretHash::parse(bad), None, "{bad}");
        }
    }
}
