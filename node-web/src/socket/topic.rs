//! What a program subscribes to at the socket, as it writes it.

use contract::Address;
use contract::node::Level;

/// A topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Topic {
    /// `net`: one summary of each telescope.
    Network,
    /// `tel/SITE/TELESCOPE`: all that is published of a telescope and of what its site shares; with more words only the
    /// keys that begin with them, such as `tel/paranal/io/device/dome`.
    Telescope {
        /// The telescope.
        address: Address,
        /// First words of the keys, without the telescope; all where empty.
        below: String,
    },
    /// `frames/SITE/TELESCOPE`: each frame that is announced.
    Frames(Address),
    /// `alerts`: the active alerts of all telescopes.
    Alerts,
    /// `commands`: the newest commands given by this server, and how far they are.
    Commands,
    /// `log`, `log?telescope=SITE/TELESCOPE&level=warn`: each line of the nodes' logs.
    Log {
        /// Of this telescope only.
        telescope: Option<Address>,
        /// Of this level and the more urgent ones.
        level: Level,
    },
}

const EXPECTED: &str = "expected net, alerts, commands, log, log?telescope=SITE/TELESCOPE&level=warn, tel/SITE/TELESCOPE, \
                        tel/SITE/TELESCOPE/device/KIND/NAME or frames/SITE/TELESCOPE";

impl Topic {
    /// Reads a topic; the error says what was expected.
    pub fn read(text: &str) -> Result<Self, String> {
        let wrong = |what: &str| format!("{text:?} is no topic{what}; {EXPECTED}");
        let (path, query) = text.split_once('?').unwrap_or((text, ""));
        let words: Vec<&str> = path.split('/').collect();
        let address = |site, telescope| Address::new(site, telescope).map_err(|error| wrong(&format!(" ({error})")));
        if !query.is_empty() && path != "log" {
            return Err(wrong(" (only log has a query)"));
        }
        match words.as_slice() {
            ["net"] => Ok(Self::Network),
            ["alerts"] => Ok(Self::Alerts),
            ["commands"] => Ok(Self::Commands),
            ["log"] => Self::read_log(query).map_err(|what| wrong(&what)),
            ["frames", site, telescope] => Ok(Self::Frames(address(site, telescope)?)),
            ["tel", site, telescope, below @ ..] => {
                Ok(Self::Telescope { address: address(site, telescope)?, below: below.join("/") })
            }
            _ => Err(wrong("")),
        }
    }

    fn read_log(query: &str) -> Result<Self, String> {
        let (mut telescope, mut level) = (None, Level::Info);
        for part in query.split('&').filter(|part| !part.is_empty()) {
            match part.split_once('=') {
                Some(("telescope", name)) => {
                    let (site, name) = name.split_once('/').ok_or(" (a telescope is SITE/TELESCOPE)")?;
                    telescope = Some(Address::new(site, name).map_err(|error| format!(" ({error})"))?);
                }
                Some(("level", word)) => {
                    let unknown = |_| format!(" ({word:?} is no level: error, warn or info)");
                    level = serde_json::from_value(word.into()).map_err(unknown)?;
                }
                _ => return Err(format!(" ({part:?} is neither telescope= nor level=)")),
            }
        }
        Ok(Self::Log { telescope, level })
    }

    /// The telescope of which a right is needed; none for what is about all of them, which shows what the caller may see.
    pub fn telescope(&self) -> Option<&Address> {
        match self {
            Self::Telescope { address, .. } | Self::Frames(address) => Some(address),
            Self::Log { telescope, .. } => telescope.as_ref(),
            Self::Network | Self::Alerts | Self::Commands => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_topic_is_read_and_a_wrong_one_is_answered_with_what_was_expected() {
        let io = || Address::new("paranal", "io").unwrap();
        for (text, topic) in [
            ("net", Topic::Network),
            ("alerts", Topic::Alerts),
            ("commands", Topic::Commands),
            ("log", Topic::Log { telescope: None, level: Level::Info }),
            ("log?telescope=paranal/io&level=warn", Topic::Log { telescope: Some(io()), level: Level::Warn }),
            ("frames/paranal/io", Topic::Frames(io())),
            ("tel/paranal/io", Topic::Telescope { address: io(), below: String::new() }),
            ("tel/paranal/io/device/dome", Topic::Telescope { address: io(), below: "device/dome".to_owned() }),
        ] {
            assert_eq!(Topic::read(text), Ok(topic), "{text}");
        }
        for wrong in [
            "",
            "nets",
            "tel",
            "tel/paranal",
            "tel//io",
            "frames/paranal/io/x",
            "net?x",
            "log?level=loud",
            "log?telescope=io",
            "log?colour=red",
            "tel/Para nal/io",
        ] {
            let error = Topic::read(wrong).unwrap_err();
            assert!(error.contains("is no topic") && error.contains("expected net"), "{error}");
        }
    }
}
