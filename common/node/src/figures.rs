//! Figures of a node's published state.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use contract::Scalar;

/// The figures of one node, by name; all clones are the same figures.
#[derive(Debug, Clone, Default)]
pub(crate) struct Figures {
    by_name: Arc<Mutex<BTreeMap<String, Scalar>>>,
}

impl Figures {
    /// Sets a figure; its name ends in its unit.
    pub(crate) fn set(&self, name: &str, value: Scalar) {
        self.by_name.lock().unwrap_or_else(PoisonError::into_inner).insert(name.to_owned(), value);
    }

    /// All of them, as they are now.
    pub(crate) fn all(&self) -> BTreeMap<String, Scalar> {
        self.by_name.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
