//! Where a new password comes from: the terminal, a file, or another program.

use std::io::{IsTerminal as _, Read as _, Write as _};
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use contract::Name;

const MOST_BYTES: u64 = 4096;

/// Where the new password comes from; asked for on the terminal where absent.
#[derive(Debug, Args)]
pub struct PasswordSource {
    /// A file that holds the password in its first line; - reads standard input.
    #[arg(long, value_name = "FILE")]
    password_file: Option<PathBuf>,
}

impl PasswordSource {
    /// The password for a user.
    ///
    /// # Errors
    /// There is none, or the two that were typed differ.
    pub fn get(&self, name: &Name) -> anyhow::Result<String> {
        match &self.password_file {
            Some(file) if file.as_os_str() == "-" => first_line(std::io::stdin().lock()),
            Some(file) => {
                let open = std::fs::File::open(file);
                first_line(open.with_context(|| format!("cannot read the password in {}", file.display()))?)
            }
            None if std::io::stdin().is_terminal() => {
                let password = ask(&format!("Password for {name}: "))?;
                ensure!(password == ask("The same again: ")?, "the two passwords differ; nothing was changed");
                Ok(password)
            }
            None => bail!(
                "there is no terminal to ask for the password; give it by --password-file FILE, or - for standard input"
            ),
        }
    }
}

fn first_line(reader: impl std::io::Read) -> anyhow::Result<String> {
    let mut text = String::new();
    reader.take(MOST_BYTES).read_to_string(&mut text).context("cannot read the password")?;
    Ok(text.lines().next().unwrap_or_default().to_owned())
}

/// Asks without showing what is typed.
fn ask(prompt: &str) -> anyhow::Result<String> {
    let mut terminal = std::io::stderr();
    write!(terminal, "{prompt}")?;
    terminal.flush()?;
    echo(false).context("the terminal cannot hide what is typed; give the password by --password-file FILE")?;
    let mut typed = String::new();
    let read = std::io::stdin().read_line(&mut typed);
    echo(true)?;
    writeln!(terminal)?;
    read?;
    Ok(typed.trim_end_matches(['\r', '\n']).to_owned())
}

fn echo(on: bool) -> anyhow::Result<()> {
    let status = Command::new("stty").arg(if on { "echo" } else { "-echo" }).status().context("cannot run stty")?;
    ensure!(status.success(), "stty failed");
    Ok(())
}
