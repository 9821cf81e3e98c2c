//! One line of a FITS header: keyword, value and comment in 80 characters.

use contract::Scalar;

/// Longest text that fits one card between its quotes.
const TEXT_LENGTH: usize = 68;
const CARD_LENGTH: usize = 80;

/// A value as FITS knows it.
#[derive(Debug, Clone, PartialEq)]
pub enum CardValue {
    /// T or F.
    Logical(bool),
    /// A whole number.
    Int(i64),
    /// A number; what is not finite has no form in FITS and is never written.
    Float(f64),
    /// Text; cut at 68 characters, and what is not printable ASCII becomes `?`.
    Text(String),
}

/// One keyword.
#[derive(Debug, Clone, PartialEq)]
pub struct Card {
    /// One to eight of A-Z, 0-9, `-` and `_`.
    pub keyword: String,
    /// Its value.
    pub value: CardValue,
    /// The meaning; cut where the card ends.
    pub comment: String,
}

impl Card {
    /// A card of these three.
    pub fn new(keyword: &str, value: CardValue, comment: &str) -> Self {
        Self { keyword: keyword.to_owned(), value, comment: comment.to_owned() }
    }

    /// The card as it stands in the file, 80 characters; `None` for a number that is not finite.
    pub fn record(&self) -> Option<String> {
        let value = match &self.value {
            CardValue::Logical(value) => format!("{:>20}", if *value { "T" } else { "F" }),
            CardValue::Int(value) => format!("{value:>20}"),
            CardValue::Float(value) => format!("{:>20}", float(*value)?),
            CardValue::Text(text) => format!("{:<20}", quoted(text)),
        };
        let mut record = format!("{:<8}= {value}", self.keyword);
        if !self.comment.is_empty() && record.len() + 4 <= CARD_LENGTH {
            record.push_str(" / ");
            record.push_str(&printable(&self.comment));
        }
        record.truncate(CARD_LENGTH);
        Some(format!("{record:<CARD_LENGTH$}"))
    }
}

impl CardValue {
    /// The form of a value that a device property had; lists become text.
    pub fn of(scalar: &Scalar) -> Self {
        match scalar {
            Scalar::Bool(value) => Self::Logical(*value),
            Scalar::Int(value) => Self::Int(*value),
            Scalar::Float(value) => Self::Float(*value),
            Scalar::Text(text) => Self::Text(text.clone()),
            Scalar::List(_) => Self::Text(scalar.to_string()),
        }
    }
}

impl From<bool> for CardValue {
    fn from(value: bool) -> Self {
        Self::Logical(value)
    }
}

impl From<&str> for CardValue {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

/// The shortest digits that read back as the same number, with a decimal point and a capital E.
fn float(value: f64) -> Option<String> {
    if !value.is_finite() {
        return None;
    }
    let digits = format!("{value:?}");
    Some(match digits.split_once('e') {
        Some((mantissa, exponent)) if mantissa.contains('.') => format!("{mantissa}E{exponent}"),
        Some((mantissa, exponent)) => format!("{mantissa}.0E{exponent}"),
        None => digits,
    })
}

fn quoted(text: &str) -> String {
    let mut inside = String::new();
    for c in printable(text).trim_end().chars() {
        // A quote is written twice, and must not be cut in half.
        let width = if c == '\'' { 2 } else { 1 };
        if inside.len() + width > TEXT_LENGTH {
            break;
        }
        inside.extend(std::iter::repeat_n(c, width));
    }
    format!("'{inside:<8}'")
}

/// Text with everything that FITS cannot carry replaced by `?`.
pub fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_ascii() && !c.is_ascii_control() { c } else { '?' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(value: CardValue, comment: &str) -> String {
        let record = Card::new("KEY", value, comment).record().unwrap();
        assert_eq!(record.len(), 80, "{record}");
        record.trim_end().to_owned()
    }

    #[test]
    fn values_stand_in_the_fixed_format_columns() {
        assert_eq!(record(CardValue::Logical(true), "yes"), "KEY     =                    T / yes");
        assert_eq!(record(CardValue::Int(-7), ""), "KEY     =                   -7");
        assert_eq!(record(CardValue::Float(0.25), "[s] c"), "KEY     =                 0.25 / [s] c");
        assert_eq!(record("ab".into(), "c"), "KEY     = 'ab      '           / c");
    }

    #[test]
    fn a_float_keeps_all_its_digits_and_a_point() {
        for (value, text) in
            [(1e-7, "1.0E-7"), (2461365.56809978, "2461365.56809978"), (3.0, "3.0"), (1e300, "1.0E300")]
        {
            assert_eq!(float(value).unwrap(), text);
            assert_eq!(text.parse::<f64>().unwrap(), value);
        }
        for value in [f64::NAN, f64::INFINITY] {
            assert_eq!(Card::new("KEY", CardValue::Float(value), "").record(), None);
        }
    }

    #[test]
    fn text_that_fits_is_never_cut_inside_a_quote_or_a_letter() {
        assert_eq!(record("O'Brien ü".into(), ""), "KEY     = 'O''Brien ?'");
        let long = record("'".repeat(80).as_str().into(), "lost");
        assert_eq!(long, format!("KEY     = '{}'", "'".repeat(68)));
        assert_eq!(record("x".repeat(67).as_str().into(), "lost").len(), 79);
        assert!(record("a\nb\0c".into(), "").contains("'a?b?c   '"));
    }
}
