//! The bus as an AsyncAPI document: every key with the JSON Schema of its payloads, for programs that read the bus or make
//! code for it.

use schemars::SchemaGenerator;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use crate::bus_page::{Pattern, patterns};
use crate::keys::ROOT;
use crate::row::{Carried, Piece};
use crate::table::{Topic, payloads};

/// The document, AsyncAPI 3.0.
pub fn document(version: &str) -> Value {
    let mut generator = generator();
    let mut messages = Map::new();
    for payload in payloads() {
        // A payload has its own name, unlike the Rust types that several kinds of devices have.
        let schema = (payload.schema)(&mut generator);
        messages.insert(payload.name.to_owned(), json!({ "name": payload.name, "payload": schema }));
    }
    let (channels, operations) =
        patterns().iter().map(|pattern| (channel(pattern), operation(pattern))).unzip::<_, _, Vec<_>, Vec<_>>();
    json!({
        "asyncapi": "3.0.0",
        "info": {
            "title": "Starmesh: the bus",
            "version": version,
            "description": "Everything that Starmesh nodes exchange over zenoh. A published payload is repeated as `x-rate` says; \
                            commands, orders and questions are zenoh queries with the question as their payload.",
            "license": { "name": "MIT OR Apache-2.0" },
        },
        "defaultContentType": "application/json",
        "channels": channels.into_iter().collect::<Map<_, _>>(),
        "operations": operations.into_iter().collect::<Map<_, _>>(),
        "components": {
            "messages": messages,
            "schemas": generator.take_definitions(true),
        },
    })
}

/// Makes schemas of what is sent. Types that are used twice stand once in the document, below `components/schemas`.
pub fn generator() -> SchemaGenerator {
    SchemaSettings::draft2020_12()
        .with(|settings| settings.definitions_path = "/components/schemas".into())
        .for_serialize()
        .into_generator()
}

/// Name of a channel: its key without what varies.
fn name(pattern: &Pattern) -> String {
    let words = pattern.text.split('/').skip(2).map(|word| word.trim_matches(['{', '}']));
    words.collect::<Vec<_>>().join(".")
}

fn channel(pattern: &Pattern) -> (String, Value) {
    let row = pattern.topic().row();
    let parameters = pattern.text.split('/').filter_map(|word| word.strip_prefix('{')?.strip_suffix('}'));
    let parameters: Map<String, Value> =
        parameters.map(|word| (word.to_owned(), json!({ "description": meaning(word, pattern.topic()) }))).collect();
    let messages: Map<String, Value> =
        pattern.names.iter().map(|name| (name.clone(), reference(&["components", "messages", name]))).collect();
    let channel = json!({
        "address": format!("{ROOT}/{}", pattern.text),
        "description": row.meaning,
        "parameters": parameters,
        "messages": messages,
        "x-rate": row.rate.to_string(),
        "x-carried": row.carried.to_string(),
        "x-writer": row.writer,
        "x-reader": row.reader,
    });
    (name(pattern), channel)
}

/// What a subscriber does with a channel: receive, or ask.
fn operation(pattern: &Pattern) -> (String, Value) {
    let id = name(pattern);
    let messages = |names: &[String]| -> Vec<Value> {
        names.iter().map(|message| reference(&["channels", &id, "messages", message])).collect()
    };
    let channel = reference(&["channels", &id]);
    if !matches!(pattern.topic().row().carried, Carried::Query | Carried::LargeAnswers) {
        let operation = json!({ "action": "receive", "channel": channel, "messages": messages(&pattern.names) });
        return (format!("receive-{id}"), operation);
    }
    // The names of a query are those of what is asked, of each kind, and then those of what is answered.
    let (asked, answered) = pattern.names.split_at(pattern.names.len().saturating_sub(1));
    let operation = json!({
        "action": "send",
        "channel": channel,
        "messages": messages(asked),
        "reply": { "channel": channel, "messages": messages(answered) },
    });
    (format!("ask-{id}"), operation)
}

fn meaning(word: &str, topic: Topic) -> String {
    let named = |piece: &Piece| match piece {
        Piece::Name(name) if *name == word => Some(format!("{name}: letters, digits, `_`, `-` and `.`")),
        _ => None,
    };
    match word {
        "site" => "site: small letters, digits and `-`".to_owned(),
        "telescope" => "telescope of the site, or `shared` for what its telescopes share".to_owned(),
        "kind" => "kind of device, as ASCOM calls it, in small letters".to_owned(),
        "role" => "role of the node: device, observatory, archive or web".to_owned(),
        _ => topic.row().pieces.iter().find_map(named).unwrap_or_else(|| word.to_owned()),
    }
}

/// A JSON pointer within the document.
fn reference(path: &[&str]) -> Value {
    let words: Vec<String> = path.iter().map(|word| word.replace('~', "~0").replace('/', "~1")).collect();
    json!({ "$ref": format!("#/{}", words.join("/")) })
}
