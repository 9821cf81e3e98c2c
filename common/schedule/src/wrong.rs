//! Why an `action_value` is refused.

/// The fault of an action's parameters, and what was expected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wrong {
    /// The parameter, spelt as it stands in the row; `None` where no single one is at fault.
    pub field: Option<String>,
    /// The fault and what was expected, without the name of the parameter.
    pub what: String,
}

impl Wrong {
    /// Of one parameter.
    pub fn of(field: impl Into<String>, what: impl Into<String>) -> Self {
        Self { field: Some(field.into()), what: what.into() }
    }

    /// Of the parameters as a whole.
    pub fn whole(what: impl Into<String>) -> Self {
        Self { field: None, what: what.into() }
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
