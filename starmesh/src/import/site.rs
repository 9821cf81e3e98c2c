//! Asks devices for an import: the place of the site, where the command line does not contain it, and the values that
//! its weather stations do not measure. Nothing is connected or moved.

use std::time::Duration;

use contract::Kind;
use serde_json::Value;

use super::block::Block;
use super::entry::Notes;

/// A place on Earth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Location {
    /// Geodetic latitude, degrees, north positive.
    pub latitude_deg: f64,
    /// Degrees, east positive.
    pub longitude_deg: f64,
    /// m above the sea.
    pub elevation_m: f64,
}

const TIMEOUT: Duration = Duration::from_secs(3);
/// ASCOM's number of the error "this device does not have that".
const NOT_IMPLEMENTED: i64 = 0x400;

/// Asks the mounts, one after the other, without connecting or moving anything; `None` where none answers.
pub async fn ask(blocks: &[Block]) -> Option<Location> {
    for mount in blocks.iter().filter(|block| block.kind == Kind::Telescope) {
        if let Some(location) = location(&mount.server, mount.number).await {
            return Some(location);
        }
    }
    None
}

/// The place that a mount reports.
pub async fn location(server: &str, number: i64) -> Option<Location> {
    let client = client()?;
    let number = async |property: &str| -> Option<f64> {
        let answer = get(&client, Kind::Telescope, (server, number), property).await?;
        let is_good = answer.get("ErrorNumber").and_then(Value::as_i64).unwrap_or(0) == 0;
        answer.get("Value").and_then(Value::as_f64).filter(|value| is_good && value.is_finite())
    };
    let latitude_deg = number("sitelatitude").await?;
    let (longitude_deg, elevation_m) = (number("sitelongitude").await?, number("siteelevation").await?);
    // 0, 0 is what drivers report before anybody has set it.
    let is_reported =
        (latitude_deg, longitude_deg) != (0.0, 0.0) && latitude_deg.abs() <= 90.0 && longitude_deg.abs() <= 360.0;
    is_reported.then_some(Location { latitude_deg, longitude_deg, elevation_m })
}

fn client() -> Option<reqwest::Client> {
    local_http::client_builder().timeout(TIMEOUT).build().ok()
}

/// Removes limits on values that a station does not measure, as it reports: the predecessor ignored them, and here they
/// would hold the dome closed for ever. The new form applies as soon as there is a value.
pub async fn spare_absent(blocks: &mut [Block], notes: &mut Notes) {
    let Some(client) = client() else { return };
    for station in blocks.iter_mut().filter(|block| block.kind == Kind::ObservingConditions) {
        for index in 0..station.limits.len() {
            let Some(parameter) = station.limits.get(index).and_then(|(_, limit)| parameter(limit)) else { continue };
            let measured = match parameter.as_str() {
                "RelativeSkyTemp" => vec!["SkyTemperature", "Temperature"],
                other => vec![other],
            };
            for property in measured {
                let answer =
                    get(&client, station.kind, (&station.server, station.number), &property.to_ascii_lowercase()).await;
                let error = answer.as_ref().and_then(|answer| answer.get("ErrorNumber")).and_then(Value::as_i64);
                if error != Some(NOT_IMPLEMENTED) {
                    continue;
                }
                let place = station.place();
                let what = format!("the station has no {property}, so Astra passed over it; required = false");
                if let Some((line, limit)) = station.limits.get_mut(index) {
                    notes.add(*line, format!("{place}: limit on {parameter}: {what}"));
                    *limit = limit.trim_end_matches(" }").to_owned() + ", required = false }";
                }
                break;
            }
        }
    }
}

/// The parameter of a limit, as [`super::devices`] has written it.
fn parameter(limit: &str) -> Option<String> {
    let (word, _) = limit.strip_prefix("{ parameter = \"")?.split_once('"')?;
    Some(word.to_owned())
}

/// A property of a device, as its server answers.
async fn get(client: &reqwest::Client, kind: Kind, (server, number): (&str, i64), property: &str) -> Option<Value> {
    let kind = kind.ascom().to_lowercase();
    let device = format!("http://{server}/api/v1/{kind}/{number}");
    let address = format!("{device}/{property}?ClientID=1&ClientTransactionID=1");
    let answer = client.get(address).send().await.ok()?;
    serde_json::from_slice(&answer.bytes().await.ok()?).ok()
}
