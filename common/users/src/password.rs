//! Passwords: which are taken, and their argon2id hashes.

use std::fmt;
use std::sync::LazyLock;

use argon2::password_hash::phc;
use argon2::{Algorithm, Argon2, Params, PasswordHasher as _, PasswordVerifier as _};

use crate::secret::random;

/// Characters of a password.
const FEWEST: usize = 12;
const MOST: usize = 256;
/// A hash in the file that asks for more memory (KiB) or rounds would let each login stop the host.
const MOST_MEMORY_KIB: u32 = 256 << 10;
const MOST_ROUNDS: u32 = 16;
/// A hash that no password has, of the same cost as all that are made here: what is verified for a name that is not known.
const OF_NOBODY: &str =
    "$argon2id$v=19$m=19456,t=2,p=1$AAAAAAAAAAAAAAAAAAAAAA$AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA";

/// Why a password is not taken.
#[derive(Debug, thiserror::Error)]
pub enum PasswordFault {
    /// Too short to withstand guessing.
    #[error("the password has {0} characters: expected {FEWEST} or more; several words are easy to keep in mind")]
    Short(usize),
    /// Longer than anybody types.
    #[error("the password has {0} characters: expected at most {MOST}")]
    Long(usize),
    /// Few different characters, or little else than the name.
    #[error("the password is easily guessed: expected more than the name, a repeated character or a row of digits")]
    Guessed,
    /// Some terminals cannot send it.
    #[error(
        "the password has a character that cannot be typed, such as a line end: expected letters, digits, signs and blanks"
    )]
    Control,
    /// It could not be hashed.
    #[error("the password could not be hashed: {0}")]
    Hash(String),
}

/// The argon2id hash of a password, with its salt and cost.
#[derive(Clone, PartialEq, Eq)]
pub struct PasswordHash(String);

impl PasswordHash {
    /// Of a new password of a user; takes some 20 ms of one core and 19 MiB.
    ///
    /// # Errors
    /// The password is not taken, or the system gives no random numbers.
    pub fn of_new(password: &str, name: &str) -> Result<Self, PasswordFault> {
        check(password, name)?;
        let hash = |error: &dyn fmt::Display| PasswordFault::Hash(error.to_string());
        let salt = random::<16>().map_err(|error| hash(&error))?;
        let made = Argon2::default().hash_password_with_salt(password.as_bytes(), &salt);
        Ok(Self(made.map_err(|error| hash(&error))?.to_string()))
    }

    /// As it is in the file.
    ///
    /// # Errors
    /// What was expected.
    pub(crate) fn parse(text: &str) -> Result<Self, &'static str> {
        let expected = "expected a hash of argon2id, such as `starmesh user password` writes";
        let hash = phc::PasswordHash::new(text).map_err(|_| expected)?;
        if hash.algorithm != Algorithm::Argon2id.ident() || hash.hash.is_none() || hash.salt.is_none() {
            return Err(expected);
        }
        let params = Params::try_from(&hash).map_err(|_| expected)?;
        if params.m_cost() > MOST_MEMORY_KIB || params.t_cost() > MOST_ROUNDS {
            return Err("expected at most 256 MiB of memory and 16 rounds for a hash");
        }
        Ok(Self(text.to_owned()))
    }

    /// As it is written to the file.
    pub(crate) fn text(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for PasswordHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PasswordHash(...)")
    }
}

/// Is this the password of the hash? Without a hash the work is the same, and the answer no.
pub(crate) fn verify(password: &str, hash: Option<&PasswordHash>) -> bool {
    static NOBODY: LazyLock<PasswordHash> = LazyLock::new(|| PasswordHash(OF_NOBODY.to_owned()));
    let is_right = Argon2::default().verify_password(password.as_bytes(), hash.unwrap_or(&NOBODY).text()).is_ok();
    is_right && hash.is_some()
}

fn check(password: &str, name: &str) -> Result<(), PasswordFault> {
    let count = password.chars().count();
    if count < FEWEST {
        return Err(PasswordFault::Short(count));
    }
    if count > MOST {
        return Err(PasswordFault::Long(count));
    }
    if password.chars().any(char::is_control) {
        return Err(PasswordFault::Control);
    }
    let small = password.to_lowercase();
    let rest = small.replace(&name.to_lowercase(), "");
    let mut different: Vec<char> = rest.chars().collect();
    different.sort_unstable();
    different.dedup();
    let is_row = small
        .bytes()
        .zip(small.bytes().skip(1))
        .all(|(one, next)| next == one.wrapping_add(1) || (one, next) == (b'9', b'0'));
    if different.len() < 5 || is_row { Err(PasswordFault::Guessed) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weak_passwords_are_refused() {
        for weak in [
            "",
            "short",
            "eleven char",
            "aaaaaaaaaaaaaa",
            "1234567890123",
            "ana-ana-ana-ana",
            "abcdefghijklm",
            &"x".repeat(300),
            "with a line\nend in it",
        ] {
            assert!(PasswordHash::of_new(weak, "ana").is_err(), "{weak}");
        }
        assert!(check("four plain words here", "ana").is_ok());
    }

    #[test]
    fn a_hash_verifies_its_password_and_is_never_shown() {
        let hash = PasswordHash::of_new("four plain words here", "ana").unwrap();
        assert!(verify("four plain words here", Some(&hash)));
        assert!(!verify("four plain words Here", Some(&hash)) && !verify("", Some(&hash)) && !verify("x", None));
        assert!(hash.text().starts_with("$argon2id$v=19$m=19456,t=2,p=1$"), "{}", hash.text());
        assert_eq!(format!("{hash:?}"), "PasswordHash(...)");
        assert_ne!(PasswordHash::of_new("four plain words here", "ana").unwrap(), hash, "each has a salt of its own");
        assert_eq!(PasswordHash::parse(hash.text()).unwrap(), hash);
        assert!(PasswordHash::parse(OF_NOBODY).is_ok(), "the work for a name that is not known");
        for bad in [
            "",
            "secret",
            &hash.text().replace("argon2id", "argon2i"),
            &hash.text().replace("m=19456", "m=9000000"),
            "$argon2id$v=19$m=19456,t=2,p=1",
        ] {
            assert!(PasswordHash::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_name_that_is_not_known_costs_as_much() {
        let cost = |text: &str| Params::try_from(&phc::PasswordHash::new(text).unwrap()).unwrap();
        let hash = PasswordHash::of_new("four plain words here", "ana").unwrap();
        let (one, two) = (cost(hash.text()), cost(OF_NOBODY));
        assert_eq!((one.m_cost(), one.t_cost(), one.p_cost()), (two.m_cost(), two.t_cost(), two.p_cost()));
        assert_eq!(one.output_len(), two.output_len());
    }
}
