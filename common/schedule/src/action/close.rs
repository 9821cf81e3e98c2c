//! `close`: parks the mount, closes roof and covers, and waits until that is verified.

use schemars::JsonSchema;
use serde::Deserialize;

use super::{ActionType, Needs, Parameters};

/// Parks the mount, closes the roof and the covers, and waits until that is verified.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Close {}

/// The note of a row that ends before everything is closed.
pub const TOO_LATE: &str = "not verified closed before end_time; the closing goes on";

impl ActionType for Close {
    const NAME: &'static str = "close";
    const EXAMPLE: &'static str = "{}";
}

impl Parameters for Close {
    fn needs(&self) -> Needs {
        Needs { safe: false, mount: true, parallel: false, all_before: false }
    }
}
