//! What is at an address of `--connect` from which no telescope answered, for the person who wrote it.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::time::Duration;

/// An address is looked at for so long.
const LIMIT: Duration = Duration::from_secs(2);
/// What is to be done about a wrong one.
const CORRECT: &str =
    "the address is in [bus] listen of that host's observatory.toml, and `starmesh up` prints it there";

/// What is there, and what to do. Blocks for some seconds at most.
pub fn found_at(endpoint: &str) -> String {
    found_within(endpoint, LIMIT)
}

fn found_within(endpoint: &str, limit: Duration) -> String {
    let Some(address) = endpoint.strip_prefix("tcp/") else {
        return format!("{endpoint} did not answer; why is not known of an address without tcp/; {CORRECT}");
    };
    let address = address.split(['?', '#']).next().unwrap_or_default();
    let mut addresses = match address.to_socket_addrs() {
        Ok(addresses) => addresses,
        Err(error) => return format!("{endpoint} leads nowhere ({error}): correct its host; {CORRECT}"),
    };
    let connected = addresses.try_fold(None, |failed, address| match TcpStream::connect_timeout(&address, limit) {
        Ok(stream) => Err(stream),
        Err(error) => Ok(failed.or(Some(error))),
    });
    match connected {
        Err(stream) if is_web_server(&stream, limit) => format!(
            "at {endpoint} a web server answers, which is no bus: it may be the page of Starmesh or an Alpaca server, and the bus has \
             another port; {CORRECT}"
        ),
        Err(_) => format!(
            "at {endpoint} a program listens, and no telescope answers through it: it is no bus of Starmesh, or no node is on it; \
             {CORRECT}"
        ),
        Ok(Some(error)) if error.kind() == ErrorKind::ConnectionRefused => {
            format!("nothing listens at {endpoint}: start `starmesh up` there, or correct the address; {CORRECT}")
        }
        Ok(error) => {
            let why = error.map(|error| format!(" ({error})")).unwrap_or_default();
            format!("no host answers at {endpoint}{why}: look at the address, the network and the firewall; {CORRECT}")
        }
    }
}

/// Does it answer a request for a page as a web server does? A bus says nothing to it.
fn is_web_server(mut stream: &TcpStream, limit: Duration) -> bool {
    let mut answer = [0; 5];
    let asked = stream
        .set_read_timeout(Some(limit))
        .and_then(|()| stream.set_write_timeout(Some(limit)))
        .and_then(|()| stream.write_all(b"GET / HTTP/1.0\r\n\r\n"))
        .and_then(|()| stream.read_exact(&mut answer));
    asked.is_ok() && answer == *b"HTTP/"
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use super::*;

    /// The words about a server that gives each client this answer once it was asked.
    fn words_about(answer: &'static [u8]) -> (String, String) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
        let serving = std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut request = [0; 18];
            stream.read_exact(&mut request).unwrap();
            stream.write_all(answer).unwrap();
        });
        let words = found_within(&endpoint, Duration::from_secs(60));
        serving.join().unwrap();
        (endpoint, words)
    }

    #[test]
    fn a_wrong_address_is_named_with_what_is_there_and_what_to_do() {
        let nobody = found_at("tcp/127.0.0.1:1");
        assert!(nobody.starts_with("nothing listens at tcp/127.0.0.1:1: start `starmesh up` there"), "{nobody}");
        let (endpoint, web) = words_about(b"HTTP/1.1 400 Bad Request\r\n\r\n");
        assert!(web.starts_with(&format!("at {endpoint} a web server answers, which is no bus")), "{web}");
        let (endpoint, other) = words_about(b"");
        assert!(other.starts_with(&format!("at {endpoint} a program listens, and no telescope answers")), "{other}");
        for words in [nobody, web, other, found_at("udp/127.0.0.1:1"), found_at("tcp/no host:7447")] {
            assert!(words.ends_with(CORRECT), "{words}");
        }
    }
}
