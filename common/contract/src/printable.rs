//! Text from outside as it may stand in a log line, a mail or on a terminal.

use std::borrow::Cow;
use std::fmt::Write as _;

/// The text on one line, with nothing that a terminal interprets: control characters, ends of lines and marks that turn
/// the direction of writing are spelled out, such as `\n` and `\u{1b}`. Other text stays as it is.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.chars().any(acts) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match c {
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            // writing to a string does not fail
            c if acts(c) => drop(write!(out, "\\u{{{:x}}}", u32::from(c))),
            c => out.push(c),
        }
    }
    Cow::Owned(out)
}

/// Does a terminal or a reader of lines do something else with this than show it?
fn acts(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{2028}' | '\u{2029}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_in_a_text_ends_its_line_or_steers_a_terminal() {
        let cases = [
            ("Barnard's star, -5.3 °C", "Barnard's star, -5.3 °C"),
            ("M31\n2026-11-22 ERROR dome open", "M31\\n2026-11-22 ERROR dome open"),
            ("\u{1b}[2J\u{1b}]0;x\u{7}", "\\u{1b}[2J\\u{1b}]0;x\\u{7}"),
            ("a\r\u{9b}31m\u{85}\u{2028}b", "a\\r\\u{9b}31m\\u{85}\\u{2028}b"),
            ("user\u{202e}txt.exe\t.", "user\\u{202e}txt.exe\\t."),
        ];
        for (text, wanted) in cases {
            assert_eq!(printable(text), wanted);
            assert!(matches!(printable(wanted), Cow::Borrowed(_)), "what is harmless is not copied");
        }
    }
}
