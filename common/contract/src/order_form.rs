//! What a person may order, as a form: words, parameters and the right it needs. The command line, the API and its documents are
//! made from it, so an order is the same everywhere.

mod parameter;

use std::collections::BTreeMap;
use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use self::parameter::Given;
pub use self::parameter::{OrderParameter, ParameterValue};
use crate::OrderKind;

/// The longest reason, characters: a line of the log has to hold it.
pub const LONGEST_REASON: usize = 500;

/// What somebody may do; each right contains those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Right {
    /// Reads everything but secrets and addresses of devices.
    Viewer,
    /// Also closes, writes comments, and proves schedules.
    Observer,
    /// Also opens, starts, puts schedules in force, and answers alerts.
    Operator,
    /// Also overrides limits, and reads the audit.
    Engineer,
}

impl Right {
    /// All of them, the least first.
    pub const ALL: [Self; 4] = [Self::Viewer, Self::Observer, Self::Operator, Self::Engineer];

    /// As it is written in files, and by the API.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Observer => "observer",
            Self::Operator => "operator",
            Self::Engineer => "engineer",
        }
    }
}

impl fmt::Display for Right {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// The form of one order.
#[derive(Debug, Clone, Copy)]
pub struct OrderForm {
    /// How it is called, such as `stay-closed`.
    pub word: &'static str,
    /// What it does, in one or two sentences.
    pub meaning: &'static str,
    /// The right that it needs.
    pub right: Right,
    /// It ends with a dome that is verified closed, which takes a while.
    pub closes: bool,
    /// It cannot be given without a reason.
    pub needs_reason: bool,
    /// Its parameters, those that are required first.
    pub parameters: &'static [OrderParameter],
    make: fn(&Given) -> OrderKind,
}

const ALERT: OrderParameter = OrderParameter {
    name: "alert",
    meaning: "Id of the alert, such as dome-not-closed/dome_1.",
    value: ParameterValue::Text,
};
const CAMERA: OrderParameter =
    OrderParameter { name: "camera", meaning: "Name of the camera.", value: ParameterValue::Text };
/// A schedule by order has at most 1,000,000 bytes, and so fewer rows.
const ROW: &[OrderParameter] = &[
    OrderParameter {
        name: "number",
        meaning: "Number of the row as the page and `starmesh schedule rows` show it: the first is 1.",
        value: ParameterValue::Whole { min: 1, max: 1_000_000 },
    },
    OrderParameter {
        name: "of",
        meaning: "SHA-256 of the schedule that the row stands in, in hexadecimal digits: where another one is in force, the order \
                  is refused. The one in force where it is absent.",
        value: ParameterValue::OptionalText,
    },
];
const INPUT: OrderParameter = OrderParameter {
    name: "input",
    meaning: "The input as `starmesh status` and the page name it, such as wx/Humidity or sun.",
    value: ParameterValue::Text,
};

/// A form of what is ordered without parameters and without a reason.
const fn plain(word: &'static str, meaning: &'static str, right: Right, make: fn(&Given) -> OrderKind) -> OrderForm {
    OrderForm { word, meaning, right, closes: false, needs_reason: false, parameters: &[], make }
}

/// Every order.
pub const ORDERS: &[OrderForm] = &[
    OrderForm {
        closes: true,
        ..plain("close", "Stop everything and close now; the robotic switch goes off.", Right::Observer, |_| {
            OrderKind::Close
        })
    },
    plain(
        "start",
        "Work through the schedule. While `stay-closed` stands, nothing opens before `open-again`.",
        Right::Operator,
        |_| OrderKind::Robotic(true),
    ),
    OrderForm {
        closes: true,
        ..plain("stop", "Stop working through the schedule, after closing.", Right::Operator, |_| {
            OrderKind::Robotic(false)
        })
    },
    plain("reload", "Read the schedule file again.", Right::Operator, |_| OrderKind::ReloadSchedule),
    OrderForm {
        closes: true,
        ..plain("stay-closed", "Close, and open for nobody until `open-again`.", Right::Operator, |_| {
            OrderKind::StayClosed(true)
        })
    },
    plain(
        "open-again",
        "Take `stay-closed` back; the schedule goes on once the sky is safe, where somebody has ordered `start`.",
        Right::Operator,
        |_| OrderKind::StayClosed(false),
    ),
    OrderForm {
        needs_reason: true,
        parameters: &[
            INPUT,
            OrderParameter {
                name: "minutes",
                meaning: "For so many minutes of sky time.",
                value: ParameterValue::Number { min: 1.0, max: 480.0, default: Some(60.0) },
            },
        ],
        ..plain(
            "override",
            "Do without one limit of the weather, or the Sun's, for a while.",
            Right::Engineer,
            |given| OrderKind::Override { input: given.text("input"), for_s: given.minutes_s("minutes") },
        )
    },
    OrderForm {
        parameters: &[INPUT],
        // The right to close contains the right to apply a limit again.
        ..plain("restore", "Apply an overridden limit again.", Right::Observer, |given| OrderKind::Override {
            input: given.text("input"),
            for_s: 0.0,
        })
    },
    OrderForm {
        parameters: &[ALERT],
        ..plain(
            "ack",
            "Somebody knows of an alert and sees to it: it is not escalated, and clears when its cause is gone.",
            Right::Operator,
            |given| OrderKind::Acknowledge(given.text("alert")),
        )
    },
    OrderForm {
        needs_reason: true,
        parameters: &[
            ALERT,
            OrderParameter {
                name: "for_min",
                meaning: "For so many minutes of sky time.",
                value: ParameterValue::Number { min: 1.0, max: 1440.0, default: Some(60.0) },
            },
        ],
        ..plain("shelve", "Send one alert to nobody for a while.", Right::Operator, |given| OrderKind::Shelve {
            alert: given.text("alert"),
            for_s: given.minutes_s("for_min"),
        })
    },
    OrderForm {
        parameters: &[ALERT],
        ..plain("unshelve", "Send a shelved alert again.", Right::Operator, |given| {
            OrderKind::Unshelve(given.text("alert"))
        })
    },
    OrderForm {
        parameters: ROW,
        ..plain(
            "skip",
            "Do without a row of tonight that has not ended; one at work ends with the frame under way.",
            Right::Operator,
            |given| OrderKind::Skip(given.row()),
        )
    },
    OrderForm {
        parameters: ROW,
        ..plain(
            "repeat",
            "Run a row again within its window: one that has finished from its first frame, one that failed or was skipped from \
             where it stopped, one that rests now.",
            Right::Operator,
            |given| OrderKind::Repeat(given.row()),
        )
    },
    OrderForm {
        parameters: &[
            CAMERA,
            OrderParameter {
                name: "temperature_c",
                meaning: "Set point, degrees Celsius; that of the configuration where absent.",
                value: ParameterValue::Number { min: -273.15, max: 100.0, default: None },
            },
        ],
        ..plain(
            "cool",
            "Run a camera's cooler now; the next row that exposes wants the configured set point again.",
            Right::Operator,
            |given| OrderKind::Cool { camera: given.text("camera"), set_c: given.number("temperature_c") },
        )
    },
    OrderForm {
        parameters: &[CAMERA],
        ..plain("warm", "Switch a camera's cooler off, until a row wants it.", Right::Operator, |given| {
            OrderKind::Warm(given.text("camera"))
        })
    },
    OrderForm {
        parameters: &[OrderParameter {
            name: "night",
            meaning: "Date of its evening, such as 20261121; the night under way where absent.",
            value: ParameterValue::OptionalText,
        }],
        ..plain(
            "complete-headers",
            "Complete the headers of a night again, with all that has arrived at the archive by now.",
            Right::Operator,
            |given| OrderKind::CompleteHeaders { night: given.optional("night") },
        )
    },
    OrderForm {
        parameters: &[
            OrderParameter {
                name: "text",
                meaning: "The whole schedule, a row per line, at most 1000000 bytes.",
                value: ParameterValue::Document,
            },
            OrderParameter {
                name: "instead_of",
                meaning: "SHA-256 of the schedule that it replaces, in hexadecimal digits: where another one is in force, the order \
                          is refused. Whatever is in force is replaced where it is absent.",
                value: ParameterValue::OptionalText,
            },
        ],
        ..plain(
            "put-schedule",
            "Put another schedule in the place of the one in force; refused with what is wrong where it is none.",
            Right::Operator,
            |given| OrderKind::PutSchedule { text: given.text("text"), instead_of: given.optional("instead_of") },
        )
    },
];

/// What is wrong with an order that was given.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BadOrder {
    /// There is none of that name.
    #[error("there is no order {word:?}; expected one of {}", words())]
    Unknown {
        /// What was given.
        word: String,
    },
    /// A parameter is missing, unknown or of another type.
    #[error("{parameter}: {problem}")]
    Parameter {
        /// Its name.
        parameter: String,
        /// What is wrong, and what is expected.
        problem: String,
    },
    /// It needs a reason.
    #[error("reason: {word} needs one, for those who read the log")]
    Reason {
        /// The order.
        word: &'static str,
    },
    /// Its reason is too long.
    #[error(
        "reason: expected at most {LONGEST_REASON} characters, got {length}; put the rest where people look for it"
    )]
    LongReason {
        /// How many characters it has.
        length: usize,
    },
}

/// Is this short enough for a reason? The command line, the bus and the API ask the same.
///
/// # Errors
/// Where it is too long.
pub fn check_reason(reason: &str) -> Result<(), BadOrder> {
    match reason.chars().count() {
        ..=LONGEST_REASON => Ok(()),
        length => Err(BadOrder::LongReason { length }),
    }
}

fn words() -> String {
    ORDERS.iter().map(|form| form.word).collect::<Vec<_>>().join(", ")
}

impl OrderForm {
    /// The form of this name.
    ///
    /// # Errors
    /// Where there is none; the names are in the error.
    pub fn of(word: &str) -> Result<&'static Self, BadOrder> {
        ORDERS.iter().find(|form| form.word == word).ok_or_else(|| BadOrder::Unknown { word: word.to_owned() })
    }

    /// The order with these parameters.
    ///
    /// # Errors
    /// Where one is missing, unknown, of another type or out of its range, and where a reason is needed and missing.
    pub fn fill(&self, given: &serde_json::Map<String, Value>, reason: &str) -> Result<OrderKind, BadOrder> {
        let wrong = |parameter: &str, problem: String| BadOrder::Parameter { parameter: parameter.to_owned(), problem };
        let is_known = |name: &str| self.parameters.iter().any(|parameter| parameter.name == name);
        if let Some(name) = given.keys().find(|name| !is_known(name)) {
            let names: Vec<&str> = self.parameters.iter().map(|parameter| parameter.name).collect();
            let expected =
                if names.is_empty() { "it has none".to_owned() } else { format!("it has {}", names.join(", ")) };
            return Err(wrong(name, format!("{} has no such parameter; {expected}", self.word)));
        }
        let mut filled = BTreeMap::new();
        for parameter in self.parameters {
            let found = given.get(parameter.name).filter(|value| !value.is_null()).cloned();
            let value = parameter.take(found).map_err(|problem| wrong(parameter.name, problem))?;
            if let Some(value) = value {
                filled.insert(parameter.name, value);
            }
        }
        check_reason(reason)?;
        if self.needs_reason && reason.trim().is_empty() {
            return Err(BadOrder::Reason { word: self.word });
        }
        Ok((self.make)(&Given::new(filled)))
    }

    /// The JSON Schema of its parameters.
    pub fn schema(&self) -> Value {
        let of = |parameter: &OrderParameter| (parameter.name.to_owned(), parameter.schema());
        let required = self.parameters.iter().filter(|parameter| parameter.value.is_required());
        json!({
            "type": "object",
            "properties": self.parameters.iter().map(of).collect::<serde_json::Map<_, _>>(),
            "required": required.map(|parameter| parameter.name).collect::<Vec<_>>(),
            "additionalProperties": false,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::OrderedRow;

    fn fill(word: &str, given: Value, reason: &str) -> Result<OrderKind, String> {
        let given = given.as_object().unwrap().clone();
        OrderForm::of(word).and_then(|form| form.fill(&given, reason)).map_err(|error| error.to_string())
    }

    #[test]
    fn an_order_is_made_of_its_words() {
        assert_eq!(fill("close", json!({}), ""), Ok(OrderKind::Close));
        let input = "wx/Humidity".to_owned();
        let overridden = |for_s| Ok(OrderKind::Override { input: input.clone(), for_s });
        assert_eq!(fill("override", json!({"input": input}), "dew sensor is broken"), overridden(3600.0));
        assert_eq!(fill("override", json!({"input": input, "minutes": 5}), "x"), overridden(300.0));
        assert_eq!(fill("restore", json!({"input": input}), ""), overridden(0.0));
        let cool = |set_c| Ok(OrderKind::Cool { camera: "c".to_owned(), set_c });
        assert_eq!(fill("cool", json!({"camera": "c"}), ""), cool(None));
        assert_eq!(fill("cool", json!({"camera": "c", "temperature_c": -60.5}), ""), cool(Some(-60.5)));
        // People count rows from 1, the bus from 0.
        let of = Some("abc".to_owned());
        assert_eq!(fill("skip", json!({"number": 4}), ""), Ok(OrderKind::Skip(OrderedRow { row: 3, of: None })));
        let again = fill("repeat", json!({"number": 1, "of": "abc"}), "");
        assert_eq!(again, Ok(OrderKind::Repeat(OrderedRow { row: 0, of })));
    }

    #[test]
    fn a_wrong_order_is_refused_with_what_is_expected() {
        for (word, given, reason, expected) in [
            ("open", json!({}), "", "expected one of close, start"),
            ("close", json!({"now": true}), "", "it has none"),
            ("override", json!({}), "x", "input: it is missing"),
            ("override", json!({"input": " "}), "x", "input: it is missing"),
            ("override", json!({"input": 3}), "x", "expected a text, got 3"),
            ("override", json!({"input": "sun"}), " ", "reason: override needs one"),
            ("override", json!({"input": "sun", "minutes": 481}), "x", "expected a number from 1 to 480, got 481"),
            ("override", json!({"input": "sun", "minutes": "60"}), "x", "expected a number from 1 to 480"),
            ("override", json!({"input": "sun", "minutes": 0}), "x", "expected a number from 1"),
            ("skip", json!({}), "", "number: it is missing. Number of the row as the page"),
            ("skip", json!({"number": 0}), "", "number: expected a whole number from 1 to 1000000, got 0"),
            ("repeat", json!({"number": 2.5}), "", "expected a whole number from 1 to 1000000, got 2.5"),
            ("repeat", json!({"number": "2"}), "", "expected a whole number from 1 to 1000000, got \"2\""),
            ("close", json!({}), &"\u{e9}".repeat(501), "reason: expected at most 500 characters, got 501"),
        ] {
            let error = fill(word, given.clone(), reason).unwrap_err();
            assert!(error.contains(expected), "{word} {given}: {error}");
        }
    }

    #[test]
    fn every_order_of_the_bus_has_a_form_and_closing_needs_the_least_right_that_orders() {
        let given =
            json!({"input": "sun", "alert": "a/b", "camera": "c", "text": "{}", "night": "20261121", "number": 2});
        let made: Vec<OrderKind> = ORDERS
            .iter()
            .map(|form| {
                let names: Vec<&str> = form.parameters.iter().map(|parameter| parameter.name).collect();
                let given = given.as_object().unwrap().iter().filter(|(name, _)| names.contains(&name.as_str()));
                form.fill(&given.map(|(name, value)| (name.clone(), value.clone())).collect(), "why").unwrap()
            })
            .collect();
        for kind in &made {
            // A new kind of order does not compile here before it has a form.
            let is_made = match kind {
                OrderKind::Robotic(on) => made.contains(&OrderKind::Robotic(!on)),
                OrderKind::StayClosed(on) => made.contains(&OrderKind::StayClosed(!on)),
                OrderKind::Close
                | OrderKind::ReloadSchedule
                | OrderKind::Override { .. }
                | OrderKind::Acknowledge(_)
                | OrderKind::Shelve { .. }
                | OrderKind::Unshelve(_)
                | OrderKind::PutSchedule { .. }
                | OrderKind::Cool { .. }
                | OrderKind::CompleteHeaders { .. }
                | OrderKind::Skip(_)
                | OrderKind::Repeat(_)
                | OrderKind::Warm(_) => true,
            };
            assert!(is_made, "{kind:?}");
        }
        assert_eq!(OrderForm::of("close").unwrap().right, Right::Observer);
        assert!(ORDERS.iter().all(|form| form.right >= Right::Observer));
    }
}
