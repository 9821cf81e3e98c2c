//! `complete_headers`: waits until the archive has stored every frame of this night with a complete header.

use schemars::JsonSchema;
use serde::Deserialize;

use super::{ActionType, Needs, Parameters};

/// Waits until the archive has stored every frame of this night with a whole header; the archive completes headers by
/// itself, and nothing is commanded.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct CompleteHeaders {}

impl ActionType for CompleteHeaders {
    const NAME: &'static str = "complete_headers";
    const EXAMPLE: &'static str = "{}";
}

impl Parameters for CompleteHeaders {
    fn needs(&self) -> Needs {
        Needs { safe: false, mount: false, parallel: false, all_before: true }
    }
}
