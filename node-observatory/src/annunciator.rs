//! What people did about alerts ([`safety::annunciator`](::safety::annunciator)) as a file: `alerts-TELESCOPE.json` in
//! the data folder.

use std::path::{Path, PathBuf};

use safety::annunciator::Annunciator;

/// Reads what the incarnation before knew. A file that cannot be read counts as empty: every alert is then new.
pub fn read(path: &Path) -> Annunciator {
    let read = match std::fs::read(path) {
        Ok(bytes) => {
            serde_json::from_slice(&bytes).map(Annunciator::of_the_life_before).map_err(|error| error.to_string())
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Annunciator::default()),
        Err(error) => Err(error.to_string()),
    };
    read.unwrap_or_else(|error| {
        bus::aside::keep_copy(path, &error, "What people did about alerts is not known; all alerts are new.");
        Annunciator::default()
    })
}

/// Where a telescope's are kept.
pub fn path(config: &config::Observatory) -> PathBuf {
    config.folders.data.join(format!("alerts-{}.json", config.place.telescope))
}

#[cfg(test)]
mod tests {
    use contract::observatory::{AlertKind, Alerts};
    use safety::said::Said;
    use units::Utc;

    use super::*;

    #[test]
    fn it_is_kept_on_disk_and_a_broken_file_forgets_it() {
        let at = Utc::from_seconds;
        let said = Said { from: "web/ana".to_owned(), reason: "known".to_owned(), at_utc: at(1.0) };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("alerts.json");
        assert_eq!(read(&path), Annunciator::default());
        let mut desk = Annunciator::default();
        let alerts = vec![AlertKind::DomeNotClosed.alert("d", at(0.0), "c")];
        desk.hear(&Alerts { alerts, ..Alerts::default() }, true, at(0.0));
        desk.acknowledge("dome-not-closed/d", &said).unwrap();
        desk.shelve("dome-not-closed/d", 60.0, said).unwrap();
        crate::kept::write_whole(&path, &folder.path().join("part"), &desk).unwrap();
        let again = read(&path);
        assert_eq!(again, desk.clone().of_the_life_before());
        assert_ne!(again, desk, "its nodes may not have spoken yet");
        assert_eq!(again.shown(at(2.0)), desk.shown(at(2.0)));
        std::fs::write(&path, "{").unwrap();
        assert_eq!(read(&path), Annunciator::default());
    }
}
