//! The OpenAPI document as a page for people: no script, and nothing from elsewhere.

use std::fmt::Write as _;

use serde_json::Value;

use crate::problem::Code;

/// The page.
pub fn html(document: &Value) -> String {
    let mut page = String::from(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>Starmesh API</title>\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><link rel=\"stylesheet\" href=\"/assets/starmesh.css\">\
         <link rel=\"icon\" href=\"/assets/favicon.svg\"></head><body class=\"document\"><main>",
    );
    let info = &document["info"];
    let _ = write!(
        page,
        "<h1>Starmesh API</h1><p>Version {}. {}</p><p>The same for programs: <a href=\"/api/openapi.json\">OpenAPI</a>, and of the \
         bus and the socket AsyncAPI (<a href=\"/api/asyncapi.json\">bus</a>, <a href=\"/api/socket.json\">socket</a>).</p>",
        text(&info["version"]),
        text(&info["description"])
    );
    for (path, verbs) in document["paths"].as_object().into_iter().flatten() {
        for (verb, operation) in verbs.as_object().into_iter().flatten() {
            operation_section(&mut page, path, verb, operation);
        }
    }
    page.push_str("<h2>Problems</h2>");
    for code in Code::ALL {
        let _ = write!(
            page,
            "<section id=\"problem-{0}\"><h3>{0}</h3><p>Status {1}. {2}</p></section>",
            code.word(),
            code.status().as_u16(),
            escaped(code.meaning())
        );
    }
    page.push_str("<h2>Types</h2>");
    for (name, schema) in document["components"]["schemas"].as_object().into_iter().flatten() {
        let _ = write!(page, "<section id=\"{0}\"><h3>{0}</h3><p>{1}</p>", escaped(name), text(&schema["description"]));
        members(&mut page, schema);
        page.push_str("</section>");
    }
    page.push_str("</main></body></html>");
    page
}

fn operation_section(page: &mut String, path: &str, verb: &str, operation: &Value) {
    let _ = write!(
        page,
        "<section><h2><code>{} {}</code></h2><p>{}</p><p>Right: {}</p>",
        verb.to_uppercase(),
        escaped(path),
        text(&operation["summary"]),
        text(&operation["x-right"])
    );
    let parameters = operation["parameters"].as_array().map(Vec::as_slice).unwrap_or_default();
    if !parameters.is_empty() {
        page.push_str("<table><tr><th>Parameter</th><th>In</th><th>Type</th><th>Meaning</th></tr>");
        for parameter in parameters {
            let needed = if parameter["required"] == true { "" } else { " (optional)" };
            let _ = write!(
                page,
                "<tr><td><code>{}</code></td><td>{}{needed}</td><td>{}</td><td>{}</td></tr>",
                text(&parameter["name"]),
                text(&parameter["in"]),
                kind(&parameter["schema"]),
                text(&parameter["description"])
            );
        }
        page.push_str("</table>");
    }
    if let Some(schema) = operation.pointer("/requestBody/content/application~1json/schema") {
        let _ = write!(page, "<p>Takes JSON: {}</p>", kind(schema));
    }
    for media_type in operation["requestBody"]["content"].as_object().into_iter().flatten().map(|(name, _)| name) {
        if media_type != "application/json" {
            let _ = write!(page, "<p>Takes <code>{}</code></p>", escaped(media_type));
        }
    }
    for (status, answer) in
        operation["responses"].as_object().into_iter().flatten().filter(|(status, _)| *status != "default")
    {
        let content = answer["content"].as_object().into_iter().flatten().map(|(media_type, content)| {
            let schema = content.get("schema").map(|schema| format!(", {}", kind(schema))).unwrap_or_default();
            format!(" <code>{}</code>{schema}", escaped(media_type))
        });
        let _ = write!(page, "<p>{status}: {}{}</p>", text(&answer["description"]), content.collect::<String>());
    }
    page.push_str("</section>");
}

fn members(page: &mut String, schema: &Value) {
    let Some(properties) = schema["properties"].as_object() else {
        let _ = write!(page, "<p>{}</p>", kind(schema));
        return;
    };
    page.push_str("<table><tr><th>Member</th><th>Type</th><th>Meaning</th></tr>");
    for (name, member) in properties {
        let _ = write!(
            page,
            "<tr><td><code>{}</code></td><td>{}</td><td>{}</td></tr>",
            escaped(name),
            kind(member),
            text(&member["description"])
        );
    }
    page.push_str("</table>");
}

/// A schema in a few words, types with their own section as links.
fn kind(schema: &Value) -> String {
    if let Some(name) = schema["$ref"].as_str().and_then(|reference| reference.rsplit('/').next()) {
        return format!("<a href=\"#{0}\">{0}</a>", escaped(name));
    }
    if let Some(value) = schema.get("const") {
        return format!("<code>{}</code>", escaped(&value.to_string()));
    }
    if let Some(values) = schema["enum"].as_array() {
        let values: Vec<String> =
            values.iter().map(|value| format!("<code>{}</code>", escaped(&value.to_string()))).collect();
        return values.join(" or ");
    }
    for word in ["anyOf", "oneOf"] {
        if let Some(schemas) = schema[word].as_array() {
            return schemas.iter().map(kind).collect::<Vec<_>>().join(" or ");
        }
    }
    match &schema["type"] {
        Value::String(word) if word == "array" => format!("list of {}", kind(&schema["items"])),
        Value::String(word) if word == "object" && schema["additionalProperties"].is_object() => {
            format!("object of {}", kind(&schema["additionalProperties"]))
        }
        Value::String(word) => escaped(word),
        Value::Array(words) => words.iter().filter_map(Value::as_str).map(escaped).collect::<Vec<_>>().join(" or "),
        _ => "any".to_owned(),
    }
}

fn text(value: &Value) -> String {
    escaped(value.as_str().unwrap_or_default())
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
