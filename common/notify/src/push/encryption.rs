//! The encryption of a message for one browser: RFC 8291, with the content coding `aes128gcm` of RFC 8188.

use anyhow::{anyhow, ensure};
use ring::aead::{AES_128_GCM, Aad, LessSafeKey, NONCE_LEN, Nonce, UnboundKey};
use ring::agreement::{ECDH_P256, EphemeralPrivateKey, UnparsedPublicKey, agree_ephemeral};
use ring::error::Unspecified;
use ring::hkdf::{HKDF_SHA256, Salt};
use ring::rand::{SecureRandom as _, SystemRandom};

/// A message of one record, so this is only a limit.
const RECORD: u32 = 4096;
/// What every push service takes (RFC 8030, section 7.2), without salt, sizes, public key, end of the text and tag of the encryption.
const MOST_BYTES: usize = 4096 - 16 - 4 - 1 - PUBLIC_KEY - 1 - 16;
/// A point of P-256, not compressed.
const PUBLIC_KEY: usize = 65;
const AUTH: usize = 16;

/// Encrypts a text for the browser with this public key and this secret.
///
/// # Errors
/// The text is too long, or these are no such keys.
pub fn encrypt(text: &[u8], browser: &[u8], auth: &[u8]) -> anyhow::Result<Vec<u8>> {
    ensure!(text.len() <= MOST_BYTES, "the message has {} bytes: expected at most {MOST_BYTES}", text.len());
    ensure!(auth.len() == AUTH, "keys.auth has {} bytes: expected {AUTH} in base64url", auth.len());
    let failed = |_| anyhow!("this host gives no random numbers");
    let (random, mut salt) = (SystemRandom::new(), [0; 16]);
    random.fill(&mut salt).map_err(failed)?;
    let own = EphemeralPrivateKey::generate(&ECDH_P256, &random).map_err(failed)?;
    let own_public = own.compute_public_key().map_err(failed)?;
    let ends = Ends { browser, server: own_public.as_ref() };
    let sealed = agree_ephemeral(own, &UnparsedPublicKey::new(&ECDH_P256, browser), |shared| {
        seal(text, shared, &ends, auth, &salt)
    });
    let no_key =
        |_| anyhow!("keys.p256dh is no public key: expected a point of P-256, {PUBLIC_KEY} bytes in base64url");
    sealed.map_err(no_key)?.map_err(|_| anyhow!("the message cannot be encrypted"))
}

/// The public keys of both ends.
struct Ends<'a> {
    browser: &'a [u8],
    server: &'a [u8],
}

/// Everything that follows from the shared secret.
fn seal(text: &[u8], shared: &[u8], ends: &Ends<'_>, auth: &[u8], salt: &[u8; 16]) -> Result<Vec<u8>, Unspecified> {
    let input = derived(auth, shared, &[b"WebPush: info\0", ends.browser, ends.server])?;
    let key = derived(salt, &input, &[b"Content-Encoding: aes128gcm\0"])?;
    let nonce = derived(salt, &input, &[b"Content-Encoding: nonce\0"])?;
    // The text ends with a 2, since no other record follows.
    let mut record = [text, &[2]].concat();
    let key = LessSafeKey::new(UnboundKey::new(&AES_128_GCM, &key[..AES_128_GCM.key_len()])?);
    let nonce = Nonce::try_assume_unique_for_key(&nonce[..NONCE_LEN])?;
    key.seal_in_place_append_tag(nonce, Aad::empty(), &mut record)?;
    let length = u8::try_from(ends.server.len()).map_err(|_| Unspecified)?;
    Ok([salt, &RECORD.to_be_bytes()[..], &[length], ends.server, &record].concat())
}

/// HKDF with SHA-256 (RFC 5869): shorter keys are the first bytes of this one.
fn derived(salt: &[u8], secret: &[u8], info: &[&[u8]]) -> Result<[u8; 32], Unspecified> {
    let mut key = [0; 32];
    Salt::new(HKDF_SHA256, salt).extract(secret).expand(info, HKDF_SHA256)?.fill(&mut key)?;
    Ok(key)
}

#[cfg(test)]
mod tests {
    use base64::Engine as _;
    use base64::engine::general_purpose::URL_SAFE_NO_PAD;
    use test_support::Browser;

    use super::*;

    fn bytes(text: &str) -> Vec<u8> {
        URL_SAFE_NO_PAD.decode(text).unwrap()
    }

    #[test]
    fn the_example_of_rfc_8291_has_its_keys_and_its_body() {
        let shared = bytes("kyrL1jIIOHEzg3sM2ZWRHDRB62YACZhhSlknJ672kSs");
        let server = bytes("BP4z9KsN6nGRTbVYI_c7VJSPQTBtkgcy27mlmlMoZIIgDll6e3vCYLocInmYWAmS6TlzAC8wEqKK6PBru3jl7A8");
        let browser = bytes("BCVxsr7N_eNgVRqvHtD0zTZsEc6-VV-JvLexhqUzORcxaOzi6-AYWXvTBHm4bjyPjs7Vd8pZGH6SRpkNtoIAiw4");
        let auth = bytes("BTBZMqHH6r4Tts7J_aSIgg");
        let salt: [u8; 16] = bytes("DGv6ra1nlYgDCS1FRnbzlw").try_into().unwrap();
        let input = derived(&auth, &shared, &[b"WebPush: info\0", &browser, &server]).unwrap();
        assert_eq!(input[..], bytes("S4lYMb_L0FxCeq0WhDx813KgSYqU26kOyzWUdsXYyrg"));
        let key = derived(&salt, &input, &[b"Content-Encoding: aes128gcm\0"]).unwrap();
        assert_eq!(key[..16], bytes("oIhVW04MRdy2XN9CiKLxTg"));
        let nonce = derived(&salt, &input, &[b"Content-Encoding: nonce\0"]).unwrap();
        assert_eq!(nonce[..12], bytes("4h_95klXJ5E_qnoN"));
        let text = b"When I grow up, I want to be a watermelon";
        let ends = Ends { browser: &browser, server: &server };
        let body = "DGv6ra1nlYgDCS1FRnbzlwAAEABBBP4z9KsN6nGRTbVYI_c7VJSPQTBtkgcy27mlmlMoZIIgDll6e3vCYLocInmYWAmS6TlzAC8w\
                    EqKK6PBru3jl7A_yl95bQpu6cVPTpK4Mqgkf1CXztLVBSt2Ks3oZwbuwXPXLWyouBWLVWGNWQexSgSxsj_Qulcy4a-fN";
        assert_eq!(URL_SAFE_NO_PAD.encode(seal(text, &shared, &ends, &auth, &salt).unwrap()), body);
    }

    #[test]
    fn a_browser_reads_what_was_encrypted_for_it_and_nobody_elses() {
        let text = "a".repeat(MOST_BYTES);
        for read in [text.as_str(), "", "\u{e9}"] {
            let browser = Browser::new();
            let sealed = encrypt(read.as_bytes(), browser.public(), browser.auth()).unwrap();
            assert!(sealed.len() <= 4096, "{}", sealed.len());
            assert_eq!(browser.read(&sealed).as_deref(), Some(read));
        }
        let (browser, other) = (Browser::new(), Browser::new());
        let sealed = encrypt(b"for another", other.public(), other.auth()).unwrap();
        assert_eq!(browser.read(&sealed), None);
        let mut spoilt = encrypt(b"on the way", other.public(), other.auth()).unwrap();
        *spoilt.last_mut().unwrap() ^= 1;
        assert_eq!(other.read(&spoilt), None);
    }

    #[test]
    fn what_is_no_key_and_what_is_too_long_is_told() {
        let browser = Browser::new();
        let why = |text: &[u8], key: &[u8], auth: &[u8]| encrypt(text, key, auth).unwrap_err().to_string();
        assert!(why(b"x", &[4; 65], browser.auth()).contains("p256dh is no public key"));
        assert!(why(b"x", b"", browser.auth()).contains("p256dh is no public key"));
        assert!(why(b"x", browser.public(), b"short").contains("keys.auth has 5 bytes: expected 16"));
        let long = vec![b'x'; MOST_BYTES + 1];
        assert!(why(&long, browser.public(), browser.auth()).contains("expected at most"));
    }
}
