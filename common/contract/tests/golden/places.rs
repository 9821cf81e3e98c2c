//! Where in a JSON sample something stands.

use serde_json::Value;

/// One step down.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    Key(String),
    Index(usize),
}

/// The way from the top of a sample to one value in it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Place(pub Vec<Step>);

/// Objects whose keys are free: their keys are data, not names of the contract.
pub fn has_free_keys(name: &str, pattern: &str) -> bool {
    let last = pattern.rsplit('.').next().unwrap_or_default();
    matches!(last, "readings" | "figures" | "metadata" | "paired" | "sensor_ages_s" | "unread")
        && !pattern.starts_with("ask")
        || matches!((name, pattern), ("node.diary", "fields") | ("observatory.focus_learned", "focusers"))
        || is_any_json(name, pattern)
}

/// Values that may be any JSON, and all within them: a row of a schedule, a JSON Schema.
pub fn is_any_json(name: &str, pattern: &str) -> bool {
    let within = |place: &str| pattern.strip_prefix(place).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
    name == "actions.answer" && (within("actions.*.example") || within("actions.*.schema"))
}

impl Place {
    /// As the rules write it: keys joined by dots, `*` for any index and any free key; the top is empty.
    pub fn pattern(&self, name: &str) -> String {
        let mut pattern = String::new();
        for step in &self.0 {
            let word = match step {
                Step::Key(key) if !has_free_keys(name, &pattern) => key.as_str(),
                _ => "*",
            };
            if !pattern.is_empty() {
                pattern.push('.');
            }
            pattern.push_str(word);
        }
        pattern
    }

    pub fn get<'a>(&self, sample: &'a Value) -> &'a Value {
        self.0.iter().fold(sample, |value, step| match step {
            Step::Key(key) => &value[key],
            Step::Index(i) => &value[*i],
        })
    }

    pub fn get_mut<'a>(&self, sample: &'a mut Value) -> &'a mut Value {
        self.0.iter().fold(sample, |value, step| match step {
            Step::Key(key) => &mut value[key],
            Step::Index(i) => &mut value[*i],
        })
    }

    /// The sample with another value here.
    pub fn replaced(&self, sample: &Value, new: Value) -> Value {
        let mut changed = sample.clone();
        *self.get_mut(&mut changed) = new;
        changed
    }

    /// The sample without the key that ends this place; `None` where an index or nothing ends it.
    pub fn removed(&self, sample: &Value) -> Option<Value> {
        let (Step::Key(key), parents) = self.0.split_last()? else { return None };
        let mut changed = sample.clone();
        Self(parents.to_vec()).get_mut(&mut changed).as_object_mut()?.shift_remove(key)?;
        Some(changed)
    }

    /// Does a free key end this place?
    pub fn is_free(&self, name: &str) -> bool {
        matches!(self.0.split_last(), Some((Step::Key(_), parents)) if has_free_keys(name, &Self(parents.to_vec()).pattern(name)))
    }
}

/// Every place of a sample, the top first.
pub fn places(sample: &Value) -> Vec<Place> {
    fn walk(value: &Value, here: &Place, found: &mut Vec<Place>) {
        found.push(here.clone());
        let mut down = |step: Step, value: &Value| {
            let mut next = here.clone();
            next.0.push(step);
            walk(value, &next, found);
        };
        match value {
            Value::Object(map) => map.iter().for_each(|(key, value)| down(Step::Key(key.clone()), value)),
            Value::Array(list) => list.iter().enumerate().for_each(|(i, value)| down(Step::Index(i), value)),
            _ => {}
        }
    }
    let mut found = Vec::new();
    walk(sample, &Place::default(), &mut found);
    found
}
