//! Notifies whoever supervises this process that it is up and its loops turn: systemd (`sd_notify`), `starmesh up`, or the
//! device node that starts the others ([`crate::watchdog`]).
//!
//! The protocol is one datagram to the socket that `NOTIFY_SOCKET` names; nothing happens where there is none.

/// Reports that the process is ready and alive. The manager's `WatchdogSec` ends and restarts a process that stops
/// reporting. Cheap: at most one datagram each second.
pub fn alive() {
    #[cfg(unix)]
    socket::send();
}

#[cfg(unix)]
mod socket {
    #[cfg(target_os = "linux")]
    use std::os::linux::net::SocketAddrExt as _;
    use std::os::unix::net::{SocketAddr, UnixDatagram};
    use std::sync::{Mutex, OnceLock, PoisonError};
    use std::time::{Duration, Instant};

    static SOCKET: OnceLock<Option<(UnixDatagram, SocketAddr)>> = OnceLock::new();
    static LAST: Mutex<Option<Instant>> = Mutex::new(None);

    pub fn send() {
        let Some((socket, manager)) = SOCKET.get_or_init(open) else { return };
        let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
        if last.is_some_and(|at| at.elapsed() < Duration::from_secs(1)) {
            return;
        }
        *last = Some(Instant::now());
        // A manager that does not listen is no business of this process.
        let _ = socket.send_to_addr(b"READY=1\nWATCHDOG=1\n", manager);
    }

    fn open() -> Option<(UnixDatagram, SocketAddr)> {
        let name = std::env::var("NOTIFY_SOCKET").ok()?;
        let manager = match name.strip_prefix('@') {
            #[cfg(target_os = "linux")]
            Some(name) => SocketAddr::from_abstract_name(name).ok()?,
            #[cfg(not(target_os = "linux"))]
            Some(_) => return None,
            None => SocketAddr::from_pathname(&name).ok()?,
        };
        let socket = UnixDatagram::unbound().ok()?;
        // A full queue must not block the loop that reports that it is alive.
        socket.set_nonblocking(true).ok()?;
        Some((socket, manager))
    }
}
