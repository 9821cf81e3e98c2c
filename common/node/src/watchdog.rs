//! A supervisor's watchdog: it notices that a process of this program still runs and its loops turn no more.
//!
//! The process reports over the socket of `sd_notify` ([`crate::service_manager`]), which each supervisor opens for each
//! process that it starts; systemd does the same with `WatchdogSec`.

use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::time::Duration;

use tokio::process::Child;

/// The variable with the socket, as systemd calls it.
pub const SOCKET: &str = "NOTIFY_SOCKET";
/// A process reports every 5 s; one that has not for so many seconds hangs.
const SILENT_S: u32 = 20;
/// One that has just been started may have to wait for a busy machine.
const FIRST_S: u32 = 60;

/// Counts the seconds without a report. Pure: seconds come in.
///
/// It counts seconds in which the supervisor itself ran: after the supervisor, or the whole machine, was stopped for a
/// while, nobody is ended for that.
#[derive(Debug)]
struct Seconds {
    silent: u32,
    most: u32,
}

impl Seconds {
    /// For a process that starts now.
    fn of_start() -> Self {
        Self { silent: 0, most: FIRST_S }
    }

    /// It has reported.
    fn reported(&mut self) {
        *self = Self { silent: 0, most: SILENT_S };
    }

    /// A second has passed. Does it hang?
    fn is_hung_after_another(&mut self) -> bool {
        self.silent += 1;
        self.silent > self.most
    }
}

/// The socket on which one process reports, and what it has reported.
#[derive(Debug)]
pub struct Watchdog {
    #[cfg(unix)]
    socket: tokio::net::UnixDatagram,
    folder: PathBuf,
}

impl Watchdog {
    /// The path for the variable [`SOCKET`] of the process.
    pub fn path(&self) -> PathBuf {
        self.folder.join("notify")
    }

    /// Opens the socket of a process that is started next; must be called within a runtime.
    ///
    /// # Errors
    /// Where this system has no such socket, or no room for one: the process then runs without a watchdog.
    #[cfg(unix)]
    pub fn open() -> std::io::Result<Self> {
        use std::os::unix::fs::DirBuilderExt as _;
        use std::sync::atomic::{AtomicU32, Ordering};
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("starmesh-{}-{number}", std::process::id()));
        // What an earlier process of the same number left here, which nobody uses any more.
        remove(&folder);
        std::fs::DirBuilder::new().mode(0o700).create(&folder)?;
        match tokio::net::UnixDatagram::bind(folder.join("notify")) {
            Ok(socket) => Ok(Self { socket, folder }),
            Err(error) => {
                remove(&folder);
                Err(error)
            }
        }
    }

    /// Opens the socket of a process that is started next.
    ///
    /// # Errors
    /// Always: this system has no such socket.
    #[cfg(not(unix))]
    pub fn open() -> std::io::Result<Self> {
        Err(std::io::Error::new(std::io::ErrorKind::Unsupported, "this system has no sockets with a path"))
    }

    /// Returns when the process has not reported for 20 s, or for 60 s since it was started.
    pub async fn hung(&self) {
        self.hung_by(Duration::from_secs(1)).await;
    }

    /// The same, with seconds of another length.
    async fn hung_by(&self, second: Duration) {
        let mut seconds = Seconds::of_start();
        let mut tick = tokio::time::interval(second);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                () = self.report() => seconds.reported(),
                _ = tick.tick() => if seconds.is_hung_after_another() {
                    return;
                },
            }
        }
    }

    #[cfg(unix)]
    async fn report(&self) {
        // What else it reports does not matter here.
        if self.socket.recv(&mut [0; 64]).await.is_err() {
            std::future::pending().await
        }
    }

    #[cfg(not(unix))]
    async fn report(&self) {
        std::future::pending().await
    }
}

/// Waits until a process ends, or hangs: `None`. Without a watchdog nobody notices that it hangs.
pub async fn ended(child: &mut Child, watchdog: &std::io::Result<Watchdog>) -> Option<std::io::Result<ExitStatus>> {
    let hung = async {
        match watchdog {
            Ok(watchdog) => watchdog.hung().await,
            Err(_) => std::future::pending().await,
        }
    };
    tokio::select! {
        ended = child.wait() => Some(ended),
        () = hung => None,
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        remove(&self.folder);
    }
}

/// Removes the folder of a socket. What is left of it does no harm.
fn remove(folder: &Path) {
    let _ = std::fs::remove_file(folder.join("notify"));
    let _ = std::fs::remove_dir(folder);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn first_second_of_hanging(mut seconds: Seconds) -> u32 {
        (1..).find(|_| seconds.is_hung_after_another()).unwrap_or_default()
    }

    #[test]
    fn a_process_hangs_after_twenty_silent_seconds_and_a_new_one_after_sixty() {
        assert_eq!(first_second_of_hanging(Seconds::of_start()), FIRST_S + 1);
        let mut seconds = Seconds::of_start();
        for _ in 0..1000 {
            seconds.reported();
            assert!((0..5).all(|_| !seconds.is_hung_after_another()), "it reports every 5 s");
        }
        seconds.reported();
        assert_eq!(first_second_of_hanging(seconds), SILENT_S + 1);
    }

    #[cfg(unix)]
    #[tokio::test]
    async fn what_a_process_reports_arrives_and_one_that_reports_nothing_hangs() {
        let limit = Duration::from_secs(60);
        let watchdog = Watchdog::open().unwrap();
        let process = std::os::unix::net::UnixDatagram::unbound().unwrap();
        process.send_to(b"READY=1\nWATCHDOG=1\n", watchdog.path()).unwrap();
        tokio::time::timeout(limit, watchdog.report()).await.unwrap();
        tokio::time::timeout(limit, watchdog.hung_by(Duration::from_millis(1))).await.unwrap();
        let folder = watchdog.folder.clone();
        assert!(folder.exists());
        drop(watchdog);
        assert!(!folder.exists());
    }
}
