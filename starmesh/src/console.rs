//! Prints lines for people and pipes: a reader that takes only the first of them ends us quietly, not with a panic.

use std::fmt;
use std::io::{ErrorKind, IsTerminal as _, Write as _};

use contract::printable;

/// Writes to standard output.
pub fn line(text: fmt::Arguments<'_>) -> anyhow::Result<()> {
    Ok(writeln!(std::io::stdout(), "{text}")?)
}

/// Writes a line with text from elsewhere: from the bus, a device or a file. Control characters in it cannot end the
/// line (and forge another one) or control the terminal.
pub fn foreign_line(text: fmt::Arguments<'_>) -> anyhow::Result<()> {
    line(format_args!("{}", printable(&text.to_string())))
}

/// Writes a line of a document as it is, for a file or another program; on a terminal as [`foreign_line`].
pub fn document_line(text: &str) -> anyhow::Result<()> {
    if std::io::stdout().is_terminal() { foreign_line(format_args!("{text}")) } else { line(format_args!("{text}")) }
}

/// Is this only the error of a reader that has ended, such as `head`?
pub fn reader_has_gone(error: &anyhow::Error) -> bool {
    let cause = error.downcast_ref::<std::io::Error>();
    cause.is_some_and(|cause| cause.kind() == ErrorKind::BrokenPipe)
}
