//! The API as an OpenAPI document, made from its endpoints.

use contract::Right;
use schemars::SchemaGenerator;
use schemars::generate::Contract;
use serde_json::{Map, Value, json};

use super::endpoint::{Answer, Endpoint, Needs};
use crate::problem::ProblemDocument;

/// The document, OpenAPI 3.1.
pub fn document(endpoints: &[Endpoint], version: &str) -> Value {
    // What is answered, and what is taken: of the latter, what may be left out is not required.
    let mut generator = contract::async_api::generator();
    let mut taken = generator_of_requests();
    let problem = generator.subschema_for::<ProblemDocument>();
    let mut paths: Map<String, Value> = Map::new();
    for endpoint in endpoints {
        let operation = operation(endpoint, &mut generator, &mut taken);
        let path = paths.entry(endpoint.path).or_insert_with(|| json!({}));
        path[endpoint.verb.word()] = operation;
    }
    let mut schemas = taken.take_definitions(true);
    schemas.extend(generator.take_definitions(true));
    let description = "Every read and every command of a network of telescopes. Times are RFC 3339 UTC with `Z`, angles are degrees, a \
                       number's name ends in its unit, and a missing value is `null` or absent, never NaN. Unknown members and \
                       enum values may come; ignore them. Errors are problem documents (RFC 9457).";
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "Starmesh",
            "version": version,
            "description": description,
            "license": { "name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0" },
        },
        "servers": [{ "url": "/" }],
        "security": [{ "token": [] }, { "session": [] }, {}],
        "paths": paths,
        "components": {
            "securitySchemes": {
                "token": { "type": "http", "scheme": "bearer", "description": "A token that `starmesh user token add` printed." },
                "session": { "type": "apiKey", "in": "cookie", "name": "starmesh", "description": "What `POST /api/v1/login` sets." },
            },
            "responses": {
                "Problem": {
                    "description": "What is wrong, and what to do.",
                    "content": { "application/problem+json": { "schema": problem } },
                },
            },
            "schemas": schemas,
        },
    })
}

fn generator_of_requests() -> SchemaGenerator {
    let mut settings = contract::async_api::generator().settings().clone();
    settings.contract = Contract::Deserialize;
    settings.into_generator()
}

fn operation(endpoint: &Endpoint, generator: &mut SchemaGenerator, taken: &mut SchemaGenerator) -> Value {
    let mut operation = json!({
        "operationId": endpoint.id,
        "summary": endpoint.summary,
        "tags": [tag(endpoint.path)],
        "parameters": parameters(endpoint, taken),
        "responses": responses(endpoint, generator),
        "x-right": right(endpoint.needs),
    });
    if endpoint.needs == Needs::Nothing {
        operation["security"] = json!([{}]);
    }
    if endpoint.body.is_some() || endpoint.body_media.is_some() {
        let json = endpoint.body.map(|body| ("application/json".to_owned(), json!({ "schema": body(taken) })));
        let other =
            endpoint.body_media.map(|media_type| (media_type.to_owned(), json!({ "schema": { "type": "string" } })));
        let content: Map<String, Value> = json.into_iter().chain(other).collect();
        operation["requestBody"] = json!({ "required": true, "content": content });
    }
    operation
}

/// The first word of a path that says what it is about.
fn tag(path: &str) -> &str {
    let mut words = path.split('/').filter(|word| !word.is_empty() && !matches!(*word, "api" | "v1"));
    match words.clone().count() {
        4.. if words.clone().next() == Some("telescopes") => words.nth(3).unwrap_or("telescopes"),
        _ => words.next().unwrap_or("page"),
    }
}

/// What it needs, in a few words.
pub fn right(needs: Needs) -> String {
    match needs {
        Needs::Nothing => "none".to_owned(),
        Needs::Known => "signed in".to_owned(),
        Needs::Everywhere(right) => format!("{right} of all telescopes"),
        Needs::Anywhere(right) | Needs::There(right) => Right::word(right).to_owned(),
    }
}

fn parameters(endpoint: &Endpoint, generator: &mut SchemaGenerator) -> Vec<Value> {
    let in_path = endpoint.path.split('/').filter_map(|word| word.strip_prefix('{')?.strip_suffix('}'));
    let mut parameters: Vec<Value> = in_path
        .map(|name| {
            let description = match name {
                "site" => "The site.",
                "telescope" => "The telescope, or `shared` for what the telescopes of the site share.",
                "draft" => "The draft: letters, digits, `_`, `-` or `.`.",
                "version" => "The version, from 1.",
                "id" => "Its id.",
                "camera" => "Configured name of the camera.",
                "night" => "The date of its evening at the site, such as 20261121.",
                "z" => "The level: 0 is the whole frame in one tile, each next one has twice as many columns and rows.",
                "x" => "Column of the tile, from 0.",
                "y" => "Row of the tile, from 0.",
                _ => "",
            };
            json!({ "name": name, "in": "path", "required": true, "description": description, "schema": { "type": "string" } })
        })
        .collect();
    for (name, meaning, is_required) in &endpoint.headers {
        parameters.push(json!({
            "name": name, "in": "header", "required": is_required, "description": meaning, "schema": { "type": "string" },
        }));
    }
    let query = endpoint.query.map(|schema| schema(generator).to_value()).unwrap_or_default();
    let required: Vec<&str> = query["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    for (name, schema) in query["properties"].as_object().into_iter().flatten() {
        let mut schema = schema.clone();
        let description = schema.as_object_mut().and_then(|words| words.shift_remove("description"));
        parameters.push(json!({
            "name": name, "in": "query", "required": required.contains(&name.as_str()), "description": description, "schema": schema,
        }));
    }
    parameters
}

fn responses(endpoint: &Endpoint, generator: &mut SchemaGenerator) -> Value {
    let mut responses = Map::new();
    for Answer { status, meaning, content } in &endpoint.answers {
        // One status may have several forms.
        let response = responses.entry(status.to_string()).or_insert_with(|| json!({ "description": meaning }));
        if let Some((media_type, schema)) = content {
            let schema = schema.map(|schema| json!({ "schema": schema(generator) })).unwrap_or_else(|| json!({}));
            response["content"][*media_type] = schema;
        }
    }
    responses.insert("default".to_owned(), json!({ "$ref": "#/components/responses/Problem" }));
    Value::Object(responses)
}
