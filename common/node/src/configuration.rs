//! Reads the configuration of a node, with the files that it names.

use std::io::{ErrorKind, Read as _};
use std::path::Path;

use anyhow::Context as _;
use config::Observatory;
use config::header::HeaderTable;

/// The text of a file, and no more of it than shows that it is too large.
fn read_text(file: &Path) -> std::io::Result<String> {
    let (mut bytes, most) = (Vec::new(), config::MOST_BYTES as u64 + 1);
    std::fs::File::open(file)?.take(most).read_to_end(&mut bytes)?;
    config::utf8(bytes).map_err(std::io::Error::other)
}

/// The text of a configuration file; errors name the file.
pub fn config_text(file: &Path) -> anyhow::Result<String> {
    let read = read_text(file);
    let help = read.as_ref().err().map_or("", |error| help(error.kind()));
    read.with_context(|| format!("cannot read the configuration {}{help}", file.display()))
}

/// What to do about a configuration that cannot be read.
fn help(kind: ErrorKind) -> &'static str {
    match kind {
        ErrorKind::NotFound => "; name the telescope's observatory.toml, or make one with `starmesh init`",
        ErrorKind::IsADirectory => "; name the file in it, such as observatory.toml",
        ErrorKind::PermissionDenied => "; let this account read it, or start the nodes from the account that may",
        _ => "",
    }
}

/// Reads a configuration file without the files that it names; errors name the file.
pub fn read_observatory(file: &Path) -> anyhow::Result<Observatory> {
    let text = config_text(file)?;
    let folder = file.parent().unwrap_or(Path::new("."));
    config::parse(&text, folder).with_context(|| format!("{} is not a valid configuration", file.display()))
}

/// Reads a configuration file with its FITS-header table; errors name the file.
pub fn read_config(file: &Path) -> anyhow::Result<(Observatory, HeaderTable)> {
    let config = read_observatory(file)?;
    let header = read_header(&config)?;
    Ok((config, header))
}

/// The FITS-header table of a configuration, its own or the built-in one.
///
/// # Errors
/// The file that the configuration names cannot be read, or is no table.
pub fn read_header(config: &Observatory) -> anyhow::Result<HeaderTable> {
    let Some(csv) = &config.archive.fits_header else { return Ok(HeaderTable::default()) };
    let shown = csv.display();
    let text =
        read_text(csv).with_context(|| format!("archive.fits_header: cannot read the FITS-header table {shown}"))?;
    text.parse().with_context(|| format!("archive.fits_header: {shown} is not a valid FITS-header table"))
}

/// As [`read_config`], for a node that goes on with the built-in rows where the FITS-header table cannot be used: no
/// dome stays open because of a table. The returned text is the table's error.
pub(crate) fn read_config_of_node(file: &Path) -> anyhow::Result<(Observatory, HeaderTable, Option<String>)> {
    let config = read_observatory(file)?;
    Ok(match read_header(&config) {
        Ok(header) => (config, header, None),
        Err(why) => (config, HeaderTable::default(), Some(format!("{why:#}; the built-in rows are used"))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_of_another_account_is_told_with_what_to_do() {
        assert!(help(ErrorKind::PermissionDenied).contains("let this account read it"));
        assert_eq!(help(ErrorKind::Other), "");
    }
}
