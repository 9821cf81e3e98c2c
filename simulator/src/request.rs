//! One request to a device: its member and its parameters.

use crate::answer::Refusal;

/// A request as it came over HTTP.
#[derive(Debug, Clone)]
pub struct Request {
    /// PUT rather than GET.
    pub is_put: bool,
    /// The member in lower case, such as `slewtoazimuth`.
    pub member: String,
    parameters: Vec<(String, String)>,
}

impl Request {
    /// From the last part of the address and the query (GET) or the form (PUT).
    pub fn new(is_put: bool, member: &str, encoded: &str) -> Self {
        let parameters = encoded
            .split('&')
            .filter(|pair| !pair.is_empty())
            .map(|pair| pair.split_once('=').unwrap_or((pair, "")))
            .map(|(name, value)| (decode(name), decode(value)))
            .collect();
        Self { is_put, member: member.to_owned(), parameters }
    }

    /// All parameters but the client's numbers, as `Name=value&...`, for the log.
    pub fn summary(&self) -> String {
        let own = self.parameters.iter().filter(|(name, _)| !name.to_ascii_lowercase().starts_with("client"));
        own.map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join("&")
    }

    /// The client's number of this transaction; 0 where it gave none, as the protocol has it.
    pub fn client_transaction(&self) -> u32 {
        let found = self.parameters.iter().find(|(name, _)| name.eq_ignore_ascii_case("ClientTransactionID"));
        found.and_then(|(_, value)| value.parse().ok()).unwrap_or(0)
    }

    /// A parameter's text. Names in a query are compared without case, names in a form with it, as Alpaca has it.
    ///
    /// # Errors
    /// HTTP 400 when it is missing.
    pub fn text(&self, name: &str) -> Result<&str, Refusal> {
        let matches = |given: &str| if self.is_put { given == name } else { given.eq_ignore_ascii_case(name) };
        let found = self.parameters.iter().find(|(given, _)| matches(given));
        found
            .map(|(_, value)| value.as_str())
            .ok_or_else(|| Refusal::BadRequest(format!("parameter {name} is missing")))
    }

    /// A parameter's finite number.
    ///
    /// # Errors
    /// HTTP 400 when it is missing or no number.
    pub fn number(&self, name: &str) -> Result<f64, Refusal> {
        let text = self.text(name)?;
        text.parse().ok().filter(|n: &f64| n.is_finite()).ok_or_else(|| bad(name, text, "a number"))
    }

    /// A parameter's whole number.
    ///
    /// # Errors
    /// HTTP 400 when it is missing or no whole number.
    pub fn integer(&self, name: &str) -> Result<i32, Refusal> {
        let text = self.text(name)?;
        text.parse().map_err(|_| bad(name, text, "a whole number"))
    }

    /// A parameter's truth value, `true` or `false` in any case.
    ///
    /// # Errors
    /// HTTP 400 when it is missing or neither.
    pub fn truth(&self, name: &str) -> Result<bool, Refusal> {
        let text = self.text(name)?;
        text.to_ascii_lowercase().parse().map_err(|_| bad(name, text, "true or false"))
    }
}

fn bad(name: &str, text: &str, expected: &str) -> Refusal {
    Refusal::BadRequest(format!("parameter {name}={text} is not {expected}"))
}

/// Undoes `application/x-www-form-urlencoded`; a broken escape stands for itself.
pub fn decode(encoded: &str) -> String {
    let mut bytes = Vec::with_capacity(encoded.len());
    let mut rest = encoded.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        let escaped = after.get(..2).filter(|_| first == b'%').and_then(|hex| std::str::from_utf8(hex).ok());
        if let Some(byte) = escaped.and_then(|hex| u8::from_str_radix(hex, 16).ok()) {
            bytes.push(byte);
            rest = &after[2..];
        } else {
            bytes.push(if first == b'+' { b' ' } else { first });
            rest = after;
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn queries_ignore_case_and_forms_do_not() {
        let get = Request::new(false, "axisrates", "axis=1&clientTRANSACTIONid=7");
        assert_eq!((get.integer("Axis").unwrap(), get.client_transaction()), (1, 7));
        let put = Request::new(true, "connected", "connected=True");
        assert!(matches!(put.truth("Connected"), Err(Refusal::BadRequest(_))));
        assert!(Request::new(true, "connected", "Connected=TRUE").truth("Connected").unwrap());
    }

    #[test]
    fn escapes_are_undone_and_broken_ones_stay() {
        assert_eq!(decode("a%20b+c%3D%C3%A9%2"), "a b c=é%2");
        assert!(Request::new(true, "x", "V=NaN").number("V").is_err());
    }
}
