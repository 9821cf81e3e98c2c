//! Requests written by hand, so that a test decides each byte, and users for them.

use std::net::SocketAddr;
use std::path::Path;

use serde_json::Value;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpSocket, TcpStream};
use users::{FileFault, PasswordHash, User, Users};

use super::Stage;

pub const PASSWORD: &str = "four plain words here";

pub struct Answer {
    pub status: u16,
    pub head: String,
    pub text: String,
}

impl Answer {
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.text).unwrap_or_default()
    }

    pub fn header(&self, name: &str) -> Option<&str> {
        let lines = self.head.lines().filter_map(|line| line.split_once(": "));
        lines.into_iter().find(|(key, _)| key.eq_ignore_ascii_case(name)).map(|(_, value)| value)
    }

    /// What a browser would send back.
    pub fn cookie(&self) -> String {
        let set = self.header("set-cookie").unwrap_or_else(|| panic!("no cookie: {} {}", self.head, self.text));
        set.split(';').next().unwrap().to_owned()
    }
}

/// Sends a request and reads the answer to its end.
pub async fn exchange(mut stream: impl AsyncRead + AsyncWrite + Unpin, request: &str) -> Answer {
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut bytes = Vec::new();
    // An end without farewell is an end.
    let _ = stream.read_to_end(&mut bytes).await;
    let whole = String::from_utf8_lossy(&bytes).into_owned();
    let (head, text) = whole.split_once("\r\n\r\n").unwrap_or((&whole, ""));
    let status = head.get(9..12).and_then(|status| status.parse().ok()).unwrap_or(0);
    Answer { status, head: head.to_owned(), text: text.to_owned() }
}

/// A request with headers, each with its line end, and a body of JSON where there is one.
pub fn request(host: &str, ask: &str, headers: &str, body: Option<&Value>) -> String {
    let head = format!("{ask} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{headers}");
    match body {
        None => format!("{head}\r\n"),
        Some(body) => {
            let text = body.to_string();
            format!("{head}Content-Type: application/json\r\nContent-Length: {}\r\n\r\n{text}", text.len())
        }
    }
}

impl Stage {
    /// As from another host: from another address of this one.
    pub async fn connect_from(&self, source: &str) -> std::io::Result<TcpStream> {
        let socket = TcpSocket::new_v4()?;
        socket.bind(SocketAddr::new(source.parse().unwrap(), 0))?;
        socket.connect(self.authority().parse().unwrap()).await
    }

    pub async fn raw(&self, text: &str) -> Answer {
        exchange(self.connect_from("127.0.0.1").await.unwrap(), text).await
    }

    /// `ask` is such as `GET /api/v1/me`.
    pub async fn ask(&self, ask: &str, headers: &str, body: Option<&Value>) -> Answer {
        self.raw(&request(self.authority(), ask, headers, body)).await
    }

    pub async fn status(&self, ask: &str, headers: &str) -> u16 {
        self.ask(ask, headers, None).await.status
    }

    pub async fn log_in_as(&self, name: &str, password: &str, source: &str) -> Answer {
        let body = serde_json::json!({ "name": name, "password": password });
        let text = request(self.authority(), "POST /api/v1/login", "", Some(&body));
        exchange(self.connect_from(source).await.unwrap(), &text).await
    }

    /// The header with the cookie of a new session.
    pub async fn session(&self, name: &str) -> String {
        let answer = self.log_in_as(name, PASSWORD, "127.0.0.1").await;
        assert_eq!(answer.status, 200, "{}", answer.text);
        format!("Cookie: {}\r\n", answer.cookie())
    }
}

pub fn change<T>(folder: &Path, change: impl FnOnce(&mut Users) -> T) -> T {
    users::edit(&folder.join("users.toml"), |users| Ok::<_, FileFault>(change(users))).unwrap()
}

pub fn add_user(folder: &Path, name: &str, rights: &[&str]) {
    let password = PasswordHash::of_new(PASSWORD, name).unwrap();
    let grants = rights.iter().map(|right| right.parse().unwrap()).collect();
    change(folder, |users| users.users.insert(name.parse().unwrap(), User { password, grants }));
}

/// A folder with a users file: ana is an operator of paranal, eve an engineer everywhere.
pub fn with_users() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    add_user(folder.path(), "ana", &["operator:paranal/*"]);
    add_user(folder.path(), "eve", &["engineer"]);
    folder
}
