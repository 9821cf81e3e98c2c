//! Alpaca discovery: finds the servers of a network, and writes device blocks for `observatory.toml`.

use std::collections::BTreeSet;
use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use contract::{Kind, Name};
use serde_json::Value;
use tokio::net::UdpSocket;
use tokio::time::{Instant, timeout, timeout_at};

use crate::body::{JSON_CAP, read_capped};
use crate::client::http_client;
use crate::transaction::Transactions;
use crate::{AlpacaError, response, value};

/// The port on which Alpaca servers listen for the question.
pub const PORT: u16 = 32227;
const QUESTION: &[u8] = b"alpacadiscovery1";

/// A device that a server on the network has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Alpaca server, `host:port`.
    pub server: String,
    /// Its kind.
    pub kind: Kind,
    /// Number on that server.
    pub number: u32,
    /// The server's name for it.
    pub name: String,
    /// The driver's unique id, empty where it reports none.
    pub unique_id: String,
}

/// Asks the local network and this host, and lists the devices of all that answer within `wait`.
pub async fn discover(wait: Duration) -> std::io::Result<Vec<Found>> {
    let targets = [Ipv4Addr::BROADCAST, Ipv4Addr::LOCALHOST].map(|address| SocketAddr::from((address, PORT)));
    let mut found: Vec<Found> = Vec::new();
    for server in servers(&targets, wait).await? {
        match configured_devices(&server).await {
            // A host answers once for each route to it; the unique id shows that.
            Ok(devices) => found.extend(
                devices
                    .into_iter()
                    .filter(|new| new.unique_id.is_empty() || !found.iter().any(|old| old.unique_id == new.unique_id))
                    .collect::<Vec<_>>(),
            ),
            Err(error) => tracing::warn!(server, %error, "an Alpaca server does not list its devices"),
        }
    }
    Ok(found)
}

/// Servers that answer a question sent to `targets`.
pub async fn servers(targets: &[SocketAddr], wait: Duration) -> std::io::Result<Vec<String>> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).await?;
    socket.set_broadcast(true)?;
    for target in targets {
        // A network without broadcast must not hide the servers of this host.
        if let Err(error) = socket.send_to(QUESTION, target).await {
            tracing::debug!(%target, %error, "discovery could not ask");
        }
    }
    let (end, mut servers, mut buffer) = (Instant::now() + wait, BTreeSet::new(), [0; 2048]);
    while let Ok(received) = timeout_at(end, socket.recv_from(&mut buffer)).await {
        let Ok((length, from)) = received else { continue };
        if let Some(port) = alpaca_port(&buffer[..length]) {
            servers.insert(format!("{}:{port}", from.ip()));
        }
    }
    Ok(servers.into_iter().collect())
}

fn alpaca_port(answer: &[u8]) -> Option<u16> {
    let answer: Value = serde_json::from_slice(answer).ok()?;
    let port = answer.as_object()?.iter().find(|(key, _)| key.eq_ignore_ascii_case("AlpacaPort"))?.1;
    u16::try_from(value::whole(port).ok()?).ok()
}

/// The devices of one server, as its management interface lists them.
pub async fn configured_devices(server: &str) -> Result<Vec<Found>, AlpacaError> {
    let transactions = Transactions::fresh();
    let asked = transactions.next();
    let url = format!("http://{server}/management/v1/configureddevices?ClientID=1&ClientTransactionID={asked}");
    let asking = async {
        let response = http_client()?.get(url).send().await.map_err(|error| AlpacaError::from_http(&error))?;
        let status = response.status().as_u16();
        response::parse(status, &read_capped(response, JSON_CAP).await?, &transactions, asked)
    };
    let answer = timeout(Duration::from_secs(3), asking).await.unwrap_or_else(|_| Err(AlpacaError::timeout(3.0)))?;
    let devices = answer.value.ok_or(AlpacaError::NoValue)?;
    let devices = devices.as_array().ok_or_else(|| AlpacaError::Protocol("no list of devices".to_owned()))?;
    Ok(devices.iter().filter_map(|device| found(server, device)).collect())
}

fn found(server: &str, device: &Value) -> Option<Found> {
    let device = device.as_object()?;
    let field = |name: &str| device.iter().find(|(key, _)| key.eq_ignore_ascii_case(name)).map(|(_, value)| value);
    let text = |name: &str| field(name).and_then(Value::as_str).unwrap_or_default().to_owned();
    Some(Found {
        server: server.to_owned(),
        kind: text("DeviceType").parse().ok()?,
        number: u32::try_from(value::whole(field("DeviceNumber")?).ok()?).ok()?,
        name: text("DeviceName"),
        unique_id: text("UniqueID"),
    })
}

/// Of the names that are made of what devices call themselves.
const LONGEST_NAME: usize = 32;

/// A block ready for `observatory.toml`.
pub fn as_toml(found: &Found) -> String {
    let Found { server, kind, number, .. } = found;
    let plain: String =
        found.name.to_ascii_lowercase().chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    let words: Vec<&str> = plain.split('_').filter(|word| !word.is_empty()).collect();
    // Whole words, as many as a column of the page has room for.
    let mut plain = String::new();
    for word in words {
        let joint = if plain.is_empty() { "" } else { "_" };
        if plain.len() + joint.len() + word.len() > LONGEST_NAME && !plain.is_empty() {
            break;
        }
        plain += joint;
        plain.extend(word.chars().take(LONGEST_NAME));
    }
    let name = plain.parse::<Name>().map_or_else(|_| format!("{kind}_{number}"), |name| name.to_string());
    // A name may contain characters that end a line, or that a comment of TOML must not contain.
    let comment = contract::printable(&found.name);
    format!("# {comment}\n[[{kind}]]\nname = \"{name}\"\nserver = \"{server}\"\nnumber = {number}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_found_device_becomes_a_block_that_the_configuration_takes() {
        let found = |name: &str| Found {
            server: "10.0.0.5:11111".to_owned(),
            kind: Kind::Dome,
            number: 2,
            name: name.to_owned(),
            unique_id: "u1".to_owned(),
        };
        let place = "[observatory]\nsite = \"a\"\ntelescope = \"b\"\nlatitude_deg = 0.0\nlongitude_deg = 0.0\nelevation_m = 0.0\n";
        let long = "ASCOM Remote Driver for the Observatory's Main Dome (Controller Revision 7)";
        for (given, taken) in [
            ("Baader \"Classic\" Dome", "baader_classic_dome"),
            ("a\u{1b}[2J\u{8}\n[[camera]]", "a_2j_camera"),
            (long, "ascom_remote_driver_for_the"),
            (&"x".repeat(300), &"x".repeat(32)),
            ("<img src=x onerror=alert(1)>", "img_src_x_onerror_alert_1"),
            ("Kuppel Süd", "kuppel_s_d"),
            ("//", "dome_2"),
        ] {
            let text = as_toml(&found(given));
            let parsed = config::parse(&format!("{place}{text}"), std::path::Path::new(".")).expect(&text);
            let dome = &parsed.dome[0].common;
            assert_eq!((dome.name.as_str(), dome.server.as_str(), dome.number), (taken, "10.0.0.5:11111", 2));
            assert!(parsed.camera.is_empty(), "{text}");
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_server_that_answers_is_found_and_noise_is_not() {
        let server = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let target = server.local_addr().unwrap();
        tokio::spawn(async move {
            let mut buffer = [0; 64];
            loop {
                let (length, from) = server.recv_from(&mut buffer).await.unwrap();
                assert_eq!(&buffer[..length], QUESTION);
                for answer in ["noise", r#"{"AlpacaPort": "x"}"#, r#"{"alpacaport": 4711}"#] {
                    server.send_to(answer.as_bytes(), from).await.unwrap();
                }
            }
        });
        // An answer may come too late on a busy machine.
        let answered = async {
            loop {
                let found = servers(&[target], Duration::from_millis(300)).await.unwrap();
                if !found.is_empty() {
                    return found;
                }
            }
        };
        let found = tokio::time::timeout(Duration::from_secs(120), answered).await.unwrap();
        assert_eq!(found, ["127.0.0.1:4711"]);
    }
}
