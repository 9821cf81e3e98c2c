//! What no message to a user may contain.

/// Words of programmers, which nobody sees.
pub const FOREIGN: &[&str] = &[
    "f64",
    "u16",
    "u32",
    "i64",
    "usize",
    "untagged",
    "enum",
    "struct",
    "variant",
    "Some(",
    "None",
    "Option",
    "serde",
    "TOML parse",
    "invalid type",
    "unknown field",
    "missing field",
    "a sequence",
    "array of length",
    "socket address",
    "panicked",
    "Err(",
    "BadKey",
    "stand-in",
];
