//! The keywords of an image, answered with the type that was asked for.

use std::path::{Path, PathBuf};

use crate::card::{self, Card, Value};

/// A keyword that is missing or holds something else.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KeywordError {
    /// It is not there, or has no value.
    #[error("{} has no {keyword} in its header; expected {expected}", file.display())]
    Missing {
        /// Which file.
        file: PathBuf,
        /// Which keyword.
        keyword: String,
        /// The type that was asked for.
        expected: &'static str,
    },
    /// It is there with a value of another kind.
    #[error("{}: {keyword} is {found} in its header; expected {expected}", file.display())]
    Kind {
        /// Which file.
        file: PathBuf,
        /// Which keyword.
        keyword: String,
        /// Its value.
        found: String,
        /// The type that was asked for.
        expected: &'static str,
    },
}

/// Keywords and values, in the file's order. Where one stands twice the first counts.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    file: PathBuf,
    cards: Vec<(String, Value)>,
}

impl Header {
    /// Reads cards up to END; answers the header and the bytes it took with END's card, without what fills its block.
    /// `None` when END does not come.
    pub(crate) fn read(file: &Path, bytes: &[u8]) -> Option<(Self, usize)> {
        let mut cards: Vec<(String, Value)> = Vec::new();
        for (n, bytes) in bytes.chunks_exact(card::LENGTH).enumerate() {
            match card::read(bytes) {
                Card::End => return Some((Self { file: file.to_owned(), cards }, (n + 1) * card::LENGTH)),
                Card::Value(keyword, value) => cards.push((keyword, value)),
                Card::Continue(more) => {
                    if let Some((_, Value::Text(text))) = cards.last_mut()
                        && text.ends_with('&')
                    {
                        text.pop();
                        text.push_str(&more);
                    }
                }
                Card::Comment => {}
            }
        }
        None
    }

    /// Adds the keywords of the file's first header that are not here, except those about its own data.
    pub(crate) fn adopt_primary(&mut self, primary: &Self) {
        const OWN: [&str; 6] = ["BSCALE", "BZERO", "BLANK", "DATASUM", "CHECKSUM", "EXTNAME"];
        let is_here = |keyword: &str| OWN.contains(&keyword) || self.value(keyword).is_some();
        let new = primary.cards.iter().filter(|(keyword, _)| !is_here(keyword));
        let new: Vec<_> = new.cloned().collect();
        self.cards.extend(new);
    }

    /// The file it was read from.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// All keywords with their values, comments left out.
    pub fn cards(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.cards.iter().map(|(keyword, value)| (keyword.as_str(), value))
    }

    /// The value of a keyword, whatever its type; `None` when it is not there or has no value.
    pub fn value(&self, keyword: &str) -> Option<&Value> {
        let card = self.cards.iter().find(|(name, _)| name.eq_ignore_ascii_case(keyword))?;
        Some(&card.1).filter(|value| **value != Value::Undefined)
    }

    /// A number, whole or not; always finite.
    ///
    /// # Errors
    /// [`KeywordError`] when the keyword is missing or no number.
    pub fn number(&self, keyword: &str) -> Result<f64, KeywordError> {
        self.typed(keyword, "a number", |value| match value {
            Value::Whole(whole) => Some(*whole as f64),
            Value::Number(number) => Some(*number),
            _ => None,
        })
    }

    /// A whole number; `5.` counts as one.
    ///
    /// # Errors
    /// [`KeywordError`] when the keyword is missing or no whole number.
    pub fn whole(&self, keyword: &str) -> Result<i64, KeywordError> {
        // Beyond this not every whole number has its own f64.
        const EXACT: f64 = 9_007_199_254_740_992.0;
        self.typed(keyword, "a whole number", |value| match value {
            Value::Whole(whole) => Some(*whole),
            Value::Number(number) if number.fract() == 0.0 && number.abs() <= EXACT => Some(*number as i64),
            _ => None,
        })
    }

    /// Text, without blanks at its end.
    ///
    /// # Errors
    /// [`KeywordError`] when the keyword is missing or no text.
    pub fn text(&self, keyword: &str) -> Result<&str, KeywordError> {
        self.typed(keyword, "text", |value| match value {
            Value::Text(text) => Some(text.as_str()),
            _ => None,
        })
    }

    /// True or false.
    ///
    /// # Errors
    /// [`KeywordError`] when the keyword is missing or neither T nor F.
    pub fn logical(&self, keyword: &str) -> Result<bool, KeywordError> {
        self.typed(keyword, "T or F", |value| match value {
            Value::Logical(logical) => Some(*logical),
            _ => None,
        })
    }

    fn typed<'a, T>(
        &'a self,
        keyword: &str,
        expected: &'static str,
        read: impl FnOnce(&'a Value) -> Option<T>,
    ) -> Result<T, KeywordError> {
        let (file, keyword) = (self.file.clone(), keyword.to_owned());
        let Some(value) = self.value(&keyword) else { return Err(KeywordError::Missing { file, keyword, expected }) };
        read(value).ok_or_else(|| KeywordError::Kind { file, keyword, found: written(value), expected })
    }
}

/// A value as the file has it.
fn written(value: &Value) -> String {
    match value {
        Value::Logical(logical) => if *logical { "T" } else { "F" }.to_owned(),
        Value::Whole(whole) => whole.to_string(),
        Value::Number(number) => number.to_string(),
        Value::Text(text) => format!("'{text}'"),
        Value::Undefined => "without a value".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(cards: &[&str]) -> Header {
        let text: String = cards.iter().chain([&"END"]).map(|card| format!("{card:80}")).collect();
        Header::read(Path::new("night/m31.fits"), text.as_bytes()).unwrap().0
    }

    #[test]
    fn a_keyword_answers_in_the_type_that_was_asked_for() {
        let header = header(&[
            "EXPTIME =                   30",
            "GAIN    =                 1.25",
            "YBAYROFF=                   1.",
            "OBJECT  = 'M 31    '",
            "MANUAL  =                    F",
            "EXPTIME =                   60",
        ]);
        assert_eq!(header.number("EXPTIME"), Ok(30.0));
        assert_eq!(header.whole("exptime"), Ok(30));
        assert_eq!(header.number("GAIN"), Ok(1.25));
        assert_eq!(header.whole("YBAYROFF"), Ok(1));
        assert_eq!(header.text("OBJECT"), Ok("M 31"));
        assert_eq!(header.logical("MANUAL"), Ok(false));
    }

    #[test]
    fn an_error_names_the_file_the_keyword_and_what_was_expected() {
        let header = header(&["EXPTIME = 'thirty'", "GAIN    = 1.25", "FILTER  ="]);
        let message = |error: KeywordError| error.to_string();
        assert_eq!(
            message(header.number("EXPTIME").unwrap_err()),
            "night/m31.fits: EXPTIME is 'thirty' in its header; expected a number"
        );
        assert_eq!(
            message(header.whole("GAIN").unwrap_err()),
            "night/m31.fits: GAIN is 1.25 in its header; expected a whole number"
        );
        for keyword in ["FILTER", "OBJECT"] {
            let expected = format!("night/m31.fits has no {keyword} in its header; expected text");
            assert_eq!(message(header.text(keyword).unwrap_err()), expected);
        }
    }

    #[test]
    fn long_text_goes_on_in_the_next_card() {
        let header = header(&["NOTE    = 'clouds from &'", "CONTINUE  'the west&'", "CONTINUE  ', then rain' / all"]);
        assert_eq!(header.text("NOTE"), Ok("clouds from the west, then rain"));
    }

    #[test]
    fn a_header_without_end_is_none() {
        assert_eq!(Header::read(Path::new("x"), &[b' '; 2880]), None);
        assert_eq!(Header::read(Path::new("x"), b"END"), None);
    }
}
