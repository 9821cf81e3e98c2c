//! The messages of the socket, both ways, and the document that describes them.

use std::collections::BTreeMap;

use contract::async_api::generator;
use schemars::{JsonSchema, SchemaGenerator};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use units::Utc;

/// A message of a program or page.
#[derive(Debug, PartialEq, JsonSchema, Deserialize)]
#[serde(tag = "op", rename_all = "snake_case", deny_unknown_fields)]
pub enum ClientMessage {
    /// Subscribes to topics.
    Sub {
        /// The topics, such as `net` or `tel/paranal/io`.
        topics: Vec<String>,
        /// Where to go on after an interruption.
        resume: Option<Resume>,
        /// At most so many changes of a topic per second: 0.1 to 10; 5 where it was never given.
        max_rate_hz: Option<f64>,
    },
    /// Ends subscriptions.
    Unsub {
        /// The topics, as they were given.
        topics: Vec<String>,
    },
    /// Asks for a `pong`.
    Ping {
        /// Comes back with it.
        t: Option<Value>,
    },
}

/// What a program has received before.
#[derive(Debug, PartialEq, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Resume {
    /// The `session` of the `welcome`; another one, after a restart of the web node, begins with a `snap`.
    pub session: String,
    /// The `seq` of the last message of each topic.
    pub seq: BTreeMap<String, u64>,
}

/// What a message of the server is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The first message: `session`, `version`, `speed` of the sky's clock, `heartbeat_s`, `most_topics`.
    Welcome,
    /// All of a topic.
    Snap,
    /// What has changed in a topic.
    Delta,
    /// Things that happened, in their order, each once.
    Event,
    /// Things that happened between `from` and `to` are no longer here: ask the archive for them.
    Gap,
    /// Each second, also when nothing happens.
    Beat,
    /// Answers a `ping`.
    Pong,
    /// What the program sent is not done: a problem as the API answers it.
    Err,
}

/// A message of the server.
#[derive(Debug, JsonSchema, Serialize)]
pub struct ServerMessage {
    /// What it is.
    pub op: Kind,
    /// Of which topic, as it was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// Number up to which the program knows the topic with this message.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seq: Option<u64>,
    /// Sky time of the server.
    pub at_utc: Utc,
    /// The content.
    pub data: Value,
}

/// The document about the socket, AsyncAPI 3.0.
pub fn document(version: &str) -> Value {
    let mut sent = generator();
    let mut received = SchemaGenerator::new(sent.settings().clone().for_deserialize());
    let schemas = [
        ("to-server", received.subschema_for::<ClientMessage>()),
        ("from-server", sent.subschema_for::<ServerMessage>()),
    ];
    let mut definitions = sent.take_definitions(true);
    definitions.extend(received.take_definitions(true));
    let messages: BTreeMap<&str, Value> =
        schemas.into_iter().map(|(name, schema)| (name, json!({ "name": name, "payload": schema }))).collect();
    let of = |name: &str| json!([{ "$ref": format!("#/channels/socket/messages/{name}") }]);
    json!({
        "asyncapi": "3.0.0",
        "info": {
            "title": "Starmesh: the socket of the API",
            "version": version,
            "description": "One WebSocket, at which a program subscribes to topics; docs/api.md describes them.",
            "license": { "name": "MIT OR Apache-2.0" },
        },
        "defaultContentType": "application/json",
        "channels": { "socket": {
            "address": "/api/v1/ws",
            "description": "Needs a session or token, where there are users; or a ticket of POST /api/v1/ws-ticket, as ?ticket=....",
            "messages": {
                "to-server": { "$ref": "#/components/messages/to-server" },
                "from-server": { "$ref": "#/components/messages/from-server" },
            },
        } },
        "operations": {
            "ask": { "action": "send", "channel": { "$ref": "#/channels/socket" }, "messages": of("to-server") },
            "listen": { "action": "receive", "channel": { "$ref": "#/channels/socket" }, "messages": of("from-server") },
        },
        "components": { "messages": messages, "schemas": definitions },
    })
}
