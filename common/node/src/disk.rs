//! Free room of the folders that a node writes to: a figure of its state, and an alert while there is too little.

use std::path::{Path, PathBuf};
use std::time::Duration;

use bus::Clock;
use config::Observatory;
use contract::observatory::AlertKind;
use contract::{Role, Scalar};

use crate::alerts::NodeAlerts;
use crate::figures::Figures;

const PERIOD: Duration = Duration::from_secs(15);

/// Reports it until the node ends.
pub(crate) async fn keep_publishing(
    config: &Observatory,
    role: Role,
    figures: &Figures,
    alerts: &NodeAlerts,
    clock: &Clock,
) -> anyhow::Result<()> {
    let folders = &config.folders;
    let mut watched = vec![("data", folders.data.clone())];
    if role == Role::Archive {
        watched.push(("images", folders.images.clone()));
    }
    loop {
        for (name, folder) in &watched {
            let asked = folder.clone();
            let Some(free_gb) = tokio::task::spawn_blocking(move || free_gb(asked)).await? else { continue };
            // Hundredths: a state that changes with every byte would show nothing more.
            figures.set(&format!("{name}_free_gb"), Scalar::Float((free_gb * 100.0).floor() / 100.0));
            report(config.safety.disk_free_min_gb, alerts, name, folder, free_gb);
            if *name == "images" {
                warn_early(config.archive.disk_warn_gb, alerts, folder, free_gb);
            }
        }
        clock.tick(PERIOD).await;
    }
}

fn report(least_gb: f64, alerts: &NodeAlerts, name: &str, folder: &Path, free_gb: f64) {
    if free_gb >= least_gb {
        return alerts.clear(AlertKind::Disk, name);
    }
    let cause = format!("{} has {free_gb:.2} GB left, needed are {least_gb} GB", folder.display());
    alerts.raise(AlertKind::Disk, name, &cause);
}

fn warn_early(warn_gb: f64, alerts: &NodeAlerts, images: &Path, free_gb: f64) {
    if free_gb >= warn_gb {
        return alerts.clear(AlertKind::ArchiveDiskLow, "");
    }
    let cause = format!("{} has {free_gb:.2} GB left, archive.disk_warn_gb is {warn_gb} GB", images.display());
    alerts.raise(AlertKind::ArchiveDiskLow, "", &cause);
}

/// Room for this process in a folder, or in the nearest one above it that exists, GB (1e9 bytes); `None` if the system
/// does not report it.
#[cfg(target_os = "linux")]
pub fn free_gb(mut folder: PathBuf) -> Option<f64> {
    while !folder.exists() && folder.pop() {}
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { &folder };
    let volume = rustix::fs::statvfs(folder).ok()?;
    Some(volume.f_bavail as f64 * volume.f_frsize as f64 / 1e9)
}

#[cfg(not(target_os = "linux"))]
/// Room for this process in a folder, GB (1e9 bytes); not known on this system.
pub fn free_gb(_: PathBuf) -> Option<f64> {
    None
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_is_not_made_yet_has_the_room_of_the_one_above() {
        let here = tempfile::tempdir().unwrap();
        let free = free_gb(here.path().to_owned()).unwrap();
        assert!(free > 0.0);
        assert!((free_gb(here.path().join("no/such")).unwrap() - free).abs() < 1.0);
        assert!(free_gb(PathBuf::from("data-not-made")).unwrap() > 0.0);
    }
}
