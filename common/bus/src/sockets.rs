//! The sockets of zenoh's links. zenoh opens and owns them, and has no function for what is done here.

use std::io;
use std::net::SocketAddr;

use zenoh::session::Link;

/// The two ends of a TCP link: this process's and the peer's.
pub type Ends = (SocketAddr, SocketAddr);

/// Both ends of a link by TCP.
pub fn ends(link: &Link) -> Option<Ends> {
    Some((address(link.src())?, address(link.dst())?))
}

/// The address of a TCP locator such as `tcp/127.0.0.1:7447`.
fn address(locator: &zenoh::config::Locator) -> Option<SocketAddr> {
    locator.to_string().strip_prefix("tcp/")?.parse().ok()
}

/// Ends links at once; returns how many there were.
pub async fn shut_down(ends: Vec<Ends>) -> io::Result<usize> {
    run(move || system::each(&ends, |socket| socket.shutdown(std::net::Shutdown::Both))).await
}

/// Closing this link shall not wait: a host that is off must not stop what others send.
///
/// zenoh-link-tcp lets the closing of a socket wait 10 s for what the peer has not acknowledged (`SO_LINGER`), and closes in
/// the threads that receive everything: two hosts that were off made a node deaf to all others for 10 s
/// (eclipse-zenoh/zenoh#2350). Without the option the kernel sends what is left, and nobody waits.
pub async fn close_in_background(link: &Link) {
    static REFUSED: std::sync::Once = std::sync::Once::new();
    let Some(ends) = ends(link).filter(|_| cfg!(target_os = "linux")) else { return };
    if let Err(error) = do_not_linger(vec![ends]).await {
        REFUSED.call_once(|| {
            tracing::error!(
                %error,
                "the sockets of the bus cannot be reached: when another host goes off, this node receives nothing for 10 s \
                 and more; it needs Linux 5.6, and a container CAP_SYS_PTRACE"
            );
        });
    }
}

/// Returns how many there were.
async fn do_not_linger(ends: Vec<Ends>) -> io::Result<usize> {
    run(move || system::each(&ends, system::do_not_linger)).await
}

async fn run(act: impl FnOnce() -> io::Result<usize> + Send + 'static) -> io::Result<usize> {
    tokio::task::spawn_blocking(act).await.map_err(io::Error::other).flatten()
}

#[cfg(target_os = "linux")]
mod system {
    use std::io;
    use std::net::{SocketAddr, TcpStream};
    use std::os::unix::ffi::OsStrExt as _;

    use rustix::io::Errno;
    use rustix::process::{PidfdFlags, PidfdGetfdFlags, getpid, pidfd_getfd, pidfd_open};

    use super::Ends;

    /// Acts on this process's sockets between these ends.
    pub fn each(ends: &[Ends], act: impl Fn(&TcpStream) -> io::Result<()>) -> io::Result<usize> {
        let own = pidfd_open(getpid(), PidfdFlags::empty())?;
        let same =
            |a: SocketAddr, b: SocketAddr| a.ip().to_canonical() == b.ip().to_canonical() && a.port() == b.port();
        let mut count = 0;
        for entry in std::fs::read_dir("/proc/self/fd")? {
            let entry = entry?;
            // Only sockets are touched: whoever closes a second descriptor of a file loses all locks on it that the
            // process has, and SQLite's database is then anybody's.
            let is_socket =
                std::fs::read_link(entry.path()).is_ok_and(|to| to.as_os_str().as_bytes().starts_with(b"socket:"));
            let Some(number) = entry.file_name().to_str().and_then(|name| name.parse().ok()).filter(|_| is_socket)
            else {
                continue;
            };
            let socket = match pidfd_getfd(&own, number, PidfdGetfdFlags::empty()) {
                Ok(descriptor) => TcpStream::from(descriptor),
                Err(errno @ (Errno::PERM | Errno::NOSYS)) => return Err(errno.into()),
                // It has been closed since.
                Err(_) => continue,
            };
            match (socket.local_addr(), socket.peer_addr()) {
                (Ok(here), Ok(there)) if ends.iter().any(|(src, dst)| same(here, *src) && same(there, *dst)) => {
                    act(&socket)?;
                    count += 1;
                }
                // Its number was given to a file in between, which is left open rather than unlocked.
                (Err(error), _) if Errno::from_io_error(&error) == Some(Errno::NOTSOCK) => std::mem::forget(socket),
                // Of others, or a listener.
                _ => {}
            }
        }
        Ok(count)
    }

    pub fn do_not_linger(socket: &TcpStream) -> io::Result<()> {
        Ok(rustix::net::sockopt::set_socket_linger(socket, None)?)
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    use std::io;
    use std::net::TcpStream;

    use super::Ends;

    pub fn each(_: &[Ends], _: impl Fn(&TcpStream) -> io::Result<()>) -> io::Result<usize> {
        Err(io::Error::other("this is known only for Linux"))
    }

    pub fn do_not_linger(_: &TcpStream) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use std::net::{TcpListener, TcpStream};
    use std::time::Duration;

    use rustix::net::sockopt::{set_socket_linger, socket_linger};

    use super::*;
    use crate::{Bus, Clock};

    #[tokio::test]
    async fn the_sockets_that_are_meant_and_no_others_close_in_the_background() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let [meant, other] = [0, 1].map(|_| TcpStream::connect(listener.local_addr().unwrap()).unwrap());
        for socket in [&meant, &other] {
            set_socket_linger(socket, Some(Duration::from_secs(10))).unwrap();
        }
        let ends = (meant.local_addr().unwrap(), meant.peer_addr().unwrap());
        assert_eq!(do_not_linger(vec![ends]).await.unwrap(), 1);
        assert_eq!(socket_linger(&meant).unwrap(), None);
        assert_eq!(socket_linger(&other).unwrap(), Some(Duration::from_secs(10)));
    }

    /// A database whose locks are lost is written by two processes at once.
    #[tokio::test]
    async fn a_file_that_this_process_has_locked_stays_locked() {
        use rustix::fs::{FlockOperation, fcntl_lock};
        let path = std::env::temp_dir().join(format!("starmesh-locked-{}", std::process::id()));
        let file = std::fs::File::create(&path).unwrap();
        fcntl_lock(&file, FlockOperation::NonBlockingLockExclusive).unwrap();
        let end = ([127, 0, 0, 1], 1).into();
        assert_eq!(do_not_linger(vec![(end, end)]).await.unwrap(), 0);
        // The locks of this process do not concern itself: the kernel's table shows them.
        let (pid, inode) = (std::process::id(), std::os::unix::fs::MetadataExt::ino(&file.metadata().unwrap()));
        let locks = std::fs::read_to_string("/proc/locks").unwrap();
        std::fs::remove_file(&path).unwrap();
        let is_ours = |line: &str| line.contains(&format!(" {pid} ")) && line.contains(&format!(":{inode} "));
        assert!(locks.lines().any(is_ours), "{locks}");
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn the_links_of_a_node_close_in_the_background() {
        let open = async |connect| {
            let config = config::Bus { listen: Vec::new(), connect, multicast: false };
            Bus::open(&config, Clock::machine_clock()).await.unwrap()
        };
        let own = open(Vec::new()).await;
        let _peer = open(own.locators().await).await;
        let mended = own.clone();
        tokio::spawn(async move { mended.keep_mending().await });
        let began = std::time::Instant::now();
        loop {
            let links: Vec<Ends> = own.session.info().links().await.filter_map(|link| ends(&link)).collect();
            let no_longer = |socket: &TcpStream| match socket_linger(socket)? {
                None => Ok(()),
                Some(wait) => Err(io::Error::other(format!("waits {wait:?}"))),
            };
            let found = system::each(&links, no_longer);
            if found.as_ref().is_ok_and(|count| *count > 0) {
                return;
            }
            assert!(began.elapsed() < Duration::from_secs(120), "{found:?}");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }
}
