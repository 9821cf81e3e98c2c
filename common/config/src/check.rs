//! Reads `observatory.toml` and proves what holds between its parts.

use std::path::Path;

use contract::observatory::Severity;

use crate::document::Document;
use crate::fault::{ConfigError, Fault};
use crate::findings::Findings;
use crate::network_archive::NetworkArchive;
use crate::observatory::Observatory;
use crate::read;
use crate::visibility::HorizonSource;
use crate::{plausible, relations};

/// Larger texts are neither configuration nor header table; what a text of this size becomes in memory is some ten times it.
pub const MOST_BYTES: usize = 1 << 20;

/// Reads and checks a configuration; relative paths in it start at `folder`.
///
/// # Errors
/// All that refuses it, each with its line.
pub fn parse(text: &str, folder: &Path) -> Result<Observatory, ConfigError> {
    let (observatory, findings) = look(text, folder, false);
    let faults: Vec<Fault> = findings.into_iter().filter(|fault| fault.severity == Severity::Error).collect();
    match observatory.filter(|_| faults.is_empty()) {
        Some(observatory) => Ok(observatory),
        None => Err(ConfigError { faults }),
    }
}

/// All that can be checked of a configuration without looking at other files, in the order of its lines: what refuses
/// it, what leaves nothing to run, and what a person should know. The values hold stand-ins where there are errors, and
/// are absent where the text could not be read to its end.
pub fn examine(text: &str, folder: &Path) -> (Option<Observatory>, Vec<Fault>) {
    look(text, folder, true)
}

/// Line and column, from 1, of a key such as `archive.filename.object`; of what it would stand in where it does not stand
/// there, and 0 where that does not either.
pub fn locate(text: &str, path: &str) -> (usize, usize) {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let (root, _) = toml::de::DeTable::parse_recoverable(text);
    Document::new(text, root.into_inner()).line_of(path)
}

fn look(text: &str, folder: &Path, whole: bool) -> (Option<Observatory>, Vec<Fault>) {
    if text.len() > MOST_BYTES {
        let what = format!("{} bytes: a configuration has at most {MOST_BYTES}", text.len());
        return (None, vec![Fault { line: 0, column: 0, severity: Severity::Error, what }]);
    }
    // some editors on Windows begin a file with it
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let read::Reading { document, observatory, faults, spoilt, torn } = read::read(text);
    let mut findings = Findings::new(&document, spoilt, faults);
    let Some(mut observatory) = observatory else { return (None, findings.into_faults()) };
    resolve(&mut observatory, folder);
    relations::prove(&mut observatory, &mut findings, torn);
    plausible::prove(&observatory, &mut findings);
    if whole && !torn {
        relations::whole(&observatory, &mut findings);
    }
    (Some(observatory), findings.into_faults())
}

/// Relative paths start at the configuration's own folder.
fn resolve(observatory: &mut Observatory, folder: &Path) {
    let folders = [&mut observatory.folders.data, &mut observatory.folders.images];
    for path in folders.into_iter().chain([
        &mut observatory.schedule.file,
        &mut observatory.archive.database,
        &mut observatory.web.users,
    ]) {
        *path = folder.join(&path);
    }
    for file in [
        &mut observatory.archive.fits_header,
        &mut observatory.archive.backups,
        &mut observatory.imaging.catalogue,
        &mut observatory.hooks.script,
        &mut observatory.web.certificate,
        &mut observatory.web.key,
    ] {
        *file = file.take().map(|path| folder.join(path));
    }
    match &mut observatory.archive.parquet {
        Some(NetworkArchive::Folder(path)) => *path = folder.join(&path),
        Some(NetworkArchive::Bucket(bucket)) => {
            bucket.secret_file = bucket.secret_file.take().map(|path| folder.join(path));
        }
        None => {}
    }
    for delivery in &mut observatory.delivery {
        for file in [&mut delivery.directory, &mut delivery.ssh_config, &mut delivery.secret_file] {
            *file = file.take().map(|path| folder.join(path));
        }
    }
    for mount in &mut observatory.telescope {
        if let Some(HorizonSource::File(path)) = &mut mount.horizon {
            *path = folder.join(&path);
        }
    }
    let alerts = &mut observatory.alerts;
    let secrets = alerts.webhook.iter_mut().map(|hook| &mut hook.token_file);
    let secrets = secrets.chain(alerts.smtp.iter_mut().map(|smtp| &mut smtp.password_file));
    for file in secrets.chain([&mut alerts.ca_file]).flatten() {
        *file = folder.join(&file);
    }
}

#[cfg(test)]
mod tests {
    use contract::Kind;

    use super::*;

    const MINIMAL: &str = r#"
[observatory]
site = "paranal"
telescope = "callisto"
latitude_deg = -24.6
longitude_deg = -70.4
elevation_m = 2500

[[telescope]]
name = "mount"
server = "10.0.0.5:11111"

[[camera]]
name = "cam"
server = "10.0.0.5:11111"
temperature_c = -30

[[dome]]
name = "dome"
server = "10.0.0.5:11111"
"#;

    fn faults(extra: &str) -> String {
        parse(&format!("{MINIMAL}{extra}"), Path::new("/site")).map(|_| ()).unwrap_err().to_string()
    }

    #[test]
    fn a_minimal_file_gets_its_defaults() {
        let observatory = parse(MINIMAL, Path::new("/site")).unwrap();
        assert_eq!(observatory.folders.images, Path::new("/site").join("images"));
        assert_eq!(observatory.dome[0].common.period_s, 1.0);
        assert_eq!(observatory.camera[0].common.period_s, 5.0);
        assert_eq!(observatory.camera[0].telescope.as_ref().unwrap().as_str(), "mount");
        assert_eq!(observatory.camera[0].focuser, None);
        assert_eq!(observatory.enclosures()[0].to_string(), "paranal/callisto/dome/dome");
    }

    #[test]
    fn an_unknown_key_is_refused_with_its_line() {
        let message = faults("[[focuser]]\nname = \"f\"\nserver = \"a:1\"\nperiod = 3\n");
        assert!(message.contains("line 24") && message.contains("did you mean \"period_s\"?"), "{message}");
    }

    #[test]
    fn parts_that_do_not_fit_are_all_named_with_their_lines() {
        let message = faults(
            "[[observingconditions]]\nname = \"wx\"\nserver = \"10.0.0.6\"\nlimit = [{ parameter = \"Humidty\", upper = 80 }, { parameter = \"WindSpeed\" }]\n",
        );
        assert!(
            message.contains("line 23: observingconditions \"wx\": server \"10.0.0.6\" is no host:port"),
            "{message}"
        );
        assert!(message.contains("line 24: limit on \"Humidty\": no such parameter"), "{message}");
        assert!(message.contains("neither upper nor lower"), "{message}");
    }

    #[test]
    fn a_pairing_with_nothing_is_refused() {
        let message = faults("[[camera]]\nname = \"guide\"\nserver = \"a:1\"\nfocuser = \"f9\"\n");
        assert!(message.contains("camera \"guide\": focuser = \"f9\" names no focuser"), "{message}");
    }

    #[test]
    fn a_fault_policy_that_makes_no_sense_is_refused() {
        let message = faults("[faults.policy]\ncamera = \"without\"\nfocusser = \"skip\"\n");
        assert!(message.contains("faults.policy.camera = \"without\": no frame"), "{message}");
        assert!(message.contains("faults.policy.focusser: no such kind; expected one of telescope"), "{message}");
        let fine = parse(&format!("{MINIMAL}[faults.policy]\nfocuser = \"without\"\n"), Path::new("/site")).unwrap();
        assert_eq!(fine.faults.policy(Kind::Focuser), crate::FaultPolicy::Without);
        assert_eq!(fine.faults.policy(Kind::Camera), crate::FaultPolicy::Postpone);
    }

    #[test]
    fn not_a_number_is_no_limit() {
        let message = faults(
            "[[observingconditions]]\nname = \"wx\"\nserver = \"a:1\"\nlimit = [{ parameter = \"Humidity\", upper = nan }]\n",
        );
        assert!(message.contains("must be finite"), "{message}");
    }
}
