//! The table of the bus: which key says what, how often, how safely, who writes it and who reads it.
//!
//! `docs/bus.md` is made from it; a test fails when a key has no row or the page is not what [`markdown`] gives.

use std::fmt::Write as _;

use crate::{Kind, key::ROOT};

/// What is known of one sort of key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row {
    /// The key below [`ROOT`], with `{…}` for each chunk that varies.
    pub pattern: &'static str,
    /// Names of its payloads (of a query: what is sent, then what is answered); `{kind}` stands for each kind.
    pub payloads: &'static [&'static str],
    /// What it says.
    pub says: &'static str,
    /// When it is said.
    pub rate: &'static str,
    /// How zenoh carries it.
    pub qos: &'static str,
    /// Its one writer; of a query, who asks.
    pub writer: &'static str,
    /// Who reads it; of a query, who answers.
    pub reader: &'static str,
}

/// A level: each sample stands for itself, and the newest is enough.
const STATE: &str = "drop, advanced publisher with cache 1; answers a plain `get`";
/// Readings are recorded, so that ten minutes of them are kept for a reader that was cut off.
const TELEMETRY: &str =
    "drop, advanced publisher with a cache of ten minutes and more, recovery; answers a plain `get`";
/// Must overtake everything else.
const URGENT: &str = "drop, real-time priority, express";
/// Must arrive, late if need be.
const EVENT: &str = "drop, advanced publisher with cache 1000, recovery";
/// Answered at once, else its outcome is unknown.
const QUERY: &str = "query, interactive priority, express";

/// One row per sort of key.
pub const TABLE: &[Row] = &[
    Row {
        pattern: "{site}/{telescope}/device/{kind}/{name}/capabilities",
        payloads: &["{kind}.capabilities"],
        says: "what the device can do, and what it says of itself",
        rate: "on change, and every 10 s",
        qos: STATE,
        writer: "device node",
        reader: "observatory, web, archive",
    },
    Row {
        pattern: "{site}/{telescope}/device/{kind}/{name}/state",
        payloads: &["{kind}.state"],
        says: "what is true of the device now: link, typed fields, readings, last command",
        rate: "at every poll and change, at least every `period_s` (1 to 5 s)",
        qos: TELEMETRY,
        writer: "device node",
        reader: "observatory, web, archive",
    },
    Row {
        pattern: "{site}/{telescope}/device/{kind}/{name}/command",
        payloads: &["{kind}.command", "reply"],
        says: "do something; answered at once, done when state says so",
        rate: "when asked",
        qos: QUERY,
        writer: "observatory; web and archive where no token is needed",
        reader: "device node",
    },
    Row {
        pattern: "{site}/{telescope}/device/camera/{name}/frame",
        payloads: &["camera.frame"],
        says: "a frame is safe in the spool and can be fetched by HTTP",
        rate: "event",
        qos: EVENT,
        writer: "device node",
        reader: "archive, observatory, web",
    },
    Row {
        pattern: "{site}/{telescope}/device/dome/{name}/guard",
        payloads: &["dome.guard"],
        says: "the guard's number, the permits that it counts, what it does",
        rate: "every 1 s",
        qos: URGENT,
        writer: "device node of the dome",
        reader: "observatory, web",
    },
    Row {
        pattern: "{site}/{telescope}/device/observingconditions/{name}/record",
        payloads: &["record.question", "observingconditions.record"],
        says: "what a weather station said before: evidence for an observatory node that was restarted",
        rate: "when asked",
        qos: QUERY,
        writer: "observatory",
        reader: "device node",
    },
    Row {
        pattern: "{site}/{telescope}/device/switch/{name}/record",
        payloads: &["record.question", "switch.record"],
        says: "what a set of switches said before: evidence for an observatory node that was restarted",
        rate: "when asked",
        qos: QUERY,
        writer: "observatory",
        reader: "device node",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/safety/state",
        payloads: &["observatory.safety"],
        says: "the verdict, its reasons, and every input with its age",
        rate: "on change, and every 1 s",
        qos: TELEMETRY,
        writer: "observatory node",
        reader: "web, archive",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/lease/state",
        payloads: &["observatory.lease"],
        says: "who commands, with which fencing token",
        rate: "on change, and every 1 s",
        qos: STATE,
        writer: "observatory node",
        reader: "web",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/night/state",
        payloads: &["observatory.night"],
        says: "posture, the robotic switch, and the actions under way",
        rate: "on change, and every 1 s",
        qos: STATE,
        writer: "observatory node",
        reader: "web, archive",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/schedule/state",
        payloads: &["observatory.schedule"],
        says: "the rows of the schedule and how far they are",
        rate: "on change, and every 10 s",
        qos: STATE,
        writer: "observatory node",
        reader: "web",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/alerts/state",
        payloads: &["alerts"],
        says: "what needs a person, merged from all nodes of the telescope",
        rate: "on change, and every 10 s",
        qos: STATE,
        writer: "observatory node",
        reader: "web",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/pointing/state",
        payloads: &["observatory.pointing"],
        says: "where the telescope looks when it is sent somewhere, and the pointing models",
        rate: "on change, and every 10 s",
        qos: STATE,
        writer: "observatory node",
        reader: "observatory nodes that stand by, web",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/guiding/state",
        payloads: &["observatory.guiding"],
        says: "how the guide loop does",
        rate: "on change, and every 10 s",
        qos: STATE,
        writer: "observatory node",
        reader: "web",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/guiding/reference",
        payloads: &["observatory.guide_reference"],
        says: "where the stars of a field stood that guiding holds",
        rate: "event",
        qos: EVENT,
        writer: "observatory node",
        reader: "observatory nodes that stand by",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/focus/state",
        payloads: &["observatory.focus"],
        says: "how the focus run does, with all its points, and the best known positions",
        rate: "on change, and every 10 s",
        qos: STATE,
        writer: "observatory node",
        reader: "web",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/focus/run",
        payloads: &["observatory.focus_run"],
        says: "a focus run that has ended, with all its points and the curve",
        rate: "event",
        qos: EVENT,
        writer: "observatory node",
        reader: "archive, observatory nodes that stand by",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/focus-learnt/state",
        payloads: &["observatory.focus_learnt"],
        says: "what the focus runs of many nights taught, of which best position, offsets and coefficient are made",
        rate: "on change, and every 10 s",
        qos: STATE,
        writer: "observatory node",
        reader: "observatory nodes that stand by",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/standing/state",
        payloads: &["observatory.standing"],
        says: "what people have ordered and what holds until it is taken back or ends",
        rate: "on change, and every 1 s",
        qos: STATE,
        writer: "observatory node",
        reader: "observatory nodes that stand by, web",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/optics/state",
        payloads: &["observatory.optics"],
        says: "what solved frames taught: scale, rotation and distortion of each camera, and the best zero points",
        rate: "on change, and every 10 s",
        qos: STATE,
        writer: "observatory node",
        reader: "observatory nodes that stand by, web",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/permit/{dome}",
        payloads: &["observatory.permit"],
        says: "may this dome be open? Silence is a no",
        rate: "every 1 s",
        qos: URGENT,
        writer: "observatory node",
        reader: "device nodes of the dome and the mount",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/frame/{id}/facts",
        payloads: &["observatory.facts"],
        says: "what was measured on a frame",
        rate: "event",
        qos: EVENT,
        writer: "observatory node",
        reader: "web, archive",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/guiding/correction",
        payloads: &["observatory.correction"],
        says: "how far a frame of the guide loop stands off, and the pulses that followed",
        rate: "event",
        qos: EVENT,
        writer: "observatory node",
        reader: "archive",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/order",
        payloads: &["order", "reply"],
        says: "a person's order",
        rate: "when asked",
        qos: QUERY,
        writer: "web, command line",
        reader: "observatory node",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/actions",
        payloads: &["actions.question", "actions.answer"],
        says: "the actions that a schedule may ask for, with the schema of their parameters; a plain `get` brings all",
        rate: "when asked",
        qos: QUERY,
        writer: "web, command line, anybody",
        reader: "observatory node",
    },
    Row {
        pattern: "{site}/{telescope}/observatory/schedule/check",
        payloads: &["schedule.draft", "schedule.findings"],
        says: "what is wrong with a schedule, which is not made active; the answer may take seconds for thousands of rows",
        rate: "when asked",
        qos: QUERY,
        writer: "web, command line, anybody",
        reader: "observatory node",
    },
    Row {
        pattern: "{site}/{telescope}/archive/stored",
        payloads: &["archive.stored"],
        says: "a file is safe on the archive's disk",
        rate: "event",
        qos: EVENT,
        writer: "archive node",
        reader: "web, observatory",
    },
    Row {
        pattern: "{site}/{telescope}/archive/history",
        payloads: &["archive.question", "archive.answer"],
        says: "question and answer about the past",
        rate: "when asked",
        qos: QUERY,
        writer: "web, command line, anybody",
        reader: "archive node",
    },
    Row {
        pattern: "{site}/{telescope}/node/{role}/{id}/state",
        payloads: &["node.state"],
        says: "health of a node",
        rate: "every 5 s",
        qos: STATE,
        writer: "each node",
        reader: "web, command line, archive",
    },
    Row {
        pattern: "{site}/{telescope}/node/{role}/{id}/alerts",
        payloads: &["alerts"],
        says: "what a node itself needs a person for",
        rate: "on change, and every 10 s",
        qos: STATE,
        writer: "each node",
        reader: "observatory, web",
    },
    Row {
        pattern: "{site}/{telescope}/node/{role}/{id}/diary",
        payloads: &["node.diary"],
        says: "a line of the node's log",
        rate: "event",
        qos: EVENT,
        writer: "each node",
        reader: "archive, web, command line",
    },
    Row {
        pattern: "{site}/{telescope}/node/{role}/{id}/audit",
        payloads: &["node.audit"],
        says: "who ordered or moved what, when, with which token, and what became of it; each record holds the hash of the one before",
        rate: "event, once it is on the node's disk",
        qos: EVENT,
        writer: "device and observatory nodes",
        reader: "archive, anybody",
    },
    Row {
        pattern: "{site}/{telescope}/node/{role}/{id}/audit-since",
        payloads: &["audit.question", "audit.answer"],
        says: "the records of the node's own file, in portions",
        rate: "when asked",
        qos: QUERY,
        writer: "archive, command line, anybody",
        reader: "device and observatory nodes",
    },
    Row {
        pattern: "{site}/{telescope}/node/{role}/{id}/alive",
        payloads: &[],
        says: "the node's session lives; a hint only, nobody's safety rests on it",
        rate: "while connected",
        qos: "liveliness token, no payload",
        writer: "each node",
        reader: "web, command line",
    },
];

impl Row {
    /// Is `key` (written in full) of this sort?
    pub fn matches(&self, key: &str) -> bool {
        let Some(rest) = key.strip_prefix(ROOT).and_then(|rest| rest.strip_prefix('/')) else { return false };
        rest.split('/').count() == self.pattern.split('/').count()
            && rest.split('/').zip(self.pattern.split('/')).all(|(chunk, word)| word.starts_with('{') || word == chunk)
    }

    /// Names of all its payloads, with each kind spelled out.
    pub fn names(&self) -> Vec<String> {
        let each = |name: &&str| -> Vec<String> {
            if name.contains("{kind}") {
                Kind::ALL.iter().map(|kind| name.replace("{kind}", kind.word())).collect()
            } else {
                vec![(*name).to_owned()]
            }
        };
        self.payloads.iter().flat_map(each).collect()
    }
}

/// The generated part of `docs/bus.md`: the table, then each payload once with the text that `sample` gives for its
/// name.
pub fn markdown(sample: impl Fn(&str) -> String) -> String {
    let mut page = String::from("## Keys\n\n");
    let _ = writeln!(page, "Every key begins with `{ROOT}/`.\n");
    page.push_str("| Key | Payload | Says | When | Carried | Written (asked) by | Read (answered) by |\n");
    page.push_str("|---|---|---|---|---|---|---|\n");
    for row in TABLE {
        let payloads: Vec<String> = row.payloads.iter().map(|name| format!("`{name}`")).collect();
        let payloads = if payloads.is_empty() { "none".to_owned() } else { payloads.join(" → ") };
        let Row { pattern, says, rate, qos, writer, reader, .. } = row;
        let _ = writeln!(page, "| `{pattern}` | {payloads} | {says} | {rate} | {qos} | {writer} | {reader} |");
    }
    page.push_str("\n## Payloads\n");
    let mut shown: Vec<String> = Vec::new();
    for name in TABLE.iter().flat_map(Row::names) {
        if !shown.contains(&name) {
            let _ = write!(page, "\n### `{name}`\n\n```json\n{}\n```\n", sample(&name).trim_end());
            shown.push(name);
        }
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Address, Key, Name, NodeTopic, Part, Role};

    /// Number of each sort of key. A new variant stops the compiler here: number it, and add it to `every_key`.
    fn number(key: &Key) -> usize {
        match key {
            Key::Capabilities(_) => 0,
            Key::State(_) => 1,
            Key::Command(_) => 2,
            Key::Frame(_) => 3,
            Key::Guard(_) => 4,
            Key::Record(_) => 12,
            Key::Observatory(..) => 5,
            Key::Permit(..) => 6,
            Key::Facts(..) => 7,
            Key::Order(_) => 8,
            Key::Stored(_) => 9,
            Key::History(_) => 10,
            Key::Node(..) => 11,
            Key::Correction(_) => 13,
            Key::FocusRun(..) => 14,
            Key::GuideReference(..) => 15,
            Key::Actions(_) => 16,
            Key::ScheduleCheck(_) => 17,
        }
    }
    const SORTS: usize = 18;

    fn every_key() -> Vec<Key> {
        let at = Address::new("paranal", "callisto").unwrap();
        let name: Name = "alpha".parse().unwrap();
        let mut keys = vec![
            Key::Frame(at.device(Kind::Camera, &name)),
            Key::Guard(at.device(Kind::Dome, &name)),
            Key::Record(at.device(Kind::ObservingConditions, &name)),
            Key::Record(at.device(Kind::Switch, &name)),
            Key::Permit(at.clone(), name.clone()),
            Key::Facts(at.clone(), name.clone()),
            Key::Correction(at.clone()),
            Key::GuideReference(at.clone()),
            Key::FocusRun(at.clone()),
            Key::Order(at.clone()),
            Key::Actions(at.clone()),
            Key::ScheduleCheck(at.clone()),
            Key::Stored(at.clone()),
            Key::History(at.clone()),
        ];
        for kind in Kind::ALL {
            let device = at.device(kind, &name);
            keys.extend([Key::Capabilities(device.clone()), Key::State(device.clone()), Key::Command(device)]);
        }
        keys.extend(Part::ALL.map(|part| Key::Observatory(at.clone(), part)));
        for role in Role::ALL {
            keys.extend(NodeTopic::ALL.map(|topic| Key::Node(at.clone(), role, name.clone(), topic)));
        }
        keys
    }

    #[test]
    fn every_key_has_exactly_one_row() {
        let keys = every_key();
        for sort in 0..SORTS {
            assert!(keys.iter().any(|key| number(key) == sort), "no example of sort {sort}");
        }
        for key in &keys {
            let text = key.to_string();
            let rows: Vec<_> = TABLE.iter().filter(|row| row.matches(&text)).map(|row| row.pattern).collect();
            assert_eq!(rows.len(), 1, "{text} is of the rows {rows:?}");
        }
        for row in TABLE {
            assert!(keys.iter().any(|key| row.matches(&key.to_string())), "no key is of the row {}", row.pattern);
        }
    }

    #[test]
    fn a_key_of_another_version_is_of_no_row() {
        for text in ["starmesh/v2/a/b/archive/stored", "starmesh/v1/a/b/archive/stored/x", "starmesh/v1", ""] {
            assert!(TABLE.iter().all(|row| !row.matches(text)), "{text}");
        }
    }

    #[test]
    fn kinds_are_spelled_out_in_the_names() {
        let names: Vec<String> = TABLE.iter().flat_map(Row::names).collect();
        assert!(names.contains(&"filterwheel.state".to_owned()));
        assert!(names.iter().all(|name| !name.contains('{')), "{names:?}");
    }
}
