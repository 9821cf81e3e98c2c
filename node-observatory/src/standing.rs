//! A person's operator orders ([`safety::standing`](::safety::standing)) as a file, and the alerts that remind of them.
//!
//! The file is `standing-TELESCOPE.json` in the data folder.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use contract::observatory::AlertKind;
use safety::on_disk::OnDisk;

use crate::control_room::ControlRoom;

/// Reads the file; of one that cannot be read a copy is kept.
pub fn read(path: &Path) -> OnDisk {
    let unreadable = |why: String| {
        bus::aside::keep_copy(path, &why, "The dome stays closed until a person decides anew.");
        OnDisk::Unreadable(format!("{} cannot be read: {why}", path.display()))
    };
    match std::fs::read(path) {
        Ok(bytes) => match serde_json::from_slice(&bytes) {
            Ok(standing) => OnDisk::Found(standing),
            Err(error) => unreadable(error.to_string()),
        },
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => OnDisk::Absent,
        Err(error) => unreadable(error.to_string()),
    }
}

/// The file of a telescope's operator orders.
pub fn path(config: &config::Observatory) -> PathBuf {
    config.folders.data.join(format!("standing-{}.json", config.place.telescope))
}

/// Raises an alert for every operator order, so that none is forgotten.
pub async fn keep_reminding(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let mut standing = room.standing.subscribe();
    let mut shown: BTreeSet<(AlertKind, String)> = BTreeSet::new();
    loop {
        let now = room.node.bus.clock().utc();
        let reminders = standing.borrow_and_update().reminders(now);
        let mut wanted = BTreeSet::new();
        for (kind, instance, cause) in reminders {
            room.node.alerts.raise(kind, &instance, &cause);
            wanted.insert((kind, instance));
        }
        for (kind, instance) in shown.difference(&wanted) {
            room.node.alerts.clear(*kind, instance);
        }
        shown = wanted;
        tokio::select! {
            changed = standing.changed() => changed?,
            () = tokio::time::sleep(Duration::from_secs(5)) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use safety::said::Said;
    use safety::standing::{Override, Standing};
    use units::Utc;

    use super::*;

    #[test]
    fn orders_outlive_a_restart_and_a_broken_file_stays_closed() {
        let folder = tempfile::tempdir().unwrap();
        let (path, now) = (folder.path().join("standing.json"), Utc::from_seconds(2000.0));
        assert_eq!(read(&path), OnDisk::Absent);
        assert_eq!(OnDisk::Absent.orders(now), Standing::default());
        let said = Said {
            from: "web/ana".to_owned(),
            reason: "people on the roof".to_owned(),
            at_utc: Utc::from_seconds(1000.0),
        };
        let order = Override { said: said.clone(), until_utc: Utc::from_seconds(1600.0) };
        let overrides = [("wx/Humidity".to_owned(), order)].into();
        let standing = Standing { stay_closed: Some(said), overrides, ..Standing::default() };
        crate::kept::write_whole(&path, &folder.path().join("part"), &standing).unwrap();
        assert_eq!(read(&path), OnDisk::Found(standing));
        std::fs::write(&path, "{").unwrap();
        assert!(read(&path).orders(now).stay_closed.is_some());
        let kept = std::fs::read_dir(folder.path()).unwrap().map(|file| file.unwrap().file_name());
        assert!(
            kept.map(|name| name.to_string_lossy().into_owned()).any(|name| name.starts_with("standing.json.bad-"))
        );
        assert!(path.exists(), "without it a restart would know of no order");
    }
}
