//! Every command of this program that a document shows can be typed as it is printed there.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Parser as _;

use crate::Arguments;

/// README and all Markdown below docs, deploy and examples.
fn documents() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut found = vec![root.join("README.md"), root.join("CONTRIBUTING.md")];
    let mut folders = vec![root.join("docs"), root.join("deploy"), root.join("examples")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "md") {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// Commands of a text: lines of code blocks, and words in back ticks that begin with the program's name.
fn commands(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut in_block = false;
    // A command continues after a backslash.
    for line in text.replace("\\\n", " ").lines() {
        if line.trim_start().starts_with("```") {
            in_block = !in_block;
        } else if in_block {
            let line = line.trim().replace("cargo run --release -- ", "starmesh ");
            if line.starts_with("starmesh ") {
                found.push(line.to_owned());
            }
        } else {
            let quoted = line.split('`').skip(1).step_by(2);
            found.extend(quoted.filter(|words| words.starts_with("starmesh ")).map(str::to_owned));
        }
    }
    found
}

/// The words of a command as a shell splits it, without comments and pipes.
fn words(command: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), String::new(), None);
    for c in command.chars() {
        match (c, quote) {
            ('#' | '|' | '>' | '&', None) if word.is_empty() => break,
            ('\'' | '"', None) => quote = Some(c),
            (c, Some(open)) if c == open => quote = None,
            (' ', None) => words.extend((!word.is_empty()).then(|| std::mem::take(&mut word))),
            (c, _) => word.push(c),
        }
    }
    words.extend((!word.is_empty()).then_some(word));
    words
}

#[test]
fn every_command_of_the_documents_can_be_typed() {
    let (mut wrong, mut count) = (Vec::new(), 0);
    for document in documents() {
        let text = fs::read_to_string(&document).unwrap();
        for command in commands(&text) {
            // Any role.
            let words = words(&command.replace(" ROLE ", " web "));
            // A name alone, or a form with things left out.
            if words.len() < 2 || command.contains("...") || words.iter().any(|word| word.starts_with('[')) {
                continue;
            }
            count += 1;
            let parsed = Arguments::try_parse_from(&words);
            if let Err(error) = parsed.map(|_| ()) {
                use clap::error::ErrorKind::{
                    DisplayHelpOnMissingArgumentOrSubcommand, MissingRequiredArgument, MissingSubcommand,
                };
                // A sentence names commands without their arguments.
                let is_name = matches!(
                    error.kind(),
                    MissingRequiredArgument | MissingSubcommand | DisplayHelpOnMissingArgumentOrSubcommand
                );
                if !is_name {
                    wrong.push(format!("{}: {command}\n{error}", document.display()));
                }
            }
        }
    }
    assert!(count > 50, "{count} commands found");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
