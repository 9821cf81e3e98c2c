//! What the parameters of an action may be: a JSON Schema made of the action's type, and whether given ones fit it.
//!
//! In addition to the words of JSON Schema there is `unit`. What no schema says (two parameters that exclude each
//! other) is the action's own `check`.

mod words;

use config::meant;
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value};
use units::Utc;

use self::words::{expected, shown};
pub use self::words::{kind, range};
use crate::wrong::{Mend, Wrong};

/// The schema of an action's parameters; one that it does not name is refused.
pub fn of<A: JsonSchema>(title: &str) -> Value {
    let settings = SchemaSettings::draft2020_12().with(|settings| settings.inline_subschemas = true);
    let mut schema = settings.into_generator().into_root_schema_for::<A>().to_value();
    tidy(&mut schema);
    if let Value::Object(schema) = &mut schema {
        schema.insert("title".to_owned(), title.into());
        schema.insert("additionalProperties".to_owned(), false.into());
    }
    schema
}

/// Joins the lines of descriptions, and drops the widths of Rust's numbers.
fn tidy(schema: &mut Value) {
    let Value::Object(words) = schema else { return };
    if let Some(Value::String(text)) = words.get_mut("description") {
        *text = text.replace('\n', " ");
    }
    let is_width = |format: &str| ["int", "uint", "float", "double"].iter().any(|number| format.starts_with(number));
    if words.get("format").and_then(Value::as_str).is_some_and(is_width) {
        words.shift_remove("format");
    }
    for word in ["properties", "anyOf", "oneOf", "items"] {
        match words.get_mut(word) {
            Some(Value::Array(schemas)) => schemas.iter_mut().for_each(tidy),
            Some(Value::Object(schemas)) if word == "properties" => schemas.values_mut().for_each(tidy),
            Some(schema) => tidy(schema),
            None => {}
        }
    }
}

/// The parameters that a schema knows, in the order in which they are reported.
pub fn properties(schema: &Value) -> impl Iterator<Item = (&str, &Value)> + Clone {
    schema["properties"].as_object().into_iter().flatten().map(|(name, schema)| (name.as_str(), schema))
}

/// Must this parameter be given?
pub fn is_required(schema: &Value, name: &str) -> bool {
    schema["required"].as_array().is_some_and(|names| names.iter().any(|required| required == name))
}

/// As [`check`]; then words to choose from are spelt as the action spells them.
pub fn checked(schema: &Value, mut given: Value) -> Result<Value, Wrong> {
    check(schema, &given)?;
    spell(schema, &mut given);
    Ok(given)
}

fn spell(schema: &Value, value: &mut Value) {
    match value {
        Value::String(word) => {
            if let Some(choice) = choices(schema).into_iter().flatten().find(|choice| alike(choice, word)) {
                *word = choice.to_owned();
            }
        }
        Value::Array(values) => values.iter_mut().for_each(|value| spell(&schema["items"], value)),
        Value::Object(given) => given.iter_mut().for_each(|(name, value)| spell(&schema["properties"][name], value)),
        Value::Null | Value::Bool(_) | Value::Number(_) => {}
    }
}

/// Refuses an unknown parameter, a missing one, and a value of another type or out of its range, in this order.
pub fn check(schema: &Value, given: &Value) -> Result<(), Wrong> {
    let Value::Object(given) = given else {
        return Err(Wrong::whole(format!("expected an object, found {}", shown(given))));
    };
    known(schema, given)?;
    for (name, about) in properties(schema) {
        match given.get(name) {
            Some(value) => allowed(name, about, value)?,
            None if is_required(schema, name) => {
                return Err(Wrong::of(name, format!("is missing; expected {}", expected(about))));
            }
            None => {}
        }
    }
    Ok(())
}

fn known(schema: &Value, given: &Map<String, Value>) -> Result<(), Wrong> {
    let names = properties(schema).map(|(name, _)| name);
    let Some(stranger) = given.keys().find(|key| names.clone().all(|name| name != *key)) else { return Ok(()) };
    let hint = match names.clone().next() {
        Some(_) => meant(stranger, names.clone()),
        None => "the action takes none".to_owned(),
    };
    Err(Wrong::of(stranger, format!("unknown parameter; {hint}")).mend(Some(Mend::name(stranger, names))))
}

fn allowed(name: &str, schema: &Value, value: &Value) -> Result<(), Wrong> {
    if fits(schema, value) {
        return Ok(());
    }
    match (value, choices(schema)) {
        (Value::String(word), Some(choices)) => {
            let what = format!("unknown word {word:?}; {}", meant(word, choices.clone()));
            Err(Wrong::of(name, what).mend(Mend::word(word, choices)))
        }
        (Value::Object(_), _) if schema["properties"].is_object() => {
            check(schema, value).map_err(|wrong| Wrong::of(name, wrong.to_string()))
        }
        _ => {
            let what = format!("expected {}, found {}", expected(schema), shown(value));
            Err(Wrong::of(name, what).mend(limit(schema, value).map(|end| Mend::Value(end.to_string()))))
        }
    }
}

/// The end of the range beyond which a number lies; not of an angle, which would be another place in the sky.
fn limit<'a>(schema: &'a Value, value: &Value) -> Option<&'a Value> {
    let number = value.as_f64().filter(|_| schema["unit"] != "deg")?;
    let (low, high) = (&schema["minimum"], &schema["maximum"]);
    let end = match low.as_f64().is_some_and(|low| number < low) {
        true => low,
        false => high.as_f64().filter(|high| number > *high).map(|_| high)?,
    };
    fits(schema, end).then_some(end)
}

fn fits(schema: &Value, value: &Value) -> bool {
    if let Some(schemas) = alternatives(schema) {
        return schemas.iter().any(|schema| fits(schema, value)) && is_within(schema, value);
    }
    let is_of_type = types(schema).any(|word| match word {
        "number" => value.is_number(),
        "integer" => value.is_i64() || value.is_u64(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        "null" => value.is_null(),
        _ => false,
    });
    is_of_type && is_within(schema, value)
}

fn is_within(schema: &Value, value: &Value) -> bool {
    match value {
        Value::Number(number) => {
            let number = number.as_f64().unwrap_or(f64::NAN);
            let (low, high) = (schema["minimum"].as_f64(), schema["maximum"].as_f64());
            low.is_none_or(|low| number >= low) && high.is_none_or(|high| number <= high)
        }
        Value::String(word) if is_time(schema) => word.parse::<Utc>().is_ok(),
        Value::String(word) => choices(schema).is_none_or(|all| all.iter().any(|choice| alike(choice, word))),
        Value::Array(values) => {
            let (least, most) = (schema["minItems"].as_u64(), schema["maxItems"].as_u64());
            let count = values.len() as u64;
            let is_long_enough = least.is_none_or(|least| count >= least) && most.is_none_or(|most| count <= most);
            let is_item = |value: &Value| schema["items"].is_null() || fits(&schema["items"], value);
            // the range of a parameter that is one number or a list of them is that of each
            let is_in_range = |value: &Value| !value.is_number() || is_within(schema, value);
            is_long_enough && values.iter().all(|value| is_item(value) && is_in_range(value))
        }
        Value::Object(_) => schema["properties"].is_null() || check(schema, value).is_ok(),
        Value::Null | Value::Bool(_) => true,
    }
}

fn is_time(schema: &Value) -> bool {
    schema["format"] == "date-time"
}

/// Schedules of other systems write the same word in upper case, with blanks or hyphens.
fn alike(choice: &str, word: &str) -> bool {
    let plain = |text: &str| text.trim().to_lowercase().replace([' ', '-', '_'], "");
    plain(choice) == plain(word)
}

fn types(schema: &Value) -> impl Iterator<Item = &str> {
    let one = schema["type"].as_str();
    let several = schema["type"].as_array().into_iter().flatten().filter_map(Value::as_str);
    one.into_iter().chain(several)
}

/// The schemas of which a value fits one.
pub fn alternatives(schema: &Value) -> Option<&Vec<Value>> {
    schema["anyOf"].as_array().or(schema["oneOf"].as_array())
}

/// The words that a text may be, where it is one of few.
fn choices(schema: &Value) -> Option<Vec<&str>> {
    if let Some(words) = schema["enum"].as_array() {
        return Some(words.iter().filter_map(Value::as_str).collect());
    }
    if let Some(word) = schema["const"].as_str() {
        return Some(vec![word]);
    }
    let words = alternatives(schema)?.iter().filter(|schema| schema["type"] != "null").map(choices);
    words.collect::<Option<Vec<_>>>().map(|words| words.concat())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn refused(schema: Value, value: Value) -> String {
        check(&json!({"properties": {"x": schema}}), &json!({"x": value})).unwrap_err().to_string()
    }

    #[test]
    fn numbers_are_refused_outside_their_range_with_range_and_unit() {
        let seconds = json!({"type": ["number", "null"], "minimum": 0, "maximum": 60, "unit": "s"});
        assert_eq!(refused(seconds.clone(), json!(-1)), "x: expected a number, 0 to 60 s, found -1");
        assert_eq!(refused(seconds.clone(), json!("1")), "x: expected a number, 0 to 60 s, found \"1\"");
        for good in [json!(0), json!(60), json!(0.5), Value::Null] {
            assert!(check(&json!({"properties": {"x": seconds}}), &json!({"x": good})).is_ok(), "{good}");
        }
        let bin = json!({"type": "integer", "minimum": 1, "maximum": 16});
        assert_eq!(refused(bin.clone(), json!(1.5)), "x: expected a whole number, 1 to 16, found 1.5");
        assert_eq!(refused(bin, Value::Null), "x: expected a whole number, 1 to 16, found null");
    }

    #[test]
    fn lists_are_measured_and_each_of_their_values_is_looked_at() {
        let pair = json!({"type": "array", "items": {"type": "number", "minimum": 0, "maximum": 9}, "minItems": 2, "maxItems": 2});
        assert_eq!(refused(pair.clone(), json!([1])), "x: expected a list of 2 numbers, 0 to 9, found [1]");
        assert!(refused(pair.clone(), json!([1, 10])).contains("found [1,10]"));
        let either = json!({"anyOf": [{"type": "number"}, pair, {"type": "null"}]});
        let ranged = json!({"anyOf": [{"type": "integer"}, {"type": "array", "items": {"type": "integer"}}], "minimum": 5, "maximum": 50});
        assert!(refused(ranged.clone(), json!([7, 4_294_967_296_u64])).contains("5 to 50, found [7,4294967296]"));
        assert!(fits(&ranged, &json!([9, 7])) && !fits(&ranged, &json!(4)));
        assert_eq!(refused(either, json!("x")), "x: expected a number or a list of 2 numbers, found \"x\"");
    }

    #[test]
    fn a_word_is_taken_in_any_case_and_a_slip_finds_the_one_that_was_meant() {
        let words = json!({"type": "string", "enum": ["single", "normalized_variance"]});
        for word in ["SINGLE", "Normalized Variance", "normalized-variance"] {
            assert!(fits(&words, &json!(word)), "{word}");
        }
        assert_eq!(refused(words.clone(), json!("singel")), "x: unknown word \"singel\"; did you mean \"single\"?");
        assert!(refused(words, json!(5)).contains("expected one of single, normalized_variance, found 5"));
    }

    #[test]
    fn words_of_an_enumeration_are_taken_in_any_case_and_spelt_as_the_type_spells_them() {
        #[derive(Debug, PartialEq, serde::Deserialize, JsonSchema)]
        #[serde(rename_all = "snake_case")]
        enum Source {
            /// Of the sky.
            TwilightSky,
            /// Of a panel.
            Panel,
        }
        #[derive(Debug, serde::Deserialize, JsonSchema)]
        struct Row {
            source: Source,
            other: Option<Source>,
            inner: Option<Inner>,
        }
        #[derive(Debug, serde::Deserialize, JsonSchema)]
        struct Inner {
            #[schemars(range(min = 0, max = 1))]
            share: f64,
        }
        let schema = of::<Row>("row");
        let read = |row: Value| -> Result<Row, String> {
            let row = checked(&schema, row).map_err(|wrong| wrong.to_string())?;
            serde_json::from_value(row).map_err(|error| format!("left to serde: {error}"))
        };
        let row = read(json!({"source": "Twilight Sky", "other": "PANEL", "inner": {"share": 1}})).unwrap();
        assert_eq!((row.source, row.other, row.inner.unwrap().share), (Source::TwilightSky, Some(Source::Panel), 1.0));
        assert!(read(json!({"source": "panel", "other": null, "inner": null})).is_ok());
        let refused = |row| read(row).unwrap_err();
        assert_eq!(refused(json!({"source": "pannel"})), "source: unknown word \"pannel\"; did you mean \"panel\"?");
        let beyond = json!({"source": "panel", "inner": {"share": 2}});
        assert_eq!(refused(beyond), "inner: share: expected a number, 0 to 1, found 2");
        assert!(refused(json!({"source": "panel", "inner": {"shair": 2}})).contains("did you mean \"share\"?"));
        assert_eq!(range(&schema["properties"]["source"]).unwrap(), "twilight_sky, panel");
    }

    #[test]
    fn the_finding_of_a_missing_parameter_names_what_was_expected_and_a_long_value_is_cut() {
        let schema = json!({"properties": {"x": {"type": "string"}}, "required": ["x"]});
        let missing = check(&schema, &json!({})).unwrap_err();
        assert_eq!(missing, Wrong::of("x", "is missing; expected a text"));
        assert!(refused(json!({"type": "number"}), json!("ä".repeat(500))).len() < 200);
        assert_eq!(
            check(&json!({}), &json!({"y": 1})).unwrap_err().to_string(),
            "y: unknown parameter; the action takes none"
        );
    }
}
