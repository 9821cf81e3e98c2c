//! Work that may wait steps back behind work that may not.

/// How much nicer: with a busy machine such a thread gets a third of what another gets.
#[cfg(target_os = "linux")]
const NICER: i32 = 5;

/// Gives the calling thread, and the threads it starts, a smaller share of the processor, for good: so it is for
/// threads of its own, never for one of a pool. Does nothing where the system knows no priority of a single thread.
pub fn step_back() {
    #[cfg(target_os = "linux")]
    {
        use rustix::process::{getpriority_process, setpriority_process};
        // Linux keeps the priority per thread, and no id means the calling one; who is nicer already stays so.
        let lowered = getpriority_process(None).and_then(|now| setpriority_process(None, now.max(NICER)));
        if let Err(error) = lowered {
            tracing::debug!(%error, "a thread keeps its priority");
        }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn only_the_thread_that_asks_steps_back() {
        let priority = || rustix::process::getpriority_process(None).unwrap();
        let before = priority();
        let thread = std::thread::spawn(move || {
            step_back();
            (priority(), std::thread::spawn(priority).join().unwrap())
        });
        let nicest = NICER.max(before);
        assert_eq!(thread.join().unwrap(), (nicest, nicest), "its own threads too");
        assert_eq!(priority(), before);
    }
}
