//! What an alert of the catalogue is called, and the alert itself.

use std::fmt::Display;

use units::Utc;

use super::{Alert, AlertKind};

impl AlertKind {
    /// The id of one alert of this kind; `instance` is empty where there is only one.
    pub fn id(self, instance: impl Display) -> String {
        let word = self.entry().word;
        match instance.to_string().as_str() {
            "" => word.to_owned(),
            instance => format!("{word}/{instance}"),
        }
    }

    /// An alert of this kind.
    pub fn alert(self, instance: impl Display, raised_utc: Utc, cause: &str) -> Alert {
        let entry = self.entry();
        let [cause, consequence, action] = [cause, entry.consequence, entry.action].map(str::to_owned);
        Alert {
            id: self.id(instance),
            priority: entry.priority,
            raised_utc,
            cause,
            consequence,
            action,
            returned_utc: None,
            acknowledged_by: None,
            acknowledged_utc: None,
            shelved_by: None,
            shelved_until_utc: None,
            shelved_reason: None,
        }
    }

    /// The kind that an id names; `None` for one of a newer version.
    pub fn of(id: &str) -> Option<Self> {
        let begins = |kind: &&Self| {
            let rest = id.strip_prefix(kind.entry().word);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
        };
        Self::ALL.iter().find(begins).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observatory::catalogue::AlertEntry;

    #[test]
    fn every_id_names_its_kind() {
        for kind in AlertKind::ALL {
            for instance in ["", "dome_1", "wx/Humidity"] {
                assert_eq!(AlertKind::of(&kind.id(instance)), Some(*kind), "{instance}");
            }
        }
        for id in ["", "dome", "dome-not-closed-yet", "archive", "archive/other", "twin2"] {
            assert_eq!(AlertKind::of(id), None, "{id}");
        }
    }

    #[test]
    fn every_row_has_words_that_are_sentences() {
        for kind in AlertKind::ALL {
            let AlertEntry { word, consequence, action, .. } = kind.entry();
            for text in [*consequence, *action, kind.means()] {
                assert!(text.ends_with('.') && text.starts_with(char::is_uppercase), "{word}: {text:?}");
            }
        }
    }
}
