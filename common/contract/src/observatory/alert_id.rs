//! What an alert of the catalogue is called, and the alert itself.

use std::fmt::Display;

use units::Utc;

use super::{Alert, AlertKind};
use crate::Address;

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
        let id = self.id(instance);
        let [cause, consequence, action] = [cause, entry.consequence, entry.action].map(str::to_owned);
        let action = match (entry.instance, id.strip_prefix(entry.word)) {
            ("", _) | (_, None) => action,
            (placeholder, Some(instance)) => action.replace(placeholder, instance.trim_start_matches('/')),
        };
        Alert {
            id,
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
            node: None,
            missed_since_utc: None,
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

impl Alert {
    /// With the telescope in the commands and the names of files that a person should type; in the catalogue `SITE` and
    /// `TELESCOPE` stand for it.
    pub fn at(self, address: &Address) -> Self {
        let action =
            self.action.replace("SITE", address.site.as_str()).replace("TELESCOPE", address.telescope.as_str());
        Self { action, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observatory::catalogue::AlertEntry;

    #[test]
    fn what_to_do_names_the_telescope_and_the_instance_and_no_placeholder() {
        let callisto = Address::new("paranal", "callisto").unwrap();
        let alert = AlertKind::Override.alert("wx/Humidity", Utc::EPOCH, "c").at(&callisto);
        assert_eq!(alert.action, "Apply the limit again: starmesh order paranal/callisto restore wx/Humidity.");
        let alert = AlertKind::ClocksDisagree.alert("", Utc::EPOCH, "c").at(&callisto);
        assert!(alert.action.contains("remove clock-callisto.json"), "{}", alert.action);
        for kind in AlertKind::ALL {
            let action = kind.alert("instance-1", Utc::EPOCH, "c").at(&callisto).action;
            let placeholders = ["SITE", "TELESCOPE", kind.entry().instance].into_iter().filter(|word| !word.is_empty());
            for placeholder in placeholders {
                assert!(!action.contains(placeholder), "{kind:?}: {action}");
            }
        }
    }

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
