//! Alpaca discovery: answers `alpacadiscovery1` on UDP with the server's port.

use std::io;
use std::net::Ipv4Addr;

use tokio::net::UdpSocket;

/// The question of a client; the 1 is the version.
const QUESTION: &[u8] = b"alpacadiscovery1";

/// Listens on a UDP port of all interfaces (broadcasts reach no single one).
///
/// # Errors
/// When the port is taken.
pub async fn bind(port: u16) -> io::Result<UdpSocket> {
    UdpSocket::bind((Ipv4Addr::UNSPECIFIED, port)).await
}

/// Answers until dropped.
pub async fn answer(socket: UdpSocket, alpaca_port: u16) {
    let mut question = [0; 64];
    let answer = format!("{{\"AlpacaPort\":{alpaca_port}}}");
    loop {
        match socket.recv_from(&mut question).await {
            Ok((length, from)) if question[..length].starts_with(QUESTION) => {
                let _ = socket.send_to(answer.as_bytes(), from).await;
            }
            Ok(_) => {}
            // An earlier answer was refused by its receiver; the server goes on.
            Err(_) => tokio::time::sleep(std::time::Duration::from_millis(10)).await,
        }
    }
}
