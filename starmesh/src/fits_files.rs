//! `starmesh fits`: what an archive would refuse in FITS files, and copies of them that it accepts (docs/fits.md).

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::{Args, Subcommand};
use fits::profile::{self, Profile, ProfileName};

use crate::console::foreign_line;

/// What `starmesh fits` does.
#[derive(Debug, Subcommand)]
pub enum FitsCommand {
    /// Print what breaks the rules of an archive, with the rule; exit code 1 if anything does.
    Check(Check),
    /// Write the copies that an archive accepts: the same pixels, header and name by its profile. Nothing is overwritten.
    Convert(Convert),
}

/// Options of `starmesh fits check`.
#[derive(Debug, Args)]
pub struct Check {
    /// FITS files, plain or in compressed tiles (`.fz`).
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Whose rules: plain (the default of new sites), astra, eso or lco.
    #[arg(long, default_value = "astra")]
    profile: ProfileName,
}

/// Options of `starmesh fits convert`.
#[derive(Debug, Args)]
pub struct Convert {
    /// FITS files, plain or in compressed tiles (`.fz`).
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Whose rules: plain (the default of new sites), astra, eso or lco.
    #[arg(long)]
    profile: ProfileName,
    /// The folder for the copies; it is made if it is not there.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// A keyword that the copies get whatever the files have, such as INSTRUME=SPECULOOS1; may be given several times.
    #[arg(long = "set", value_name = "KEYWORD=VALUE", value_parser = keyword_and_value)]
    values: Vec<(String, String)>,
}

fn keyword_and_value(text: &str) -> Result<(String, String), String> {
    let parts = text.split_once('=').filter(|(keyword, value)| !keyword.is_empty() && !value.is_empty());
    let (keyword, value) = parts.ok_or("expected KEYWORD=VALUE, such as INSTRUME=SPECULOOS1")?;
    Ok((keyword.to_owned(), value.to_owned()))
}

/// Runs the command.
///
/// # Errors
/// A file breaks a rule, or cannot be read or written.
pub fn run(command: &FitsCommand) -> anyhow::Result<()> {
    match command {
        FitsCommand::Check(options) => check(options),
        FitsCommand::Convert(options) => convert(options),
    }
}

fn check(options: &Check) -> anyhow::Result<()> {
    let profile = Profile::load(options.profile)?;
    let (mut left, mut wrong, mut unreadable) = (0, 0, 0);
    let mut mended = Vec::new();
    for file in &options.files {
        match profile::check_copy(file, &profile) {
            Ok(found) => {
                for violation in &found.left {
                    foreign_line(format_args!("{}: {violation}", file.display()))?;
                }
                for warning in profile::warnings(file, &profile)? {
                    foreign_line(format_args!("{}: warning: {warning}", file.display()))?;
                }
                left += found.left.len();
                wrong += usize::from(!found.left.is_empty() || !found.mended.is_empty());
                mended.extend(found.mended.into_iter().map(|violation| (file, violation)));
            }
            Err(error) => {
                complain(&error);
                unreadable += 1;
            }
        }
    }
    // What a person has to see to comes first.
    for (file, violation) in &mended {
        foreign_line(format_args!("{}: {violation}", file.display()))?;
    }
    let (name, count, violations) = (options.profile, options.files.len(), left + mended.len());
    let mut found = match (unreadable, violations) {
        (0, 0) => return foreign_line(format_args!("{count} files, no violation of profile {name}")),
        (0, _) => format!("{violations} violations of profile {name} in {wrong} of {count} files"),
        _ => format!(
            "{unreadable} of {count} files cannot be checked; {violations} violations of profile {name} in the others"
        ),
    };
    if !mended.is_empty() {
        found += &match left {
            0 => "; a copy has none of them".to_owned(),
            _ => format!(
                "; {left} of them, which are listed first, would be in a copy too, and keep it from being made (--set KEYWORD=VALUE \
                 gives a value that is missing); the other {} are mended in a copy",
                mended.len()
            ),
        };
        found += &format!(": starmesh fits convert --profile {name} --out copies {}", typed(&options.files));
    }
    bail!("{}", contract::printable(&found))
}

/// Files as a person types them; more than some by patterns.
fn typed(files: &[PathBuf]) -> String {
    const FEW: usize = 4;
    let pattern = |file: &PathBuf| {
        let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.map(|folder| quoted(folder) + "/").unwrap_or_default();
        let ending = file.extension().map(|ending| format!(".{}", ending.display())).unwrap_or_default();
        format!("{folder}*{ending}")
    };
    let words: Vec<String> = match files.len() {
        ..=FEW => files.iter().map(|file| quoted(file)).collect(),
        _ => files.iter().map(pattern).collect::<BTreeSet<String>>().into_iter().collect(),
    };
    words.join(" ")
}

/// A path as a word of a shell.
fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+=:@%,".contains(c);
    if text.chars().all(is_plain) { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

fn convert(options: &Convert) -> anyhow::Result<()> {
    let profile = Profile::load(options.profile)?;
    let shown = options.out.display();
    std::fs::create_dir_all(&options.out).with_context(|| format!("cannot make the folder {shown}"))?;
    let mut failed = 0;
    for file in &options.files {
        match profile::deliver_copy(file, &options.out, &profile, &options.values) {
            Ok(copy) => {
                let was_there = if copy.was_there { " (was there already)" } else { "" };
                foreign_line(format_args!("{} -> {}{was_there}", file.display(), name(&copy.path)))?;
                for warning in profile::warnings(&copy.path, &profile)? {
                    let text = format!("{}: warning: {warning}", file.display());
                    node::lines::complain(contract::printable(&text));
                }
            }
            Err(error) => {
                complain(&error);
                failed += 1;
            }
        }
    }
    let count = options.files.len();
    if failed > 0 {
        bail!("{failed} of {count} files were not converted; {} copies are in {shown}", count - failed);
    }
    Ok(())
}

fn complain(error: &dyn std::error::Error) {
    node::lines::complain(format_args!("starmesh: {}", contract::printable(&error.to_string())));
}

fn name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}
