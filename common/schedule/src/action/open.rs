//! `open`: opens roof and covers, takes the mount out of its park position, and starts the cooler.

use schemars::JsonSchema;
use serde::Deserialize;

use super::{ActionType, Needs, Parameters};

/// Opens the roof and the covers, takes the mount out of its park position, and starts the cooler.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Open {}

impl ActionType for Open {
    const NAME: &'static str = "open";
    const EXAMPLE: &'static str = "{}";
}

impl Parameters for Open {
    fn needs(&self) -> Needs {
        Needs { safe: true, mount: true, parallel: false, all_before: false }
    }
}
