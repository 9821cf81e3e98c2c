//! What people did about alerts ([`::safety::annunciator`]) as a file: `alerts-TELESCOPE.json` in the
//! data folder.

use std::path::{Path, PathBuf};

use safety::annunciator::Annunciator;

/// Reads what the incarnation before knew. A file that cannot be read counts as empty: every alert is then new.
pub fn read(path: &Path) -> Annunciator {
    let read = match std::fs::read(path) {
        Ok(bytes) => {
            serde_json::from_slice(&bytes).map(Annunciator::of_the_boot_before).map_err(|error| error.to_string())
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Annunciator::default()),
        Err(error) => Err(error.to_string()),
    };
    read.unwrap_or_else(|error| {
        node::aside::keep_copy(path, &error, "What people did about alerts is not known; all alerts are new.");
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
    use safety::ordered_by::OrderedBy;
    use units::Utc;

    use super::*;

    #[test]
    fn it_survives_on_disk_and_a_broken_file_forgets_it() {
        let at = Utc::from_seconds;
        let ordered_by = OrderedBy { from: "web/ana".to_owned(), reason: "known".to_owned(), at_utc: at(1.0) };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("alerts.json");
        assert_eq!(read(&path), Annunciator::default());
        let mut annunciator = Annunciator::default();
        let alerts = vec![AlertKind::DomeNotClosed.alert("d", at(0.0), "c")];
        annunciator.observe(&Alerts { alerts, ..Alerts::default() }, None, at(0.0));
        annunciator.acknowledge("dome-not-closed/d", &ordered_by).unwrap();
        annunciator.shelve("dome-not-closed/d", 60.0, ordered_by).unwrap();
        crate::persisted::write_whole(&path, &folder.path().join("part"), &annunciator).unwrap();
        let again = read(&path);
        assert_eq!(again, annunciator.clone().of_the_boot_before());
        assert_ne!(again, annunciator, "its nodes may not have spoken yet");
        assert_eq!(again.published(at(2.0)), annunciator.published(at(2.0)));
        std::fs::write(&path, "{").unwrap();
        assert_eq!(read(&path), Annunciator::default());
    }
}
