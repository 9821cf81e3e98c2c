//! Where the anchor of the clocks is persisted, so that a restart of this node does not forget a step of the wall
//! clock.

use std::path::{Path, PathBuf};

use bus::MachineTime;
use safety::clocks::{Anchor, Clocks};
use units::Utc;

/// The file of the anchor; none for a clock that follows a simulator.
#[derive(Debug)]
pub struct ClockFile(Option<PathBuf>);

impl ClockFile {
    /// Where a telescope's anchor is; `folder` is the data folder, `None` for a clock that follows a simulator.
    pub fn new(folder: Option<&Path>, telescope: &str) -> Self {
        Self(folder.map(|folder| folder.join(format!("clock-{telescope}.json"))))
    }

    /// Begins to watch the clocks from the anchor in the file, or from now, which it writes there.
    pub fn watch(&self, speed: f64, utc: Utc, now: MachineTime) -> Clocks {
        let stored = self.0.as_ref().and_then(|file| std::fs::read(file).ok());
        let stored = stored.and_then(|bytes| serde_json::from_slice::<Anchor>(&bytes).ok());
        let mut clocks = Clocks::new(stored, node::kernel_boot_id(), speed, utc, now);
        if let (Some(file), Some(anchor)) = (&self.0, clocks.to_persist()) {
            write(file, &anchor);
        }
        clocks
    }

    /// Persists an anchor outside the safety loop: no disk delays the next verdict.
    pub fn write_aside(&self, anchor: Anchor) {
        if let Some(file) = self.0.clone() {
            std::thread::spawn(move || write(&file, &anchor));
        }
    }
}

fn write(file: &Path, anchor: &Anchor) {
    if let Err(error) = crate::persisted::write_whole(file, &file.with_extension("json.part"), anchor) {
        tracing::warn!(file = %file.display(), %error, "after a restart a step of the wall clock would not be noticed");
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_restart_of_the_node_does_not_forget_a_step() {
        let (at, utc) = (
            |second| MachineTime::from_boot(Duration::from_secs_f64(second)),
            |second| Utc::from_seconds(1.8e9 + second),
        );
        let folder = tempfile::tempdir().unwrap();
        let file = ClockFile::new(Some(folder.path()), "t");
        file.watch(1.0, utc(0.0), at(0.0));
        let mut again = file.watch(1.0, utc(100.0 - 3600.0), at(100.0));
        let known = !node::kernel_boot_id().is_empty();
        let doubts = again.doubts(utc(101.0 - 3600.0), at(101.0), &[]);
        let offsets: Vec<i64> = doubts.iter().map(|doubt| doubt.offset_s.round() as i64).collect();
        assert_eq!(offsets, if known { vec![3600] } else { Vec::new() });
    }
}
