//! The signals that ask a process to end.

use std::sync::OnceLock;

use tokio::sync::watch;

/// Waits until standard input closes; a thread of its own, so that a read without end cannot hold the runtime up.
pub async fn parent_end() {
    let (ended, end) = tokio::sync::oneshot::channel();
    std::thread::spawn(move || {
        // Later input is not for us; an error ends the reading as the end of the file does.
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
        let _ = ended.send(());
    });
    let _ = end.await;
}

/// The signals that have arrived.
#[derive(Debug, Clone, Copy, Default)]
struct Arrived {
    /// SIGTERM, Ctrl-C or the end of the terminal has asked for an end in good order.
    end: bool,
    /// How often SIGTERM or Ctrl-C has arrived.
    terminations: u32,
}

static ARRIVED: OnceLock<watch::Receiver<Arrived>> = OnceLock::new();

/// Takes the signals from now on, so that one that arrives while the process starts is an order like any later one. Without
/// it, the first that waits for a signal takes them.
///
/// A thread of its own takes them: what the process does meanwhile, such as reading files, delays none.
pub fn listen() {
    arrived();
}

fn arrived() -> watch::Receiver<Arrived> {
    let start = || {
        let (sender, receiver) = watch::channel(Arrived::default());
        let (ready, is_ready) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            if let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_io().build() {
                runtime.block_on(take(&sender, &ready));
            }
        });
        // An error means that the thread could take no signal: then the system's own reaction stays.
        let _ = is_ready.recv();
        receiver
    };
    ARRIVED.get_or_init(start).clone()
}

#[cfg(unix)]
async fn take(arrived: &watch::Sender<Arrived>, ready: &std::sync::mpsc::Sender<()>) {
    use tokio::signal::unix::{SignalKind, signal};
    let (Ok(mut terminate), Ok(mut interrupt)) = (signal(SignalKind::terminate()), signal(SignalKind::interrupt()))
    else {
        return;
    };
    // Under `nohup` the end of the terminal means nothing.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mut hangup = handles_hangup(&status).then(|| signal(SignalKind::hangup()).ok()).flatten();
    let _ = ready.send(());
    loop {
        let hung_up = async {
            match &mut hangup {
                Some(hangup) => hangup.recv().await,
                None => std::future::pending().await,
            }
        };
        // A shell may signal the end of a terminal twice, so it is never the second signal, which ends at once.
        let is_termination = tokio::select! {
            _ = terminate.recv() => true,
            _ = interrupt.recv() => true,
            _ = hung_up => false,
        };
        arrived.send_modify(|arrived| {
            arrived.end = true;
            arrived.terminations += u32::from(is_termination);
        });
    }
}

#[cfg(not(unix))]
async fn take(arrived: &watch::Sender<Arrived>, ready: &std::sync::mpsc::Sender<()>) {
    let _ = ready.send(());
    while tokio::signal::ctrl_c().await.is_ok() {
        arrived.send_modify(|arrived| {
            arrived.end = true;
            arrived.terminations += 1;
        });
    }
}

/// Waits for SIGTERM, Ctrl-C or the end of the terminal, whichever asks first for an end in good order.
pub async fn end_asked() {
    until(|arrived| arrived.end).await;
}

/// Waits for one more SIGTERM or Ctrl-C than there has been.
pub async fn termination() {
    let before = arrived().borrow().terminations;
    until(move |arrived| arrived.terminations > before).await;
}

async fn until(condition: impl Fn(&Arrived) -> bool) {
    if arrived().wait_for(condition).await.is_err() {
        // Nothing takes signals here: the system's own reaction ends the process.
        std::future::pending().await
    }
}

/// Does a process with this status, as Linux reports it, not ignore SIGHUP? An unknown status counts as ignoring it.
#[cfg(unix)]
fn handles_hangup(status: &str) -> bool {
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask & 1 == 0)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_the_terminal_asks_for_an_end_unless_it_is_to_be_ignored() {
        assert!(handles_hangup("Name:\tstarmesh\nSigIgn:\t0000000000001000\nSigCgt:\t0000000000000001\n"));
        assert!(!handles_hangup("SigIgn:\t0000000000001001\n"), "nohup");
        assert!(!handles_hangup(""), "nothing is reported");
    }

    #[tokio::test]
    async fn a_hangup_is_an_order_to_end() {
        if !handles_hangup(&std::fs::read_to_string("/proc/self/status").unwrap()) {
            return; // these tests themselves run under nohup
        }
        listen();
        rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::HUP).unwrap();
        end_asked().await;
        end_asked().await;
        let terminated = tokio::spawn(termination());
        tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        assert!(!terminated.is_finished(), "the end of the terminal never ends at once");
        for _ in 0..2 {
            let terminated = tokio::spawn(termination());
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
            rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::TERM).unwrap();
            terminated.await.unwrap();
        }
    }
}
