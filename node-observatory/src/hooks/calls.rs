//! Calls in a script's text that were probably meant to be calls of this node's functions.
//!
//! The language finds out whether a called function exists when it is called, which is at night. A misspelling in
//! one of the names of [`engine::CALLS`] is found here instead.

use config::{distance, nearest};

use super::engine;

/// What is called in a text, as `(line, name)`, lines from 1; methods (`x.len()`) and definitions are not calls.
fn called(text: &str) -> Vec<(usize, &str)> {
    let bytes = text.as_bytes();
    let (mut at, mut line, mut found, mut before) = (0, 1, Vec::new(), "");
    while let Some(&byte) = bytes.get(at) {
        let rest = &bytes[at..];
        let length = match byte {
            b'/' if rest.starts_with(b"//") => rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len()),
            b'/' if rest.starts_with(b"/*") => {
                rest.windows(2).position(|w| w == b"*/").map_or(rest.len(), |end| end + 2)
            }
            b'"' | b'\'' | b'`' => quoted(rest),
            b'a'..=b'z' | b'A'..=b'Z' | b'_' => {
                let length = rest.iter().position(|b| !b.is_ascii_alphanumeric() && *b != b'_').unwrap_or(rest.len());
                let word = &text[at..at + length];
                let next = rest[length..].iter().find(|b| !b.is_ascii_whitespace());
                if next == Some(&b'(') && before != "." && before != "fn" {
                    found.push((line, word));
                }
                before = word;
                length
            }
            b'0'..=b'9' => rest.iter().position(|b| !b.is_ascii_alphanumeric() && *b != b'_').unwrap_or(rest.len()),
            _ => {
                if !byte.is_ascii_whitespace() {
                    before = if byte == b'.' { "." } else { "" };
                }
                1
            }
        };
        line += rest[..length].iter().filter(|b| **b == b'\n').count();
        at += length;
    }
    found
}

/// Bytes of the quoted text at the beginning of `rest`, with its quotes.
fn quoted(rest: &[u8]) -> usize {
    let mut at = 1;
    while let Some(&byte) = rest.get(at) {
        match byte {
            b'\\' if rest[0] != b'`' => at += 2,
            byte if byte == rest[0] => return at + 1,
            _ => at += 1,
        }
    }
    rest.len()
}

/// A line for each call that is near one of this node's functions, and neither that nor one of the script's `own`.
pub fn misspelt(text: &str, own: &[&str]) -> Vec<String> {
    let slip = |(line, name): (usize, &str)| {
        let is_known = engine::CALLS.contains(&name) || own.contains(&name);
        let meant = nearest(name, engine::CALLS).filter(|_| !is_known)?;
        // Farther off it may well be a function of the language.
        let is_near = distance(name, meant) <= (meant.len() / 3).max(1);
        is_near.then(|| format!("line {line}: no function is called {name}; did you mean {meant}?"))
    };
    called(text).into_iter().filter_map(slip).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calls_are_found_among_comments_and_texts() {
        let text = "// a()\nfn open() { /* b()\n */ c(1); x.d(); let e = \"f()\"; `g()`; h (2, i('\\'')); if (j) { } }";
        let names: Vec<(usize, &str)> = called(text).into_iter().filter(|(_, name)| *name != "if").collect();
        assert_eq!(names, [(3, "c"), (3, "h"), (3, "i")]);
        for broken in ["\"", "`", "'\\", "/*", "a(\"\\", "é(", "/* é"] {
            called(broken);
        }
    }

    #[test]
    fn a_slip_in_a_name_is_reported_and_functions_of_the_language_are_not() {
        let report = misspelt("fn open() {\n  default_opne();\n  comand_string(\"telescope\", \"X\");\n}", &["open"]);
        assert_eq!(report[0], "line 2: no function is called default_opne; did you mean default_open?");
        assert_eq!(report[1], "line 3: no function is called comand_string; did you mean command_string?");
        let fine = "fn open() { print(abs(1)); parse_int(\"1\"); range(0, 1); type_of(1); mine(); note(\"x\"); exit(); take(1) }";
        assert_eq!(misspelt(fine, &["mine"]), Vec::<String>::new());
        let mut fine =
            ["sort", "floor", "round", "sqrt", "timestamp", "is_def_fn", "Fn", "call", "min", "max", "rand"].iter();
        assert!(fine.all(|name| misspelt(&format!("{name}(1)"), &[]).is_empty()));
    }
}
