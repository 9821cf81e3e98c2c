//! A script as it is read and proven: its functions must be known ones, and take what these take.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, Read as _};
use std::path::Path;
use std::sync::Arc;

use config::nearest;
use rhai::{AST, FnAccess};

use super::{calls, engine};

/// Bytes of a script's text: a site's own steps are some pages, and reading must not take long.
pub(super) const LONGEST: usize = 64 * 1024;
/// So many faults are reported; after these are fixed, the next ones are reported.
const REPORTED: usize = 20;
/// Longest reported part of a name, characters.
const NAME: usize = 60;
/// Longest reported part of a fault, characters.
const FAULT: usize = 300;

/// A function that a script may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Function {
    /// Before anything opens.
    BeforeOpen,
    /// Instead of the default opening.
    Open,
    /// After it has opened and is ready.
    AfterOpen,
    /// May observing begin?
    IsReady,
    /// Before the default closing begins.
    BeforeClose,
    /// Around the default closing.
    Close,
    /// After everything is verified closed.
    AfterClose,
}

/// All of them, by name.
pub const FUNCTIONS: [(&str, Function); 7] = [
    ("before_open", Function::BeforeOpen),
    ("open", Function::Open),
    ("after_open", Function::AfterOpen),
    ("is_ready", Function::IsReady),
    ("before_close", Function::BeforeClose),
    ("close", Function::Close),
    ("after_close", Function::AfterClose),
];

impl Function {
    /// Its name in the script.
    pub fn name(self) -> &'static str {
        FUNCTIONS.iter().find(|(_, function)| *function == self).map_or("", |(name, _)| *name)
    }
}

/// Why a script cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ScriptError {
    /// The file cannot be read.
    #[error("the site's script {file} cannot be read: {source}")]
    Read {
        /// Which.
        file: String,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// Its text is wrong; one line per fault.
    #[error("the site's script {file}: {}", .faults.join("; "))]
    Wrong {
        /// Which.
        file: String,
        /// What.
        faults: Vec<String>,
    },
}

/// A proven script. Cheap to clone.
#[derive(Clone)]
pub struct Script {
    /// Its text.
    pub(super) ast: Arc<AST>,
    functions: BTreeSet<Function>,
}

impl Script {
    /// Reads a file.
    ///
    /// # Errors
    /// When it cannot be read, or [`Self::compile`] refuses it.
    pub fn read(path: &Path) -> Result<Self, ScriptError> {
        let file = path.display().to_string();
        let mut bytes = Vec::new();
        // One byte more than it may have, so that what is longer is seen to be, and is not in memory.
        let most = u64::try_from(LONGEST + 1).unwrap_or(u64::MAX);
        let read = File::open(path).and_then(|script| script.take(most).read_to_end(&mut bytes));
        let text = match read {
            Ok(_) if bytes.len() > LONGEST => return Err(ScriptError::Wrong { file, faults: vec![too_long()] }),
            Ok(_) => String::from_utf8(bytes).map_err(io::Error::other),
            Err(source) => Err(source),
        };
        match text {
            Ok(text) => Self::compile(&text).map_err(|faults| ScriptError::Wrong { file, faults }),
            Err(source) => Err(ScriptError::Read { file, source }),
        }
    }

    /// Compiles a text and proves its functions.
    ///
    /// # Errors
    /// Syntax with line and column; functions that are neither known nor `private`, and calls that are a misspelling of
    /// one of this node's functions, with the nearest known name; parameters where there are none; a text of more than
    /// 64 KiB. At most 20 faults are reported.
    pub fn compile(text: &str) -> Result<Self, Vec<String>> {
        if text.len() > LONGEST {
            return Err(vec![too_long()]);
        }
        let ast = engine::bare().compile(text).map_err(|error| vec![shortened(&error.to_string())])?;
        let (mut functions, mut faults) = (BTreeSet::new(), Vec::new());
        for function in ast.iter_functions().filter(|function| function.access == FnAccess::Public) {
            if faults.len() > REPORTED {
                break;
            }
            let (name, parameters) = (function.name, function.params.len());
            // `|x| ...` within a function is one without a name of the script's own.
            if name.starts_with("anon$") {
                continue;
            }
            let line = line_of(text, name).map_or(String::new(), |line| format!("line {line}: "));
            match FUNCTIONS.iter().find(|(known, _)| *known == name) {
                Some((_, known)) if parameters == 0 => {
                    functions.insert(*known);
                }
                Some(_) => faults.push(format!("{line}{name} takes no parameters, and here has {parameters}")),
                None => {
                    let name: String = name.chars().take(NAME).collect();
                    let name = name.as_str();
                    let meant = nearest(name, FUNCTIONS.iter().map(|(name, _)| *name));
                    let meant = meant.map_or(String::new(), |meant| format!("did you mean {meant}? "));
                    let known = FUNCTIONS.map(|(name, _)| name).join(", ");
                    faults.push(format!(
                        "{line}no function is called {name}; {meant}(known: {known}; write `private fn {name}` for one \
                         of your own)"
                    ));
                }
            }
        }
        let own: Vec<&str> = ast.iter_functions().map(|function| function.name).collect();
        faults.extend(calls::misspelt(text, &own));
        if faults.len() > REPORTED {
            faults.truncate(REPORTED);
            faults.push("and more".to_owned());
        }
        if faults.is_empty() { Ok(Self { ast: Arc::new(ast), functions }) } else { Err(faults) }
    }

    /// Has it this function?
    pub fn has(&self, function: Function) -> bool {
        self.functions.contains(&function)
    }

    /// Names of its known functions.
    pub fn names(&self) -> Vec<&'static str> {
        self.functions.iter().map(|function| function.name()).collect()
    }
}

/// A fault that quotes the script may quote all of it.
fn shortened(fault: &str) -> String {
    match fault.char_indices().nth(FAULT) {
        Some((end, _)) => format!("{} ...", &fault[..end]),
        None => fault.to_owned(),
    }
}

fn too_long() -> String {
    format!("it has more than {LONGEST} bytes: expected a text of at most {} KiB", LONGEST / 1024)
}

/// The line, from 1, on which a function is defined.
fn line_of(text: &str, name: &str) -> Option<usize> {
    let defines = |line: &str| {
        let rest = line.trim_start().strip_prefix("fn ").map(str::trim_start)?;
        rest.strip_prefix(name)?.trim_start().starts_with('(').then_some(())
    };
    text.lines().position(|line| defines(line).is_some()).map(|index| index + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        Script::compile(text).map(|_| ()).unwrap_err().join("\n")
    }

    #[test]
    fn known_functions_and_private_ones_are_taken() {
        let script = Script::compile("fn open() { mine(1); default_open(); }\nprivate fn mine(x) { x }\n").unwrap();
        assert_eq!(script.names(), ["open"]);
        assert!(script.has(Function::Open) && !script.has(Function::Close));
        assert_eq!(Script::compile("").unwrap().names(), Vec::<&str>::new());
        assert!(FUNCTIONS.iter().all(|(name, function)| function.name() == *name));
    }

    #[test]
    fn an_unknown_function_is_refused_with_the_nearest_known_one() {
        let message = refused("// mine\nfn befor_open() { }\n");
        assert!(message.contains("line 2: no function is called befor_open; did you mean before_open?"), "{message}");
    }

    #[test]
    fn parameters_where_there_are_none_are_refused() {
        assert_eq!(refused("fn close(dome, mount) { }"), "line 1: close takes no parameters, and here has 2");
    }

    #[test]
    fn wrong_syntax_is_reported_with_line_and_column() {
        let message = refused("fn open() {\n  let a = ;\n}\n");
        assert!(message.contains("line 2, position 11"), "{message}");
        let message = refused("fn open() {\n  mistyped + 1\n}\n");
        assert!(message.contains("mistyped") && message.contains("line 2, position 3"), "{message}");
    }

    #[test]
    fn no_script_can_name_another_text_to_run() {
        for text in ["import \"x\" as x;", "fn open() { eval(\"1\") }"] {
            assert!(Script::compile(text).is_err(), "{text}");
        }
    }
}
