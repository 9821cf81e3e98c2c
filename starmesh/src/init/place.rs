//! The place of a telescope, as its mount or a simulator reports it, and the time there.

use std::time::Duration;

use alpaca::discovery::Found;
use contract::Kind;
use serde_json::Value;
use units::Utc;

use crate::import::site::Location;

/// The surroundings of the devices, as far as they are known.
#[derive(Debug, Clone, Copy, Default)]
pub struct Surroundings {
    /// Their place.
    pub place: Option<Location>,
    /// Sky time there, where a simulator is all of them.
    pub simulated: Option<Utc>,
}

const LIMIT: Duration = Duration::from_secs(3);

/// Asks the mounts, and the server whether it is a simulator. Nothing is connected.
pub async fn ask(found: &[Found]) -> Surroundings {
    let mut servers: Vec<&str> = found.iter().map(|device| device.server.as_str()).collect();
    servers.dedup();
    if let [only] = servers.as_slice()
        && let Some(around) = simulator(only).await
    {
        return around;
    }
    for mount in found.iter().filter(|device| device.kind == Kind::Telescope) {
        if let Some(place) = crate::import::site::location(&mount.server, i64::from(mount.number)).await {
            return Surroundings { place: Some(place), simulated: None };
        }
    }
    Surroundings::default()
}

/// The surroundings that a Starmesh simulator reports.
async fn simulator(server: &str) -> Option<Surroundings> {
    let client = local_http::client_builder().timeout(LIMIT).build().ok()?;
    let answer = client.get(format!("http://{server}/simulator/v1/world")).send().await.ok()?;
    let world: Value = serde_json::from_slice(&answer.bytes().await.ok()?).ok()?;
    let number = |key: &str| world.get("site")?.get(key)?.as_f64();
    Some(Surroundings {
        place: Some(Location {
            latitude_deg: number("latitude_deg")?,
            longitude_deg: number("longitude_deg")?,
            elevation_m: number("elevation_m")?,
        }),
        simulated: Some(world.get("utc")?.as_str()?.parse().ok()?),
    })
}
