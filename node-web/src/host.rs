//! How busy this machine is, refreshed every 5 s for the heartbeat.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use schemars::JsonSchema;
use serde::Serialize;
use sysinfo::{DiskRefreshKind, Disks, System};

const EVERY: Duration = Duration::from_secs(5);
/// A disk fills slowly, and asking all disks costs more than the rest.
const DISK_EVERY: u32 = 12;

/// Parts of the machine in use, percent; absent until measured, or where the system does not report them.
#[derive(Debug, Clone, Copy, PartialEq, Default, JsonSchema, Serialize)]
pub struct Usage {
    /// Processor, all cores.
    pub cpu_percent: Option<f64>,
    /// Memory that is not available.
    pub memory_percent: Option<f64>,
    /// Disk that holds the data folder.
    pub disk_percent: Option<f64>,
}

/// The newest figures.
#[derive(Debug, Default)]
pub struct Host {
    usage: Mutex<Usage>,
}

impl Host {
    /// The newest figures.
    pub fn usage(&self) -> Usage {
        *self.usage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Measures for ever.
    pub async fn measure(self: Arc<Self>, data_folder: PathBuf) -> anyhow::Result<()> {
        let mut system =
            System::new().inspect_err(|error| tracing::debug!(%error, "this system reports no usage")).ok();
        let mut usage = Usage::default();
        for round in 0u32.. {
            if round.is_multiple_of(DISK_EVERY) {
                let folder = data_folder.clone();
                // A network disk that does not answer must not hold a thread of the runtime.
                let asked = tokio::task::spawn_blocking(move || disk_percent(&folder));
                usage.disk_percent =
                    tokio::time::timeout(EVERY, asked).await.ok().and_then(Result::ok).flatten().map(round_1);
            }
            if let Some(system) = &mut system {
                system.refresh_memory();
                let total = system.total_memory() as f64;
                let used = total - system.available_memory() as f64;
                usage.memory_percent = (total > 0.0).then(|| round_1(100.0 * used / total));
                system.refresh_cpu_usage();
                usage.cpu_percent = (round > 0).then(|| round_1(f64::from(system.global_cpu_usage())));
            }
            *self.usage.lock().unwrap_or_else(PoisonError::into_inner) = usage;
            // The processor's share is a difference of two measurements: the second one follows soon.
            tokio::time::sleep(if round == 0 { Duration::from_millis(500) } else { EVERY }).await;
        }
        Ok(())
    }
}

fn disk_percent(folder: &Path) -> Option<f64> {
    let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let disks = Disks::new_with_refreshed_list_specifics(DiskRefreshKind::nothing().with_storage()).ok()?;
    let holds = disks.iter().filter(|disk| folder.starts_with(disk.mount_point()));
    let disk = holds.max_by_key(|disk| disk.mount_point().as_os_str().len()).or_else(|| disks.first())?;
    let total = disk.total_space() as f64;
    (total > 0.0).then(|| 100.0 * (total - disk.available_space() as f64) / total)
}

fn round_1(value: f64) -> f64 {
    if value.is_finite() { (value.clamp(0.0, 100.0) * 10.0).round() / 10.0 } else { 0.0 }
}
