//! A server with limits on connections, header time and total time.

use std::net::IpAddr;
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio_rustls::TlsAcceptor;

use crate::places::{Places, Room};

/// Room for the header of one request; longer ones are refused.
const HEADER_BYTES: usize = 16 << 10;
/// An answer that is under way at the end of a connection's time, or of the server's, may take so long.
const LAST_ANSWER: Duration = Duration::from_secs(2);
/// The pause after an error of the system, such as too many open files.
const PAUSE: Duration = Duration::from_millis(100);

/// The first byte of every TLS connection.
const TLS_HANDSHAKE: u8 = 0x16;
/// For a client that does not know that this is TLS.
const PLAIN_HTTP: &[u8] =
    b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain; charset=utf-8\r\nConnection: close\r\n\r\n\
    This server speaks HTTPS only: ask for https:// instead of http://.\n";

/// The limits of one server for its clients.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Connections.
    pub room: Room,
    /// The time for the header of a request, and for a connection that asks nothing.
    pub header: Duration,
    /// The time for a connection with all its answers; a socket that was upgraded is not counted.
    pub total: Duration,
}

/// The address of the client; an extension of each request.
#[derive(Debug, Clone, Copy)]
pub struct Peer(pub IpAddr);

/// Serves until `stop` ends; answers under way then have 2 s.
pub async fn serve(listener: TcpListener, router: Router, limits: Limits, stop: impl Future<Output = ()>) {
    serve_tls(listener, None, router, limits, stop).await;
}

/// The same, over TLS where there is an acceptor.
pub async fn serve_tls(
    listener: TcpListener,
    tls: Option<TlsAcceptor>,
    router: Router,
    limits: Limits,
    stop: impl Future<Output = ()>,
) {
    let places = Places::new(limits.room);
    let (ending, ends) = watch::channel(false);
    let mut connections = JoinSet::new();
    let mut stop = std::pin::pin!(stop);
    let mut refused: u64 = 0;
    loop {
        let accepted = tokio::select! {
            () = &mut stop => break,
            Some(_) = connections.join_next() => continue,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, peer)) => match places.take(peer.ip()) {
                Some(place) => {
                    let router = router.clone().layer(Extension(Peer(peer.ip())));
                    // Small answers must not wait for an acknowledgement of the one before.
                    let _ = stream.set_nodelay(true);
                    let (tls, ends) = (tls.clone(), ends.clone());
                    connections.spawn(async move {
                        let _place = place;
                        match tls {
                            None => connection(stream, router, limits, ends).await,
                            Some(tls) => encrypted(stream, tls, router, limits, ends).await,
                        }
                    });
                }
                None => {
                    refused += 1;
                    // A flood may cause thousands of refusals a second.
                    if refused.is_power_of_two() {
                        let (peer, room) = (peer.ip(), limits.room.total);
                        tracing::warn!(%peer, refused, room, "a connection was refused: no place is free for its address");
                    }
                }
            },
            Err(error) => {
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(PAUSE).await;
            }
        }
    }
    drop(listener);
    ending.send_replace(true);
    let _ = tokio::time::timeout(LAST_ANSWER, async { while connections.join_next().await.is_some() {} }).await;
}

/// A connection over TLS. The handshake has the time of a header; a client that speaks plain HTTP is answered in it.
async fn encrypted(
    mut stream: TcpStream,
    tls: TlsAcceptor,
    router: Router,
    limits: Limits,
    ends: watch::Receiver<bool>,
) {
    let handshake = async {
        let mut first = [0];
        if stream.peek(&mut first).await? == 1 && first != [TLS_HANDSHAKE] {
            // An answer that comes before all of the question was read would be lost by a reset.
            let mut asked = [0; 4096];
            let _ = stream.read(&mut asked).await?;
            stream.write_all(PLAIN_HTTP).await?;
            stream.shutdown().await?;
            return Ok(None);
        }
        tls.accept(stream).await.map(Some)
    };
    match tokio::time::timeout(limits.header, handshake).await {
        Ok(Ok(Some(stream))) => connection(stream, router, limits, ends).await,
        // The client left, or does not trust the certificate.
        Ok(Err(error)) => tracing::debug!(%error, "a TLS handshake failed"),
        Ok(Ok(None)) | Err(_) => {}
    }
}

async fn connection(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    router: Router,
    limits: Limits,
    mut ends: watch::Receiver<bool>,
) {
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.header)
        .max_buf_size(HEADER_BYTES)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
        .with_upgrades();
    let mut served = std::pin::pin!(served);
    let over = async {
        tokio::select! {
            () = tokio::time::sleep(limits.total) => {}
            _ = ends.wait_for(|ended| *ended) => {}
        }
    };
    tokio::select! {
        // An error is the client's: it left, or sent no HTTP.
        _ = &mut served => return,
        () = over => {}
    }
    served.as_mut().graceful_shutdown();
    let _ = tokio::time::timeout(LAST_ANSWER, served).await;
}

#[cfg(test)]
mod tests {
    use axum::routing::get;

    use super::*;

    const LIMITS: Limits = Limits {
        room: Room { total: 20, per_address: 10, trusted: 5 },
        header: Duration::from_millis(500),
        total: Duration::from_secs(3),
    };

    /// What takes longer hangs, also on a busy machine.
    const LONG: Duration = Duration::from_secs(120);

    async fn start(limits: Limits) -> std::net::SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let endless = || async {
            // More than the buffers of both ends hold, so that it waits for a reader.
            axum::body::Body::from(vec![0; 64 << 20])
        };
        let who = |Extension(Peer(ip)): Extension<Peer>| async move { ip.to_string() };
        let router = Router::new().route("/", get(who)).route("/large", get(endless));
        tokio::spawn(serve(listener, router, limits, std::future::pending()));
        address
    }

    async fn ask(address: std::net::SocketAddr) -> reqwest::Result<String> {
        let client = crate::client_builder().timeout(LONG).build()?;
        client.get(format!("http://{address}/")).send().await?.text().await
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn half_requests_hold_the_places_of_one_address_and_give_them_back() {
        let patient = start(Limits { header: 10 * LONG, ..LIMITS }).await;
        let held = send_halves(patient).await;
        let full = ask(patient).await;
        assert!(full.is_err(), "ten of one address, and not one more: {full:?}");
        drop(held);

        let address = start(LIMITS).await;
        let held = send_halves(address).await;
        let asked = async {
            loop {
                match ask(address).await {
                    Ok(answer) => return answer,
                    Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
                }
            }
        };
        let answer = tokio::time::timeout(LONG, asked).await.unwrap();
        assert_eq!(answer, "127.0.0.1", "those that sent half of a request are gone");
        drop(held);
    }

    async fn send_halves(address: std::net::SocketAddr) -> Vec<TcpStream> {
        let mut held = Vec::new();
        for _ in 0..200 {
            let mut stream = TcpStream::connect(address).await.unwrap();
            let _ = stream.write_all(b"GET / HTTP/1.1\r\nHost: x\r\n").await;
            held.push(stream);
        }
        held
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_answer_that_nobody_takes_ends() {
        let address = start(LIMITS).await;
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(b"GET /large HTTP/1.1\r\nHost: x\r\n\r\n").await.unwrap();
        // The other end is closed when it takes nothing any more either.
        let closed = async {
            while stream.write_all(b"G").await.is_ok() {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        };
        tokio::time::timeout(LONG, closed).await.unwrap();
        let mut got = Vec::new();
        let _ = tokio::time::timeout(LONG, stream.read_to_end(&mut got)).await.unwrap();
        assert!(got.len() < 64 << 20, "{}", got.len());
        assert_eq!(ask(address).await.unwrap(), "127.0.0.1");
    }
}
