//! Runs the command line as a person does.

use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// The result of a call of `starmesh`.
pub struct Output {
    /// It ended well.
    pub success: bool,
    /// Standard output.
    pub out: String,
    /// Standard error.
    pub err: String,
}

impl Output {
    /// The one JSON object of each line.
    pub fn json(&self) -> Vec<Value> {
        self.out.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|_| panic!("{line}"))).collect()
    }
}

/// Calls it and waits. What runs on this machine for this account is none of its business.
pub fn starmesh<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> Output {
    let nothing = tempfile::tempdir().unwrap();
    starmesh_of(nothing.path(), arguments)
}

/// Calls it with the runtime directory of an account.
pub fn starmesh_of<S: AsRef<OsStr>>(runtime: &Path, arguments: impl IntoIterator<Item = S>) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_starmesh"));
    let output = command.env("XDG_RUNTIME_DIR", runtime).args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Output { success: output.status.success(), out: text(output.stdout), err: text(output.stderr) }
}

/// A number of an answer.
pub fn number(answer: &Value, field: &str) -> f64 {
    answer[field].as_f64().unwrap_or_else(|| panic!("{field} in {answer}"))
}

/// The fields of an answer, in order.
pub fn fields(answer: &Value) -> Vec<&str> {
    answer.as_object().unwrap().keys().map(String::as_str).collect()
}
