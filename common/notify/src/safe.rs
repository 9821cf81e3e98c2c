//! The words of a server that was sent a password, without the password.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use contract::printable;

/// The text in place of what may be a secret.
const HIDDEN: &str = "[hidden]";
/// Shorter words contain no encoded password of useful length: codes such as `535` and `5.7.8`.
const SHORT: usize = 8;

/// One line without characters that control a terminal.
pub fn line(words: &str) -> String {
    printable(words.trim()).into_owned()
}

/// A server's words as one line without these secrets: as they are, in base64, or in a code of the server's own. Only
/// plain words and words that are too short for a code remain.
pub fn without(words: &str, secrets: &[&str]) -> String {
    let mut words = words.to_owned();
    let secrets = secrets.iter().map(|secret| secret.trim()).filter(|secret| !secret.is_empty());
    for secret in secrets {
        for form in [secret.to_owned(), STANDARD.encode(secret)] {
            words = words.replace(&form, HIDDEN).replace(form.trim_end_matches('='), HIDDEN);
        }
    }
    let plain = words.split_whitespace().map(|word| if is_plain(word) { word } else { HIDDEN });
    line(&plain.collect::<Vec<_>>().join(" "))
}

/// A word of a language, a number or a short code.
fn is_plain(word: &str) -> bool {
    let bare = word.trim_matches(|c: char| c.is_ascii_punctuation());
    let mut letters = bare.chars();
    let begins = letters.next().is_none_or(char::is_alphabetic);
    let one_case = letters.clone().all(char::is_lowercase) || bare.chars().all(char::is_uppercase);
    bare.len() < SHORT || word.contains(HIDDEN) || (begins && one_case && bare.chars().all(char::is_alphabetic))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_that_repeats_the_login_in_any_code_is_reported_without_it() {
        let password = "s3cret-Pa55";
        let cases = [
            (
                "permanent error (535): 5.7.8 wrong name or password",
                "permanent error (535): 5.7.8 wrong name or password",
            ),
            ("535 got s3cret-Pa55, wanted another", "535 got [hidden], wanted another"),
            ("535 <AGNhbGxpc3RvAHMzY3JldC1QYTU1> refused", "535 [hidden] refused"),
            ("535 auth=czNjcmV0LVBhNTU= no", "535 auth=[hidden] no"),
            ("535 s3cret%2DPa55 733363726574 no", "535 [hidden] [hidden] no"),
            ("535 55aP-terc3s\nadmin: all is well", "535 [hidden] admin: all is well"),
        ];
        for (words, wanted) in cases {
            assert_eq!(without(words, &[password]), wanted);
        }
        assert_eq!(without("x correct horse battery y", &["correct horse battery\n"]), "x [hidden] y");
        assert_eq!(without("no", &[""]), "no");
    }
}
