//! Which commands of a maker's own a device may be sent: nothing that `observatory.toml` does not list.

use contract::device::vendor::VendorCommand;
use serde::{Deserialize, Deserializer};

/// One line of `vendor_commands`: a method and a text, such as `command_string READY_STATE`; a `*` at its end stands for
/// anything. Parameters of an `action` are free.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VendorPattern {
    method: String,
    text: String,
    any_end: bool,
}

const METHODS: [&str; 4] = ["command_string", "command_bool", "command_blind", "action"];

impl VendorPattern {
    /// May this be sent?
    pub fn allows(&self, command: &VendorCommand) -> bool {
        let is_text = |text: &str| if self.any_end { text.starts_with(&self.text) } else { text == self.text };
        self.method == command.method() && is_text(command.text())
    }

    fn read(line: &str) -> Result<Self, String> {
        let expected = format!(
            "expected one of {} and what is commanded, such as \"command_string READY_STATE\"",
            METHODS.join(", ")
        );
        let (method, text) = line.split_once(' ').ok_or(format!("vendor command {line:?}: {expected}"))?;
        let (text, any_end) = text.strip_suffix('*').map_or((text, false), |text| (text, true));
        if !METHODS.contains(&method) || (text.trim().is_empty()) {
            // a lone * would allow all that the maker ever thought of
            return Err(format!("vendor command {line:?}: {expected}"));
        }
        Ok(Self { method: method.to_owned(), text: text.to_owned(), any_end })
    }
}

impl<'de> Deserialize<'de> for VendorPattern {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let line = String::deserialize(deserializer)?;
        Self::read(&line).map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use contract::device::vendor::Words;

    use super::*;

    fn string(command: &str) -> VendorCommand {
        VendorCommand::CommandString(Words { command: command.to_owned(), raw: false })
    }

    #[test]
    fn only_what_is_listed_is_allowed() {
        let exact = VendorPattern::read("command_string READY_STATE").unwrap();
        assert!(exact.allows(&string("READY_STATE")));
        for other in ["READY_STATE=1", "READY", "ready_state", ""] {
            assert!(!exact.allows(&string(other)), "{other}");
        }
        let blind = VendorCommand::CommandBlind(Words { command: "READY_STATE".to_owned(), raw: false });
        assert!(!exact.allows(&blind));
        let open = VendorPattern::read("command_string CLEAR *").unwrap();
        assert!(open.allows(&string("CLEAR 12")) && !open.allows(&string("CLEAR")) && !open.allows(&string("OPEN")));
        let action = VendorPattern::read("action Reset").unwrap();
        assert!(action.allows(&VendorCommand::Action { name: "Reset".to_owned(), parameters: "ha".to_owned() }));
    }

    #[test]
    fn a_line_that_allows_everything_or_nothing_is_refused() {
        for line in ["command_string *", "command_string", "CommandString X", "action  *", ""] {
            assert!(VendorPattern::read(line).unwrap_err().contains("expected one of command_string"), "{line}");
        }
    }
}
