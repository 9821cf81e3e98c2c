//! Lines for people and pipes: who reads only the first of them ends us quietly, not with a panic.

use std::fmt;
use std::io::{ErrorKind, Write as _};

/// Writes one line to standard output.
pub fn line(text: fmt::Arguments<'_>) -> anyhow::Result<()> {
    Ok(writeln!(std::io::stdout(), "{text}")?)
}

/// Is this error only a reader that has gone, such as `head`?
pub fn reader_has_gone(error: &anyhow::Error) -> bool {
    let cause = error.downcast_ref::<std::io::Error>();
    cause.is_some_and(|cause| cause.kind() == ErrorKind::BrokenPipe)
}
