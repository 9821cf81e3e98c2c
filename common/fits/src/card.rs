//! One line of a header: a keyword and its value, in 80 characters (FITS Standard 4.0, section 4).

/// Characters of a card.
pub const LENGTH: usize = 80;

/// A value as the file has it.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// T or F.
    Logical(bool),
    /// A whole number.
    Whole(i64),
    /// A number with a point or an exponent.
    Number(f64),
    /// Text without its quotes and without blanks at its end.
    Text(String),
    /// The keyword is there, its value is left out, or of a kind that images do not need (complex numbers).
    Undefined,
}

/// A card with its meaning.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Card {
    /// The last of the header.
    End,
    /// A keyword and its value.
    Value(String, Value),
    /// More text for the card before (section 4.2.1.2).
    Continue(String),
    /// A comment, or nothing.
    Comment,
}

/// Reads a card. A card that is not of the standard's form counts as a comment, as in other readers.
pub(crate) fn read(card: &[u8]) -> Card {
    let text: String = card.iter().map(|byte| char::from(*byte)).collect();
    let text = text.trim_end_matches([' ', '\0']);
    if text == "END" {
        return Card::End;
    }
    if let Some(rest) = text.strip_prefix("CONTINUE") {
        return match value(rest) {
            Value::Text(more) => Card::Continue(more),
            _ => Card::Comment,
        };
    }
    let keyword_and_rest = match text.strip_prefix("HIERARCH ") {
        Some(long) => long.split_once('='),
        None if text.get(8..9) == Some("=") => text.get(..8).zip(text.get(9..)),
        None => None,
    };
    match keyword_and_rest {
        Some((keyword, rest)) if !matches!(keyword.trim(), "COMMENT" | "HISTORY" | "") => {
            Card::Value(keyword.trim().to_ascii_uppercase(), value(rest))
        }
        _ => Card::Comment,
    }
}

/// The text after the value of a card, without blanks around it; that of COMMENT and HISTORY is no such text.
pub(crate) fn comment(card: &[u8]) -> String {
    let text: String = card.iter().map(|byte| char::from(*byte)).collect();
    let text = text.trim_end_matches([' ', '\0']);
    let after = match text.strip_prefix("CONTINUE") {
        Some(rest) => rest,
        None => text.split_once('=').map_or("", |(_, rest)| rest),
    };
    let after = after.trim_start();
    let after = match after.strip_prefix('\'') {
        // Two quotes are one of the text.
        Some(quoted) => {
            let mut is_inside = true;
            quoted.trim_start_matches(|next| {
                is_inside ^= next == '\'';
                is_inside || next == '\''
            })
        }
        None => after,
    };
    after.split_once('/').map_or(String::new(), |(_, comment)| comment.trim().to_owned())
}

/// The value in the text after the `=`, without its comment.
fn value(text: &str) -> Value {
    let text = text.trim_start();
    if let Some(quoted) = text.strip_prefix('\'') {
        return Value::Text(unquoted(quoted));
    }
    let word = text.split('/').next().unwrap_or_default().trim();
    match word {
        "T" => return Value::Logical(true),
        "F" => return Value::Logical(false),
        _ => {}
    }
    if let Ok(whole) = word.parse() {
        return Value::Whole(whole);
    }
    // Rust's own forms of "inf" and "nan" are no numbers in FITS.
    let is_number = word.bytes().all(|byte| byte.is_ascii_digit() || b"+-.eEdD".contains(&byte));
    let number = is_number.then(|| word.replace(['d', 'D'], "E").parse().ok()).flatten();
    number.filter(|number: &f64| number.is_finite()).map_or(Value::Undefined, Value::Number)
}

/// Text up to the closing quote; two quotes are one of the text.
fn unquoted(text: &str) -> String {
    let mut read = String::new();
    let mut left = text.chars().peekable();
    while let Some(next) = left.next() {
        if next == '\'' && left.next_if_eq(&'\'').is_none() {
            break;
        }
        read.push(next);
    }
    read.truncate(read.trim_end_matches(' ').len());
    read
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(card: &str) -> Card {
        read(card.as_bytes())
    }

    fn is(keyword: &str, value: Value) -> Card {
        Card::Value(keyword.to_owned(), value)
    }

    #[test]
    fn values_have_their_type() {
        assert_eq!(of("SIMPLE  =                    T / FITS"), is("SIMPLE", Value::Logical(true)));
        assert_eq!(of("NAXIS1  =                  721"), is("NAXIS1", Value::Whole(721)));
        assert_eq!(of("BZERO   =                1500."), is("BZERO", Value::Number(1500.0)));
        assert_eq!(of("EXPTIME = 1.5D+01 / s"), is("EXPTIME", Value::Number(15.0)));
        assert_eq!(of("WBRGGB  = '' / From CR2"), is("WBRGGB", Value::Text(String::new())));
        assert_eq!(of("EMPTY   =                      / nobody knows"), is("EMPTY", Value::Undefined));
        assert_eq!(of("BAD     = NaN"), is("BAD", Value::Undefined));
        assert_eq!(of("BAD     = 1e999"), is("BAD", Value::Undefined));
        assert_eq!(of("COMPLEX = (1.0, 2.0)"), is("COMPLEX", Value::Undefined));
    }

    #[test]
    fn text_keeps_quotes_and_slashes_and_loses_blanks_at_its_end() {
        let text = |text: &str| Value::Text(text.to_owned());
        assert_eq!(of("OBSERVER= 'O''Neill / me  ' / who"), is("OBSERVER", text("O'Neill / me")));
        assert_eq!(of("OBJECT  = '  M 31'"), is("OBJECT", text("  M 31")));
        assert_eq!(of("OPEN    = 'never closed"), is("OPEN", text("never closed")));
        assert_eq!(of("CONTINUE  ' and more&'"), Card::Continue(" and more&".to_owned()));
        assert_eq!(of("HIERARCH ESO TEL ALT = 45.25 / [deg]"), is("ESO TEL ALT", Value::Number(45.25)));
    }

    #[test]
    fn what_is_no_card_of_the_standard_is_a_comment() {
        for card in ["", "COMMENT = 'J2000'", "HISTORY a = b", "        = 5", "KEYWORD without a value", "ÄÖÜ=="] {
            assert_eq!(of(card), Card::Comment, "{card}");
        }
        assert_eq!(of("END     "), Card::End);
        assert_eq!(read(&[0xff; 80]), Card::Comment);
    }
}
