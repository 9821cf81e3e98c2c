//! A program at the socket, byte by byte.

use serde_json::Value;
use test_support::LIMIT;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use super::Stage;

/// A WebSocket client of a few lines: it receives text frames and sends short ones.
pub struct Socket(TcpStream);

impl Socket {
    pub async fn open(stage: &Stage, path: &str, headers: &str) -> Result<Self, u16> {
        let mut stream = TcpStream::connect(stage.authority()).await.unwrap();
        let host = stage.authority();
        let ask = format!(
            "GET {path} HTTP/1.1\r\nHost: {host}\r\n{headers}Connection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        );
        stream.write_all(ask.as_bytes()).await.unwrap();
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            head.push(stream.read_u8().await.unwrap());
        }
        match String::from_utf8_lossy(&head[9..12]).parse::<u16>().unwrap() {
            101 => Ok(Self(stream)),
            status => Err(status),
        }
    }

    pub async fn recv(&mut self) -> Value {
        let [first, short] = [self.0.read_u8().await.unwrap(), self.0.read_u8().await.unwrap()];
        assert_eq!(first, 0x81, "one whole text frame, unmasked");
        let length = match short {
            126 => u64::from(self.0.read_u16().await.unwrap()),
            127 => self.0.read_u64().await.unwrap(),
            short => u64::from(short),
        };
        let mut text = vec![0; usize::try_from(length).unwrap()];
        self.0.read_exact(&mut text).await.unwrap();
        serde_json::from_slice(&text).unwrap()
    }

    /// Waits for a message that is as wanted; those before it are in the failure, but for beats.
    #[track_caller]
    pub fn until(&mut self, wanted: impl Fn(&Value) -> bool) -> impl Future<Output = Value> {
        let line = std::panic::Location::caller().line();
        async move {
            let mut passed = Vec::new();
            let looked = async {
                loop {
                    let message = self.recv().await;
                    if wanted(&message) {
                        return message;
                    }
                    passed.extend((message["op"] != "beat").then(|| message.to_string()));
                }
            };
            let found = tokio::time::timeout(LIMIT, looked).await.ok();
            found.unwrap_or_else(|| panic!("line {line}: not among {passed:#?}"))
        }
    }

    /// The code with which the server closes it; what it sends before is passed over.
    pub async fn closed(&mut self) -> u16 {
        let looked = async {
            loop {
                let [first, short] = [self.0.read_u8().await.unwrap(), self.0.read_u8().await.unwrap()];
                let length = if short == 126 { usize::from(self.0.read_u16().await.unwrap()) } else { short.into() };
                let mut content = vec![0; length];
                self.0.read_exact(&mut content).await.unwrap();
                if first == 0x88 {
                    return u16::from_be_bytes([content[0], content[1]]);
                }
            }
        };
        tokio::time::timeout(LIMIT, looked).await.unwrap()
    }

    pub async fn send(&mut self, text: &str) {
        // Clients mask; a mask of zeros is one too.
        let mut frame = match u8::try_from(text.len()) {
            Ok(length @ ..126) => vec![0x81, 0x80 | length],
            _ => [&[0x81, 0x80 | 126][..], &u16::try_from(text.len()).unwrap().to_be_bytes()].concat(),
        };
        frame.extend([0; 4]);
        frame.extend(text.as_bytes());
        self.0.write_all(&frame).await.unwrap();
    }
}
