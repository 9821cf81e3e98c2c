//! One parameter of an order: what it may be, and its value in an order that is given.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use crate::OrderedRow;

/// One parameter of an order.
#[derive(Debug, Clone, Copy)]
pub struct OrderParameter {
    /// Its name, with its unit.
    pub name: &'static str,
    /// What it is.
    pub meaning: &'static str,
    /// What it may be.
    pub value: ParameterValue,
}

/// What a parameter may be.
#[derive(Debug, Clone, Copy)]
pub enum ParameterValue {
    /// A text, which must be given.
    Text,
    /// A text that may be left out.
    OptionalText,
    /// A whole document of many lines, which must be given.
    Document,
    /// A whole number in a range, which must be given.
    Whole {
        /// The smallest.
        min: u32,
        /// The largest.
        max: u32,
    },
    /// A number in a range.
    Number {
        /// The smallest.
        min: f64,
        /// The largest.
        max: f64,
        /// What it is where it is not given; absent where the device's own value counts.
        default: Option<f64>,
    },
}

impl ParameterValue {
    /// Must it be given?
    pub const fn is_required(self) -> bool {
        matches!(self, Self::Text | Self::Document | Self::Whole { .. })
    }
}

impl OrderParameter {
    /// Its value where this was found, with its default where nothing was.
    ///
    /// # Errors
    /// It is missing, of another type or out of its range.
    pub(super) fn take(&self, found: Option<Value>) -> Result<Option<Value>, String> {
        Ok(match (self.value, found) {
            (ParameterValue::Text | ParameterValue::Document, Some(Value::String(text))) if !text.trim().is_empty() => {
                Some(Value::String(text))
            }
            (ParameterValue::OptionalText, Some(Value::String(text))) => Some(Value::String(text)),
            (ParameterValue::OptionalText, None) => None,
            (ParameterValue::Text | ParameterValue::Document, None | Some(Value::String(_)))
            | (ParameterValue::Whole { .. }, None) => return Err(format!("it is missing. {}", self.meaning)),
            (ParameterValue::Whole { min, max }, Some(found)) => {
                let number = found.as_u64().filter(|number| (u64::from(min)..=u64::from(max)).contains(number));
                if number.is_none() {
                    return Err(format!("expected a whole number from {min} to {max}, got {found}"));
                }
                Some(found)
            }
            (ParameterValue::Number { min, max, .. }, Some(Value::Number(number)))
                if number.as_f64().is_some_and(|number| (min..=max).contains(&number)) =>
            {
                Some(Value::Number(number))
            }
            (ParameterValue::Number { default, .. }, None) => default.map(|default| json!(default)),
            (ParameterValue::Number { min, max, .. }, Some(found)) => {
                return Err(format!("expected a number from {min} to {max}, got {found}"));
            }
            (_, Some(found)) => return Err(format!("expected a text, got {found}")),
        })
    }

    /// Its JSON Schema.
    pub(super) fn schema(&self) -> Value {
        let mut schema = match self.value {
            ParameterValue::Text | ParameterValue::Document => json!({ "type": "string", "minLength": 1 }),
            ParameterValue::OptionalText => json!({ "type": "string" }),
            ParameterValue::Whole { min, max } => json!({ "type": "integer", "minimum": min, "maximum": max }),
            ParameterValue::Number { min, max, default: Some(default) } => {
                json!({ "type": "number", "minimum": min, "maximum": max, "default": default })
            }
            ParameterValue::Number { min, max, default: None } => {
                json!({ "type": "number", "minimum": min, "maximum": max })
            }
        };
        schema["description"] = json!(self.meaning);
        schema
    }
}

/// The parameters of one order that were given, each of its type.
pub struct Given(BTreeMap<&'static str, Value>);

impl Given {
    pub(super) fn new(given: BTreeMap<&'static str, Value>) -> Self {
        Self(given)
    }

    pub(super) fn text(&self, name: &str) -> String {
        self.0.get(name).and_then(Value::as_str).unwrap_or_default().to_owned()
    }

    pub(super) fn optional(&self, name: &str) -> Option<String> {
        self.0.get(name).and_then(Value::as_str).map(str::to_owned)
    }

    pub(super) fn number(&self, name: &str) -> Option<f64> {
        self.0.get(name).and_then(Value::as_f64)
    }

    /// The row that is named as people count them, from 1.
    pub(super) fn row(&self) -> OrderedRow {
        let number = self.0.get("number").and_then(Value::as_u64).and_then(|number| u32::try_from(number).ok());
        OrderedRow { row: number.unwrap_or_default().saturating_sub(1), of: self.optional("of") }
    }

    /// A time given in minutes, s.
    pub(super) fn minutes_s(&self, name: &str) -> f64 {
        self.number(name).unwrap_or_default() * 60.0
    }
}
