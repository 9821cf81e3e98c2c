//! The place of a telescope, as its mount or a simulator reports it, and the time there.

use std::time::Duration;

use alpaca::discovery::Found;
use contract::Kind;
use serde_json::Value;
use units::Utc;

use crate::import::site::Location;

/// The surroundings of the devices, as far as they are known.
#[derive(Debug, Clone, Default)]
pub struct Surroundings {
    /// Their place.
    pub place: Option<Location>,
    /// Sky time there, where a simulator is all of them.
    pub simulated: Option<Utc>,
    /// For a person: which device reported the place, and which others report another.
    pub told: Vec<String>,
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
    let mut around = Surroundings::default();
    for mount in found.iter().filter(|device| device.kind == Kind::Telescope) {
        let Some(place) = crate::import::site::location(&mount.server, i64::from(mount.number)).await else { continue };
        let Location { latitude_deg, longitude_deg, elevation_m } = place;
        let words = format!(
            "{latitude_deg} deg north, {longitude_deg} deg east, {elevation_m} m, as mount {} of {} reports it ({})",
            mount.number, mount.server, mount.name
        );
        match around.place {
            None => {
                around.told.push(format!("place: {words}"));
                around.place = Some(place);
            }
            Some(taken) if taken != place => around.told.push(format!("another place, which is not taken: {words}")),
            Some(_) => {}
        }
    }
    around
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
        told: vec![format!("place and time: those of the simulator at {server}")],
    })
}
