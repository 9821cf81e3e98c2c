//! The runs of a node before this one, in a file of its data folder: a run that ended without being asked to is a line in the
//! log, and the third within ten minutes is an alert.
//!
//! Whatever starts the node again (systemd, a container engine, `starmesh up`), the next run notices it. What reads and
//! writes is apart from the node's work, which waits for no disk.

use std::fmt::Display;
use std::path::PathBuf;
use std::sync::OnceLock;
use std::time::Duration;

use anyhow::Context as _;
use contract::observatory::AlertKind;

use crate::Node;
use crate::host::now_s;

/// So many ends ...
pub const MANY: usize = 3;
/// ... within this time are an alert.
pub const WITHIN: Duration = Duration::from_secs(600);
/// A disk that takes longer than this to remove the file makes the next run note an end that was none.
const DISK: Duration = Duration::from_secs(1);

/// The ends that nobody asked for, of the last ten minutes. Pure: time comes in, in seconds of any clock.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Ends(Vec<u64>);

impl Ends {
    /// Takes an end.
    pub fn take(&mut self, now_s: u64) {
        self.0.push(now_s);
        self.forget(now_s);
    }

    /// Is this an alert? Forgets what is older.
    pub fn are_many(&mut self, now_s: u64) -> bool {
        self.forget(now_s);
        self.0.len() >= MANY
    }

    fn forget(&mut self, now_s: u64) {
        // An end that lies further in the future was noted by a clock that was wrong, and would be an alert until then.
        self.0.retain(|at_s| now_s.abs_diff(*at_s) <= WITHIN.as_secs());
        let surplus = self.0.len().saturating_sub(MANY);
        self.0.drain(..surplus);
    }

    /// As the file has them: the process that runs, and the ends before it.
    fn text(&self, pid: u32) -> String {
        let ends: Vec<String> = self.0.iter().map(u64::to_string).collect();
        format!("{pid} {}\n", ends.join(" "))
    }

    /// The process that wrote the file, and the ends before it; of a file that is damaged only what can be read.
    fn read(text: &str) -> Self {
        Self(text.split_whitespace().skip(1).filter_map(|word| word.parse().ok()).collect())
    }
}

/// This program's own file, which the next run is started from. It is looked up once: Linux calls a file "NAME (deleted)"
/// after an update has replaced it.
///
/// # Errors
/// Where the system does not give it.
pub fn program() -> anyhow::Result<PathBuf> {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    if let Some(program) = PROGRAM.get() {
        return Ok(program.clone());
    }
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    Ok(PROGRAM.get_or_init(|| replaced(program)).clone())
}

/// The file that stands where a deleted one stood; `program` itself where there is none.
fn replaced(program: PathBuf) -> PathBuf {
    let before = program.to_str().and_then(|path| path.strip_suffix(" (deleted)")).map(PathBuf::from);
    before.filter(|path| path.exists()).unwrap_or(program)
}

/// Notes that this run has begun; logs, and raises, what the file shows of those before it. Lasts as long as the alert may.
pub(crate) async fn notice(node: &Node) {
    let path = path(&node.config, node.role, &node.id);
    let noted = tokio::task::spawn_blocking(move || {
        let before = std::fs::read_to_string(&path).ok();
        let mut ends = before.as_deref().map(Ends::read).unwrap_or_default();
        if before.is_some() {
            ends.take(now_s());
        }
        // Without the file the next run does not know of this one.
        let _ = path.parent().map(std::fs::create_dir_all);
        let _ = std::fs::write(&path, ends.text(std::process::id()));
        (before.is_some(), ends)
    });
    let Ok((has_ended, mut ends)) = noted.await else { return };
    if !has_ended {
        return;
    }
    let how = "the run before this one ended without being asked to: by a signal, an error, or with its machine";
    tracing::warn!("{how}");
    let instance = contract::node::name(node.role, &node.id);
    while ends.are_many(now_s()) {
        let cause = format!(
            "the {} node {} ended {MANY} times or more within {} min; {how}",
            node.role,
            node.id,
            WITHIN.as_secs() / 60
        );
        node.alerts.raise(AlertKind::NodeEnds, &instance, &cause);
        tokio::time::sleep(Duration::from_secs(10)).await;
    }
    node.alerts.clear(AlertKind::NodeEnds, &instance);
}

/// The node ended as it was asked to.
pub(crate) async fn ended_well(node: &Node) {
    let path = path(&node.config, node.role, &node.id);
    let removing = tokio::task::spawn_blocking(move || std::fs::remove_file(path));
    // One that is not removed is an end that was none, in the next run's log.
    let _ = tokio::time::timeout(DISK, removing).await;
}

/// Is a run of a node of this telescope and data folder noted that has not ended as it was asked to: one that goes on, or
/// was killed?
pub fn is_open(config: &config::Observatory, role: impl Display, id: impl Display) -> bool {
    path(config, role, id).exists()
}

fn path(config: &config::Observatory, role: impl Display, id: impl Display) -> PathBuf {
    config.folders.data.join(format!(".run-{}-{role}-{id}", config.place.telescope))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_third_end_within_ten_minutes_is_an_alert_and_older_ones_are_forgotten() {
        let mut ends = Ends::default();
        for (at_s, many) in [(1000, false), (1200, false), (1400, true), (1590, true), (2100, false), (2150, true)] {
            ends.take(at_s);
            assert_eq!(ends.are_many(at_s), many, "at {at_s}: {ends:?}");
        }
        assert!(ends.are_many(2190) && !ends.are_many(2191), "the end at 1590 has passed");
        ends.take(1600);
        assert!(ends.are_many(1600), "a clock that was set back by less than ten minutes loses nothing");
    }

    #[test]
    fn ends_that_a_wrong_clock_noted_in_the_future_are_forgotten_when_it_is_set_right() {
        let mut ends = Ends::default();
        for _ in 0..MANY {
            ends.take(2_000_000_000);
        }
        assert!(ends.are_many(2_000_000_000));
        assert!(!ends.are_many(1_800_000_000) && ends == Ends::default(), "{ends:?}");
    }

    #[test]
    fn a_program_that_an_update_replaced_is_the_file_in_its_place() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("starmesh");
        let deleted = folder.path().join("starmesh (deleted)");
        assert_eq!(replaced(deleted.clone()), deleted, "nothing stands in its place");
        std::fs::write(&program, "").unwrap();
        assert_eq!((replaced(deleted), replaced(program.clone())), (program.clone(), program));
    }

    #[test]
    fn the_file_of_a_run_is_read_by_the_next_one_and_damage_costs_only_what_is_damaged() {
        let ends = Ends(vec![7, 9]);
        assert_eq!(Ends::read(&ends.text(42)), ends);
        assert_eq!(Ends::read("42 7 \u{0}\u{0} 9"), Ends(vec![7, 9]));
        assert_eq!(Ends::read(""), Ends::default());
    }
}
