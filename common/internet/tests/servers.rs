//! The client against small real servers on this host, which answer with the bytes that a test gives them.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test ends by panicking")]

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use hyper::body::Incoming;
use internet::{Client, Request, Response, StatusCode, first_bytes, header, trust, whole_bytes};
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, DnType, IsCa, KeyPair, date_time_ymd};
use rustls::pki_types::PrivateKeyDer;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpSocket};
use tokio_rustls::TlsAcceptor;

/// No step takes longer, also on a busy machine.
const LIMIT: Duration = Duration::from_secs(60);

/// What a server does once it has answered.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Then {
    Closes,
    Waits,
}

#[derive(Clone)]
struct Server {
    port: u16,
    asked: Arc<Mutex<Vec<String>>>,
    /// How many clients left a server that waits.
    left: Arc<Mutex<usize>>,
}

impl Server {
    async fn start(answer: &[u8], then: Then, tls: Option<TlsAcceptor>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let server = Self { port, asked: Arc::default(), left: Arc::default() };
        let (own, answer) = (server.clone(), answer.to_owned());
        tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                let (own, answer, tls) = (own.clone(), answer.clone(), tls.clone());
                tokio::spawn(async move {
                    let Some(tls) = tls else { return own.serve(stream, &answer, then).await };
                    // A client that does not accept the certificate leaves.
                    if let Ok(stream) = tls.accept(stream).await {
                        own.serve(stream, &answer, then).await;
                    }
                });
            }
        });
        server
    }

    async fn serve(&self, mut stream: impl AsyncRead + AsyncWrite + Unpin, answer: &[u8], then: Then) {
        let mut request = Vec::new();
        while !is_whole(&String::from_utf8_lossy(&request)) {
            if stream.read_buf(&mut request).await.unwrap_or(0) == 0 {
                return;
            }
        }
        self.asked.lock().unwrap().push(String::from_utf8(request).unwrap());
        let _ = stream.write_all(answer).await;
        let _ = stream.flush().await;
        if then == Then::Waits {
            let _ = stream.read(&mut [0]).await;
            *self.left.lock().unwrap() += 1;
        }
        let _ = stream.shutdown().await;
    }

    fn url(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}/{path}", self.port)
    }

    fn asked(&self) -> Vec<String> {
        self.asked.lock().unwrap().clone()
    }
}

/// Is this a header, with as much after it as it announces?
fn is_whole(request: &str) -> bool {
    let Some((head, body)) = request.split_once("\r\n\r\n") else { return false };
    let length = head.lines().find_map(|line| line.to_lowercase().strip_prefix("content-length: ")?.parse().ok());
    body.len() >= length.unwrap_or(0)
}

async fn soon<T>(work: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, work).await.unwrap()
}

async fn until(what: &str, holds: impl Fn() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < LIMIT, "{what}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

async fn get(url: &str) -> anyhow::Result<Response<Incoming>> {
    soon(Client::new(url, None).await?.send(Request::get(url), String::new())).await
}

fn with_length(announced: usize, body: &[u8]) -> Vec<u8> {
    [format!("HTTP/1.1 200 OK\r\nContent-Length: {announced}\r\n\r\n").as_bytes(), body].concat()
}

/// An answer in pieces of 100 bytes, with its end or without.
fn in_pieces(body: &[u8], end: &str) -> Vec<u8> {
    let mut answer = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n".to_vec();
    for piece in body.chunks(100) {
        answer.extend([format!("{:x}\r\n", piece.len()).as_bytes(), piece, b"\r\n"].concat());
    }
    [&answer, end.as_bytes()].concat()
}

#[tokio::test]
async fn a_request_arrives_with_its_address_its_headers_and_its_body() {
    let server = Server::start(&with_length(2, b"ok"), Then::Closes, None).await;
    let url = server.url("hook?id=7");
    let request = Request::post(&url).header(header::CONTENT_TYPE, "application/json");
    let client = Client::new(&url, None).await.unwrap();
    let mut answer = soon(client.send(request, "{\"text\":\"ä\"}".to_owned())).await.unwrap();
    assert_eq!((answer.status(), soon(whole_bytes(&mut answer, 2)).await.unwrap()), (StatusCode::OK, b"ok".to_vec()));
    let asked = &server.asked()[0];
    assert!(
        asked.starts_with("POST /hook?id=7 HTTP/1.1\r\n") && asked.ends_with("\r\n\r\n{\"text\":\"ä\"}"),
        "{asked}"
    );
    assert!(asked.contains("content-type: application/json") && asked.contains("user-agent: starmesh"), "{asked}");
}

#[tokio::test]
async fn a_redirection_is_handed_back_and_its_target_is_never_asked() {
    let target = Server::start(&with_length(0, b""), Then::Closes, None).await;
    for status in [301, 302, 303, 307, 308] {
        let to = target.url("elsewhere");
        let answer = format!("HTTP/1.1 {status} Go\r\nLocation: {to}\r\nContent-Length: 0\r\n\r\n");
        let server = Server::start(answer.as_bytes(), Then::Closes, None).await;
        let answer = get(&server.url("")).await.unwrap();
        assert_eq!((answer.status().as_u16(), answer.headers()[header::LOCATION].to_str().unwrap()), (status, &*to));
        assert_eq!(server.asked().len(), 1);
    }
    assert!(target.asked().is_empty());
}

#[tokio::test]
async fn an_answer_over_its_limit_is_refused_however_it_is_sent() {
    let body: Vec<u8> = (0..1000_u32).map(|number| number as u8).collect();
    let to_the_end = [b"HTTP/1.1 200 OK\r\n\r\n", &*body].concat();
    for (answer, how) in
        [(with_length(1000, &body), "length"), (in_pieces(&body, "0\r\n\r\n"), "pieces"), (to_the_end, "end")]
    {
        let server = Server::start(&answer, Then::Closes, None).await;
        let mut whole = get(&server.url("")).await.unwrap();
        assert_eq!(soon(whole_bytes(&mut whole, 1000)).await.unwrap(), body, "{how}");
        let mut over = get(&server.url("")).await.unwrap();
        let error = soon(whole_bytes(&mut over, 999)).await.unwrap_err().to_string();
        assert_eq!(error, "its answer has more than 999 bytes", "{how}");
    }
    // One that never ends is refused as soon as it is over the limit.
    let endless = Server::start(&with_length(usize::MAX / 2, &body), Then::Waits, None).await;
    assert!(soon(whole_bytes(&mut get(&endless.url("")).await.unwrap(), 999)).await.is_err());
}

#[tokio::test]
async fn an_answer_that_breaks_off_is_quoted_as_far_as_it_came_and_never_taken_for_whole() {
    let body = [b'x'; 100];
    for answer in [with_length(1000, &body), in_pieces(&body, ""), in_pieces(&body, "no number\r\n")] {
        let server = Server::start(&answer, Then::Closes, None).await;
        let error = soon(whole_bytes(&mut get(&server.url("")).await.unwrap(), 1000)).await.unwrap_err();
        assert!(error.to_string().contains("its answer broke off"), "{error:#}");
        for (most, wanted) in [(0, 0), (30, 30), (100, 100), (1000, 100)] {
            let quoted = soon(first_bytes(&mut get(&server.url("")).await.unwrap(), most)).await;
            assert_eq!(quoted, body[..wanted], "{most}");
        }
    }
}

#[tokio::test]
async fn the_first_bytes_are_quoted_while_the_rest_is_still_to_come() {
    let server = Server::start(&with_length(1000, b"<html>denied"), Then::Waits, None).await;
    let mut answer = get(&server.url("")).await.unwrap();
    assert_eq!(soon(first_bytes(&mut answer, 6)).await, b"<html>");
}

#[tokio::test]
async fn no_error_contains_the_url_and_each_gives_the_reason() {
    // Bound and not listening: nobody else gets its port.
    let held = TcpSocket::new_v4().unwrap();
    held.bind("127.0.0.1:0".parse().unwrap()).unwrap();
    let closed = held.local_addr().unwrap();
    let other = Server::start(b"SSH-2.0-OpenSSH_9.7\r\n", Then::Closes, None).await;
    let silent = Server::start(b"", Then::Closes, None).await;
    for (url, token, wanted) in [
        (format!("http://{closed}/s3cret"), "t0ken", "it cannot be reached"),
        (other.url("s3cret"), "t0ken", "it cannot be reached"),
        (silent.url("s3cret"), "t0ken", "it cannot be reached"),
        ("s3cret".to_owned(), "t0ken", "it cannot be reached"),
        ("ftp://127.0.0.1/s3cret".to_owned(), "t0ken", "it cannot be reached"),
        (silent.url("s3cret path"), "t0ken", "characters that no request may have"),
        (silent.url("s3cret"), "t0ken\n", "characters that no request may have"),
    ] {
        let client = Client::new(&url, None).await.unwrap();
        let request = Request::get(&url).header(header::AUTHORIZATION, token);
        let error = format!("{:#}", soon(client.send(request, String::new())).await.unwrap_err());
        assert!(error.contains(wanted) && !error.contains("s3cret") && !error.contains("t0ken"), "{url}: {error}");
    }
}

#[tokio::test]
async fn a_server_that_does_not_answer_is_waited_for_as_long_as_its_caller_waits_and_no_longer() {
    let server = Server::start(b"", Then::Waits, None).await;
    let url = server.url("");
    let asking = tokio::spawn(async move { get(&url).await });
    until("the question arrives", || server.asked().len() == 1).await;
    assert!(!asking.is_finished());
    asking.abort();
    until("the connection is given up", || *server.left.lock().unwrap() == 1).await;
    assert_eq!(server.asked().len(), 1, "it was asked once");
}

/// An authority of a name, and a server of the host `localhost` that it signed, valid from a year on.
fn signed(name: &str, from_year: i32) -> (String, TlsAcceptor) {
    let mut params = CertificateParams::default();
    params.distinguished_name.push(DnType::CommonName, name);
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let authority = CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap();
    let mut params = CertificateParams::new(vec!["localhost".to_owned()]).unwrap();
    (params.not_before, params.not_after) = (date_time_ymd(from_year, 1, 1), date_time_ymd(4000, 1, 1));
    let key = KeyPair::generate().unwrap();
    let chain = vec![params.signed_by(&key, &authority).unwrap().der().clone()];
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = rustls::ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
    let key = PrivateKeyDer::Pkcs8(key.serialize_der().into());
    let config = builder.with_no_client_auth().with_single_cert(chain, key).unwrap();
    (authority.pem(), TlsAcceptor::from(Arc::new(config)))
}

#[tokio::test]
async fn only_a_certificate_of_a_known_authority_that_is_valid_now_is_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let ((stranger, _), (before, _)) = (signed("stranger", 2020), signed("site", 2020));
    for (from_year, is_known, others, wanted) in [
        (2020, true, &stranger, Ok(StatusCode::OK)),
        (2020, false, &stranger, Err("name the authority's certificate in alerts.ca_file")),
        (2020, false, &before, Err("not signed by the authority that this host knows under that name")),
        (3000, true, &stranger, Err("not valid yet: look at the clock of this host")),
    ] {
        let (pem, tls) = signed("site", from_year);
        let file = folder.path().join("ca.pem");
        std::fs::write(&file, if is_known { pem + others } else { others.clone() }).unwrap();
        let server = Server::start(&with_length(0, b""), Then::Closes, Some(tls)).await;
        let url = format!("https://localhost:{}/s3cret", server.port);
        let client = Client::new(&url, Some(&file)).await.unwrap();
        let answer = soon(client.send(Request::get(&url), String::new())).await;
        match (answer, wanted) {
            (Ok(answer), Ok(status)) => assert_eq!((answer.status(), server.asked().len()), (status, 1)),
            (Err(error), Err(text)) => {
                let error = format!("{error:#}");
                assert!(error.contains(text) && !error.contains("s3cret"), "{error}");
                assert!(server.asked().is_empty(), "nothing was sent");
            }
            (answer, wanted) => panic!("{wanted:?}: {answer:?}"),
        }
    }
}

#[tokio::test]
async fn a_server_that_a_stranger_named_is_asked_on_the_public_internet_alone() {
    let folder = tempfile::tempdir().unwrap();
    let (file, (pem, tls)) = (folder.path().join("ca.pem"), signed("site", 2020));
    std::fs::write(&file, pem).unwrap();
    let server = Server::start(&with_length(0, b""), Then::Closes, Some(tls)).await;
    let url = format!("https://localhost:{}/s3cret", server.port);
    let client = Client::public(&url, Some(&file)).await.unwrap();
    let error = format!("{:#}", soon(client.send(Request::get(&url), "")).await.unwrap_err());
    assert!(error.contains("no address of the public internet") && !error.contains("s3cret"), "{error}");
    for address in ["127.0.0.1", "[::1]", "192.168.1.1"] {
        let url = format!("https://{address}:{}/s3cret", server.port);
        let error = Client::public(&url, Some(&file)).await.unwrap_err().to_string();
        assert!(error.contains("expected a name"), "{error}");
    }
    let plain = Server::start(&with_length(0, b""), Then::Closes, None).await;
    let unencrypted = plain.url("").replace("127.0.0.1", "localhost");
    let client = Client::public(&unencrypted, None).await.unwrap();
    assert!(soon(client.send(Request::get(&unencrypted), "")).await.is_err());
    assert!(plain.asked().is_empty() && server.asked().is_empty());
    let client = Client::new(&url, Some(&file)).await.unwrap();
    assert_eq!(soon(client.send(Request::get(&url), "")).await.unwrap().status(), StatusCode::OK);
}

#[tokio::test]
async fn a_file_of_authorities_that_cannot_be_used_is_an_error_that_gives_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("ca.pem");
    let (good, _) = signed("site", 2020);
    let half = &good[..good.len() / 2];
    let key = KeyPair::generate().unwrap().serialize_pem();
    let no_certificate = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n";
    for (text, wanted) in [
        (String::new(), "holds no certificate: expected PEM"),
        (key, "holds no certificate: expected PEM"),
        (half.to_owned(), "is no PEM file"),
        (good.clone() + half, "is no PEM file"),
        (good.clone() + no_certificate, "a certificate in it cannot be used"),
    ] {
        std::fs::write(&file, &text).unwrap();
        let error = format!("{:#}", trust::tls(Some(&file)).await.unwrap_err());
        assert!(error.starts_with("alerts.ca_file: ") && error.contains(wanted), "{wanted}: {error}\n{text}");
    }
    std::fs::write(&file, good).unwrap();
    trust::tls(Some(&file)).await.unwrap();
}
