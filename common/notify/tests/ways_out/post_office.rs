//! A mail server as far as RFC 5321, 3207 (STARTTLS) and 4954 (AUTH) go for one mail at a time.

use std::sync::{Arc, Mutex};

use rustls::ServerConfig;
use tokio::io::{AsyncBufReadExt as _, AsyncRead, AsyncWrite, AsyncWriteExt as _, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsAcceptor;

/// The behaviour of the server.
#[derive(Clone, Default)]
pub struct Rules {
    /// Speaks TLS from the first byte.
    pub tls: Option<Arc<ServerConfig>>,
    /// Offers STARTTLS.
    pub starttls: Option<Arc<ServerConfig>>,
    /// Offers this login, and takes mail only after it.
    pub login: Option<&'static str>,
    /// Addresses that it does not know.
    pub unknown: Vec<&'static str>,
    /// Never answers QUIT.
    pub mute_at_end: bool,
    /// Refuses each login with these words after the login that it received; the mails of others with these words
    /// alone.
    pub repeats: Option<&'static str>,
}

#[derive(Debug, Clone)]
pub struct Received {
    pub to: Vec<String>,
    pub text: String,
    pub encrypted: bool,
    pub logged_in: bool,
}

#[derive(Clone)]
pub struct PostOffice {
    pub port: u16,
    mails: Arc<Mutex<Vec<Received>>>,
    /// Every line that came in the open.
    open: Arc<Mutex<Vec<String>>>,
    rules: Rules,
}

/// `printf '\0callisto\0s3cret-Pa55' | base64`, and both alone.
const PLAIN: &str = "AGNhbGxpc3RvAHMzY3JldC1QYTU1";
const USER: &str = "Y2FsbGlzdG8=";
const PASSWORD: &str = "czNjcmV0LVBhNTU=";

trait Wire: AsyncRead + AsyncWrite + Unpin + Send {}
impl<T: AsyncRead + AsyncWrite + Unpin + Send> Wire for T {}

impl PostOffice {
    pub async fn open(rules: Rules) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let office = Self { port, mails: Arc::default(), open: Arc::default(), rules };
        let clerk = office.clone();
        tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                let clerk = clerk.clone();
                // The tests are about clients that leave in the middle.
                tokio::spawn(async move { drop(clerk.meet(stream).await) });
            }
        });
        office
    }

    pub fn mails(&self) -> Vec<Received> {
        self.mails.lock().unwrap().clone()
    }

    /// The words that came in the open, without their arguments.
    pub fn sent_in_the_open(&self) -> Vec<String> {
        let open = self.open.lock().unwrap();
        let mut words: Vec<String> =
            open.iter().map(|line| line.split(' ').next().unwrap_or_default().to_owned()).collect();
        words.sort();
        words.dedup();
        words
    }

    async fn meet(&self, stream: TcpStream) -> std::io::Result<()> {
        match &self.rules.tls {
            Some(tls) => {
                let stream = TlsAcceptor::from(tls.clone()).accept(stream).await?;
                self.serve(Box::new(stream), true, true).await
            }
            None => self.serve(Box::new(stream), false, true).await,
        }
    }

    async fn serve(&self, wire: Box<dyn Wire>, encrypted: bool, greets: bool) -> std::io::Result<()> {
        let mut wire = BufReader::new(wire);
        if greets {
            wire.write_all(b"220 mail.test ESMTP\r\n").await?;
        }
        let (mut to, mut logged_in) = (Vec::new(), false);
        while let Some(line) = self.line(&mut wire, encrypted).await? {
            let word = line.split(' ').next().unwrap_or_default().to_ascii_uppercase();
            let answer = match word.as_str() {
                "EHLO" => self.offers(encrypted),
                "STARTTLS" if self.rules.starttls.is_some() && !encrypted => {
                    wire.write_all(b"220 go ahead\r\n").await?;
                    let tls = TlsAcceptor::from(self.rules.starttls.clone().unwrap());
                    let stream = tls.accept(wire.into_inner()).await?;
                    return Box::pin(self.serve(Box::new(stream), true, false)).await;
                }
                "AUTH" if self.rules.repeats.is_some() => {
                    let words = self.rules.repeats.unwrap_or_default();
                    format!("535-5.7.8 you sent {line}\r\n535 5.7.8 {words}")
                }
                "AUTH" => {
                    logged_in = self.check(&mut wire, &line, encrypted).await?;
                    if logged_in { "235 welcome".to_owned() } else { "535 5.7.8 wrong name or password".to_owned() }
                }
                "MAIL" if self.rules.login.is_some() && !logged_in => "530 5.7.0 log in first".to_owned(),
                "RCPT" if self.rules.unknown.iter().any(|unknown| line.contains(unknown)) => {
                    "550 5.1.1 no such mailbox".to_owned()
                }
                "RCPT" => {
                    to.push(line.clone());
                    "250 ok".to_owned()
                }
                "DATA" if to.is_empty() => "503 5.5.1 for whom?".to_owned(),
                "DATA" => {
                    wire.write_all(b"354 go on\r\n").await?;
                    let mut text = String::new();
                    while let Some(line) = self.line(&mut wire, encrypted).await?.filter(|line| line != ".") {
                        text += &(line + "\n");
                    }
                    let to = std::mem::take(&mut to);
                    self.mails.lock().unwrap().push(Received { to, text, encrypted, logged_in });
                    "250 taken".to_owned()
                }
                "QUIT" if self.rules.mute_at_end => std::future::pending::<String>().await,
                "QUIT" => "221 bye".to_owned(),
                _ => "250 ok".to_owned(),
            };
            wire.write_all(format!("{answer}\r\n").as_bytes()).await?;
        }
        Ok(())
    }

    /// A server that encrypts anything offers its login only after that.
    fn offers(&self, encrypted: bool) -> String {
        let protects = self.rules.starttls.is_some() || self.rules.tls.is_some();
        let mut offers = vec!["mail.test".to_owned()];
        offers.extend(self.rules.starttls.iter().filter(|_| !encrypted).map(|_| "STARTTLS".to_owned()));
        offers.extend(self.rules.login.filter(|_| encrypted || !protects).map(|way| format!("AUTH {way}")));
        let last = offers.pop().unwrap_or_default();
        offers.iter().map(|offer| format!("250-{offer}\r\n")).collect::<String>() + "250 " + &last
    }

    async fn check(&self, wire: &mut BufReader<Box<dyn Wire>>, line: &str, encrypted: bool) -> std::io::Result<bool> {
        if Some("LOGIN") != self.rules.login {
            return Ok(line == format!("AUTH PLAIN {PLAIN}"));
        }
        let mut right = line == "AUTH LOGIN";
        // "Username:" and "Password:"
        for (question, wanted) in [("VXNlcm5hbWU6", USER), ("UGFzc3dvcmQ6", PASSWORD)] {
            wire.write_all(format!("334 {question}\r\n").as_bytes()).await?;
            right &= self.line(wire, encrypted).await?.as_deref() == Some(wanted);
        }
        Ok(right)
    }

    async fn line(&self, wire: &mut BufReader<Box<dyn Wire>>, encrypted: bool) -> std::io::Result<Option<String>> {
        let mut line = String::new();
        if wire.read_line(&mut line).await? == 0 {
            return Ok(None);
        }
        let line = line.trim_end().to_owned();
        if !encrypted {
            self.open.lock().unwrap().push(line.clone());
        }
        Ok(Some(line))
    }
}
