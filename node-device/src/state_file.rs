//! The file of the states that a device node published: what was recorded before its restart counts after it.
//!
//! Each state is one line, appended by a thread of its own and never waited for: it has to survive an end of the
//! process, not one of the machine. A line that cannot be read or is missing, and one of another start of the machine, another
//! server or another speed of time ends the record: nothing that was written before it counts.

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use bus::MachineTime;
use contract::{BootId, Device, Link, Payload};
use node::Node;
use node::file_writer::{self, FileWriter};
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;

/// A file of more bytes loses its older half: an hour of a station with all its sensors takes less than that half.
const MOST_BYTES: u64 = 8 << 20;
/// Lines that wait for the disk; the next ones are lost, and the record begins anew after them.
const WAITING: usize = 256;
/// A disk that takes longer to show the file keeps no device waiting.
const READS: Duration = Duration::from_secs(1);

/// One state as it was published.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecordedState<F> {
    /// By which incarnation.
    pub boot_id: BootId,
    /// With which number.
    pub seq: u64,
    /// When, on the boot-time clock.
    pub since_boot: Duration,
    /// Did the device answer?
    pub link: Link,
    /// How old its readings were, where that matters.
    pub ages_s: BTreeMap<String, f64>,
    /// What nodes decide with.
    pub fields: F,
}

/// What recorded states must have in common.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// The start of the machine that the times belong to.
    pub kernel_boot_id: String,
    /// The Alpaca server with the number of the device: another device has another past.
    pub server: String,
    /// Sky seconds in a machine second.
    pub speed: f64,
}

/// The file of one device.
pub struct StateFile {
    source: Source,
    lines: FileWriter<Vec<u8>>,
}

impl StateFile {
    /// Reads what earlier incarnations wrote, oldest first, as far as it counts; the file goes on.
    pub async fn open<F: Payload>(path: PathBuf, source: Source, now: MachineTime) -> (Self, Vec<RecordedState<F>>) {
        let (file, of) = (path.clone(), source.clone());
        let since_boot = now.since(MachineTime::from_boot(Duration::ZERO));
        let (answer, reading) = oneshot::channel();
        // Not one of the runtime's own threads, whose end a stopping node waits for: a disk may hang for ever.
        std::thread::spawn(move || drop(answer.send(read::<F>(&file, &of, since_boot))));
        let read = match tokio::time::timeout(READS, reading).await {
            Ok(Ok(read)) => read.map_err(|error| error.to_string()),
            Ok(Err(_)) => Err("its reader has died".to_owned()),
            Err(_) => Err(format!("the disk did not show it within {} s", READS.as_secs())),
        };
        let earlier = read.unwrap_or_else(|why| {
            let file = path.display();
            tracing::warn!(%file, why, "what this node recorded before its restart does not count: a dwell may run");
            Vec::new()
        });
        (Self { source, lines: write_to(path) }, earlier)
    }

    /// Has a state written.
    pub fn append<F: Payload>(&self, state: &RecordedState<F>) {
        let Ok(mut line) = serde_json::to_vec(&(&self.source, state)) else { return };
        line.push(b'\n');
        // Where it finds no room, the gap in the numbers ends the record.
        self.lines.write(line);
    }

    /// Waits until the last state is written, for so long at most: a disk may hang for ever.
    pub async fn end(self, most: Duration) {
        if !self.lines.end(most).await {
            tracing::warn!("the disk did not take this node's last states: after its restart, a dwell may run");
        }
    }
}

/// Where a device node keeps it: nodes that share a folder have one each.
pub fn path(node: &Node, device: &Device) -> PathBuf {
    let (telescope, id) = (&node.config.place.telescope, &node.id);
    node.config.folders.data.join(format!("states-{telescope}-{id}-{}-{}.jsonl", device.kind, device.name))
}

/// The way to the thread that writes.
fn write_to(path: PathBuf) -> FileWriter<Vec<u8>> {
    let consequence = "after a restart of this node, what it recorded before would not count";
    let mut is_tidy = false;
    file_writer::start(path, WAITING, consequence, move |path, line: Vec<u8>| {
        if !std::mem::replace(&mut is_tidy, true) {
            // What fails here fails for the line, too.
            let _ = tidy(path);
        }
        append(path, &line)
    })
}

/// What was written, as far as it counts `now`.
fn read<F: Payload>(path: &Path, source: &Source, now: Duration) -> io::Result<Vec<RecordedState<F>>> {
    let mut states: Vec<RecordedState<F>> = Vec::new();
    let mut damaged = None;
    let bytes = bytes(path)?;
    // Half a line is the last one of a process that was killed.
    let whole = bytes.split_inclusive(|byte| *byte == b'\n').filter(|line| line.ends_with(b"\n"));
    for (number, line) in (1..).zip(whole) {
        match serde_json::from_slice::<(Source, RecordedState<F>)>(line) {
            Ok((of, state)) => {
                if of != *source || !follows(&states, &state) {
                    states.clear();
                }
                states.extend(Some(state).filter(|_| of == *source));
            }
            Err(error) => {
                states.clear();
                damaged = Some((number, error));
            }
        }
    }
    if let Some((line, error)) = damaged {
        let file = path.display();
        tracing::warn!(%file, line, %error, "a line is damaged: what this node recorded before it does not count");
    }
    let is_past = !source.kernel_boot_id.is_empty() && states.last().is_none_or(|newest| newest.since_boot <= now);
    Ok(if is_past { states } else { Vec::new() })
}

/// Is it the next of an incarnation, or the first one of another?
fn follows<F>(states: &[RecordedState<F>], next: &RecordedState<F>) -> bool {
    states.last().is_none_or(|last| {
        let is_next = if last.boot_id == next.boot_id {
            last.seq.checked_add(1) == Some(next.seq)
        } else {
            next.seq == 0 && states.iter().all(|state| state.boot_id != next.boot_id)
        };
        is_next && last.since_boot <= next.since_boot
    })
}

/// The content of the file; nothing where there is none.
fn bytes(path: &Path) -> io::Result<Vec<u8>> {
    match fs::metadata(path) {
        Ok(found) if found.len() > 2 * MOST_BYTES => {
            Err(io::Error::other(format!("it has {} bytes, more than this node writes; move it away", found.len())))
        }
        Ok(_) => fs::read(path),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}

fn append(path: &Path, line: &[u8]) -> io::Result<()> {
    if fs::metadata(path).is_ok_and(|found| found.len() > MOST_BYTES) {
        tidy(path)?;
    }
    OpenOptions::new().create(true).append(true).open(path)?.write_all(line)
}

/// Takes half a line off the end, to which the next one would be added, and the older half off a file that is full.
fn tidy(path: &Path) -> io::Result<()> {
    let bytes = bytes(path)?;
    let after = |newline: usize| newline + 1;
    let end = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, after);
    let is_full = bytes.len() as u64 > MOST_BYTES;
    let half = bytes.iter().skip(bytes.len() / 2).position(|byte| *byte == b'\n').map_or(end, after);
    let begin = if is_full { (bytes.len() / 2 + half).min(end) } else { 0 };
    let kept = bytes.get(begin..end).unwrap_or_default();
    if kept.len() == bytes.len() { Ok(()) } else { node::private::write_whole(path, kept) }
}

#[cfg(test)]
mod tests {
    use contract::Datum;
    use contract::device::switch::Fields;

    use super::*;

    fn source() -> Source {
        Source { kernel_boot_id: "a".to_owned(), server: "10.0.0.1:11111#0".to_owned(), speed: 1.0 }
    }

    fn state(boot: &str, seq: u64, second: u64) -> RecordedState<Fields> {
        RecordedState {
            boot_id: BootId::try_from(boot.to_owned()).unwrap(),
            seq,
            since_boot: Duration::from_secs(second),
            link: Link::Connected,
            ages_s: BTreeMap::from([("GetSwitchValue0".to_owned(), 0.625)]),
            fields: Fields { values: vec![Datum::Known(second as f64 / 3.0)] },
        }
    }

    fn line(source: &Source, state: &RecordedState<Fields>) -> Vec<u8> {
        let mut line = serde_json::to_vec(&(source, state)).unwrap();
        line.push(b'\n');
        line
    }

    /// A file with these lines, one after the other.
    struct Scene {
        _folder: tempfile::TempDir,
        path: PathBuf,
    }

    impl Scene {
        fn new(lines: &[Vec<u8>]) -> Self {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("states.jsonl");
            fs::write(&path, lines.concat()).unwrap();
            Self { _folder: folder, path }
        }

        fn seconds(&self) -> Vec<u64> {
            let states = read::<Fields>(&self.path, &source(), Duration::from_secs(1000)).unwrap();
            states.iter().map(|state| state.since_boot.as_secs()).collect()
        }
    }

    fn good() -> Vec<Vec<u8>> {
        [("a", 7, 10), ("a", 8, 15), ("b", 0, 18), ("b", 1, 20)]
            .map(|(boot, seq, second)| line(&source(), &state(boot, seq, second)))
            .to_vec()
    }

    #[test]
    fn what_was_written_is_read_over_two_incarnations_and_a_killed_write() {
        let scene = Scene::new(&[]);
        assert_eq!(scene.seconds(), [0_u64; 0]);
        good().iter().for_each(|line| append(&scene.path, line).unwrap());
        let states = read::<Fields>(&scene.path, &source(), Duration::from_secs(20)).unwrap();
        assert_eq!(states, [state("a", 7, 10), state("a", 8, 15), state("b", 0, 18), state("b", 1, 20)]);
        let whole = fs::read(&scene.path).unwrap();
        let last = good()[3].len();
        for missing in 1..last {
            fs::write(&scene.path, &whole[..whole.len() - missing]).unwrap();
            assert_eq!(scene.seconds(), [10, 15, 18], "{missing} bytes are missing");
        }
        tidy(&scene.path).unwrap();
        append(&scene.path, &good()[3]).unwrap();
        assert_eq!(fs::read(&scene.path).unwrap(), whole, "half a line spoils no next one");
    }

    #[test]
    fn nothing_counts_from_before_a_line_that_is_damaged_missing_or_of_something_else() {
        let elsewhere = [
            Source { kernel_boot_id: "b".to_owned(), ..source() },
            Source { server: "10.0.0.2:11111#0".to_owned(), ..source() },
            Source { speed: 100.0, ..source() },
        ];
        let mut spoilt: Vec<Vec<u8>> = elsewhere.iter().map(|of| line(of, &state("a", 8, 15))).collect();
        spoilt.extend([b"{\"half\n".to_vec(), b"\n".to_vec(), b"\xff\xfe\n".to_vec()]);
        for spoilt in spoilt {
            let [first, _, third, last] = [0, 1, 2, 3].map(|index| good()[index].clone());
            let scene = Scene::new(&[first, spoilt.clone(), third, last]);
            assert_eq!(scene.seconds(), [18, 20], "{}", String::from_utf8_lossy(&spoilt));
        }
        let of = |states: &[(&str, u64, u64)]| {
            let lines = states.iter().map(|(boot, seq, second)| line(&source(), &state(boot, *seq, *second)));
            Scene::new(&lines.collect::<Vec<_>>()).seconds()
        };
        assert_eq!(of(&[("a", 7, 10), ("a", 9, 15), ("a", 10, 20)]), [15, 20], "a number is missing");
        assert_eq!(of(&[("a", 7, 10), ("a", 8, 9), ("a", 9, 20)]), [9, 20], "time ran back");
        assert_eq!(of(&[("a", 7, 10), ("b", 0, 11), ("a", 8, 12), ("a", 9, 13)]), [12, 13], "two write at once");
        assert_eq!(of(&[("a", 7, 10), ("a", 8, 2000)]), [0_u64; 0], "from the future");
        let nameless = Source { kernel_boot_id: String::new(), ..source() };
        let scene = Scene::new(&[line(&nameless, &state("a", 7, 10))]);
        assert_eq!(read::<Fields>(&scene.path, &nameless, Duration::from_secs(20)).unwrap(), []);
    }

    #[test]
    fn the_file_is_bounded_and_keeps_its_newest_states() {
        let scene = Scene::new(&[]);
        let long = |seq: u64| {
            let values = vec![Datum::Known(0.125); 100_000];
            line(&source(), &RecordedState { fields: Fields { values }, ..state("a", seq, seq) })
        };
        for seq in 0..40 {
            append(&scene.path, &long(seq)).unwrap();
            assert!(fs::metadata(&scene.path).unwrap().len() <= MOST_BYTES + long(seq).len() as u64);
        }
        let seconds = scene.seconds();
        assert_eq!(seconds.last(), Some(&39));
        assert!(seconds.len() > 5 && seconds.is_sorted() && seconds[0] > 0, "{seconds:?}");
        fs::File::options().write(true).open(&scene.path).unwrap().set_len(2 * MOST_BYTES + 1).unwrap();
        let refused = read::<Fields>(&scene.path, &source(), Duration::from_secs(1000)).unwrap_err();
        assert!(refused.to_string().contains("move it away"), "{refused}");
        assert!(append(&scene.path, &long(40)).is_err(), "a file that is none of ours is not touched");
    }

    #[tokio::test]
    async fn an_end_in_good_order_leaves_the_last_state_on_the_disk() {
        let scene = Scene::new(&[]);
        let now = MachineTime::from_boot(Duration::from_secs(1000));
        let (file, earlier) = StateFile::open::<Fields>(scene.path.clone(), source(), now).await;
        assert_eq!(earlier, []);
        (0..100).for_each(|seq| file.append(&state("a", seq, seq)));
        file.end(Duration::from_secs(60)).await;
        assert_eq!(scene.seconds(), (0..100).collect::<Vec<_>>());
    }

    /// A pipe shows nothing while somebody may write to it, as a file on a disk that hangs.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_stopping_node_does_not_wait_for_a_disk_that_hangs() {
        use std::os::unix::fs::OpenOptionsExt;
        use std::time::Instant;

        use rustix::fs::{CWD, Mode, OFlags, mkfifoat};

        const HANGS: Duration = Duration::from_secs(60);

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("states.jsonl");
        mkfifoat(CWD, &path, Mode::RUSR | Mode::WUSR).unwrap();
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let now = MachineTime::from_boot(Duration::from_secs(1000));
        runtime.spawn(StateFile::open::<Fields>(path.clone(), source(), now));
        // Opened without waiting, which is refused as long as nobody reads.
        let nonblocking = i32::try_from(OFlags::NONBLOCK.bits()).unwrap();
        let began = Instant::now();
        let writer = loop {
            match OpenOptions::new().write(true).custom_flags(nonblocking).open(&path) {
                Ok(writer) => break writer,
                Err(refused) => assert!(began.elapsed() < HANGS, "nobody reads it: {refused}"),
            }
            std::thread::sleep(Duration::from_millis(1));
        };
        let (stopped, seen) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            drop(runtime);
            stopped.send(()).unwrap();
        });
        assert_eq!(seen.recv_timeout(HANGS), Ok(()), "the runtime waits for the disk");
        drop(writer);
    }
}
