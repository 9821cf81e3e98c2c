//! The generated part of `docs/bus.md`.

use std::fmt::Write as _;

use crate::Kind;
use crate::keys::ROOT;
use crate::row::{Piece, TopicRow};
use crate::table::Topic;

/// One line of the page: the keys of a topic, of all kinds of devices together or of one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern {
    /// The key after its root, with `{…}` for each chunk that varies.
    pub text: String,
    /// Names of its payloads (of a query: what is sent, then what is answered); `{kind}` stands for each kind.
    pub payloads: Vec<String>,
    /// The same names with each kind spelled out.
    pub names: Vec<String>,
    topic: Topic,
}

impl Pattern {
    /// The topic whose keys these are.
    pub fn topic(&self) -> Topic {
        self.topic
    }
}

/// Every line of the page, in its order.
pub fn patterns() -> Vec<Pattern> {
    Topic::ALL.iter().flat_map(|topic| patterns_of(*topic)).collect()
}

fn patterns_of(topic: Topic) -> Vec<Pattern> {
    let names = |kind: Kind| (topic.row().payloads)(kind).into_iter().map(|payload| payload.name.to_owned());
    match topic.kinds() {
        [] => vec![pattern(topic, "", names(Kind::Telescope).map(|name| (name.clone(), vec![name])).collect())],
        kinds if *kinds == Kind::ALL => {
            let of_any = names(Kind::Telescope).map(|name| name.replacen(Kind::Telescope.word(), "{kind}", 1));
            let spelled = |name: &String| {
                let mut all: Vec<String> = kinds.iter().map(|kind| name.replace("{kind}", kind.word())).collect();
                all.dedup();
                all
            };
            vec![pattern(topic, "{kind}", of_any.map(|name| (name.clone(), spelled(&name))).collect())]
        }
        kinds => kinds
            .iter()
            .map(|kind| pattern(topic, kind.word(), names(*kind).map(|name| (name.clone(), vec![name])).collect()))
            .collect(),
    }
}

/// `payloads` are the names, each with itself spelled out.
fn pattern(topic: Topic, kind: &str, payloads: Vec<(String, Vec<String>)>) -> Pattern {
    let mut text = "{site}/{telescope}".to_owned();
    for piece in topic.row().pieces {
        let _ = match piece {
            Piece::Word(word) | Piece::Part(word) => write!(text, "/{word}"),
            Piece::Kind(_) => write!(text, "/{kind}"),
            Piece::Name(name) => write!(text, "/{{{name}}}"),
            Piece::Role => write!(text, "/{{role}}"),
        };
    }
    let (payloads, names): (Vec<_>, Vec<_>) = payloads.into_iter().unzip();
    Pattern { text, payloads, names: names.concat(), topic }
}

/// The page: the table, then each payload once with the text that `sample` gives for its name.
pub fn markdown(sample: impl Fn(&str) -> String) -> String {
    let mut page = String::from("## Keys\n\n");
    let _ = writeln!(page, "Every key begins with `{ROOT}/`.\n");
    page.push_str("| Key | Payload | Meaning | When | Carried | Written (asked) by | Read (answered) by |\n");
    page.push_str("|---|---|---|---|---|---|---|\n");
    for Pattern { text, payloads, topic, .. } in patterns() {
        let payloads: Vec<String> = payloads.iter().map(|name| format!("`{name}`")).collect();
        let payloads = if payloads.is_empty() { "none".to_owned() } else { payloads.join(" → ") };
        let TopicRow { meaning, rate, carried, writer, reader, .. } = topic.row();
        let _ = writeln!(page, "| `{text}` | {payloads} | {meaning} | {rate} | {carried} | {writer} | {reader} |");
    }
    page.push_str("\n## Payloads\n");
    let mut shown: Vec<String> = Vec::new();
    for name in patterns().into_iter().flat_map(|pattern| pattern.names) {
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
    use crate::table;

    #[test]
    fn kinds_are_spelled_out_in_the_names() {
        let names: Vec<String> = patterns().into_iter().flat_map(|pattern| pattern.names).collect();
        assert!(names.contains(&"filterwheel.state".to_owned()));
        assert!(names.iter().all(|name| !name.contains('{')), "{names:?}");
        let known: Vec<&str> = table::payloads().iter().map(|payload| payload.name).collect();
        assert!(known.iter().all(|name| names.iter().any(|listed| listed == name)));
        assert!(names.iter().all(|name| known.contains(&name.as_str())), "the kind is in the name of each type");
    }
}
