//! Why an `action_value` is refused, and what mends it.

use config::nearest;
use serde_json::Value;

/// The fault of an action's parameters, and what was expected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wrong {
    /// The parameter, spelt as it stands in the row; `None` where no single one is at fault.
    pub field: Option<String>,
    /// The fault and what was expected, without the name of the parameter.
    pub what: String,
    /// What to do about the parameter, where that is certain.
    pub mend: Option<Mend>,
}

/// What to do about a field that is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Mend {
    /// It has another name.
    Name(String),
    /// It has another value, as JSON.
    Value(String),
    /// It is left out.
    Remove,
}

impl Wrong {
    /// Of one parameter.
    pub fn of(field: impl Into<String>, what: impl Into<String>) -> Self {
        Self { field: Some(field.into()), ..Self::whole(what) }
    }

    /// Of the parameters as a whole.
    pub fn whole(what: impl Into<String>) -> Self {
        Self { field: None, what: what.into(), mend: None }
    }

    /// With what to do about it.
    pub fn mend(self, mend: Option<Mend>) -> Self {
        Self { mend, ..self }
    }
}

impl Mend {
    /// For a name that is unknown: the known one that was meant, or none.
    pub fn name<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Self {
        nearest(name, known).map_or(Self::Remove, |near| Self::Name(near.to_owned()))
    }

    /// For a word that is unknown: the known one that was meant, where there is one.
    pub fn word<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<Self> {
        nearest(word, known).map(|near| Self::Value(Value::from(near).to_string()))
    }
}

impl std::fmt::Display for Wrong {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.field {
            Some(field) => write!(f, "{field}: {}", self.what),
            None => f.write_str(&self.what),
        }
    }
}

impl std::error::Error for Wrong {}
