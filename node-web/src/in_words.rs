//! What a parser says is wrong with a request, as a sentence for people: which member, what was expected, what was found.

/// The sentence for a fault at a place such as `parameters.minutes`; the place is empty for the whole.
pub fn in_words(place: &str, fault: &str) -> String {
    // The parser's own "at line 1 column 9" counts from elsewhere.
    let fault = fault.split(" at line ").next().unwrap_or(fault).trim_end_matches('.');
    let (inner, what) = member(fault);
    let place = match (place.trim_matches('.'), inner) {
        ("", inner) => inner.to_owned(),
        (place, "") => place.to_owned(),
        // Some parsers name the member twice.
        (place, inner) if place.rsplit('.').next() == Some(inner) => place.to_owned(),
        (place, inner) => format!("{place}.{inner}"),
    };
    if place.is_empty() { format!("{what}.") } else { format!("{place}: {what}.") }
}

/// The member that a fault names, and what is wrong with it.
fn member(fault: &str) -> (&str, String) {
    let quoted = |begin: &str| {
        let rest = fault.strip_prefix(begin)?;
        rest.split_once('`')
    };
    if let Some((name, _)) = quoted("missing field `") {
        return (name, "it is missing".to_owned());
    }
    if let Some((name, _)) = quoted("duplicate field `") {
        return (name, "it is given twice; expected once".to_owned());
    }
    if let Some((name, rest)) = quoted("unknown field `") {
        return (name, format!("there is no such member; {}", choices(rest)));
    }
    if let Some((word, rest)) = quoted("unknown variant `") {
        return ("", format!("there is no such word as {word:?}; {}", choices(rest)));
    }
    for begin in ["invalid type: ", "invalid value: ", "invalid length "] {
        if let Some((found, expected)) = fault.strip_prefix(begin).and_then(|rest| rest.rsplit_once(", expected ")) {
            let is_list = begin == "invalid length " && expected.starts_with("struct ");
            let found = if is_list { "a list".to_owned() } else { found_words(found) };
            return ("", format!("expected {}, found {found}", kind(expected)));
        }
    }
    let what = match fault {
        "invalid digit found in string" | "cannot parse integer from empty string" => {
            "expected a whole number, 0 or more"
        }
        "number too large to fit in target type" => "expected a smaller number",
        "number too small to fit in target type" => "expected a larger number",
        "invalid float literal" | "cannot parse float from empty string" => "expected a number",
        "provided string was not `true` or `false`" => "expected true or false",
        other => other,
    };
    ("", what.replace('`', "\""))
}

/// `, expected one of `a`, `b`` in words.
fn choices(rest: &str) -> String {
    let names: Vec<&str> = rest.split('`').skip(1).step_by(2).collect();
    match names[..] {
        [] => "expected none".to_owned(),
        [only] => format!("expected {only}"),
        _ => format!("expected one of {}", names.join(", ")),
    }
}

fn kind(expected: &str) -> String {
    let known = match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, 0 or more",
        "i8" | "i16" | "i32" | "i64" => "a whole number",
        "f32" | "f64" => "a number",
        "a string" | "a borrowed string" => "a text",
        "a boolean" => "true or false",
        "a map" => "an object",
        "a sequence" => "a list",
        other if other.starts_with("struct ") || other.starts_with("internally tagged ") => "an object",
        other => other,
    };
    known.replace('`', "\"")
}

fn found_words(found: &str) -> String {
    let bare = |text: &str| text.trim_matches('`').to_owned();
    match found.split_once(' ') {
        Some(("string", text)) => format!("the text {text}"),
        Some(("integer" | "boolean", text)) => bare(text),
        Some(("floating", text)) => bare(text.trim_start_matches("point ")),
        _ => match found {
            "sequence" => "a list".to_owned(),
            "map" => "an object".to_owned(),
            other => bare(other),
        },
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;
    use serde::de::DeserializeOwned;

    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code, reason = "only read")]
    struct Asked {
        days: u32,
        name: String,
        ratio: Option<f64>,
        word: Option<Word>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Word {
        High,
        Low,
    }

    fn json<T: DeserializeOwned + std::fmt::Debug>(text: &str) -> String {
        let mut reader = serde_json::Deserializer::from_str(text);
        let fault = serde_path_to_error::deserialize::<_, T>(&mut reader).unwrap_err();
        in_words(&fault.path().to_string(), &fault.inner().to_string())
    }

    #[test]
    fn a_fault_of_a_parser_becomes_a_sentence_with_the_member_and_what_was_expected() {
        for (text, words) in [
            (r#"{"days": 1}"#, "name: it is missing."),
            (r#"{"days": "a", "name": "x"}"#, "days: expected a whole number, 0 or more, found the text \"a\"."),
            (r#"{"days": -1, "name": "x"}"#, "days: expected a whole number, 0 or more, found -1."),
            (r#"{"days": 1, "name": 7}"#, "name: expected a text, found 7."),
            (r#"{"days": 1, "name": ["x"]}"#, "name: expected a text, found a list."),
            (r#"{"days": 1, "name": "x", "ratio": true}"#, "ratio: expected a number, found true."),
            (
                r#"{"days": 1, "name": "x", "colour": 7}"#,
                "colour: there is no such member; expected one of days, name, ratio, word.",
            ),
            (
                r#"{"days": 1, "name": "x", "word": "loud"}"#,
                "word: there is no such word as \"loud\"; expected one of high, low.",
            ),
            (r#"[1]"#, "expected an object, found a list."),
        ] {
            let found = json::<Asked>(text);
            assert_eq!(found.replace("[0]: ", ""), words, "{text}");
        }
        assert_eq!(in_words("limit", "invalid digit found in string"), "limit: expected a whole number, 0 or more.");
        assert_eq!(in_words("", "duplicate field `limit`"), "limit: it is given twice; expected once.");
    }
}
